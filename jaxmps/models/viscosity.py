"""Viscous acceleration in the explicit step."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmps.neighbors import Pairs
from jaxmps.operators import laplacian


class AbstractViscosity(eqx.Module):
    """A model of the viscous acceleration."""

    @abc.abstractmethod
    def __call__(
        self,
        velocity: Float[Array, "n d"],
        viscosity: Float[Array, " n"],
        pairs: Pairs,
        w: Float[Array, "n k"],
        n0: float,
        lam: float,
    ) -> Float[Array, "n d"]:
        """Acceleration [m/s²] from the kinematic viscosity [m²/s] of each particle."""


class Inviscid(AbstractViscosity):
    """No viscosity: Euler's equations ([N11] Eq. 2)."""

    def __call__(self, velocity, viscosity, pairs, w, n0, lam):
        return jnp.zeros_like(velocity)


class Viscous(AbstractViscosity):
    """ν ∇²u with the Laplacian of [N11] Eq. 7, for two phases with the mean of both viscosities, so that equal masses
    exchange momentum without loss. Walls and dummies have their own velocity: no slip.

    Explicit: stable for Δt below about l0² / (2 D ν) only.
    """

    def __call__(self, velocity, viscosity, pairs, w, n0, lam):
        nu = 0.5 * (viscosity[:, None] + pairs.at_j(viscosity))
        return laplacian(velocity, pairs, nu * w, n0, lam)
