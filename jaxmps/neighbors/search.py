"""All pairs of particles within a reach, as a dense table, from cells into which the particles are sorted row by row.

Each particle meets the rows of cells next to it. In each row, those that may be near stand in a window of consecutive
places of the sorted order, which is read as a whole; the hits in it become the bits of a word. No list of candidates is
ever stored: the slots of the table are filled from the words by arithmetic.
"""

import functools
import itertools
import math
from typing import TypeAlias

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, UInt

from jaxmps.neighbors.cells import BITS, FINE, Grid, flat, make_grid, round_up, sort

Place: TypeAlias = Int[Array, " n"]  # in the sorted order
Word: TypeAlias = UInt[Array, " n"]


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
    place, start = sort(jnp.where(present, flat(cell, grid), math.prod(grid.shape)), math.prod(grid.shape), window)
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


def _windows(
    cell: list[Place], present: Bool[Array, " n"], start: Int[Array, " starts"], grid: Grid
) -> list[tuple[Place, Place]]:
    """Of each row of cells next to a particle, the first place and the number of those that may be near."""
    last = grid.shape[-1] - 1
    low, high = cell[-1] - FINE, cell[-1] + FINE
    parts = [(jnp.maximum(low, 0), jnp.minimum(high, last))]
    if grid.periodic[-1] and last < 2 * FINE:
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
            begin, end = start[flat([*row, low], grid)], start[flat([*row, high], grid) + 1]
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
    bits = min(window, BITS)
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
