"""All pairs of particles within a reach, as a dense table, from cells into which the particles are sorted row by row.

Each particle meets the rows of cells next to it. In each row, those that may be near stand in a window of consecutive
places of the sorted order, which is read as a whole; the hits in it become the bits of a word. No list of candidates is
ever stored: the slots of the table are filled from the words by arithmetic.
"""

import functools
import itertools
import math
from typing import NamedTuple, TypeAlias

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, UInt

_FINE = 2  # cells per reach along a row: the more, the shorter the windows, and the more cells there are to count
_WIDER = 1.001  # cells exceed the reach, so that round-off cannot part two neighbors by two cells
_BITS = 32  # of a word
_LANES = 8  # what a processor takes at once: loops over sizes that are no multiple of it are up to three times slower


Place: TypeAlias = Int[Array, " n"]  # in the sorted order
Word: TypeAlias = UInt[Array, " n"]


class Grid(NamedTuple):
    """Cells along each axis, in the order of the sorting: the rows lie along the last one."""

    axes: tuple[int, ...]
    shape: tuple[int, ...]
    width: tuple[float, ...]
    periodic: tuple[bool, ...]


def search(
    position: Float[Array, "n d"],
    lengths: tuple[float, ...],
    periodic: tuple[bool, ...],
    reach: float,
    capacity: int,
    window: int,
) -> tuple[Int[Array, "n k"], Bool[Array, ""], Bool[Array, ""]]:
    """Of each particle those closer than `reach` [m], n in empty slots; whether slots and whether windows were too few.

    Positions [m] are relative to the lower corner of a box of these lengths, and within it along periodic axes, where
    the nearest image counts. A particle whose position is not finite has no neighbors.
    """
    n = position.shape[0]
    grid = make_grid(lengths, periodic, reach, n)
    present = jnp.all(jnp.isfinite(position), axis=-1)
    cell = [
        jnp.clip(position[:, axis] / width, 0, size - 1).astype(jnp.int32)
        for axis, size, width in zip(grid.axes, grid.shape, grid.width, strict=True)
    ]
    place, start = _sort(jnp.where(present, _flat(cell, grid), math.prod(grid.shape)), math.prod(grid.shape), window)
    windows = _windows(cell, present, start, grid)
    # Beyond the last place a window reads what its length excludes.
    order = jnp.full(n + window, n, jnp.int32).at[place].set(lax.iota(jnp.int32, n), mode="drop")
    periods = [length if turns else None for length, turns in zip(lengths, periodic, strict=True)]
    words = _hits(position, periods, reach, order, place, windows, window)
    idx, most = _slots(words, order, round_up(capacity))
    if idx.shape[1] > capacity:
        idx = lax.optimization_barrier(idx)[:, :capacity]
    longest = functools.reduce(jnp.maximum, [jnp.max(length) for _, length in windows])
    return idx, most > capacity, longest > window


def window_size(lengths: tuple[float, ...], periodic: tuple[bool, ...], reach: float, n: int, capacity: int) -> int:
    """Places in a window that go with `capacity` slots: a fifth more than a uniform cloud needs that fills these."""
    every = round_up(n)
    if capacity < n - 1:
        grid = make_grid(lengths, periodic, reach, n)
        volume = math.prod(grid.width) * min(2 * _FINE + 1, grid.shape[-1])
        every = min(every, round_up(math.ceil(1.2 * capacity * volume / ball(reach, len(lengths)))))
    return every if every <= _BITS else round_up(every, _BITS)


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
            least = scale * reach / (_FINE if axis == fast else 1)
            count = lengths[axis] / least
            shape.append(max(1, math.floor(count) if periodic[axis] else math.ceil(count)))
            width.append(lengths[axis] / shape[-1] if periodic[axis] else least)
        if math.prod(shape) <= max(16 * n, 4096):
            return Grid(axes, tuple(shape), tuple(width), tuple(periodic[axis] for axis in axes))
        scale *= 1.5  # the box is nearly empty: larger cells take less memory, and there is little in them


def _flat(cell: list[Int[Array, " n"]], grid: Grid) -> Int[Array, " n"]:
    """The number of a cell, row by row."""
    number = cell[0]
    for c, size in zip(cell[1:], grid.shape[1:], strict=True):
        number = number * size + c
    return number


def _sort(cell: Int[Array, " n"], cells: int, most: int) -> tuple[Int[Array, " n"], Int[Array, " starts"]]:
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


def _windows(
    cell: list[Place], present: Bool[Array, " n"], start: Int[Array, " starts"], grid: Grid
) -> list[tuple[Place, Place]]:
    """Of each row of cells next to a particle, the first place and the number of those that may be near."""
    last = grid.shape[-1] - 1
    low, high = cell[-1] - _FINE, cell[-1] + _FINE
    parts = [(jnp.maximum(low, 0), jnp.minimum(high, last))]
    if grid.periodic[-1] and last < 2 * _FINE:
        parts = [(jnp.zeros_like(low), jnp.full_like(high, last))]
    elif grid.periodic[-1]:  # a window across the seam has two parts; of other windows the second one is empty
        wraps = low < 0
        parts.append((jnp.where(wraps, low + last + 1, 0), jnp.where(wraps, last, jnp.maximum(high - last - 1, -1))))
    windows = []
    for step in itertools.product(*map(_steps, grid.shape[:-1], grid.periodic[:-1])):
        row, inside = [c + s for c, s in zip(cell, step, strict=False)], present
        for axis, size in enumerate(grid.shape[:-1]):
            if grid.periodic[axis]:
                row[axis] = row[axis] % size
            else:
                inside = inside & (row[axis] >= 0) & (row[axis] < size)
        for low, high in parts:
            begin, end = start[_flat([*row, low], grid)], start[_flat([*row, high], grid) + 1]
            windows.append((begin, jnp.where(inside, end - begin, 0)))
    return windows


def _steps(size: int, periodic: bool) -> tuple[int, ...]:
    """Steps to the cells next to one, none of them met twice."""
    if size == 1:
        return (0,)
    return (0, 1) if periodic and size == 2 else (-1, 0, 1)


def _hits(
    position: Float[Array, "n d"],
    periods: list[float | None],
    reach: float,
    order: Int[Array, " places"],
    place: Place,
    windows: list[tuple[Place, Place]],
    window: int,
) -> list[tuple[Word, Place]]:
    """Words of hits in the windows, each with the place to which its lowest bit belongs."""
    bits = min(window, _BITS)
    bit = jnp.arange(bits, dtype=jnp.int32)
    numbers = lax.GatherDimensionNumbers(offset_dims=(1,), collapsed_slice_dims=(), start_index_map=(0,))
    columns = list(position.T)
    # Without the barriers, what is computed once for a particle would be fused into loops over its candidates or slots.
    ordered, windows = lax.optimization_barrier(([x.at[order].get(mode="clip") for x in columns], windows))
    words = []
    for (begin, length), skip in itertools.product(windows, range(0, window, bits)):
        begin, squared = begin + skip, 0.0
        for x, among, period in zip(columns, ordered, periods, strict=True):
            gap = jnp.abs(lax.gather(among, begin[:, None], numbers, (bits,), mode="clip") - x[:, None])
            gap = gap if period is None else jnp.minimum(gap, period - gap)
            squared = squared + gap * gap
        itself = begin[:, None] + bit == place[:, None]
        hit = (squared < reach**2) & (bit < length[:, None] - skip) & ~itself
        word = jnp.sum(jnp.where(hit, jnp.uint32(1) << bit.astype(jnp.uint32), 0), axis=-1, dtype=jnp.uint32)
        words.append((word, begin))
    return lax.optimization_barrier(words)


def _slots(
    words: list[tuple[Word, Place]], order: Int[Array, " places"], capacity: int
) -> tuple[Int[Array, "n k"], Int[Array, ""]]:
    """The particles that are hits, and the largest number of them."""
    n = words[0][0].shape[0]
    slot = lax.broadcasted_iota(jnp.int32, (n, capacity), 1)
    word, first, before, total = words[0][0][:, None], words[0][1][:, None], 0, 0
    for other, begin in words:
        later = slot >= total
        word, first = jnp.where(later, other[:, None], word), jnp.where(later, begin[:, None], first)
        before = jnp.where(later, total, before)
        total = total + _count(other)[:, None]
    rank, bit = slot - before, jnp.zeros_like(slot)
    for half in (16, 8, 4, 2, 1):  # bisection for the highest bit with no more than `rank` hits below it
        below = word & ((jnp.uint32(1) << (bit + half).astype(jnp.uint32)) - 1)
        bit = jnp.where(_count(below) <= rank, bit + half, bit)
    idx = jnp.where(slot < total, order.at[first + bit].get(mode="clip"), n)
    return idx, jnp.max(total)


def _count(word: UInt[Array, "*shape"]) -> Int[Array, "*shape"]:
    return lax.population_count(word).astype(jnp.int32)
