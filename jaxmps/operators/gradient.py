"""Models of the pressure gradient."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxmps.neighbors import Pairs


class AbstractGradient(eqx.Module):
    """A model of ∇p."""

    @abc.abstractmethod
    def __call__(
        self,
        pressure: Float[Array, " n"],
        pairs: Pairs,
        w: Float[Array, "n k"],
        n0: float,
    ) -> Float[Array, "n d"]:
        """⟨∇p⟩_i [Pa/m]. Pairs that shall not count get the weight zero."""


class MinPressure(AbstractGradient):
    """⟨∇p⟩_i = (D / n0) Σ_j (p_j − p̂_i) r_ij w_ij / r_ij² with the minimum p̂_i = min(p_i, p_j) over the neighborhood
    ([N11] Eq. 10, [T13] Eqs. 1, 2; Koshizuka, Nobe & Oka 1998).

    Every pair repels: stable, but first-order consistent only for a symmetric neighborhood. i itself belongs to the
    neighborhood over which the minimum is taken.
    """

    def __call__(self, pressure, pairs, w, n0):
        return weighted_gradient(pressure[pairs.j] - minimum(pressure, pairs, w > 0)[:, None], pairs, w, n0)


def minimum(pressure: Float[Array, " n"], pairs: Pairs, counts: Bool[Array, "n k"]) -> Float[Array, " n"]:
    """p̂_i [Pa], the smallest pressure among i and those of its neighbors that count ([T13] Eq. 2)."""
    smallest = jnp.min(jnp.where(counts, pressure[pairs.j], jnp.inf), axis=-1)
    return jnp.minimum(pressure, smallest)


def weighted_gradient(
    difference: Float[Array, "n k"], pairs: Pairs, w: Float[Array, "n k"], n0: float
) -> Float[Array, "n d"]:
    """(D / n0) Σ_j Δ_ij r_ij w_ij / r_ij² of a difference Δ_ij that belongs to each pair."""
    dim = pairs.r_ij.shape[-1]
    factor = difference * w / pairs.distance**2
    return (dim / n0) * jnp.einsum("nk,nkd->nd", factor, pairs.r_ij)
