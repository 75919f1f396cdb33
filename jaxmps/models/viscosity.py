"""Viscous acceleration in the explicit step."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxmps._types import Scalar, as_array, positive_or_one
from jaxmps.neighbors import Pairs
from jaxmps.operators import laplacian


class AbstractViscosity(eqx.Module):
    """A model of the viscous acceleration."""

    @abc.abstractmethod
    def __call__(
        self,
        velocity: Float[Array, "n d"],
        viscosity: Float[Array, " #n"],
        density: Float[Array, " #n"],
        moves: Bool[Array, " n"],
        pairs: Pairs,
        w: Float[Array, "n k"],
        n0: float,
        lam: float,
    ) -> Float[Array, "n d"]:
        """Acceleration [m/s²] of what `moves`, from kinematic viscosity [m²/s] and density [kg/m³] of each particle.

        Both are of one entry where there is one fluid.
        """

    @abc.abstractmethod
    def largest_step(self, viscosity: Float[Array, " phases"], spacing: float, dim: int) -> Scalar:
        """Δt [s] that fluids of these viscosities [m²/s] allow; infinite without viscosity."""


class Inviscid(AbstractViscosity):
    """No viscosity: Euler's equations ([N11] Eq. 2), whatever the fluids have."""

    def __call__(self, velocity, viscosity, density, moves, pairs, w, n0, lam):
        return jnp.zeros_like(velocity)

    def largest_step(self, viscosity, spacing, dim):
        return jnp.full((), jnp.inf, viscosity.dtype)


class Viscous(AbstractViscosity):
    """ρ_i a_i = (2 D / (λ n0)) Σ_j μ_ij (u_j − u_i) w_ij with μ_ij = 2 μ_i μ_j / (μ_i + μ_j), μ = ρ ν: the Laplacian of
    [N11] Eq. 7, and between two fluids the harmonic mean of their dynamic viscosities.

    That is what gives the stress across a flat interface, which lies half way between the two particles (Shakibaeinia
    & Jin 2012), and as μ_ij = μ_ji, momentum is kept to round-off at any ratio of densities and viscosities. Walls and
    dummies have their own velocity, no slip, and none of the viscosities: as if infinitely viscous, μ_ij = 2 μ_i, they
    hold the fluid at the face half a spacing before them. (Of mirrored pairs across a face the sum of the distances is
    twice that of the fluid's particles, so the friction of a linear profile is exact with any kernel.)

    Explicit: Δt ≤ `limit` l0² / (2 D ν). The scheme is stable up to about 1.8 on a lattice, and twice as viscous for a
    light fluid beside a heavy one; the default is that of Morris, Fox & Zhu 1997 in 2-D, 0.125 l0² / ν.
    """

    limit: Scalar = eqx.field(converter=as_array, default=0.5)

    def __call__(self, velocity, viscosity, density, moves, pairs, w, n0, lam):
        own = mean = (density * viscosity)[:, None]
        if len(own) > 1:
            there = pairs.at_j(own[:, 0])
            both = own + there
            mean = jnp.where(both > 0, 2.0 * own * there / positive_or_one(both), 0.0)
        mu = jnp.where(pairs.at_j(moves), mean, 2.0 * own)
        return laplacian(velocity, pairs, mu * w, n0, lam) / density[:, None]

    def largest_step(self, viscosity, spacing, dim):
        most = jnp.max(viscosity)
        return jnp.where(most > 0, self.limit * spacing**2 / (2.0 * dim * positive_or_one(most)), jnp.inf)
