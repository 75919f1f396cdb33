"""What a step tells of itself, and the log that a run keeps of it."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxmps._types import Scalar
from jaxmps.flow import Case, Energy, Event, Kind, Particles, Status, mechanical_energy
from jaxmps.models import Push
from jaxmps.neighbors import Pairs
from jaxmps.pressure import Convergence

BITS = (
    Status.NOT_FINITE,
    Status.TIME_STEP_TOO_LARGE,
    Status.TABLE_FULL,
    Status.NOT_CONVERGED,
    Status.ESCAPED,
    Status.WALL_OUTSIDE,
)
"""The status bits that a step can raise, in the order of `StepInfo.culprit`."""


class StepInfo(NamedTuple):
    """What a step tells of itself.

    `status`: bits of `Status`; `culprit`: for each of `BITS` the particle it is about; `residual`: true relative
    residual of the pressure solve; `travel`: largest displacement in spacings; `max_speed` [m/s]; `surface_count`,
    `escaped`: numbers of particles; `closest`: distance of the closest pair in spacings, before the correction;
    `stabilized`: pairs that the stabilizer kept apart; `work`: energy [J/kg] that it gave; `given`: energy [J/kg] that
    the noise gave; `energy` [J/kg]; `dt` [s].
    """

    status: Int[Array, "*steps"]
    culprit: Int[Array, "*steps bits"]
    residual: Float[Array, "*steps"]
    travel: Float[Array, "*steps"]
    max_speed: Float[Array, "*steps"]
    surface_count: Int[Array, "*steps"]
    escaped: Int[Array, "*steps"]
    closest: Float[Array, "*steps"]
    stabilized: Int[Array, "*steps"]
    work: Float[Array, "*steps"]
    given: Float[Array, "*steps"]
    energy: Energy
    dt: Float[Array, "*steps"]


def inspect(
    case: Case,
    old: Particles,
    new: Particles,
    near: Pairs,
    surface: Bool[Array, " n"],
    push: Push,
    given: Scalar,
    dt: Scalar,
    convergence: Convergence,
    overflow: Bool[Array, ""],
) -> tuple[Particles, StepInfo]:
    """Takes out the particles that left the domain, wraps periodic axes, and finds what is wrong with a step."""
    travel = new.position - old.position
    # Walls are put where their motion has them, however many periods away from the image of before.
    travel = jnp.where(old.fluid[:, None], travel, case.box.displacement(travel))
    squared_travel = jnp.sum(travel**2, axis=-1) / case.spacing**2
    squared_speed = jnp.sum(new.velocity**2, axis=-1)
    finite = jnp.isfinite(squared_travel) & jnp.isfinite(squared_speed) & jnp.isfinite(new.pressure)
    outside = finite & (new.kind != Kind.REMOVED) & ~case.box.contains(new.position)
    gone, astray = outside & new.fluid, outside & ~new.fluid
    kept = Particles(
        position=case.box.wrap(new.position),
        velocity=jnp.where(gone[:, None], 0.0, new.velocity),
        pressure=jnp.where(gone, 0.0, new.pressure),
        kind=jnp.where(gone, jnp.asarray(Kind.REMOVED, new.kind.dtype), new.kind),
        phase=new.phase,
    )
    fastest = jnp.argmax(squared_travel)
    raised = jnp.stack(
        [
            ~jnp.all(finite),
            squared_travel[fastest] > 1.0,
            overflow,
            ~convergence.converged,
            jnp.any(gone),
            jnp.any(astray),
        ]
    )
    # With pairs missing, nothing else that the step shows means anything: it has to be repeated.
    raised = jnp.where(overflow, jnp.array([bit == Status.TABLE_FULL for bit in BITS]), raised)
    nobody = jnp.array(-1)
    culprit = jnp.stack([jnp.argmin(finite), fastest, nobody, nobody, jnp.argmax(gone), jnp.argmax(astray)])
    info = StepInfo(
        status=jnp.sum(jnp.where(raised, jnp.array([int(bit) for bit in BITS]), 0)),
        culprit=culprit,
        residual=convergence.residual,
        # Roots have no derivative at rest, and these are there to be looked at.
        travel=jnp.sqrt(lax.stop_gradient(squared_travel[fastest])),
        max_speed=jnp.sqrt(lax.stop_gradient(jnp.max(jnp.where(kept.fluid, squared_speed, 0.0)))),
        surface_count=jnp.sum(surface),
        escaped=jnp.sum(gone),
        closest=jnp.min(jnp.where(near.present & old.fluid[:, None], near.distance, jnp.inf)) / case.spacing,
        stabilized=push.pairs,
        work=_work(case, new, push),
        given=given,
        energy=mechanical_energy(kept, case.density, case.gravity),
        dt=dt,
    )
    return kept, info


def _work(case: Case, new: Particles, push: Push) -> Scalar:
    """Energy [J/kg] that the stabilizer has given to the fluid: kinetic, and potential by its displacement."""
    before = eqx.tree_at(
        lambda p: (p.position, p.velocity), new, (new.position - push.displacement, new.velocity - push.velocity)
    )
    energies = (mechanical_energy(p, case.density, case.gravity).total for p in (new, before))
    return jnp.subtract(*energies)


class Log(NamedTuple):
    """Sums over the steps of a run; of each of `BITS` its number and, of the first, step, time, particle, value."""

    steps: Int[Array, ""]
    residual: Scalar
    max_speed: Scalar
    closest: Scalar
    stabilized: Scalar
    work: Scalar
    given: Scalar
    count: Int[Array, " bits"]
    step: Int[Array, " bits"]
    time: Float[Array, " bits"]
    particle: Int[Array, " bits"]
    position: Float[Array, "bits d"]
    value: Float[Array, " bits"]


def empty_log(dim: int) -> Log:
    none, zero = jnp.zeros(len(BITS), jnp.int32), jnp.zeros(len(BITS))
    count, place = jnp.zeros((), jnp.int32), jnp.zeros((len(BITS), dim))
    # Of strong type: the program of all later steps would be another one than that of the first.
    far = jnp.full((), jnp.inf, zero.dtype)
    sums = (jnp.zeros(()), jnp.zeros(()), far, jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))
    return Log(count, *sums, none, none, zero, none, place, zero)


def extend(log: Log, info: StepInfo, accepted: Bool[Array, ""], particles: Particles, time: Scalar, step: Array) -> Log:
    """The log with one more step; `particles` and `time` [s] are those at the step's start."""
    status, none = info.status, jnp.zeros_like(info.residual)
    # From a step that is not taken nobody escapes.
    raised = jnp.stack([((status & int(bit)) != 0) & (accepted | (bit != Status.ESCAPED)) for bit in BITS])
    first = raised & (log.count == 0)
    amount = jnp.where(jnp.array([bit == Status.ESCAPED for bit in BITS]), info.escaped, 1)
    value = jnp.stack([none, info.travel, none, info.residual, none, none])
    return Log(
        steps=log.steps + accepted,
        residual=log.residual + jnp.where(accepted, info.residual, 0.0),
        max_speed=jnp.where(accepted, jnp.maximum(log.max_speed, info.max_speed), log.max_speed),
        closest=jnp.where(accepted, jnp.minimum(log.closest, info.closest), log.closest),
        stabilized=log.stabilized + jnp.where(accepted, info.stabilized, 0),
        work=log.work + jnp.where(accepted, info.work, 0.0),
        given=log.given + jnp.where(accepted, info.given, 0.0),
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
        has_value = bit in (Status.TIME_STEP_TOO_LARGE, Status.NOT_CONVERGED)
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
