"""Pairs of neighbors, which all operators read."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Shaped

from jaxmps._compilation import cotangent_once
from jaxmps._vectors import Vectors, components, dot, joined, take
from jaxmps.flow import Kind, Particles
from jaxmps.neighbors.table import Neighbors


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


def pairs(neighbors: Neighbors, particles: Particles, spacing: float) -> Pairs:
    """The pairs within the cutoff at the particles' positions; differentiable in the positions."""
    position, n = particles.position, particles.position.shape[0]
    table = neighbors.table.idx
    if not neighbors.capacity:  # a particle alone in the world: operators still want a slot
        table = jnp.full((n, 1), 2 * n, table.dtype)
    own, mirror = jnp.arange(n, dtype=table.dtype)[:, None], neighbors.box.mirror
    listed = table < (n if mirror is None else 2 * n)
    image = None if mirror is None else listed & (table >= n)
    j = jnp.where(listed, table if image is None else jnp.where(image, table - n, table), own)
    at_j = [take(x, j) for x in components(position)]
    if mirror is not None and image is not None:
        at_j[mirror] = jnp.where(image, 2.0 * neighbors.box.lower[mirror] - at_j[mirror], at_j[mirror])
    apart = (cotangent_once(there - x[:, None]) for there, x in zip(at_j, components(position), strict=True))
    r_ij = tuple(neighbors.box.nearest(axis, x) for axis, x in enumerate(apart))
    squared = dot(r_ij, r_ij)
    active = particles.kind != Kind.REMOVED
    present = listed & (squared < neighbors.cutoff**2) & active[:, None] & take(active, j)
    r_ij = tuple(jnp.where(present, x, 0.0) for x in r_ij)
    # Coinciding particles get a tiny distance instead of zero: a large weight, but a finite one.
    floor = (1e-3 * spacing) ** 2
    distance = jnp.sqrt(jnp.where(present, jnp.maximum(squared, floor), spacing**2))
    image = None if image is None else image & present
    return Pairs(jnp.where(present, j, own), r_ij, distance, present, image, mirror)
