"""Models of the pressure gradient."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxmps._types import total
from jaxmps.neighbors import Pairs


class AbstractGradient(eqx.Module):
    """A model of ∇p, divided by the density of each pair."""

    @abc.abstractmethod
    def __call__(
        self,
        pressure: Float[Array, " n"],
        pair_density: Float[Array, "#n #k"],
        pairs: Pairs,
        w: Float[Array, "n k"],
        n0: float,
    ) -> Float[Array, "n d"]:
        """⟨∇p / ρ⟩_i [m/s²]; with a `pair_density` ρ_ij of one it is ⟨∇p⟩_i. A pair that shall not count gets w = 0."""


class MinPressure(AbstractGradient):
    """⟨∇p⟩_i = (D / n0) Σ_j (p_j − p̂_i) r_ij w_ij / r_ij² with the minimum p̂_i = min(p_i, p_j) over the neighborhood
    ([N11] Eq. 10, [T13] Eqs. 1, 2; Koshizuka, Nobe & Oka 1998).

    Every pair repels: stable, but first-order consistent only for a symmetric neighborhood. i itself belongs to the
    neighborhood over which the minimum is taken.
    """

    def __call__(self, pressure, pair_density, pairs, w, n0):
        difference = pairs.at_j(pressure) - minimum(pressure, pairs, w > 0)[:, None]
        return weighted_gradient(difference * (1.0 / pair_density), pairs, w, n0)


class CMPS(AbstractGradient):
    """⟨∇p⟩_i = (D / n0) Σ_j ((p_i + p_j) − (p̂_i + p̂_j)) r_ij w_ij / r_ij² ([T13] Eq. 3; Khayyer & Gotoh 2008).

    Antisymmetric in each pair: the forces sum to zero, and every pair repels. Not first-order consistent: a linear
    pressure lies above its minimum p̂ by the same amount everywhere inside a lattice, so that all pairs push alike and
    there is no force at all; p_i + p_j alone would be exact there. Fluid at rest therefore sinks until its particles
    are disordered. [T13] Eq. 6 on the size of the repulsion, |(p_i − p̂_i) + (p_i − p̂_j)| ≥ |p_j − p_i|, holds for
    p_j ≤ p_i only.
    """

    def __call__(self, pressure, pair_density, pairs, w, n0):
        excess = pressure - minimum(pressure, pairs, w > 0)
        return weighted_gradient((excess[:, None] + pairs.at_j(excess)) * (1.0 / pair_density), pairs, w, n0)


class Corrected(AbstractGradient):
    """⟨∇p⟩_i = M_i⁻¹ Σ_j (p_j − p_i) r_ij w_ij / r_ij², M_i = Σ_j w_ij r_ij ⊗ r_ij / r_ij² (GC; Khayyer & Gotoh 2011).

    Exact for linear fields in any arrangement of neighbors; attracts under tension; does not conserve momentum. Where
    M_i is ill-conditioned, det M_i ≤ `smallest` (n0 / D)^D, or i has fewer than `dim` + 1 neighbors, M_i is replaced by
    that of the full lattice, (n0 / D) I: the first term of [T13] Eq. 7.
    """

    smallest: float = eqx.field(static=True, default=0.05)

    def __call__(self, pressure, pair_density, pairs, w, n0):
        plain = weighted_gradient((pairs.at_j(pressure) - pressure[:, None]) * (1.0 / pair_density), pairs, w, n0)
        return solve_small(moments(pairs, w, n0, self.smallest), plain)


def divergence(
    velocity: Float[Array, "n d"], pairs: Pairs, w: Float[Array, "n k"], n0: float, smallest: float = 0.05
) -> Float[Array, " n"]:
    """⟨∇·u⟩_i = Σ_j u_ij · M_i⁻¹ r_ij w_ij / r_ij² [1/s]: the trace of the corrected gradient (see `Corrected`) of u.

    Exact for linear fields in any arrangement of neighbors.
    """
    matrix = moments(pairs, w, n0, smallest)
    slopes = (weighted_gradient(difference, pairs, w, n0) for difference in pairs.between(velocity))
    return total(solve_small(matrix, slope)[:, axis] for axis, slope in enumerate(slopes))


def moments(pairs: Pairs, w: Float[Array, "n k"], n0: float, smallest: float) -> Float[Array, "n d d"]:
    """(D / n0) Σ_j w_ij r_ij ⊗ r_ij / r_ij², the unit matrix on a full lattice, and also where it is ill-conditioned:
    its determinant is not above `smallest`, or there are no more than `dim` neighbors.
    """
    dim = pairs.dim
    matrix = jnp.stack([weighted_gradient(x, pairs, w, n0) for x in pairs.r_ij], axis=-1)
    well = (jnp.linalg.det(matrix) > smallest) & (jnp.sum(w > 0, axis=-1) > dim)
    return jnp.where(well[:, None, None], matrix, jnp.eye(dim, dtype=w.dtype))


def solve_small(matrix: Float[Array, "n d d"], b: Float[Array, "n d"]) -> Float[Array, "n d"]:
    """x with M x = b for symmetric 2 × 2 or 3 × 3 matrices, by Cramer's rule: LAPACK would take them one by one."""
    if b.shape[-1] == 2:
        a, c, d = matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 1]
        x = jnp.stack([d * b[:, 0] - c * b[:, 1], a * b[:, 1] - c * b[:, 0]], axis=-1)
        return x / (a * d - c * c)[:, None]
    rows = matrix[:, 0], matrix[:, 1], matrix[:, 2]
    minors = jnp.stack([jnp.cross(rows[1], rows[2]), jnp.cross(rows[2], rows[0]), jnp.cross(rows[0], rows[1])], axis=-1)
    determinant = jnp.sum(rows[0] * minors[..., 0], axis=-1)
    return jnp.einsum("nde,ne->nd", minors, b) / determinant[:, None]


def minimum(pressure: Float[Array, " n"], pairs: Pairs, counts: Bool[Array, "n k"]) -> Float[Array, " n"]:
    """p̂_i [Pa], the smallest pressure among i and those of its neighbors that count ([T13] Eq. 2)."""
    smallest = jnp.min(jnp.where(counts, pairs.at_j(pressure), jnp.inf), axis=-1)
    return jnp.minimum(pressure, smallest)


def weighted_gradient(
    difference: Float[Array, "n k"], pairs: Pairs, w: Float[Array, "n k"], n0: float
) -> Float[Array, "n d"]:
    """(D / n0) Σ_j Δ_ij r_ij w_ij / r_ij² of a difference Δ_ij that belongs to each pair."""
    return (pairs.dim / n0) * pairs.along(difference * w / pairs.distance**2)
