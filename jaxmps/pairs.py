"""Pairs of neighbors, which all operators read."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Shaped

from jaxmps._compilation import cotangent_once
from jaxmps._vectors import Vectors, components, joined, take


class Pairs(eqx.Module):
    """For particle i (row) its neighbors j (slots): components of `r_ij` = r_j − r_i [m], `distance` [m], `present`.

    A slot that is not present holds i itself and the distance l0, so that no value and no derivative meets a zero.
    Particles that were removed from the flow are nobody's neighbors. At a mirror normal to the axis `mirror`, `image`
    tells which neighbors are images: of the particle j, which may be i itself.
    """

    j: Int[Array, "n k"]
    r_ij: Vectors
    distance: Float[Array, "n k"]
    present: Bool[Array, "n k"]
    image: Bool[Array, "n k"] | None = None
    mirror: int | None = eqx.field(static=True, default=None)

    @property
    def dim(self) -> int:
        return len(self.r_ij)

    @property
    def inverse(self) -> Float[Array, "n k"]:
        """1 / |r_ij| [1/m]. Divisions take the longest of all that is done with a pair: operators share this one."""
        return 1.0 / self.distance

    @property
    def e_ij(self) -> Vectors:
        """r_ij / |r_ij|, zero in empty slots."""
        return tuple(x * self.inverse for x in self.r_ij)

    @property
    def own_image(self) -> Bool[Array, "n k"] | None:
        """Which neighbors are i's own image."""
        return None if self.image is None else self.image & (self.j == jnp.arange(len(self.j))[:, None])

    def at_j(self, x: Shaped[Array, " n"]) -> Shaped[Array, "n k"]:
        """x_j of each pair, a scalar."""
        return take(x, self.j)

    def between(self, x: Float[Array, "n d"]) -> Vectors:
        """x_j − x_i of each pair, a vector; that of an image is mirrored."""
        at_j = [self.at_j(c) for c in components(x)]
        if self.mirror is not None and self.image is not None:
            at_j[self.mirror] = jnp.where(self.image, -at_j[self.mirror], at_j[self.mirror])
        return tuple(cotangent_once(there - c[:, None]) for there, c in zip(at_j, components(x), strict=True))

    def along(self, factor: Float[Array, "n k"]) -> Float[Array, "n d"]:
        """Σ_j f_ij r_ij.

        CPUs compute a factor once if it ends with a division. One of products alone they compute anew for each axis.
        """
        return joined(tuple(jnp.sum(factor * x, axis=-1) for x in self.r_ij))
