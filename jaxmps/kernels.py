"""The weight function of MPS and the constants that follow from it on a lattice."""

import functools
import itertools
import math
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float


def weight(distance: Float[Array, "*pairs"], radius: float) -> Float[Array, "*pairs"]:
    """The weight w(r) = r_e / r − 1 for r < r_e, else 0 ([N11] Eq. 5; Koshizuka & Oka 1996).

    `distance` [m] must not be zero; `radius` is r_e [m].
    """
    return jnp.where(distance < radius, radius * (1.0 / distance) - 1.0, 0.0)


class Lattice(NamedTuple):
    """Constants of a full square or cubic lattice: n0 = Σ w, λ / l0² = Σ r² w / Σ w / l0² ([N11] Eqs. 8, 9), number of
    neighbors, and K = r_e Σ (1 / r) / (D n0), by which the rate of n overstates −n0 ∇·u.
    """

    n0: float
    lam: float
    neighbors: int
    k: float


@functools.cache
def lattice(ratio: float, dim: int) -> Lattice:
    """n0, λ and the number of neighbors of an interior lattice particle, `ratio` = r_e / l0.

    Sums, not integrals: at r_e = 2.1 l0 in 2-D the integral r_e² / 6 is wrong by a factor of 1.9. The paper's
    n0 = max n_i over the first instant is the same number wherever the fluid has an interior.
    """
    reach = range(-math.ceil(ratio), math.ceil(ratio) + 1)
    squares = (sum(x * x for x in offset) for offset in itertools.product(reach, repeat=dim))
    distances = [math.sqrt(s) for s in squares if 0 < s < ratio * ratio]
    weights = [ratio / r - 1.0 for r in distances]
    n0 = math.fsum(weights)
    lam = math.fsum(w * r * r for w, r in zip(weights, distances, strict=True)) / n0
    k = ratio * math.fsum(1.0 / r for r in distances) / (dim * n0)
    return Lattice(n0, lam, len(distances), k)
