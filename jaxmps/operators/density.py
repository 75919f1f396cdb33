"""The particle number density."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmps.kernels import weight
from jaxmps.neighbors import Pairs


def pair_weight(pairs: Pairs, radius: float) -> Float[Array, "n k"]:
    """w(|r_j − r_i|) of each pair, zero in empty slots; `radius` is r_e [m]."""
    return jnp.where(pairs.present, weight(pairs.distance, radius), 0.0)


def number_density(w: Float[Array, "n k"]) -> Float[Array, " n"]:
    """n_i = Σ_{j≠i} w(|r_j − r_i|), walls and dummies included ([N11] Eq. 6)."""
    return jnp.sum(w, axis=-1)
