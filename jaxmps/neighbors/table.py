"""The neighbor table: the one door to jax-md's lists.

A list is jax-md's own type with its conventions, and with a search of ours: theirs takes ten to seventy times as long.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Bool, Float

from jaxmps._compilation import jit
from jaxmps.flow import Box
from jaxmps.kernels import lattice
from jaxmps.neighbors.cells import ball, window_size
from jaxmps.neighbors.jax_md import partition
from jaxmps.neighbors.search import search

SKIN = 0.1
"""Default reach of the list beyond the cutoff, in spacings; the list is rebuilt after half of it.

A slot costs more than a rebuild saves: all that is summed over neighbors runs over empty slots, too. The list is
rebuilt once in nearly every step, at the predicted positions; from there the correction moves nobody by half the skin.
"""


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

    def __reduce__(self) -> tuple[Any, ...]:
        """For pickle and `copy.deepcopy`: jax-md's list has functions of this process, which are made again."""
        table = self.table
        arrays = table.idx, table.reference_position, table.error.code
        return _made, (*arrays, table.cell_list_capacity, table.max_occupancy, self.box, self.cutoff, self.skin)


def usual_capacity(reach: float, dim: int) -> int:
    """Slots for neighbors within `reach` spacings: a quarter more than in a uniform cloud, and room for the lattice.

    Flows of all our cases came to 18 of 20 slots in 2-D and 53 of 56 in 3-D, at 2.2 spacings.
    """
    return max(math.ceil(1.25 * ball(reach, dim)), lattice(reach, dim).neighbors)


def allocate(position: Float[Array, "n d"], box: Box, cutoff: float, skin: float, capacity: int) -> Neighbors:
    """A list of all pairs within `cutoff` + `skin` [m], with `capacity` slots for each particle. Not for use under jit.

    Lists of one geometry and size are of one type, so that what was compiled for one serves all.
    """
    n = position.shape[0]
    points = n if box.mirror is None else 2 * n
    capacity = max(0, min(capacity, points - 1))
    nobody = jnp.full_like(position, jnp.nan)  # nobody was anywhere: the first update builds the list
    window = window_size(_lengths(box, cutoff + skin), box.periodic, cutoff + skin, points, capacity)
    arrays = jnp.full((n, capacity), points, jnp.int32), nobody, jnp.zeros((), jnp.uint8)
    return _build(_made(*arrays, window, capacity, box, cutoff, skin), position)


def _made(
    idx: Any, reference: Any, error: Any, window: int, capacity: int, box: Box, cutoff: float, skin: float
) -> Neighbors:
    """A list from what tells it from others."""
    jax_md = partition()
    table = jax_md.NeighborList(
        idx=idx,
        reference_position=reference,
        error=jax_md.PartitionError(error),
        cell_list_capacity=window,
        max_occupancy=capacity,
        format=jax_md.Dense,
        cell_size=None,
        cell_list_fn=None,
        update_fn=_update_function(box, cutoff, skin),
    )
    return Neighbors(table, box, cutoff, skin)


def update(neighbors: Neighbors, position: Float[Array, "n d"]) -> Neighbors:
    """The list for new positions, rebuilt only when some particle has moved by more than half the skin.

    A particle whose position is not finite has no neighbors in a list built then.
    """
    box = neighbors.box
    inside = box.wrap(jax.lax.stop_gradient(position)) - jnp.array(box.lower, position.dtype)
    # A list has no derivative, also where one by a whole state is asked for.
    return eqx.tree_at(lambda n: n.table, neighbors, jax.lax.stop_gradient(neighbors.table).update(inside))


_build = jit(update)


def grow(neighbors: Neighbors, position: Float[Array, "n d"]) -> Neighbors:
    """A new list, half as large again: geometric, so that few sizes are ever compiled. Not for use under jit.

    The windows of the search grow with the slots.
    """
    target = neighbors.capacity + max(4, neighbors.capacity // 2)
    return allocate(position, neighbors.box, neighbors.cutoff, neighbors.skin, target)


@functools.cache
def _update_function(box: Box, cutoff: float, skin: float) -> Callable[..., Any]:
    """jax-md's `update_fn`, one for each geometry: it is part of the type of a list, and so of all that is compiled.

    Positions are jax-md's: relative to the lower corner and, along periodic axes, inside the box. With a mirror the
    numbers from n on are those of the images.
    """
    codes = partition().PartitionErrorCode
    reach = cutoff + skin
    lengths = _lengths(box, reach)

    def rebuild(position: Array, table: Any) -> Any:
        n = len(position)
        points = position if box.mirror is None else _with_images(position, box.mirror, reach)
        idx, slots_full, windows_full = search(
            points, lengths, box.periodic, reach, table.max_occupancy, table.cell_list_capacity
        )
        idx = idx[:n]
        error = table.error.update(codes.NEIGHBOR_LIST_OVERFLOW, slots_full)
        error = error.update(codes.CELL_LIST_OVERFLOW, windows_full)
        return dataclasses.replace(table, idx=idx, reference_position=position, error=error)

    def moved(position: Array, table: Any) -> Bool[Array, ""]:
        squared = jnp.sum(box.displacement(position - table.reference_position) ** 2, axis=-1)
        # Also for a particle that had no finite position before; one that has none now has moved nowhere.
        far = ~(squared <= (0.5 * skin) ** 2) & jnp.all(jnp.isfinite(position), axis=-1)
        return jnp.any(far)

    @custom_vmap
    def moved_on(position: Array, table: Any) -> Any:
        return jax.lax.cond(moved(position, table), rebuild, lambda _, kept: kept, position, table)

    @moved_on.def_vmap
    def _moved_on_together(members: int, batched: Any, position: Array, table: Any) -> Any:
        """Nothing is searched while no member needs it. Those that do not keep their list: the order of pairs is in the
        last digits of every sum, and a member is to be what it would be alone.
        """
        each = [0 if mapped else None for mapped in jax.tree.leaves(batched[1])]
        axes = (0 if batched[0] else None, jax.tree.unflatten(jax.tree.structure(table), each))
        need = jax.vmap(moved, axes, axis_size=members)(position, table)
        whole = jax.tree.map(lambda x, a: x if a == 0 else jnp.broadcast_to(x, (members, *x.shape)), table, axes[1])

        def together(position: Array, table: Any) -> Any:
            found = jax.vmap(rebuild, (axes[0], 0), axis_size=members)(position, table)
            return jax.tree.map(lambda a, b: jnp.where(need.reshape(-1, *(1,) * (a.ndim - 1)), a, b), found, table)

        found = jax.lax.cond(jnp.any(need), together, lambda _, kept: kept, position, whole)
        return found, jax.tree.map(lambda _: True, found)

    def update_fn(position: Array, table: Any, **_: Any) -> Any:
        return moved_on(position, table)

    return update_fn


def _lengths(box: Box, reach: float) -> tuple[float, ...]:
    """Lengths [m] of the space to be searched, with the images that lie within `reach` [m] behind a mirror."""
    return tuple(length + (reach if axis == box.mirror else 0.0) for axis, length in enumerate(box.lengths))


def _with_images(position: Float[Array, "n d"], mirror: int, reach: float) -> Float[Array, "2*n d"]:
    """Positions [m] in that space, and of those within `reach` the images; other images are nowhere."""
    image = position.at[:, mirror].multiply(-1.0)
    image = jnp.where(position[:, mirror, None] < reach, image, jnp.nan)
    return jnp.concatenate([position, image]).at[:, mirror].add(reach)
