"""Which particles lie on the free surface, and where the pressure is zero."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arrangements import DIMENSIONS, SPACING, block, table

from jaxmps._vectors import components
from jaxmps.kernels import lattice
from jaxmps.models import AtCenters, DensityThreshold, HalfSpacing, OneSided
from jaxmps.models.free_surface import toward_neighbors
from jaxmps.neighbors import Pairs
from jaxmps.operators import KernelLaplacian, number_density, pair_weight
from jaxmps.pressure import PressureEquation, poisson_operator, solve_pressure
from jaxmps.pressure.linear import Jacobi

RADIUS = 2.1 * SPACING
N0 = lattice(2.1, 2).n0
DETECTORS = pytest.mark.parametrize("detector", [DensityThreshold(), OneSided()])

solve = jax.jit(solve_pressure, static_argnums=(1, 2))


def detect(detector, near: Pairs, dim: int = 2) -> np.ndarray:
    w = pair_weight(near, RADIUS)
    return np.asarray(detector(number_density(w), near, w, lattice(2.1, dim).n0))


@DETECTORS
def test_surface_of_a_square_is_its_outermost_row(detector):
    b = block(2)
    np.testing.assert_array_equal(detect(detector, b.pairs), b.edge == 0)


@DETECTORS
def test_surface_of_a_cube_has_its_outermost_layer_and_nothing_of_its_interior(detector):
    b = block(3)
    found = detect(detector, b.pairs, 3)
    assert np.all(found[b.edge == 0])
    assert not np.any(found[b.interior])


@DETECTORS
def test_particle_alone_is_on_the_surface(detector):
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.1, 0.0]])
    assert np.all(detect(detector, table(points, RADIUS)))


def test_lattice_thinned_by_a_twentieth_is_all_surface_by_density_and_not_if_neighbors_must_be_one_sided():
    # n = Σ (r_e / r − 1) over 12 neighbors is 0.95 n0 if all distances grow by (n0 + 12) / (0.95 n0 + 12).
    b = block(2)
    near = table(np.asarray(b.points) * (N0 + 12.0) / (0.95 * N0 + 12.0), RADIUS)
    n = np.asarray(number_density(pair_weight(near, RADIUS)))
    np.testing.assert_allclose(n[b.interior], 0.95 * N0, rtol=1e-12)
    assert np.all(detect(DensityThreshold(), near))
    np.testing.assert_array_equal(detect(OneSided(), near), b.edge == 0)


def test_one_sidedness_of_the_rows_of_a_lattice_is_the_known_one():
    b = block(2)
    sided = np.linalg.norm(np.asarray(toward_neighbors(b.pairs, b.w)), axis=1) / N0
    middle = b.index[:, 0] == 6
    # The row sums of w e_y that a missing half leaves: w(1) + 2 w(√2) / √2 + w(2) + 2 w(√5) ..., here 0.28 and 0.01.
    w = {r: 2.1 / r - 1.0 for r in (1.0, np.sqrt(2.0), 2.0)}
    first = (w[1.0] + np.sqrt(2.0) * w[np.sqrt(2.0)] + w[2.0]) / N0
    for row, expected, known in ((0, first, 0.28), (1, w[2.0] / N0, 0.01), (2, 0.0, 0.0)):
        here = sided[middle & (b.index[:, 1] == row)][0]
        assert here == pytest.approx(expected, abs=1e-12)
        assert here == pytest.approx(known, abs=0.005)


def test_symmetric_neighborhood_counts_as_surface_if_it_is_sparse():
    # Four neighbors at one spacing: n = 4.4 = 0.67 n0, and nothing one-sided about it.
    points = SPACING * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    assert detect(OneSided(sparse=0.7), table(points, RADIUS))[0]
    assert not detect(OneSided(sparse=0.6), table(points, RADIUS))[0]


@DIMENSIONS
@pytest.mark.parametrize("upward", [True, False])
def test_pressure_of_the_surface_row_of_fluid_at_rest_is_that_of_half_a_spacing(dim, upward):
    b = block(dim)
    depth = b.index[:, -1] + 0.5
    depth = depth.max() + 0.5 - depth if upward else depth
    surface = depth < 1.0
    weight = 1000.0 * 9.81 * SPACING
    p = jnp.array(np.where(surface, 0.0, weight * depth))
    found = HalfSpacing().pressure(p, jnp.array(surface), jnp.array(~surface), b.pairs, b.w, SPACING)
    # Sideways far enough from the corners, where the normal is oblique.
    middle = np.all((b.index[:, :-1] > 1) & (b.index[:, :-1] < b.index.max() - 1), axis=1)
    assert np.sum(surface & middle) > 0
    np.testing.assert_allclose(found[surface & middle], 0.5 * weight, rtol=1e-12)
    np.testing.assert_array_equal(found[~surface], p[~surface])
    np.testing.assert_array_equal(AtCenters().pressure(p, surface, ~surface, b.pairs, b.w, SPACING), p)


def slab(rows: int, columns: int = 5) -> tuple[Pairs, np.ndarray]:
    """A slab of the lattice that is periodic along x, and the row of each particle."""
    offsets = [o for o in itertools.product(range(-2, 3), repeat=2) if 0 < np.linalg.norm(o) < 2.1]
    x, row = (a.ravel() for a in np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"))
    dx, dy = np.array(offsets).T
    there = np.add.outer(row, dy)
    present = (there >= 0) & (there < rows)
    own = np.arange(len(x))[:, None]
    j = np.where(present, np.add.outer(x, dx) % columns * rows + there, own)
    r_ij = np.where(present[..., None], SPACING * np.array(offsets), 0.0)
    distance = np.where(present, SPACING * np.hypot(dx, dy), SPACING)
    return Pairs(jnp.array(j), components(jnp.array(r_ij)), jnp.array(distance), jnp.array(present)), row


@pytest.mark.parametrize("rows", [8, 16])
def test_pressure_of_a_slab_is_closer_to_its_parabola_with_the_surface_outside_the_particles(rows):
    # ∇²p = −s, p = 0 on both faces, which lie half a spacing outside the first and last row: p = s y (h − y) / 2.
    near, row = slab(rows)
    w = pair_weight(near, RADIUS)
    surface = (row == 0) | (row == rows - 1)
    y, h = (row + 0.5) * SPACING, rows * SPACING
    exact = 0.5 * y * (h - y)
    error = {}
    for condition in (AtCenters(), HalfSpacing()):
        c = condition.coefficient(KernelLaplacian()(near, w, 2.1, SPACING), jnp.array(surface), near)
        unknown, zero = jnp.array(~surface), jnp.zeros(len(row))
        operator = poisson_operator(near, c, zero + 1.0, unknown)
        equation = PressureEquation(operator, zero - 1.0, unknown, zero, Jacobi(operator.diagonal))
        p, convergence = solve(equation, 1e-12, 500)
        assert convergence.converged
        p = condition.pressure(p, ~unknown, unknown, near, w, SPACING)
        error[type(condition)] = np.abs(np.asarray(p) - exact).max() / exact.max()
    # With the surface at the centers the slab is thinner by a spacing: 1 − ((rows − 1) / rows)² too little, and a bit.
    assert error[AtCenters] == pytest.approx(1.0 - ((rows - 1.0) / rows) ** 2, rel=0.25)
    assert error[HalfSpacing] < 0.25 * error[AtCenters]


@pytest.mark.parametrize(("condition", "above"), [(AtCenters(), 0.0), (HalfSpacing(), 0.5)])
def test_hydrostatic_pressure_is_exactly_the_weight_above_from_a_surface_half_a_spacing_outside_the_centers(
    condition, above
):
    # Neighbors within 1.9 spacings, so that the row below the surface alone is coupled to it. The floor carries all.
    near, row = slab(8)
    w, weight = pair_weight(near, 1.9 * SPACING), 1000.0 * 9.81
    c = KernelLaplacian()(near, w, 1.9, SPACING)
    surface, zero = row == 7, jnp.zeros(len(row))
    inside = jnp.array(~surface)
    push = np.where(row == 0, weight * np.sum(np.asarray(c * near.r_ij[1]), axis=1), 0.0)
    operator = poisson_operator(near, condition.coefficient(c, jnp.array(surface), near), zero + 1.0, inside)
    equation = PressureEquation(operator, jnp.array(-push), inside, zero, Jacobi(operator.diagonal))
    p, convergence = solve(equation, 1e-13, 500)
    assert convergence.converged
    p = condition.pressure(p, jnp.array(surface), inside, near, w, SPACING)
    np.testing.assert_allclose(p, weight * SPACING * (7 - row + above), rtol=1e-10, atol=1e-9)
