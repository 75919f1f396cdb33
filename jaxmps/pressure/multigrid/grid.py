"""The background grid, its periodic axes, and the interpolation between it and the next coarser one.

Fields on nodes are dense arrays of fixed shape, in any dimension.
"""

import itertools
import math
from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmps._types import total
from jaxmps.flow import Box

MOST_CELLS = 1_000_000_000
"""More than any device has memory for, even where there are no particles: a mistyped box, not a plan."""
_FEW = 64  # nodes of a grid that needs no coarser one: its matrix is inverted as a whole


@dataclass(frozen=True)
class Grid:
    """Elements of the size `size` [m] from the corner `lower` [m] on, `elements` along each axis.

    An open axis has one node more than elements; on a periodic one the last node is the first.
    """

    lower: tuple[float, ...]
    size: tuple[float, ...]
    elements: tuple[int, ...]
    periodic: tuple[bool, ...]

    @property
    def dim(self) -> int:
        """The number of axes."""
        return len(self.elements)

    @property
    def nodes(self) -> tuple[int, ...]:
        """Nodes along each axis; the last one of a periodic axis is its first."""
        return tuple(m + (not p) for m, p in zip(self.elements, self.periodic, strict=True))

    @property
    def closed(self) -> tuple[int, ...]:
        """Nodes along each axis with the last one of a periodic axis."""
        return tuple(m + 1 for m in self.elements)

    @cached_property
    def corners(self) -> list[tuple[int, ...]]:
        """The corners of an element, in the order of its shape functions."""
        return list(itertools.product((0, 1), repeat=self.dim))

    @cached_property
    def split(self) -> tuple[bool, ...]:
        """Along which axes the next coarser grid has half as many elements; along none for the coarsest grid."""
        small = math.prod(self.nodes) <= _FEW
        return tuple(m % 2 == 0 and m > 2 and not small for m in self.elements)

    @property
    def coarser(self) -> "Grid":
        """The grid of the next level: elements joined in twos along the axes that are split."""
        size = tuple(h * (1 + s) for h, s in zip(self.size, self.split, strict=True))
        elements = tuple(m // (1 + s) for m, s in zip(self.elements, self.split, strict=True))
        return Grid(self.lower, size, elements, self.periodic)


def cover(box: Box, size: float) -> Grid:
    """The grid over a box, of elements of about `size` [m], whose number can be halved many times.

    Raises `ValueError` for more elements than there is memory for.
    """
    if (count := math.prod(length / size for length in box.lengths)) > MOST_CELLS:
        raise ValueError(
            f"the box must have at most {MOST_CELLS:.0e} grid cells of {size:g} m, got {count:.1e}, from {box.lower} m "
            f"to {box.upper} m: take a smaller one"
        )
    elements = [_divide(length / size, p) for length, p in zip(box.lengths, box.periodic, strict=True)]
    sizes = [length / m if p else size for m, length, p in zip(elements, box.lengths, box.periodic, strict=True)]
    return Grid(box.lower, tuple(sizes), tuple(elements), box.periodic)


def _divide(wanted: float, periodic: bool) -> int:
    """A number q 2^p with small q: at least `wanted` on an open axis, the closest one on a periodic axis."""
    numbers = sorted({q << p for q in (2, 3, 5) for p in range(24)})
    if periodic:
        return min(numbers, key=lambda m: abs(math.log(m / wanted)))
    if wanted > numbers[-1]:
        raise ValueError(f"the box must be at most {numbers[-1]} grid cells long on each axis, got {wanted:.3g}")
    return next(m for m in numbers if m >= wanted)


def restrict(x: Float[Array, "*nodes"], grid: Grid) -> Float[Array, "*coarse"]:
    """The transpose of `prolong`."""
    around = _haloed_where(x, grid, grid.split)
    count = grid.coarser.nodes

    def part(offset):
        places = zip(offset, count, grid.split, strict=True)
        return around[tuple(slice(1 + o, 2 * k + o, 2) if s else slice(None) for o, k, s in places)]

    return total(weight * part(offset) for offset, weight in _hat(grid))


def prolong(x: Float[Array, "*coarse"], grid: Grid) -> Float[Array, "*nodes"]:
    """Linear interpolation from the next coarser grid to `grid`.

    Written as one sum over the places that a value goes to. One axis after the other would be a chain of copies, which
    the CPU's compiler fuses into each of the nine reads of what follows.
    """
    repeated = jnp.pad(x, [(0, int(p and s)) for p, s in zip(grid.periodic, grid.split, strict=True)], mode="wrap")
    spread = jax.lax.pad(repeated, jnp.zeros((), x.dtype), [(int(s), int(s), int(s)) for s in grid.split])

    def part(offset):
        places = zip(offset, grid.nodes, grid.split, strict=True)
        return spread[tuple(slice(1 + o, 1 + o + k) if s else slice(None) for o, k, s in places)]

    return total(weight * part(offset) for offset, weight in _hat(grid))


def _hat(grid: Grid) -> list[tuple[tuple[int, ...], float]]:
    """The nodes that a coarse node's shape function covers, and its value there."""
    offsets = itertools.product(*[(-1, 0, 1) if split else (0,) for split in grid.split])
    return [(offset, 0.5 ** sum(abs(o) for o in offset)) for offset in offsets]


def haloed(x: Float[Array, "*nodes"], grid: Grid) -> Float[Array, "*haloed"]:
    """With one more layer of nodes on each side: the periodic images, or zeros."""
    return _haloed_where(x, grid, (True,) * grid.dim)


def _haloed_where(x: Float[Array, "*nodes"], grid: Grid, where: tuple[bool, ...]) -> Float[Array, "*haloed"]:
    for axis, periodic in enumerate(grid.periodic):
        width = [(int(a == axis and where[axis]),) * 2 for a in range(x.ndim)]
        x = jnp.pad(x, width, mode="wrap" if periodic else "constant")
    return x


def closed(x: Float[Array, "*nodes"], grid: Grid) -> Float[Array, "*closed"]:
    """With the last node of each periodic axis, which is the first one again."""
    return jnp.pad(x, [(0, int(p)) for p in grid.periodic], mode="wrap") if any(grid.periodic) else x


def folded(x: Float[Array, "*closed"], grid: Grid) -> Float[Array, "*nodes"]:
    """The transpose of `closed`: what lies on the last node of a periodic axis is added to the first."""
    for axis, periodic in enumerate(grid.periodic):
        if periodic:
            last = jax.lax.slice_in_dim(x, x.shape[axis] - 1, x.shape[axis], axis=axis)
            x = jax.lax.slice_in_dim(x, 0, x.shape[axis] - 1, axis=axis)
            x = x.at[(slice(None),) * axis + (slice(0, 1),)].add(last)
    return x
