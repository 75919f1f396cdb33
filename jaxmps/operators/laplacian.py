"""Models of the Laplacian, by the coefficients c_ij [1/m²] of ⟨∇²φ⟩_i = Σ_j c_ij (φ_j − φ_i)."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmps._vectors import components, joined
from jaxmps.kernels import lattice
from jaxmps.neighbors import Pairs


class AbstractLaplacian(eqx.Module):
    """A model of ∇²."""

    @abc.abstractmethod
    def __call__(self, pairs: Pairs, w: Float[Array, "n k"], ratio: float, spacing: float) -> Float[Array, "n k"]:
        """c_ij [1/m²], zero where w = 0; `ratio` is r_e / l0, `spacing` l0 [m]."""


class KernelLaplacian(AbstractLaplacian):
    """c_ij = (2 D / (λ n0)) w_ij ([N11] Eq. 7; Koshizuka & Oka 1996). Exact for a paraboloid on a full lattice."""

    def __call__(self, pairs, w, ratio, spacing):
        n0, lam = lattice(ratio, pairs.dim)[:2]
        return kernel_coefficient(w, n0, lam * spacing**2, pairs.dim)


class HigherOrderLaplacian(AbstractLaplacian):
    """c_ij = ((5 − D) / n0) r_e / r_ij³ (HL; Khayyer & Gotoh 2010, 2012), or, `consistent`, (2 / (K n0)) r_e / r_ij³.

    The divergence of the kernel's own gradient. As published it is 1.5 K times too strong in 2-D and K times in 3-D
    (φ = x² on a full lattice, K = r_e Σ (1 / r) / (D n0)); the consistent form divides by that and is exact there.
    """

    consistent: bool = eqx.field(static=True, default=True)

    def __call__(self, pairs, w, ratio, spacing):
        dim = pairs.dim
        n0, k = lattice(ratio, dim).n0, lattice(ratio, dim).k
        factor = (2.0 / k if self.consistent else 5.0 - dim) / n0
        return jnp.where(w > 0, factor * ratio * spacing * pairs.inverse**3, 0.0)


def kernel_coefficient(w: Float[Array, "n k"], n0: float, lam: float, dim: int) -> Float[Array, "n k"]:
    """(2 D / (λ n0)) w_ij ([N11] Eq. 7), λ in m²."""
    return (2.0 * dim / (lam * n0)) * w


def laplacian(
    phi: Float[Array, "n *components"],
    pairs: Pairs,
    w: Float[Array, "n k"],
    n0: float,
    lam: float,
) -> Float[Array, "n *components"]:
    """⟨∇²φ⟩_i = (2 D / (λ n0)) Σ_j (φ_j − φ_i) w_ij ([N11] Eq. 7), λ in m².

    Exact for a paraboloid on a full lattice. Pairs that shall not count get the weight zero. A field of components is a
    vector: at a mirror it is mirrored.
    """
    if phi.ndim > 2:
        return joined(tuple(laplacian(x, pairs, w, n0, lam) for x in components(phi)))
    differences = pairs.between(phi) if phi.ndim > 1 else (pairs.at_j(phi) - phi[:, None],)
    c = kernel_coefficient(w, n0, lam, pairs.dim)
    sums = tuple(jnp.sum(c * difference, axis=-1) for difference in differences)
    return joined(sums) if phi.ndim > 1 else sums[0]
