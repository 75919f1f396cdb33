"""Several runs as one compiled program: a run in each lane, lanes side by side on a device, devices side by side."""

import copy
import time as clock
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from jaxmps._compilation import jit
from jaxmps._types import Scalar
from jaxmps.ensembles.members import Member, split
from jaxmps.flow import FATAL, Case, Outcome
from jaxmps.running import Clock, Log, Loop, Meter, Upkeep, advance_chunk, empty_log, events, start, unsolved
from jaxmps.stepping import State

T = TypeVar("T")
Look = Callable[[Case, State, Log], Any]
_CHUNK_SECONDS = 1.0


class Alone:
    """One run by the program of `simulate`, bit for bit."""

    def __init__(self, member: Member, dt: Scalar | None, look: Look):
        self._loop = Loop(member.case, member.scheme, start(member.case, member.scheme), dt, member.key)
        self._look = look

    @property
    def alive(self) -> np.ndarray:
        return np.array([not self._loop.outcome.flags & FATAL])

    @property
    def outcomes(self) -> list[Outcome]:
        return [self._loop.outcome]

    def reach(self, target: float) -> None:
        self._loop.reach(target, Meter(None, target))

    def look(self, target: float | None = None) -> Any:
        """What is seen now; at the start with the pressure of the first step towards a time `target` [s]."""
        loop, state = self._loop, self._loop.state
        if target is not None and unsolved(state):
            state = _with_pressure(state, loop.first_pressure(target, Meter(None, target)))
        seen = jax.device_get(_look(self._look, loop.case, state, loop.log))
        return jax.tree.map(lambda x: np.asarray(x)[None], seen)


class Lanes:
    """Runs that differ in values alone. One that fails stays as it was and costs no more steps; lanes are filled up to
    a multiple of the number of devices with copies that never move.
    """

    def __init__(self, batch: Sequence[Member], dt: Scalar | None, look: Look, devices: Sequence[Any]):
        self.count, self._look, self._dt = len(batch), look, dt
        self._mesh = Mesh(np.array(devices), ("lanes",)) if len(devices) > 1 else None
        filled = [*batch, *[batch[0]] * (-len(batch) % len(devices))]
        self._cases = [member.case.undescribed() for member in filled]
        self._own, self._shared = split([(c, m.scheme) for c, m in zip(self._cases, filled, strict=True)])
        self._state = _stacked([start(member.case, member.scheme) for member in filled])
        self._keys = jnp.stack([member.key for member in filled])
        self._log = _stacked([empty_log(c, _lane(self._state, k).particles) for k, c in enumerate(self._cases)])
        self._time, self._largest = float(self._state.time[0]), jnp.zeros_like(self._state.time)
        self._upkeep = Upkeep(self._cases[0], filled[0].scheme, len(filled))
        self._upkeep.going[self.count :] = False

    @property
    def alive(self) -> np.ndarray:
        return self._upkeep.going[: self.count]

    @property
    def outcomes(self) -> list[Outcome]:
        return [self._upkeep.outcome(k, events(_lane(self._log, k))) for k in range(self.count)]

    def look(self, target: float | None = None) -> Any:
        """What is seen now; at the start with the pressure of the first step towards a time `target` [s]."""
        state = self._state if target is None else _with_pressure(self._state, self._first_pressure(target))
        seen = jax.device_get(_look_lanes(self._look, self._own, self._shared, state, self._log))
        return jax.tree.map(lambda x: x[: self.count], seen)

    def _first_pressure(self, target: float) -> Any:
        """As `Loop.first_pressure`, of lanes that have no pressure yet."""
        state, zero, upkeep = self._state, jnp.zeros_like(self._state.time), copy.deepcopy(self._upkeep)
        timer = Clock(jnp.where(upkeep.going, target - self._time, 0.0), zero, zero, self._largest)
        grown: Any = state.neighbors
        while grown is not None:  # from the same start, with larger tables
            carry, steps = (state, timer, self._log), jnp.asarray(1)
            (found, _, _), status = _advance(self._mesh, self._own, self._shared, carry, self._dt, self._keys, steps)
            grown = upkeep.after(np.asarray(status), partial(_lane, state))
            if grown is not None:
                state = eqx.tree_at(lambda s: s.neighbors, state, _stacked(grown))
        new = np.array([unsolved(_lane(self._state, k)) for k in range(len(upkeep.going))])
        return jnp.where(new[:, None], found.particles.pressure, self._state.particles.pressure)

    def reach(self, target: float) -> None:
        """Steps of all that are alive until the time `target` [s]; each takes those that it would take alone."""
        zero, upkeep = jnp.zeros_like(self._state.time), self._upkeep
        timer = Clock(jnp.where(upkeep.going, target - self._time, 0.0), zero, zero, self._largest)
        while np.any(np.asarray(timer.elapsed) < np.asarray(timer.duration)):
            began = clock.perf_counter()
            carry, steps = (self._state, timer, self._log), jnp.asarray(upkeep.steps)
            carry, status = _advance(self._mesh, self._own, self._shared, carry, self._dt, self._keys, steps)
            self._state, timer, self._log = carry
            self._largest = timer.largest
            grown = upkeep.after(np.asarray(status), lambda lane: _lane(self._state, lane))
            if grown is not None:
                self._state = eqx.tree_at(lambda s: s.neighbors, self._state, _stacked(grown))
            timer = timer._replace(duration=jnp.where(upkeep.going, timer.duration, timer.elapsed))
            upkeep.pace(clock.perf_counter() - began, _CHUNK_SECONDS)
        self._time = target
        time = jnp.where(upkeep.going, jnp.asarray(target, zero.dtype), self._state.time)
        self._state = eqx.tree_at(lambda s: s.time, self._state, time)


def _with_pressure(state: State, pressure: Any) -> State:
    return eqx.tree_at(lambda s: s.particles.pressure, state, pressure)


def _lane(tree: T, lane: int) -> T:
    return jax.tree.map(lambda x: x[lane], tree)


def _stacked(trees: Sequence[Any]) -> Any:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def _over_lanes(function: Callable[..., Any], *arguments: Any) -> Any:
    """The function of each lane; of a single one without a leading axis, as if it were alone."""
    if jax.tree.leaves(arguments)[0].shape[0] > 1:
        return jax.vmap(function)(*arguments)
    result = function(*jax.tree.map(lambda x: x[0], arguments))
    return jax.tree.map(lambda x: x[None], result)


def _advance_lanes(mesh, own, shared, carry, dt, keys, most_steps):
    def on_a_device(shared, dt, most_steps, carry, keys, own):
        def one(carry, key, own):
            case, scheme = eqx.combine(own, shared)
            return advance_chunk(case, scheme, carry, dt, key, most_steps)

        return _over_lanes(one, carry, keys, own)

    each, every = PartitionSpec("lanes"), PartitionSpec()
    specs = (every, every, every, each, each, each)
    # Loops end on each device by themselves: nothing is varying or not across devices that has to be checked.
    spread = partial(jax.shard_map, mesh=mesh, in_specs=specs, out_specs=each, check_vma=False)
    run = on_a_device if mesh is None else spread(on_a_device)
    return run(shared, dt, most_steps, carry, keys, own)


_advance = jit(_advance_lanes, static_argnums=0)


def _look_at(look, case, state, log):
    return look(case, state, log)


_look = jit(_look_at, static_argnums=0)


def _look_at_lanes(look, own, shared, state, log):
    return _over_lanes(lambda state, log, own: look(eqx.combine(own, shared)[0], state, log), state, log, own)


_look_lanes = jit(_look_at_lanes, static_argnums=0)
