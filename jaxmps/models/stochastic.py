"""Stochastic velocity: random velocities that give back the energy which the scheme has lost ([N11] §3)."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from jaxmps._types import Scalar, as_array, positive_or_one

_POLE = (0.26726, 0.53452, 0.80178)  # no axis: no flow starts exactly against it


class AbstractVelocityNoise(eqx.Module):
    """A model of the random velocity."""

    @abc.abstractmethod
    def __call__(
        self,
        velocity: Float[Array, "n d"],
        loss: Scalar,
        mass: Float[Array, " n"],
        periodic: tuple[bool, ...],
        key: Key[Array, ""],
    ) -> Float[Array, "n d"]:
        """The random velocity [m/s] that is added to the `velocity` of the explicit step.

        `loss`: energy [J/kg] that the last step has lost; `mass`: relative masses, zero for what does not move;
        `periodic`: which axes are.
        """


class NoNoise(AbstractVelocityNoise):
    """Deterministic flow: the key is not used."""

    def __call__(self, velocity, loss, mass, periodic, key):
        return jnp.zeros_like(velocity)


class StochasticVelocity(AbstractVelocityNoise):
    """u_stoc,i = m_i ŝ_i with |m_i| = r α u_loss, r from U(0, 1), u_loss = √(2 ΔE) ([N11] Eqs. 14–21, Algorithm 1).

    ΔE = E^{k−1} − E^k [J/kg] is the energy per unit mass of the fluid that the last step has lost; nothing is added
    where it gained energy. (Line 3 of the printed algorithm has the comparison the wrong way round, which would take
    the root of a negative number. Nor does the paper say that energies are per unit mass: read as joules, they would
    make the velocities some twenty times as large.) The direction ŝ_i is uniform within ±π/2 of the particle's
    velocity, in three dimensions in the half-space around it, so that u·u_stoc ≥ 0; a particle at rest gets nothing.
    Each particle draws anew in each step. In the mean over the draws a step gives α u_loss ⟨|u|⟩ / π + α² ΔE / 3 back
    in two dimensions, with 1/4 for 1/π in three.

    `alpha` is usually much less than 0.1; beyond that particles jump off, as the paper warns. The draws do not depend
    on it, so that derivatives with respect to it pass through the noise.
    """

    alpha: Scalar = eqx.field(converter=as_array, default=0.04)

    def __call__(self, velocity, loss, mass, periodic, key):
        return _published(self.alpha, velocity, loss, mass, key)


class DriftFreeVelocity(AbstractVelocityNoise):
    """`StochasticVelocity` without its drift: it adds no momentum along periodic axes. Not published.

    As u·u_stoc ≥ 0, the published noise makes any mean flow along a periodic axis grow, and after the wave has gone all
    particles move to one side: the drawback that [N11] §6 leaves open. Here the directions are drawn about the velocity
    relative to that mean flow, u − ū; of the noise its mean over the mass is taken away; and what is left is scaled by
    the factor s for which

        Σ m (s u·v + ½ s² v²) = Σ m (u·u_stoc + ½ u_stoc²) / Σ m,

    so that a step gives back as much energy as with the published noise. Along axes that are not periodic there are
    walls, which take the momentum: nothing changes there.
    """

    alpha: Scalar = eqx.field(converter=as_array, default=0.04)

    def __call__(self, velocity, loss, mass, periodic, key):
        if not any(periodic):
            return _published(self.alpha, velocity, loss, mass, key)
        share = mass / positive_or_one(jnp.sum(mass))

        def mean(x: Float[Array, "n d"]) -> Float[Array, " d"]:
            return jnp.where(jnp.array(periodic), share @ x, 0.0)

        flow = velocity - mean(velocity)
        noise = _published(self.alpha, flow, loss, mass, key)
        wanted = share @ (jnp.sum(flow * noise, axis=-1) + 0.5 * jnp.sum(noise**2, axis=-1))
        free = jnp.where(mass[:, None] > 0, noise - mean(noise), 0.0)
        linear, square = share @ jnp.sum(flow * free, axis=-1), 0.5 * share @ jnp.sum(free**2, axis=-1)
        # s² square + s linear = wanted, in the form that does not cancel; a root has no derivative at zero.
        rooted = linear**2 + 4.0 * square * wanted
        bottom = linear + jnp.where(rooted > 0, jnp.sqrt(positive_or_one(rooted)), 0.0)
        return jnp.where(bottom > 0, 2.0 * wanted / positive_or_one(bottom), 0.0) * free


def _published(
    alpha: Scalar, velocity: Float[Array, "n d"], loss: Scalar, mass: Float[Array, " n"], key: Key[Array, ""]
) -> Float[Array, "n d"]:
    """[N11] Eqs. 14–21."""
    for_direction, for_magnitude = jax.random.split(key)
    squared = jnp.sum(velocity**2, axis=-1)
    there = (mass > 0) & (squared > 0)
    unit = velocity / jnp.sqrt(jnp.where(there, squared, 1.0))[:, None]
    most = alpha * jnp.where(loss > 0, jnp.sqrt(2.0 * positive_or_one(loss)), 0.0)
    magnitude = most * jax.random.uniform(for_magnitude, squared.shape, velocity.dtype)
    noise = magnitude[:, None] * _direction(unit, for_direction)
    return jnp.where(there[:, None], noise, 0.0)


def _direction(unit: Float[Array, "n d"], key: Key[Array, ""]) -> Float[Array, "n d"]:
    """Uniform on the half of the circle or sphere around `unit`; turns with it, for the sake of derivatives."""
    n, dim = unit.shape
    if dim == 2:
        # The open interval: at its ends the cosine of a rounded π/2 may be negative.
        r = jax.random.uniform(key, (n,), unit.dtype, minval=jnp.finfo(unit.dtype).eps)
        cosine, sine = jnp.cos(jnp.pi * (r - 0.5)), jnp.sin(jnp.pi * (r - 0.5))
        x, y = unit.T
        return jnp.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)
    pole = jnp.array(_POLE, unit.dtype)
    pole = pole / jnp.linalg.norm(pole)
    drawn = jax.random.normal(key, (n, dim), unit.dtype)
    drawn = drawn / positive_or_one(jnp.linalg.norm(drawn, axis=-1, keepdims=True))
    height = drawn @ pole
    drawn = jnp.where(height[:, None] < 0, -drawn, drawn)
    # The shortest rotation from the pole to `unit`.
    half = pole + unit
    across = jnp.sum(half * drawn, axis=-1) / positive_or_one(1.0 + unit @ pole)
    return drawn - across[:, None] * half + 2.0 * jnp.abs(height)[:, None] * unit
