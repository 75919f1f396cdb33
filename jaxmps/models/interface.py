"""How particles of different density meet: the density that stands for a pair, and how it shares a displacement."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxmps._types import positive_or_one
from jaxmps.neighbors import Pairs


class AbstractInterface(eqx.Module):
    """The density by which the pressure force of a pair is divided."""

    @abc.abstractmethod
    def __call__(self, density: Float[Array, " #n"], pairs: Pairs) -> Float[Array, "#n #k"]:
        """ρ_ij [kg/m³], of which 1 / ρ_ij multiplies the pressure difference p_j − p_i in the acceleration of i.

        Like all densities here, of one entry where all particles have the same.
        """


class PairedDensity(AbstractInterface):
    """ρ_ij = (ρ_i + ρ_j) / 2, as in the pressure equation (Shakibaeinia & Jin 2012; Duan et al. 2017).

    Across a flat interface with continuous p and (1/ρ) ∂p/∂n, each symmetric pair then feels the true (1/ρ) ∂p/∂n:
    layers at rest stay at rest (residual 0.003 g at 1000 : 2650 kg/m³ and r_e = 2.1 l0, where `OwnDensity` has 0.4 g).
    """

    def __call__(self, density, pairs):
        return mean_density(density, pairs)


class OwnDensity(AbstractInterface):
    """ρ_ij = ρ_i, the literal −⟨∇p⟩_i / ρ_i of [T13] Eq. 11.

    With the antisymmetric gradient it conserves momentum, which the paired density does not at unequal densities.
    """

    def __call__(self, density, pairs):
        return density[:, None]


def mean_density(density: Float[Array, " #n"], pairs: Pairs) -> Float[Array, "#n #k"]:
    """(ρ_i + ρ_j) / 2 of each pair [kg/m³]."""
    return 0.5 * (density[:, None] + _at_j(density, pairs))


def beside_walls(
    density: Float[Array, " n"], moves: Bool[Array, " n"], pairs: Pairs, w: Float[Array, "n k"]
) -> Float[Array, " n"]:
    """The densities [kg/m³], with Σ_j ρ_j w_ij / Σ_j w_ij over the moving neighbors for what is fixed: a wall is as
    heavy as the fluid before it. Away from all fluid it has the mean of what moves.
    """
    weight = jnp.where(pairs.at_j(moves), w, 0.0)
    sum_of_weights = jnp.sum(weight, axis=-1)
    near = jnp.sum(weight * pairs.at_j(density), axis=-1) / positive_or_one(sum_of_weights)
    far = jnp.sum(jnp.where(moves, density, 0.0)) / positive_or_one(jnp.sum(moves).astype(density.dtype))
    return jnp.where(moves, density, jnp.where(sum_of_weights > 0, near, jnp.where(far > 0, far, density)))


def share_of_displacement(density: Float[Array, " #n"], moves: Bool[Array, " n"], pairs: Pairs) -> Float[Array, "n k"]:
    """The part ρ_j / (ρ_i + ρ_j) of a pair's displacement that i takes, by Newton's third law; 1 if j is fixed.

    Particles have equal volumes, so densities stand for masses.
    """
    return jnp.where(pairs.at_j(moves), 0.5 * _at_j(density, pairs) / mean_density(density, pairs), 1.0)


def _at_j(density: Float[Array, " #n"], pairs: Pairs) -> Float[Array, "#n #k"]:
    return density[:, None] if len(density) == 1 else pairs.at_j(density)
