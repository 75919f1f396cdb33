"""Mechanical energy."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmps._types import Scalar
from jaxmps.particles import Particles


class Energy(NamedTuple):
    """Kinetic and potential energy per unit mass of the fluid [J/kg]."""

    kinetic: Scalar
    potential: Scalar

    @property
    def total(self) -> Scalar:
        return self.kinetic + self.potential


def mechanical_energy(particles: Particles, density: Float[Array, " n"], gravity: Float[Array, " d"]) -> Energy:
    """The mean over the fluid's mass of ½ u² and of −g·r ([N11] §3, read as energy per unit mass).

    The potential is zero at the origin of the coordinates.
    """
    mass = jnp.where(particles.fluid, density, 0.0)
    total = jnp.maximum(jnp.sum(mass), jnp.finfo(mass.dtype).tiny)
    kinetic = 0.5 * jnp.sum(mass * jnp.sum(particles.velocity**2, axis=-1)) / total
    return Energy(kinetic, -jnp.sum(mass * (particles.position @ gravity)) / total)
