"""The background grid, its interpolation, and the matrices of its elements."""

import functools
import itertools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hasty import quick

from jaxmps import Box
from jaxmps.pressure.multigrid import Grid, cover, multigrid
from jaxmps.pressure.multigrid.elements import apply, coarsen, entries, row_sums, stencil
from jaxmps.pressure.multigrid.grid import closed, folded, prolong, restrict

GRIDS = {
    "open": Grid((-1.0, 2.0), (0.5, 0.7), (12, 10), (False, False)),
    "periodic in x": Grid((-1.0, 2.0), (0.5, 0.7), (12, 10), (True, False)),
    "periodic in y": Grid((-1.0, 2.0), (0.5, 0.7), (12, 10), (False, True)),
    "periodic": Grid((-1.0, 2.0), (0.5, 0.7), (12, 10), (True, True)),
    "split along x only": Grid((-1.0, 2.0), (0.5, 0.7), (16, 5), (False, False)),
    # Along y an element's neighbor on one side is also that on the other.
    "3-D": Grid((0.0, 1.0, 2.0), (0.5, 0.7, 0.6), (6, 2, 8), (True, True, False)),
}
EVERY = pytest.mark.parametrize("name", GRIDS)


class Parts(NamedTuple):
    """The matrix of each function on a grid, the coarse elements, and the sums of rows."""

    prolong: Any
    restrict: Any
    closed: Any
    folded: Any
    stiffness: Any
    coarse: Any
    sums: Any


@quick
def parts_of(elements, grid) -> Parts:

    def matrix(function, shape):
        unit = jnp.eye(math.prod(shape)).reshape(-1, *shape)
        return jax.vmap(lambda x: function(x).ravel(), out_axes=1)(unit)

    half = stencil(elements, grid)
    return Parts(
        prolong=matrix(lambda x: prolong(x, grid), grid.coarser.nodes),
        restrict=matrix(lambda x: restrict(x, grid), grid.nodes),
        closed=matrix(lambda x: closed(x, grid), grid.nodes),
        folded=matrix(lambda x: folded(x, grid), grid.closed),
        stiffness=matrix(lambda x: apply(half, x, grid), grid.nodes),
        coarse=coarsen(elements, grid),
        sums=row_sums(elements, grid).ravel(),
    )


def random_elements(grid: Grid) -> np.ndarray:
    """Random symmetric, positive semidefinite matrices, some of them zero."""
    rng, corners = np.random.default_rng(1), 2**grid.dim
    root = rng.normal(size=(corners, corners - 1, *grid.elements)) * (rng.random(grid.elements) > 0.2)
    whole = np.einsum("ac...,bc...->ab...", root, root)
    return np.array([whole[a, b] for a, b in entries(grid.dim)])


@functools.cache
def built(name: str) -> Parts:
    grid = GRIDS[name]
    return Parts(*(np.asarray(part) for part in parts_of(jnp.array(random_elements(grid)), grid)))


def assembled(elements: np.ndarray, grid: Grid) -> np.ndarray:
    """The matrix by a loop over the elements."""
    total = np.zeros((math.prod(grid.nodes),) * 2)
    for element in itertools.product(*(range(m) for m in grid.elements)):
        at = [np.ravel_multi_index(np.add(element, c), grid.nodes, mode="wrap") for c in grid.corners]
        for value, (a, b) in zip(elements[(slice(None), *element)], entries(grid.dim), strict=True):
            total[at[a], at[b]] += value
            total[at[b], at[a]] += value if a != b else 0.0
    return total


def coordinates(grid: Grid) -> np.ndarray:
    axes = [low + h * np.arange(m) for low, h, m in zip(grid.lower, grid.size, grid.nodes, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, grid.dim)


LENGTHS = np.geomspace(1.0, 300.0, 60)


def test_open_axes_are_covered_and_by_at_most_a_third_too_much():
    for length in LENGTHS:
        grid = cover(Box((-1.0, 2.0), (-1.0 + length, 3.0)), 0.9)
        assert grid.lower == (-1.0, 2.0)
        assert grid.size == (0.9, 0.9)
        # There are 2, 3, 4, 5, 6, 8, 10, 12, 16, ... elements.
        assert length <= 0.9 * grid.elements[0] <= max(3 * 0.9, length * 4 / 3)


def test_elements_fill_a_periodic_axis_exactly_with_nearly_the_wanted_size():
    for length in LENGTHS:
        grid = cover(Box((-1.0, 2.0), (-1.0 + length, 3.0), (True, False)), 0.9)
        assert grid.size[0] * grid.elements[0] == pytest.approx(length, rel=1e-14)
        assert length < 2 * 0.9 or 1 / 1.35 < grid.size[0] / 0.9 < 1.35


@pytest.mark.parametrize("periodic", [False, True])
def test_grids_coarsen_until_few_nodes_are_left(periodic):
    for length in LENGTHS:
        grid = cover(Box((0.0, 0.0), (length, 40.0), (periodic, False)), 1.0)
        while any(grid.split):
            assert math.prod(grid.coarser.nodes) < math.prod(grid.nodes)
            grid = grid.coarser
        assert math.prod(grid.nodes) <= 64


@EVERY
def test_restriction_is_the_transpose_of_interpolation(name):
    # Weights are powers of one half: no round-off.
    np.testing.assert_array_equal(built(name).restrict, built(name).prolong.T)


@EVERY
def test_folding_is_the_transpose_of_closing(name):
    np.testing.assert_array_equal(built(name).folded, built(name).closed.T)


@EVERY
def test_interpolation_is_exact_for_constants_and_along_open_axes_for_linear_functions(name):
    grid, p = GRIDS[name], built(name).prolong
    slope = np.where(grid.periodic, 0.0, [1.3, -0.4, 0.7][: grid.dim])
    assert 1 < len(p[0]) < len(p)
    np.testing.assert_allclose(p.sum(axis=1), 1.0, rtol=1e-15)
    expected = coordinates(grid) @ slope
    np.testing.assert_allclose(p @ (coordinates(grid.coarser) @ slope), expected, atol=1e-14)


@EVERY
def test_product_is_that_of_the_matrix_assembled_by_a_loop(name):
    expected = assembled(random_elements(GRIDS[name]), GRIDS[name])
    np.testing.assert_allclose(built(name).stiffness, expected, atol=1e-14 * expected.max())
    np.testing.assert_allclose(built(name).stiffness, built(name).stiffness.T, atol=1e-14 * expected.max())


@EVERY
def test_coarse_matrix_is_that_of_the_interpolated_functions(name):
    parts = built(name)
    expected = parts.prolong.T @ parts.stiffness @ parts.prolong
    found = assembled(parts.coarse, GRIDS[name].coarser)
    np.testing.assert_allclose(found, expected, atol=1e-14 * expected.max())


@EVERY
def test_sums_of_rows_bound_the_eigenvalues(name):
    sums = built(name).sums  # zero where no element around a node has any energy
    scale = np.where(sums > 0, 1.0 / np.sqrt(np.where(sums > 0, sums, 1.0)), 0.0)
    found = np.linalg.eigvalsh(scale[:, None] * built(name).stiffness * scale)
    assert 0.3 < found.max() <= 1.0 + 1e-13
    assert found.min() >= -1e-13


@quick
def response(position, area, grid):
    """What the finest matrix makes of a one on a node inside."""
    n = len(position)
    tensor = [[area, 0.0 * area], [0.0 * area, area]]
    m = multigrid(position, tensor, jnp.zeros(n), jnp.ones(n), jnp.ones(n, bool), grid)
    return apply(m.levels[0].stencil, jnp.zeros(grid.nodes).at[4, 5].set(1.0), grid)


def test_particles_on_gauss_points_make_the_bilinear_laplacian():
    # Two points along each axis integrate the squares of linear functions exactly: 8/3 and, all around, -1/3.
    grid = Grid((0.5, -1.0), (0.2, 0.2), (8, 8), (False, False))
    gauss = 0.2 * (np.arange(8)[:, None] + 0.5 + np.array([-0.5, 0.5]) / math.sqrt(3.0)).ravel()
    x, y = np.meshgrid(0.5 + gauss, -1.0 + gauss)
    position = jnp.array(np.stack([x.ravel(), y.ravel()], axis=1))
    area = jnp.full(len(position), 0.2**2 / 4)
    expected = np.zeros(grid.nodes)
    expected[3:6, 4:7] = -1 / 3
    expected[4, 5] = 8 / 3
    np.testing.assert_allclose(response(position, area, grid), expected, atol=1e-14)
