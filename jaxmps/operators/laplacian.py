"""The Laplacian of Koshizuka & Oka."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmps.neighbors import Pairs


def laplacian(
    phi: Float[Array, "n *components"],
    pairs: Pairs,
    w: Float[Array, "n k"],
    n0: float,
    lam: float,
) -> Float[Array, "n *components"]:
    """⟨∇²φ⟩_i = (2 D / (λ n0)) Σ_j (φ_j − φ_i) w_ij ([N11] Eq. 7), λ in m².

    Exact for a paraboloid on a full lattice. Pairs that shall not count get the weight zero.
    """
    dim = pairs.r_ij.shape[-1]
    difference = phi[pairs.j] - phi[:, None]
    w = w.reshape(w.shape + (1,) * (phi.ndim - 1))
    return (2.0 * dim / (lam * n0)) * jnp.sum(difference * w, axis=1)
