"""Cells into which particles are sorted, row by row, and how many of them a window on a row has to hold."""

import math
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

FINE = 2  # cells per reach along a row: the more, the shorter the windows, and the more cells there are to count
_WIDER = 1.001  # cells exceed the reach, so that round-off cannot part two neighbors by two cells
BITS = 32  # of a word
_LANES = 8  # what a processor takes at once: loops over sizes that are no multiple of it are up to three times slower


class Grid(NamedTuple):
    """Cells along each axis, in the order of the sorting: the rows lie along the last one."""

    axes: tuple[int, ...]
    shape: tuple[int, ...]
    width: tuple[float, ...]
    periodic: tuple[bool, ...]


def window_size(lengths: tuple[float, ...], periodic: tuple[bool, ...], reach: float, n: int, capacity: int) -> int:
    """Places in a window that go with `capacity` slots: a fifth more than a uniform cloud needs that fills these."""
    every = round_up(n)
    if capacity < n - 1:
        grid = make_grid(lengths, periodic, reach, n)
        volume = math.prod(grid.width) * min(2 * FINE + 1, grid.shape[-1])
        every = min(every, round_up(math.ceil(1.2 * capacity * volume / ball(reach, len(lengths)))))
    return every if every <= BITS else round_up(every, BITS)


def ball(radius: float, dim: int) -> float:
    """The area of a circle, the volume of a sphere."""
    return math.pi * radius**2 if dim == 2 else 4.0 / 3.0 * math.pi * radius**3


def round_up(size: int, multiple: int = _LANES) -> int:
    return -(-size // multiple) * multiple


def make_grid(lengths: tuple[float, ...], periodic: tuple[bool, ...], reach: float, n: int) -> Grid:
    """Cells of `reach` [m] or more, half of that along the rows, which follow the longest axis, an open one if any."""
    dim = len(lengths)
    fast = max(range(dim), key=lambda axis: (not periodic[axis], lengths[axis]))
    axes = (*(axis for axis in range(dim) if axis != fast), fast)
    scale = _WIDER
    while True:
        shape, width = [], []
        for axis in axes:
            least = scale * reach / (FINE if axis == fast else 1)
            count = lengths[axis] / least
            shape.append(max(1, math.floor(count) if periodic[axis] else math.ceil(count)))
            width.append(lengths[axis] / shape[-1] if periodic[axis] else least)
        if math.prod(shape) <= max(16 * n, 4096):
            return Grid(axes, tuple(shape), tuple(width), tuple(periodic[axis] for axis in axes))
        scale *= 1.5  # the box is nearly empty: larger cells take less memory, and there is little in them


def flat(cell: list[Int[Array, " n"]], grid: Grid) -> Int[Array, " n"]:
    """The number of a cell, row by row."""
    number = cell[0]
    for c, size in zip(cell[1:], grid.shape[1:], strict=True):
        number = number * size + c
    return number


def sort(cell: Int[Array, " n"], cells: int, most: int) -> tuple[Int[Array, " n"], Int[Array, " starts"]]:
    """The place of each particle in the order of cells, n where it has none, and the first place of each cell.

    In round r each cell gives its r-th place to the first of those that wait. Three times faster than sorting, for
    there are only a few rounds; no more than `most`.
    """
    n = cell.shape[0]
    me = lax.iota(jnp.int32, n)
    count = jnp.zeros(cells, jnp.int32).at[cell].add(1, mode="drop")
    start = jnp.concatenate([jnp.zeros(1, jnp.int32), jnp.cumsum(count)])

    def give(r, place):
        waiting = jnp.where(place == n, me, n)
        first = jnp.full(cells, n, jnp.int32).at[cell].min(waiting, mode="drop")
        chosen = first.at[cell].get(mode="fill", fill_value=n) == me
        return jnp.where(chosen, start[cell] + r, place)

    place = lax.fori_loop(0, jnp.minimum(jnp.max(count), most), give, jnp.full(n, n, jnp.int32))
    return place, start
