"""Which particles lie on the free surface, and where between them the pressure is zero."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxmps._types import Scalar, as_array
from jaxmps._vectors import components, dot
from jaxmps.neighbors import Pairs


class AbstractFreeSurface(eqx.Module):
    """A detector of free-surface particles. A mask: its derivatives are zero."""

    @abc.abstractmethod
    def __call__(self, n: Float[Array, " n"], pairs: Pairs, w: Float[Array, "n k"], n0: float) -> Bool[Array, " n"]:
        """Whether each particle lies on the surface, from its number density n and its neighbors."""


class DensityThreshold(AbstractFreeSurface):
    """n_i < β n0 ([N11] Eq. 12; Koshizuka & Oka 1996, β = 0.97).

    With r_e = 2.1 l0 it flags the outermost row alone (n / n0 = 0.68, the next row has 0.99); with larger radii the
    second and third row as well, so n is best computed with 2.1.
    """

    beta: Scalar = eqx.field(converter=as_array, default=0.97)

    def __call__(self, n, pairs, w, n0):
        return n < self.beta * n0


class OneSided(AbstractFreeSurface):
    """n_i < β n0, and either the neighbors stand on one side, |Σ_j w_ij e_ij| > `asymmetry` n0, or n_i < `sparse` n0.

    The density alone flags a second row as soon as a flow under tension has thinned it by 2 %. The pressure there is
    set to zero, the outermost row feels no force any more and flies off as a thin line. The one-sidedness is 0.28 in
    the outermost row of a lattice at r_e = 2.1 l0, and 0.01 in the second.
    """

    beta: Scalar = eqx.field(converter=as_array, default=0.97)
    sparse: Scalar = eqx.field(converter=as_array, default=0.7)
    asymmetry: Scalar = eqx.field(converter=as_array, default=0.2)

    def __call__(self, n, pairs, w, n0):
        one_sided = jnp.sum(toward_neighbors(pairs, w) ** 2, axis=-1) > (self.asymmetry * n0) ** 2
        return (n < self.beta * n0) & (one_sided | (n < self.sparse * n0))


class AbstractSurfaceCondition(eqx.Module):
    """Where the pressure is zero: the Dirichlet condition of the pressure equation."""

    @abc.abstractmethod
    def coefficient(self, c: Float[Array, "n k"], surface: Bool[Array, " n"], pairs: Pairs) -> Float[Array, "n k"]:
        """The coefficients c_ij of the Laplacian, for surface particles j whose pressure counts as zero."""

    @abc.abstractmethod
    def pressure(
        self,
        p: Float[Array, " n"],
        surface: Bool[Array, " n"],
        inside: Bool[Array, " n"],
        pairs: Pairs,
        w: Float[Array, "n k"],
        spacing: float,
    ) -> Float[Array, " n"]:
        """The solved pressure [Pa] of particles `inside`, completed on the surface."""


class AtCenters(AbstractSurfaceCondition):
    """p = 0 at the centers of surface particles (Koshizuka & Oka 1996): half a spacing too deep."""

    def coefficient(self, c, surface, pairs):
        return c

    def pressure(self, p, surface, inside, pairs, w, spacing):
        return p


class HalfSpacing(AbstractSurfaceCondition):
    """p = 0 half a spacing outside the centers of surface particles, where the fluid ends.

    A surface particle s gets p_s = Σ_j w_sj p_j (l0/2) / (l0/2 + h_j) / Σ_j w_sj over its neighbors j inside the fluid,
    h_j their depth below s along the normal Σ_j w_sj e_sj: exact for a pressure that is linear in depth. As p_s is
    p_i / 3 for a row i right below, c_is (p_i − p_s) is (2/3) c_is p_i in the matrix, which stays symmetric.
    """

    def coefficient(self, c, surface, pairs):
        return jnp.where(pairs.at_j(surface), c * (2.0 / 3.0), c)

    def pressure(self, p, surface, inside, pairs, w, spacing):
        inward = toward_neighbors(pairs, w)
        squared = jnp.sum(inward**2, axis=-1, keepdims=True)
        inward = inward / jnp.sqrt(jnp.where(squared > 0, squared, 1.0))
        depth = jnp.maximum(dot(pairs.r_ij, components(inward[:, None])), 0.0)
        weight = jnp.where(surface[:, None] & pairs.at_j(inside), w, 0.0)
        total = jnp.sum(weight, axis=-1)
        part = 0.5 * spacing / (0.5 * spacing + depth)
        return p + jnp.sum(weight * part * pairs.at_j(p), axis=-1) / jnp.where(total > 0, total, 1.0)


def toward_neighbors(pairs: Pairs, w: Float[Array, "n k"]) -> Float[Array, "n d"]:
    """Σ_j w_ij r_ij / |r_ij|: points from the surface into the fluid, zero in a symmetric neighborhood."""
    return pairs.along(w * pairs.inverse)
