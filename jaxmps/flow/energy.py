"""Mechanical energy."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmps._types import Scalar, positive_or_one
from jaxmps.flow.particles import Particles


class Energy(NamedTuple):
    """Kinetic and potential energy per unit mass of the fluid [J/kg]."""

    kinetic: Scalar
    potential: Scalar

    @property
    def total(self) -> Float[Array, "*steps"]:
        """Kinetic and potential energy together [J/kg]."""
        return self.kinetic + self.potential


def mechanical_energy(particles: Particles, density: Float[Array, " n"], gravity: Float[Array, " d"]) -> Energy:
    """The mean over the fluid's mass of ½ u² and of −g·r ([N11] §3, read as energy per unit mass).

    The potential is zero at the origin of the coordinates.
    """
    mass = jnp.where(particles.fluid, density, 0.0)
    potential = -jnp.sum(mass * (particles.position @ gravity)) / positive_or_one(jnp.sum(mass))
    return Energy(kinetic_energy(particles.velocity, mass), potential)


def kinetic_energy(velocity: Float[Array, "n d"], mass: Float[Array, " n"]) -> Scalar:
    """The mean of ½ u² over the masses [J/kg], which may be relative; zero where there is no mass."""
    return 0.5 * jnp.sum(mass * jnp.sum(velocity**2, axis=-1)) / positive_or_one(jnp.sum(mass))


def energy_loss(
    before: Particles, after: Particles, density: Float[Array, " n"], gravity: Float[Array, " d"], dt: Scalar
) -> Scalar:
    """Mechanical energy [J/kg] that the fluid has lost in a step of `dt` [s] ([N11] Eq. 20), not counting what it loses
    in free fall.

    There a step that moves particles by their new velocity loses ½ g² Δt², which is not dissipation but the difference
    to the middle of the step, and can be more than all the rest. So the potential is taken half a step back: E is
    ½ u² − g·(r − ½ Δt u), which free fall conserves. From displacements: a particle that came in again at the other end
    of a periodic axis has lost nothing.
    """
    mass = jnp.where(before.fluid, density, 0.0)
    fall = after.position - before.position - 0.5 * dt * (after.velocity - before.velocity)
    work = jnp.sum(mass * (fall @ gravity)) / positive_or_one(jnp.sum(mass))
    return kinetic_energy(before.velocity, mass) - kinetic_energy(after.velocity, mass) + work
