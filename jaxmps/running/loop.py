"""The host's loop of a run: chunks of compiled steps up to the next frame, and what is to be done between them."""

import math
import time as clock
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from jaxmps._compilation import jit
from jaxmps._types import Scalar
from jaxmps.flow import FATAL, Case, Event, Outcome, Status
from jaxmps.running.log import Log, empty_log, events, extend, judged
from jaxmps.running.progress import Meter
from jaxmps.running.upkeep import Upkeep, happened
from jaxmps.scheme import Scheme
from jaxmps.stepping import State, largest_step, step

_COLLAPSE = 1e-3  # of the largest time step so far: speeds a thousand times as high are not a flow any more
_CHUNK_SECONDS = 0.4  # wall time between two looks at the keyboard and the progress bar


class Clock(NamedTuple):
    """Time [s] to the next frame: carried unrounded from chunk to chunk, so that chunks leave no trace in the results.

    `largest` is the largest time step so far in the run. A checkpoint has the clock, too.
    """

    duration: Scalar
    elapsed: Scalar
    dt: Scalar
    largest: Scalar


Progress: TypeAlias = tuple[State, Clock, Log]


class Snapshot(NamedTuple):
    """All that a run goes on from: what the compiled steps carry, and the events noted beside their log."""

    state: State
    timer: Clock
    log: Log
    notes: tuple[Event, ...] = ()

    @property
    def carry(self) -> Progress:
        return self.state, self.timer, self.log


class Loop:
    """The host's loop of a run: chunks of compiled steps, with `Upkeep` in between."""

    def __init__(self, case: Case, scheme: Scheme, state: State, dt: Scalar | None, key: Array):
        self.case, self.scheme, self.dt, self.key = case.undescribed(), scheme, dt, key
        zero = jnp.zeros_like(state.time)
        self._carry: Progress = (state, Clock(zero, zero, zero, zero), empty_log(self.case, state.particles))
        self._upkeep = Upkeep(case, scheme)

    @property
    def state(self) -> State:
        return self._carry[0]

    @property
    def log(self) -> Log:
        return self._carry[2]

    @property
    def outcome(self) -> Outcome:
        return self._upkeep.outcome(0, events(self.log))

    @property
    def snapshot(self) -> Snapshot:
        """Where the run stands; it can be put back there, or another loop of the same run."""
        return Snapshot(*self._carry, self._upkeep.notes[0])

    def put_back(self, snapshot: Snapshot) -> None:
        """Goes on from a snapshot. How many steps a chunk has leaves no trace in a run, and is not part of it."""
        self._carry, self._upkeep.notes[0] = snapshot.carry, snapshot.notes
        self._upkeep.going[0] = not self.outcome.flags & FATAL

    def note(self, bit: Status) -> None:
        self._upkeep.note(0, happened(self.case, self.state, bit))

    def halve(self, event: Event) -> None:
        """Takes half the time step from here on, fixed or adaptive, and notes why."""
        if self.dt is None:
            rule = jax.tree.map(lambda limit: 0.5 * limit, self.scheme.time_step)
            self.scheme = eqx.tree_at(lambda s: s.time_step, self.scheme, rule)
        else:
            self.dt = 0.5 * self.dt
        state, timer, log = self._carry
        self._carry = state, timer._replace(largest=0.5 * timer.largest), log
        self._upkeep.note(0, event)

    def first_pressure(self, target: float, bar: Meter) -> Array:
        """Pressure [Pa] that the first step towards the time `target` [s] finds; the loop itself takes none.

        The step is the run's own, made by the same program. One that fails leaves the pressure as it is.
        """
        ahead = Loop(self.case, self.scheme, self.state, self.dt, self.key)
        ahead._upkeep.steps = 1
        ahead._turn(target)
        while not int(ahead.log.steps) and ahead._upkeep.going[0]:
            ahead._chunk(bar)
        return ahead.state.particles.pressure

    def reach(self, target: float, bar: Meter, look: Callable[[], None] = lambda: None) -> None:
        """Steps until the time `target` [s], or to the last good state before a failure.

        Before each chunk it calls `look`, which may keep a snapshot.
        """
        self._turn(target)
        while float(self._carry[1].elapsed) < float(self._carry[1].duration):
            look()
            began = clock.perf_counter()
            self._chunk(bar)
            if not self._upkeep.going[0]:
                return
            self._upkeep.pace(clock.perf_counter() - began, _CHUNK_SECONDS)
        self._set(lambda s: s.time, jnp.asarray(target, self.state.time.dtype))

    def _turn(self, target: float) -> None:
        """Sets the clock for the time `target` [s], unless the loop is on its way."""
        state, timer, log = self._carry
        if float(timer.elapsed) >= float(timer.duration):
            zero = jnp.zeros_like(state.time)
            self._carry = state, Clock(zero + (target - float(state.time)), zero, zero, timer.largest), log

    def _chunk(self, bar: Meter) -> None:
        """Some steps, and what the host has to do after them."""
        steps = jnp.asarray(self._upkeep.steps)
        self._carry, status = _advance(self.case, self.scheme, self._carry, self.dt, self.key, steps)
        state, timer, log = self._carry
        bar.update(float(state.time), float(timer.dt), float(log.max_speed))
        grown = self._upkeep.after(np.asarray(status)[None], lambda _: self.state)
        if grown is not None:
            self._set(lambda s: s.neighbors, grown[0])

    def _set(self, where: Callable[[State], Any], value: Any) -> None:
        state, timer, log = self._carry
        self._carry = eqx.tree_at(where, state, value), timer, log


def frame_times(begin: float, until: float, save_every: float) -> list[float]:
    """The times [s] of the frames: that of the start, multiples of `save_every` after it, and `until`."""
    first = math.floor(begin / save_every + 1e-6) + 1
    last = math.ceil(until / save_every - 1e-9)
    return [begin, *(min(frame * save_every, until) for frame in range(first, last + 1))]


def advance_chunk(
    case: Case, scheme: Scheme, carry: Progress, dt: Scalar | None, key: Key[Array, ""], most_steps: Array
) -> tuple[Progress, Array]:
    """Up to `most_steps` steps towards the next frame; a step that fails or finds the table full is not taken."""
    last = carry[2].steps + most_steps
    stop = int(FATAL | Status.TABLE_FULL)

    def going(loop):
        (_, timer, log), status = loop
        return (timer.elapsed < timer.duration) & (log.steps < last) & ((status & stop) == 0)

    def body(loop):
        (state, timer, log), _ = loop
        limit = largest_step(case, scheme, state.particles) if dt is None else dt
        remaining = timer.duration - timer.elapsed
        # Equal steps up to the frame: a last tiny one would blow up sources that go as 1 / dt².
        count = jnp.maximum(jnp.ceil(remaining / limit * (1.0 - 1e-6)), 1.0)
        now = (remaining / count).astype(remaining.dtype)
        largest = jnp.maximum(timer.largest, now)
        collapsed = limit < _COLLAPSE * largest
        new, info = step(case, scheme, state, now, jax.random.fold_in(key, state.step))
        info = judged(log, info, state.particles)
        status = info.status | jnp.where(collapsed, int(Status.TIME_STEP_COLLAPSED), 0)
        accepted = (status & stop) == 0
        log = extend(log, info, accepted, state.particles, state.time, state.step)
        elapsed = jnp.where(count > 1, timer.elapsed + now, timer.duration)
        ahead = (new, Clock(timer.duration, elapsed, now, largest))
        state, timer = jax.tree.map(lambda a, b: jnp.where(accepted, a, b), ahead, (state, timer))
        return (state, timer, log), status

    return jax.lax.while_loop(going, body, (carry, jnp.zeros((), int)))


_advance = jit(advance_chunk)
