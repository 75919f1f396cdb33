"""The host's loop of a run: chunks of compiled steps up to the next frame, and what is to be done between them."""

import dataclasses
import math
import time as clock
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key
from scipy.spatial import KDTree

from jaxmps._compilation import jit
from jaxmps._types import Scalar
from jaxmps.flow import FATAL, Case, Event, Outcome, Status
from jaxmps.kernels import lattice
from jaxmps.monitor import Log, empty_log, events, extend
from jaxmps.neighbors import grow
from jaxmps.running.progress import Meter
from jaxmps.scheme import Scheme
from jaxmps.stepping import State, largest_step, step

_COLLAPSE = 1e-3  # of the largest time step so far: speeds a thousand times as high are not a flow any more
_CHUNK_SECONDS = 0.4  # wall time between two looks at the keyboard and the progress bar
_FEWEST = 4  # steps in a call: its temporaries, a gigabyte for 500 000 particles, are fresh memory in each call


class Clock(NamedTuple):
    """Time [s] to the next frame: carried unrounded from chunk to chunk, so that chunks leave no trace in the results.

    `largest` is the largest time step so far in the run. A checkpoint has the clock, too.
    """

    duration: Scalar
    elapsed: Scalar
    dt: Scalar
    largest: Scalar


Progress: TypeAlias = tuple[State, Clock, Log]


class Loop:
    """The host's loop: chunks of compiled steps, with repair of the neighbor table in between."""

    def __init__(self, case: Case, scheme: Scheme, state: State, dt: Scalar | None, key: Array):
        self.case, self.scheme, self.state, self.dt, self.key = case.undescribed(), scheme, state, dt, key
        self.log = empty_log(case.dim)
        self._noted: tuple[Event, ...] = ()
        self._chunk, zero = 16, jnp.zeros_like(state.time)
        self.timer = Clock(zero, zero, zero, zero)
        self._most = most_slots(case, scheme)

    @property
    def outcome(self) -> Outcome:
        return Outcome(events(self.log) + self._noted)

    def note(self, bit: Status) -> None:
        self._noted = (*self._noted, happened(self.state, bit, self.case.spacing))

    def halve(self, event: Event) -> None:
        """Takes half the time step from here on, fixed or adaptive, and notes why."""
        if self.dt is None:
            rule = jax.tree.map(lambda limit: 0.5 * limit, self.scheme.time_step)
            self.scheme = eqx.tree_at(lambda s: s.time_step, self.scheme, rule)
        else:
            self.dt = 0.5 * self.dt
        self.timer = self.timer._replace(largest=0.5 * self.timer.largest)
        self._noted = (*self._noted, event)

    def reach(self, target: float, bar: Meter, look: Callable[[], None] = lambda: None) -> None:
        """Steps until the time `target` [s], or to the last good state before a failure.

        Before each chunk it calls `look`, which may keep state, timer and log: a loop that is given them goes on there.
        """
        zero = jnp.zeros((), self.state.time.dtype)
        if float(self.timer.elapsed) >= float(self.timer.duration):
            self.timer = Clock(zero + (target - float(self.state.time)), zero, zero, self.timer.largest)
        while float(self.timer.elapsed) < float(self.timer.duration):
            look()
            began = clock.perf_counter()
            carry = (self.state, self.timer, self.log)
            carry, status = _advance(self.case, self.scheme, carry, self.dt, self.key, jnp.asarray(self._chunk))
            self.state, self.timer, self.log = carry
            bar.update(float(self.state.time), float(self.timer.dt), float(self.log.max_speed))
            if int(status) & Status.TIME_STEP_COLLAPSED:
                self.note(Status.TIME_STEP_COLLAPSED)
            if int(status) & FATAL:
                return
            if int(status) & Status.TABLE_FULL and not self._enlarge():
                return
            seconds = clock.perf_counter() - began
            self._chunk = next_chunk(self._chunk, seconds, _CHUNK_SECONDS)
        time = jnp.asarray(target, self.state.time.dtype)
        self.state = eqx.tree_at(lambda s: s.time, self.state, time)

    def _enlarge(self) -> bool:
        neighbors = grow(self.state.neighbors, self.state.particles.position)
        if neighbors.capacity > self._most:
            self.note(Status.CLUSTERED)
            return False
        self.state = eqx.tree_at(lambda s: s.neighbors, self.state, neighbors)
        return True


def next_chunk(steps: int, seconds: float, wanted: float) -> int:
    """Steps of the next chunk, which is to take the time `wanted` [s], after one of so many that took `seconds`."""
    return int(np.clip(steps * wanted / seconds, _FEWEST, min(2 * steps, 4096)))


def most_slots(case: Case, scheme: Scheme) -> int:
    """Slots of a neighbor table beyond which it is not enlarged: particles have collapsed into clusters then."""
    return min(40 * lattice(scheme.ratio, case.dim).neighbors, len(case.particles.kind))


def frame_times(begin: float, until: float, save_every: float) -> list[float]:
    """The times [s] of the frames: that of the start, multiples of `save_every` after it, and `until`."""
    first = math.floor(begin / save_every + 1e-6) + 1
    last = math.ceil(until / save_every - 1e-9)
    return [begin, *(min(frame * save_every, until) for frame in range(first, last + 1))]


def happened(state: State, bit: Status, spacing: float) -> Event:
    """The event that a run ended with at this state: of a collapsed time step with the fastest particle, of clusters
    with one of the closest.
    """
    event = Event(int(bit), float(state.time), int(state.step))
    if bit not in (Status.TIME_STEP_COLLAPSED, Status.CLUSTERED):
        return event
    fluid = np.flatnonzero(state.particles.fluid)
    position = np.asarray(state.particles.position)[fluid]
    if bit == Status.TIME_STEP_COLLAPSED:
        speed = np.linalg.norm(np.asarray(state.particles.velocity)[fluid], axis=1)
        found, value = int(np.argmax(speed)), float(speed.max())
    else:
        distance = KDTree(position).query(position, k=2)[0][:, 1]
        found, value = int(np.argmin(distance)), float(distance.min()) / spacing
    return dataclasses.replace(event, particle=int(fluid[found]), position=tuple(position[found].tolist()), value=value)


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
        status = info.status | jnp.where(collapsed, int(Status.TIME_STEP_COLLAPSED), 0)
        accepted = (status & stop) == 0
        log = extend(log, info, accepted, state.particles, state.time, state.step)
        elapsed = jnp.where(count > 1, timer.elapsed + now, timer.duration)
        ahead = (new, Clock(timer.duration, elapsed, now, largest))
        state, timer = jax.tree.map(lambda a, b: jnp.where(accepted, a, b), ahead, (state, timer))
        return (state, timer, log), status

    return jax.lax.while_loop(going, body, (carry, jnp.zeros((), int)))


_advance = jit(advance_chunk)
