"""The log that a run keeps of its steps, and what it tells of them."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxmps._types import Scalar
from jaxmps.flow import Case, Event, Particles, Status, mechanical_energy
from jaxmps.monitor import BITS, StepInfo

_RUNAWAY = 10.0  # times the speed that all its energy would give to a particle: impacts throw water up, not so fast


class Log(NamedTuple):
    """Sums over the steps of a run; of each of `BITS` its number and, of the first, step, time, particle, value.

    `lost`: the sum of `StepInfo.loss`; `put_in`: what noise gave, and walls where they gave and did not take; `scale`:
    energy [J/kg] that the flow had at the start, kinetic and what falling through its whole height would give.
    """

    steps: Int[Array, ""]
    residual: Scalar
    max_speed: Scalar
    closest: Scalar
    stabilized: Scalar
    work: Scalar
    given: Scalar
    wall_work: Scalar
    lost: Scalar
    put_in: Scalar
    scale: Scalar
    count: Int[Array, " bits"]
    step: Int[Array, " bits"]
    time: Float[Array, " bits"]
    particle: Int[Array, " bits"]
    position: Float[Array, "bits d"]
    value: Float[Array, " bits"]


def empty_log(case: Case, particles: Particles) -> Log:
    """The log of a run that starts with these particles."""
    none, zero = jnp.zeros(len(BITS), jnp.int32), jnp.zeros(len(BITS))
    count, place, no = jnp.zeros((), jnp.int32), jnp.zeros((len(BITS), case.dim)), jnp.zeros(())
    # Of strong type: the program of all later steps would be another one than that of the first.
    far = jnp.full((), jnp.inf, zero.dtype)
    height = jnp.where(particles.fluid, particles.position @ case.gravity, jnp.nan)
    fall = jnp.where(jnp.any(particles.fluid), jnp.nanmax(height) - jnp.nanmin(height), 0.0)
    scale = mechanical_energy(particles, case.density, case.gravity).kinetic + fall
    return Log(count, no, no, far, no, no, no, no, no, no, scale, none, none, zero, none, place, zero)


def judged(log: Log, info: StepInfo, particles: Particles) -> StepInfo:
    """The step with `RUNAWAY` in its status, where the energy of the flow has risen by more than all that it had and
    was given, or a particle is ten times as fast as all this would make it. `particles` are those at the step's start.
    """
    of_walls = jnp.max(jnp.where(particles.fixed, jnp.sum(particles.velocity**2, axis=-1), 0.0))
    allowed = log.scale + log.put_in + _put_in(info) + 0.5 * of_walls
    fast = 0.5 * info.max_speed**2 > _RUNAWAY**2 * allowed
    runaway = (allowed > 0) & (fast | (_risen(log, info) > allowed)) & ((info.status & int(Status.TABLE_FULL)) == 0)
    return info._replace(status=info.status | jnp.where(runaway, int(Status.RUNAWAY), 0))


def _put_in(info: StepInfo) -> Scalar:
    """Energy [J/kg] that noise gave in a step, and walls if they did not take it."""
    return info.given + jnp.maximum(info.wall_work, 0.0)


def _risen(log: Log, info: StepInfo) -> Scalar:
    """By how much [J/kg] the energy has risen that neither walls nor noise gave."""
    return -(log.lost + log.given + info.loss + info.given)


def extend(log: Log, info: StepInfo, accepted: Bool[Array, ""], particles: Particles, time: Scalar, step: Array) -> Log:
    """The log with one more step; `particles` and `time` [s] are those at the step's start."""
    status, none = info.status, jnp.zeros_like(info.residual)
    # From a step that is not taken nobody escapes.
    raised = jnp.stack([((status & int(bit)) != 0) & (accepted | (bit != Status.ESCAPED)) for bit in BITS])
    first = raised & (log.count == 0)
    amount = jnp.where(jnp.array([bit == Status.ESCAPED for bit in BITS]), info.escaped, 1)
    value = jnp.stack([none, info.travel, none, info.residual, none, none, info.residual, _risen(log, info)])
    return Log(
        steps=log.steps + accepted,
        residual=log.residual + jnp.where(accepted, info.residual, 0.0),
        max_speed=jnp.where(accepted, jnp.maximum(log.max_speed, info.max_speed), log.max_speed),
        closest=jnp.where(accepted, jnp.minimum(log.closest, info.closest), log.closest),
        stabilized=log.stabilized + jnp.where(accepted, info.stabilized, 0),
        work=log.work + jnp.where(accepted, info.work, 0.0),
        given=log.given + jnp.where(accepted, info.given, 0.0),
        wall_work=log.wall_work + jnp.where(accepted, info.wall_work, 0.0),
        lost=log.lost + jnp.where(accepted, info.loss, 0.0),
        put_in=log.put_in + jnp.where(accepted, _put_in(info), 0.0),
        scale=log.scale,
        count=log.count + jnp.where(raised, amount, 0).astype(log.count.dtype),
        step=jnp.where(first, step, log.step).astype(log.step.dtype),
        time=jnp.where(first, time, log.time),
        particle=jnp.where(first, info.culprit, log.particle).astype(log.particle.dtype),
        position=jnp.where(first[:, None], particles.position[info.culprit], log.position),
        value=jnp.where(first, value, log.value),
    )


def events(log: Log) -> tuple[Event, ...]:
    """What a log tells to a person; a full table is repaired and not worth telling."""
    told = []
    for i, bit in enumerate(BITS):
        if not int(log.count[i]) or bit == Status.TABLE_FULL:
            continue
        has_place = int(log.particle[i]) >= 0
        has_value = bit in (
            Status.TIME_STEP_TOO_LARGE,
            Status.NOT_CONVERGED,
            Status.SOLVE_FAILED,
            Status.RUNAWAY,
        )
        told.append(
            Event(
                status=int(bit),
                time=float(log.time[i]),
                step=int(log.step[i]),
                particle=int(log.particle[i]) if has_place else None,
                position=tuple(float(x) for x in log.position[i]) if has_place else None,
                value=float(log.value[i]) if has_value else None,
                count=int(log.count[i]),
            )
        )
    return tuple(told)
