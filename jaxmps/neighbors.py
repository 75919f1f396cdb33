"""The neighbor table: the one door to jax-md's lists, and `Pairs`, which all operators read.

jax-md is imported when a list is first allocated: it takes several seconds.
"""

import dataclasses
import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxmps.box import Box
from jaxmps.particles import Kind, Particles

SKIN = 0.3
"""Default reach of the list beyond the cutoff, in spacings; the list is rebuilt after half of it."""


_closures: dict[tuple, tuple[Any, Any]] = {}
_NEIGHBOR_LIST_OVERFLOW = 1  # jax_md.partition.PartitionErrorCode


class Pairs(eqx.Module):
    """For particle i (row) its neighbors j (slots): `r_ij` = r_j − r_i [m], `distance` [m], and `present`.

    A slot that is not present holds i itself and the distance l0, so that no value and no derivative meets a zero.
    Particles that were removed from the flow are nobody's neighbors.
    """

    j: Int[Array, "n k"]
    r_ij: Float[Array, "n k d"]
    distance: Float[Array, "n k"]
    present: Bool[Array, "n k"]


class Neighbors(eqx.Module):
    """jax-md's dense list with what is needed to update and enlarge it."""

    table: Any
    box: Box
    cutoff: float = eqx.field(static=True)
    skin: float = eqx.field(static=True)

    @property
    def overflow(self) -> Bool[Array, ""]:
        """Whether pairs are missing because the table or the cells are full; `grow` is the cure."""
        return self.table.error.code != 0

    @property
    def capacity(self) -> int:
        """Slots for neighbors of each particle."""
        return self.table.idx.shape[1]


def allocate(
    position: Float[Array, "n d"],
    box: Box,
    cutoff: float,
    skin: float,
    capacity: int | None = None,
) -> Neighbors:
    """A list of all pairs within `cutoff` + `skin` [m], with `capacity` slots for each particle.

    By default a quarter more slots than are needed now. Not for use under jit.
    """
    functions = _functions(box, cutoff, skin, position.dtype)
    inside = _inside(position, box)
    table = functions.allocate(inside)
    natural = table.idx.shape[1]
    if capacity is not None and capacity > natural:
        table = functions.allocate(inside, capacity - natural)
    elif capacity is not None:
        lost = jnp.any(table.idx[:, capacity:] < position.shape[0])
        table = dataclasses.replace(
            table,
            idx=table.idx[:, :capacity],
            max_occupancy=capacity,
            error=table.error.update(_NEIGHBOR_LIST_OVERFLOW, lost),
        )
    # Each allocation makes its own closures, which are part of the type: with those of the first one, what was
    # compiled for one list serves all of the same size.
    kind = (box, cutoff, skin, table.cell_list_fn is None, position.dtype)
    cell_list_fn, update_fn = _closures.setdefault(kind, (table.cell_list_fn, table.update_fn))
    table = dataclasses.replace(table, cell_list_fn=cell_list_fn, update_fn=update_fn)
    return Neighbors(table, box, cutoff, skin)


def update(neighbors: Neighbors, position: Float[Array, "n d"]) -> Neighbors:
    """The list for new positions, rebuilt only when some particle has moved by more than half the skin."""
    inside = _inside(jax.lax.stop_gradient(position), neighbors.box)
    table = neighbors.table.update(inside)
    return eqx.tree_at(lambda n: n.table, neighbors, table)


def grow(neighbors: Neighbors, position: Float[Array, "n d"]) -> Neighbors:
    """A new list, half as large again: geometric, so that few sizes are ever compiled. Not for use under jit."""
    target = neighbors.capacity + max(4, neighbors.capacity // 2)
    return allocate(position, neighbors.box, neighbors.cutoff, neighbors.skin, target)


def pairs(neighbors: Neighbors, particles: Particles, spacing: float) -> Pairs:
    """The pairs within the cutoff at the particles' positions; differentiable in the positions."""
    position, n = particles.position, particles.position.shape[0]
    table = neighbors.table.idx
    if not neighbors.capacity:  # a particle alone in the world: operators still want a slot
        table = jnp.full((n, 1), n, table.dtype)
    own = jnp.arange(n, dtype=table.dtype)[:, None]
    listed = table < n
    j = jnp.where(listed, table, own)
    r_ij = neighbors.box.displacement(position[j] - position[:, None, :])
    squared = jnp.sum(r_ij**2, axis=-1)
    active = particles.kind != Kind.REMOVED
    present = listed & (squared < neighbors.cutoff**2) & active[:, None] & active[j]
    r_ij = jnp.where(present[..., None], r_ij, 0.0)
    # Coinciding particles get a tiny distance instead of zero: a large weight, but a finite one.
    floor = (1e-3 * spacing) ** 2
    distance = jnp.sqrt(jnp.where(present, jnp.maximum(squared, floor), spacing**2))
    return Pairs(jnp.where(present, j, own), r_ij, distance, present)


def _inside(position: Float[Array, "n d"], box: Box) -> Float[Array, "n d"]:
    """Positions as jax-md wants them: within [0, length), for it truncates toward zero and wraps cell indices."""
    lengths = jnp.array(box.lengths, position.dtype)
    shifted = box.wrap(position) - jnp.array(box.lower, position.dtype)
    return jnp.clip(jnp.nan_to_num(shifted), 0.0, lengths * (1.0 - 1e-6))


@functools.cache
def _functions(box: Box, cutoff: float, skin: float, dtype: Any) -> Any:
    """jax-md's functions, one set for each geometry: every new set recompiles all that uses its lists."""
    from jax_md import partition

    # The list needs three cells along each axis, else it compares all with all. Open axes may be lengthened for that.
    lengths = [
        length if period else max(length, 3.5 * (cutoff + skin))
        for length, period in zip(box.lengths, box.periodic, strict=True)
    ]
    return partition.neighbor_list(
        lambda a, b, **_: box.displacement(a - b),
        jnp.array(lengths, dtype),
        cutoff,
        dr_threshold=skin,
        format=partition.Dense,
    )
