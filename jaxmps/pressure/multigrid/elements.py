"""Bilinear (trilinear) finite elements on a background grid: their matrices, assembled and coarsened.

Matrices are symmetric. Of an element's matrix the upper triangle is kept, of an assembled one the half of each node's
stencil that points forward.
"""

import itertools
import math
from functools import cache

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmps._types import total
from jaxmps.pressure.multigrid.grid import Grid, folded, haloed


@cache
def entries(dim: int) -> tuple[tuple[int, int], ...]:
    """Row and column of the entries of an element's matrix that are kept."""
    return tuple(itertools.combinations_with_replacement(range(2**dim), 2))


def shape_functions(
    local: Float[Array, "n d"], grid: Grid
) -> tuple[list[Float[Array, " n"]], list[list[Float[Array, " n"]]]]:
    """The shape functions of the corners at places in [0, 1]^d of an element, and the components of their gradients."""
    sides = [[(1.0 - local[:, axis], local[:, axis])[c] for axis, c in enumerate(corner)] for corner in grid.corners]
    slopes = [[(-1.0 / h, 1.0 / h)[c] for h, c in zip(grid.size, corner, strict=True)] for corner in grid.corners]
    one = jnp.ones_like(local[:, 0])
    shape = [math.prod(side, start=one) for side in sides]
    gradient = [
        [math.prod(side[:axis] + side[axis + 1 :], start=slope[axis] * one) for axis in range(grid.dim)]
        for side, slope in zip(sides, slopes, strict=True)
    ]
    return shape, gradient


def stencil(matrices: Float[Array, "entries *elements"], grid: Grid) -> Float[Array, "offsets *haloed"]:
    """The assembled matrix: the forward half of each node's stencil, with a halo."""
    half: dict[tuple[int, ...], list[Array]] = {offset: [] for offset in _offsets(grid)}
    for matrix, (a, b) in zip(matrices, entries(grid.dim), strict=True):
        half[_offset(grid, a, b)].append(_to_node(matrix, grid.corners[a], grid))
    return jnp.stack([haloed(total(parts), grid) for parts in half.values()])


def apply(half: Float[Array, "offsets *haloed"], x: Float[Array, "*nodes"], grid: Grid) -> Float[Array, "*nodes"]:
    """The product of an assembled matrix and a vector."""
    around = haloed(x, grid)

    def moved(field, offset, sign):
        return field[tuple(slice(1 + sign * o, 1 + sign * o + m) for o, m in zip(offset, x.shape, strict=True))]

    itself, *others = _offsets(grid)
    product = moved(half[0], itself, 0) * x
    for coefficient, offset in zip(half[1:], others, strict=True):
        product = product + moved(coefficient, offset, 0) * moved(around, offset, 1)
        product = product + moved(coefficient, offset, -1) * moved(around, offset, -1)
    return product


def row_sums(matrices: Float[Array, "entries *elements"], grid: Grid) -> Float[Array, "*nodes"]:
    """Σ_b |K_ab| over the elements at each node a: no eigenvalue of K divided by it exceeds one."""
    rows: list[list[Array]] = [[] for _ in grid.corners]
    for matrix, (a, b) in zip(jnp.abs(matrices), entries(grid.dim), strict=True):
        for corner in {a, b}:
            rows[corner].append(matrix)
    return total(_to_node(total(row), corner, grid) for row, corner in zip(rows, grid.corners, strict=True))


def coarsen(matrices: Float[Array, "entries *elements"], grid: Grid) -> Float[Array, "entries *coarse"]:
    """The matrices of the elements of the next coarser grid, exactly Pᵀ K P, for bilinear elements are nested."""
    parts = []
    for child in itertools.product(*[(0, 1) if split else (0,) for split in grid.split]):
        places = [slice(c, None, 1 + split) for c, split in zip(child, grid.split, strict=True)]
        weights = jnp.asarray(_inheritance(grid, child), matrices.dtype)
        parts.append(jnp.tensordot(weights, matrices[(slice(None), *places)], axes=1))
    return total(parts)


def _inheritance(grid: Grid, child: tuple[int, ...]) -> Float[np.ndarray, "entries entries"]:
    """How much of each entry of a child's matrix its parent's entries get."""

    def shape(coarse: tuple[int, ...], fine: tuple[int, ...]) -> float:
        places = [(c + f) / 2 if split else f for c, f, split in zip(child, fine, grid.split, strict=True)]
        return math.prod(1.0 - abs(place - corner) for place, corner in zip(places, coarse, strict=True))

    p = np.array([[shape(coarse, fine) for fine in grid.corners] for coarse in grid.corners])
    pairs = entries(grid.dim)
    return np.array([[p[a, f] * p[b, g] + (p[a, g] * p[b, f] if f != g else 0.0) for f, g in pairs] for a, b in pairs])


def _offset(grid: Grid, a: int, b: int) -> tuple[int, ...]:
    return tuple(y - x for x, y in zip(grid.corners[a], grid.corners[b], strict=True))


def _offsets(grid: Grid) -> list[tuple[int, ...]]:
    """The half of a node's neighbors that lies forward of it; the first is the node itself."""
    return sorted({_offset(grid, *entry) for entry in entries(grid.dim)})


def _to_node(x: Float[Array, "*elements"], corner: tuple[int, ...], grid: Grid) -> Float[Array, "*nodes"]:
    """What each element gives to the node at one of its corners."""
    return folded(jnp.pad(x, [(c, 1 - c) for c in corner]), grid)
