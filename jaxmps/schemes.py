"""A scheme is a choice of one model of each kind; the named ones are those of the papers."""

import equinox as eqx

from jaxmps._types import ArrayLike, Scalar, as_array
from jaxmps.collision import AbstractCollision, PairCollision
from jaxmps.free_surface import AbstractFreeSurface, DensityThreshold
from jaxmps.operators import AbstractGradient, MinPressure
from jaxmps.pressure import AbstractSource, DensityDeviation
from jaxmps.stochastic import AbstractVelocityNoise, NoNoise
from jaxmps.validation import between
from jaxmps.viscosity import AbstractViscosity, Inviscid, Viscous


class TimeStep(eqx.Module):
    """Δt = min(C l0 / u_max, G √(l0 / g)): the Courant limit ([N11] Eq. 13) and an upper limit for slow flow.

    Without gravity and at rest no limit exists; then `simulate` wants a `dt`.
    """

    courant: Scalar = eqx.field(converter=as_array, default=0.2)
    gravity_limit: Scalar = eqx.field(converter=as_array, default=0.044)


class Scheme(eqx.Module):
    """A numerical method. Every leaf is a float array that can be tuned; what fixes shapes or control flow is static.

    `ratio`: effective radius r_e / l0 of all operators. `tolerance`, `max_iterations`: stopping rule of the pressure
    solve, relative to its right-hand side. `clip_pressure`: whether negative pressure is set to zero.
    """

    viscosity: AbstractViscosity
    noise: AbstractVelocityNoise
    free_surface: AbstractFreeSurface
    source: AbstractSource
    gradient: AbstractGradient
    collision: AbstractCollision
    time_step: TimeStep = eqx.field(default_factory=TimeStep)
    clip_pressure: bool = eqx.field(static=True, default=True)
    ratio: float = eqx.field(static=True, default=2.1)
    tolerance: float = eqx.field(static=True, default=1e-5)
    max_iterations: int = eqx.field(static=True, default=2000)
    name: str = eqx.field(static=True, default="custom")


def mps(
    *,
    relaxation: ArrayLike = 0.2,
    beta: ArrayLike = 0.97,
    collision_distance: ArrayLike = 0.9,
    restitution: ArrayLike = 0.2,
    courant: ArrayLike = 0.2,
    viscous: bool = False,
    clip_pressure: bool = True,
    ratio: float = 2.1,
    tolerance: float = 1e-5,
) -> Scheme:
    """The standard MPS method ([N11] §2; Koshizuka & Oka 1996) with relaxed source and pair collisions.

    `relaxation` γ of the PPE source (0 to 1), `beta` of the free surface (0 to 1), collisions closer than
    `collision_distance` l0 (0 to 1) with `restitution` (0 to 1), Courant number `courant` (0 to 1); `viscous` adds
    ν ∇²u. `ratio` is r_e / l0 (1.5 to 6), `tolerance` that of the pressure solve. Raises `ValueError` for a value out
    of its range.
    """
    unit = {
        "relaxation": relaxation,
        "beta": beta,
        "collision_distance": collision_distance,
        "restitution": restitution,
        "courant": courant,
    }
    for argument, value in unit.items():
        between(argument, value, 0.0, 1.0)
    between("ratio", ratio, 1.5, 6.0, "spacings")
    between("tolerance", tolerance, 1e-15, 0.1)
    return Scheme(
        viscosity=Viscous() if viscous else Inviscid(),
        noise=NoNoise(),
        free_surface=DensityThreshold(beta),
        source=DensityDeviation(relaxation),
        gradient=MinPressure(),
        collision=PairCollision(collision_distance, restitution),
        time_step=TimeStep(courant),
        clip_pressure=clip_pressure,
        ratio=ratio,
        tolerance=tolerance,
        name="mps",
    )
