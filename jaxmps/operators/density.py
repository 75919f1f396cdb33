"""The particle number density."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmps._vectors import dot
from jaxmps.kernels import weight
from jaxmps.neighbors import Pairs


def pair_weight(pairs: Pairs, radius: float) -> Float[Array, "n k"]:
    """w(|r_j − r_i|) of each pair, zero in empty slots; `radius` is r_e [m]."""
    return jnp.where(pairs.present, weight(pairs.distance, radius), 0.0)


def number_density(w: Float[Array, "n k"]) -> Float[Array, " n"]:
    """n_i = Σ_{j≠i} w(|r_j − r_i|), walls and dummies included ([N11] Eq. 6)."""
    return jnp.sum(w, axis=-1)


def density_rate(velocity: Float[Array, "n d"], pairs: Pairs, radius: float) -> Float[Array, " n"]:
    """Dn/Dt_i = −r_e Σ_j r_ij·u_ij / r_ij³ [1/s], walls and dummies included (Khayyer & Gotoh 2009; any dimension).

    The exact rate of change of n_i for pairs within r_e. On a lattice it is −K n0 ∇·u with
    K = r_e Σ (1/r) / (D n0): 1.4175 in 2-D and 1.0731 in 3-D at r_e = 2.1 l0.
    """
    approach = -dot(pairs.r_ij, pairs.between(velocity)) * pairs.inverse**3
    counts = pairs.present & (pairs.distance < radius)
    return radius * jnp.sum(jnp.where(counts, approach, 0.0), axis=-1)
