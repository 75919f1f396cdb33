"""What a step tells of itself."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxmps._types import Scalar
from jaxmps.flow import Case, Energy, Kind, Particles, Status, mechanical_energy
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
    Status.SOLVE_FAILED,
    Status.RUNAWAY,
)
"""The status bits that a step can raise, in the order of `StepInfo.culprit`."""


_FAILED = 0.1  # of its right-hand side that a solve leaves over: what it gives is no pressure


class Work(NamedTuple):
    """Energies [J/kg] of a step: what noise and moving walls gave, and what was lost of these and of before."""

    noise: Scalar
    walls: Scalar
    loss: Scalar


class StepInfo(NamedTuple):
    """What a step tells of itself.

    `status`: bits of `Status`; `culprit`: for each of `BITS` the particle it is about; `residual`: true relative
    residual of the pressure solve; `travel`: largest displacement in spacings; `max_speed` [m/s]; `surface_count`,
    `escaped`: numbers of particles; `closest`: distance of the closest pair in spacings, before the correction;
    `stabilized`: pairs that the stabilizer kept apart; `work`: energy [J/kg] that it gave; `given`, `wall_work`: that
    noise and moving walls gave; `loss`: that is missing after the step, of these two and of what was there before;
    `energy` [J/kg]; `dt` [s].
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
    wall_work: Float[Array, "*steps"]
    loss: Float[Array, "*steps"]
    energy: Energy
    dt: Float[Array, "*steps"]


def inspect(
    case: Case,
    old: Particles,
    new: Particles,
    near: Pairs,
    surface: Bool[Array, " n"],
    push: Push,
    work: Work,
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
            convergence.residual > _FAILED,
            jnp.array(False),  # for the log to say, which knows what was there at the start
        ]
    )
    # With pairs missing, nothing else that the step shows means anything: it has to be repeated.
    raised = jnp.where(overflow, jnp.array([bit == Status.TABLE_FULL for bit in BITS]), raised)
    nobody = jnp.array(-1)
    speed = jnp.argmax(jnp.where(kept.fluid, squared_speed, 0.0))
    # Of those that are not finite one that was not before, if there is any: it has infected the others.
    before = jnp.all(jnp.isfinite(old.position) & jnp.isfinite(old.velocity), axis=-1)
    infected = jnp.argmin(jnp.where(jnp.all(before), finite, before))
    culprit = [infected, fastest, nobody, nobody, jnp.argmax(gone), jnp.argmax(astray), nobody, speed]
    info = StepInfo(
        status=jnp.sum(jnp.where(raised, jnp.array([int(bit) for bit in BITS]), 0)),
        culprit=jnp.stack(culprit),
        residual=convergence.residual,
        # Roots have no derivative at rest, and these are there to be looked at.
        travel=jnp.sqrt(lax.stop_gradient(squared_travel[fastest])),
        max_speed=jnp.sqrt(lax.stop_gradient(jnp.max(jnp.where(kept.fluid, squared_speed, 0.0)))),
        surface_count=jnp.sum(surface),
        escaped=jnp.sum(gone),
        closest=jnp.min(jnp.where(near.present & old.fluid[:, None], near.distance, jnp.inf)) / case.spacing,
        stabilized=push.pairs,
        work=_work(case, new, push),
        given=work.noise,
        wall_work=work.walls,
        loss=work.loss,
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
