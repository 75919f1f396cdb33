"""The particles' state and the materials that they are made of."""

import enum

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int

from jaxmps._types import as_array


class Kind(enum.IntEnum):
    """What a particle is.

    FLUID moves with the flow. WALL is fixed, or moves as prescribed, and has a pressure. DUMMY goes with the walls and
    counts in the number density only: it completes the neighborhood of the wall. REMOVED left the domain and takes
    part in nothing any more.
    """

    FLUID = 0
    WALL = 1
    DUMMY = 2
    REMOVED = 3


class Fluid(eqx.Module):
    """Materials, one entry per phase: density [kg/m³] and kinematic viscosity [m²/s]."""

    density: Float[Array, " phases"] = eqx.field(converter=as_array)
    viscosity: Float[Array, " phases"] = eqx.field(converter=as_array)


class Particles(eqx.Module):
    """All particles, walls included: position [m], velocity [m/s], pressure [Pa], `Kind` and phase of each."""

    position: Float[Array, "n d"]
    velocity: Float[Array, "n d"]
    pressure: Float[Array, " n"]
    kind: Int[Array, " n"]
    phase: Int[Array, " n"]

    @property
    def fluid(self):
        """Which particles move with the flow."""
        return self.kind == Kind.FLUID

    @property
    def fixed(self):
        """Which are walls and dummies: they stand, or go where a motion has them."""
        return (self.kind == Kind.WALL) | (self.kind == Kind.DUMMY)

    @property
    def listed_position(self):
        """`position`, not a number where a particle was removed: the neighbor search passes over those."""
        return jnp.where((self.kind == Kind.REMOVED)[:, None], jnp.nan, self.position)

    @property
    def has_pressure(self):
        """Which particles take part in the pressure equation and the pressure gradient: fluid and wall."""
        return (self.kind == Kind.FLUID) | (self.kind == Kind.WALL)


def at_rest(
    position: Float[ArrayLike, "n d"], kind: Int[ArrayLike, " n"], phase: Int[ArrayLike, " n"] | int = 0
) -> Particles:
    """Particles without velocity and pressure."""
    position = as_array(position)
    kind = jnp.asarray(kind, jnp.int8)
    return Particles(
        position=position,
        velocity=jnp.zeros_like(position),
        pressure=jnp.zeros_like(position[:, 0]),
        kind=kind,
        phase=jnp.broadcast_to(jnp.asarray(phase, jnp.int32), kind.shape),
    )
