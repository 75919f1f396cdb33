"""What a scheme is made of: one model of each kind, and the settings of time step and pressure solve."""

import equinox as eqx

from jaxmps._types import Scalar, as_array
from jaxmps.description import describe, table
from jaxmps.models import (
    AbstractCollision,
    AbstractFreeSurface,
    AbstractInterface,
    AbstractSource,
    AbstractStabilizer,
    AbstractSurfaceCondition,
    AbstractVelocityNoise,
    AbstractViscosity,
    AtCenters,
    NoStabilization,
    PairedDensity,
)
from jaxmps.operators import AbstractGradient, AbstractLaplacian, KernelLaplacian
from jaxmps.pressure import AbstractPreconditioning, ByMultigrid


class TimeStep(eqx.Module):
    """Δt = min(C l0 / u_max, G √(l0 / g)): the Courant limit ([N11] Eq. 13) and an upper limit for slow flow.

    Without gravity and at rest no limit exists; then `simulate` wants a `dt`.
    """

    courant: Scalar = eqx.field(converter=as_array, default=0.2)
    gravity_limit: Scalar = eqx.field(converter=as_array, default=0.044)


class Scheme(eqx.Module):
    """A numerical method. Every leaf is a float array that can be tuned; what fixes shapes or control flow is static.

    `ratio`: effective radius r_e / l0 of all operators. `tolerance`, `max_iterations`: stopping rule of the pressure
    solve, relative to its right-hand side. With multigrid the error of the pressure is a few tenths of the tolerance or
    less; by diagonal alone up to seven times the tolerance. `clip_pressure`: whether negative pressure is set to zero.
    """

    viscosity: AbstractViscosity
    noise: AbstractVelocityNoise
    free_surface: AbstractFreeSurface
    source: AbstractSource
    gradient: AbstractGradient
    collision: AbstractCollision
    laplacian: AbstractLaplacian = eqx.field(default_factory=KernelLaplacian)
    interface: AbstractInterface = eqx.field(default_factory=PairedDensity)
    surface_condition: AbstractSurfaceCondition = eqx.field(default_factory=AtCenters)
    stabilizer: AbstractStabilizer = eqx.field(default_factory=NoStabilization)
    preconditioning: AbstractPreconditioning = eqx.field(default_factory=ByMultigrid)
    time_step: TimeStep = eqx.field(default_factory=TimeStep)
    clip_pressure: bool = eqx.field(static=True, default=True)
    ratio: float = eqx.field(static=True, default=2.1)
    tolerance: float = eqx.field(static=True, default=1e-4)
    max_iterations: int = eqx.field(static=True, default=2000)
    name: str = eqx.field(static=True, default="custom")

    def _repr_html_(self) -> str:
        return table(f"Scheme {self.name}", {k: v for k, v in describe(self).items() if k != "name"})
