"""The operators on lattices, where closed forms are exact."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest
from arrangements import CLOUD, DIMENSIONS, SPACING, block, cloud, strength, table

from jaxmps._vectors import joined
from jaxmps.models import Inviscid, Viscous
from jaxmps.neighbors import Pairs
from jaxmps.operators import MinPressure, laplacian, number_density, pair_weight
from jaxmps.operators.gradient import minimum

PRESSURE = np.random.default_rng(4).uniform(0, 1e4, 150)

# Tolerances of 1e-11 and 1e-12: round-off of sums of some ten terms, magnified by l0^2 in second derivatives.


@DIMENSIONS
@pytest.mark.parametrize("ratio", [2.1, 3.1])
def test_laplacian_of_a_paraboloid_is_twice_the_dimension(dim, ratio):
    b = block(dim, ratio)
    phi = jnp.sum((b.points - 0.37) ** 2, axis=1)
    found = laplacian(phi, b.pairs, b.w, b.n0, b.lam)[b.interior]
    assert b.interior.sum() > 0
    np.testing.assert_allclose(found, 2.0 * dim, rtol=1e-11)


@DIMENSIONS
def test_laplacian_of_a_squared_coordinate_is_two_along_each_axis(dim):
    b = block(dim)
    found = laplacian(b.points**2, b.pairs, b.w, b.n0, b.lam)[b.interior]
    np.testing.assert_allclose(found, 2.0, rtol=1e-11)


@DIMENSIONS
def test_laplacian_of_a_constant_is_zero_everywhere(dim):
    b = block(dim)
    phi = jnp.full(len(b.points), 7.3)
    np.testing.assert_array_equal(laplacian(phi, b.pairs, b.w, b.n0, b.lam), 0.0)


@DIMENSIONS
def test_laplacian_of_linear_fields_is_zero_in_the_interior(dim):
    b = block(dim)
    matrix = np.random.default_rng(0).normal(size=(dim, 5))
    found = laplacian(b.points @ matrix, b.pairs, b.w, b.n0, b.lam)[b.interior]
    np.testing.assert_allclose(found, 0.0, atol=1e-11)


def test_laplacian_of_a_vector_field_is_that_of_its_components():
    near, w = cloud()
    u = jnp.array(np.random.default_rng(1).normal(size=(150, 2, 3)))
    whole = laplacian(u, near, w, 6.5, 0.01)
    for a, b in itertools.product(range(2), range(3)):
        part = laplacian(u[:, a, b], near, w, 6.5, 0.01)
        np.testing.assert_allclose(whole[:, a, b], part, rtol=1e-13, atol=1e-11)


def test_laplacian_exchanges_without_loss():
    # Antisymmetric fluxes: the sum over all particles vanishes, in any arrangement.
    near, w = cloud()
    found = laplacian(jnp.array(PRESSURE), near, w, 6.5, 0.01)
    assert abs(float(found.sum())) < 1e-12 * float(jnp.abs(found).sum())


@DIMENSIONS
def test_viscous_acceleration_of_a_parabolic_flow_is_viscosity_times_its_curvature(dim):
    b = block(dim)
    u = jnp.sum(b.points**2, axis=-1)[:, None] * jnp.arange(1.0, dim + 1)
    nu = jnp.full(len(b.points), 0.3)
    flow = nu, jnp.full_like(nu, 900.0), jnp.full(len(nu), True)
    found = Viscous()(u, *flow, b.pairs, b.w, b.n0, b.lam)[b.interior]
    np.testing.assert_allclose(found, np.broadcast_to(0.3 * 2 * dim * np.arange(1.0, dim + 1), found.shape), rtol=1e-9)
    np.testing.assert_array_equal(Inviscid()(u, *flow, b.pairs, b.w, b.n0, b.lam), 0.0)


@pytest.mark.parametrize("ratio", [1.0, 1000.0])
def test_phases_of_any_density_and_viscosity_exchange_momentum_without_loss(ratio):
    near, w = cloud()
    rng = np.random.default_rng(7)
    u, nu = jnp.array(rng.normal(size=(150, near.dim))), jnp.array(rng.uniform(0.1, 2.0, 150))
    nu = nu.at[:20].set(0.0)
    density = jnp.array(np.where(rng.random(150) > 0.5, 1.0, ratio))
    found = Viscous()(u, nu, density, jnp.full(150, True), near, w, 6.5, 0.01)
    force = density[:, None] * found
    assert np.abs(force.sum(axis=0)).max() < 1e-12 * float(jnp.abs(force).sum())
    assert float(jnp.sum(u * force)) < 0.0  # and take energy out of the flow


def test_harmonic_mean_of_dynamic_viscosities_stands_between_two_fluids_and_twice_its_own_at_a_wall():
    # Two particles: the coefficient of the pair is what one feels of the velocity of the other.
    one, beside = jnp.array([[0], [1]]), (jnp.array([[0.1], [-0.1]]), jnp.zeros((2, 1)))
    near, w = Pairs(1 - one, beside, jnp.full((2, 1), 0.1), jnp.full((2, 1), True)), jnp.full((2, 1), 1.1)
    nu, density = jnp.array([0.2, 3.0]), jnp.array([1000.0, 1.0])
    u = jnp.array([[0.0, 0.0], [1.0, 0.0]])
    coefficient = 4.0 / (0.01 * 6.5) * float(w[0, 0])
    for moves, mu in ((True, 2.0 * 200.0 * 3.0 / 203.0), (False, 2.0 * 200.0)):
        found = Viscous()(u, nu, density, jnp.array([True, moves]), near, w, 6.5, 0.01)
        assert float(found[0, 0]) == pytest.approx(coefficient * mu / 1000.0, rel=1e-12)


@DIMENSIONS
@pytest.mark.parametrize("ratio", [2.1, 3.1])
def test_gradient_of_a_linear_field_is_exact_in_the_interior(dim, ratio):
    b = block(dim, ratio)
    slope = np.array([300.0, -700.0, 500.0])[:dim]
    found = MinPressure()(b.points @ slope + 40.0, jnp.ones_like(b.w), b.pairs, b.w, b.n0)[b.interior]
    np.testing.assert_allclose(found, np.broadcast_to(slope, found.shape), rtol=1e-11)


@DIMENSIONS
def test_gradient_with_the_minimum_is_the_plain_one_in_symmetric_neighborhoods(dim):
    b = block(dim)
    rng = np.random.default_rng(2)
    p = jnp.array(rng.uniform(0, 1e4, len(b.points)))
    near = b.pairs
    plain = (p[near.j] - p[:, None])[..., None] * joined(near.r_ij) * (b.w / near.distance**2)[..., None]
    plain = dim / b.n0 * plain.sum(axis=1)
    found = MinPressure()(p, jnp.ones_like(b.w), near, b.w, b.n0)
    scale = float(jnp.abs(plain).max())
    np.testing.assert_allclose(found[b.interior], plain[b.interior], atol=1e-12 * scale)
    assert np.abs(found - plain)[b.edge == 0].max() > 1e-3 * scale


@DIMENSIONS
def test_constant_pressure_gives_no_force_anywhere(dim):
    b = block(dim)
    p = jnp.full(len(b.points), 1234.5)
    np.testing.assert_array_equal(MinPressure()(p, jnp.ones_like(b.w), b.pairs, b.w, b.n0), 0.0)


def test_pressure_force_of_every_pair_repels():
    # The part of j in the acceleration of i points away from j: p_j is nowhere below the minimum.
    near, w = cloud()
    p = jnp.array(PRESSURE)
    pushes = strength(MinPressure(), p, near, w, CLOUD.n0)[np.asarray(w) > 0]
    # Round-off, of pressures up to 1e4.
    assert pushes.min() > -1e-9
    assert np.mean(pushes > 1.0) > 0.9


@pytest.mark.parametrize("pressures", [(5.0, 5.0, 9.0), (0.0, 0.0, 3.0), (4.0, 1.0, 1.0), (1.0, 4.0, 2.0)])
def test_particle_between_two_others_is_pushed_from_the_one_of_higher_pressure(pressures):
    points = np.array([[0.1, 0.0], [0.0, 0.0], [0.23, 0.0]])  # i, left, right
    near = table(points, 2.1 * SPACING)
    w = pair_weight(near, 2.1 * SPACING)
    force = -MinPressure()(jnp.array(pressures), jnp.ones_like(w), near, w, 6.5)[0, 0]
    own, left, right = pressures
    low = min(pressures)
    push = {side: (p - low) * (0.21 / r - 1.0) / r for side, p, r in (("left", left, 0.1), ("right", right, 0.13))}
    assert own >= low
    assert float(force) == pytest.approx(2 / 6.5 * (push["left"] - push["right"]), rel=1e-12)


def test_minimum_includes_the_particle_itself():
    near, w = cloud()
    p = jnp.array(PRESSURE)
    lowest = int(np.argmin(PRESSURE))
    found = np.asarray(minimum(p, near, w > 0))
    assert np.all(found <= PRESSURE)
    assert found[lowest] == PRESSURE[lowest]
    alone = table(np.array([[0.0, 0.0], [1.0, 0.0], [1.1, 0.0]]), 2.1 * SPACING)
    weights = pair_weight(alone, 2.1 * SPACING)
    np.testing.assert_array_equal(minimum(jnp.array([9.0, 3.0, 5.0]), alone, weights > 0), [9.0, 3.0, 3.0])


def test_minimum_counts_only_pairs_of_nonzero_weight():
    near, w = cloud()
    near_radius = 1.3 * SPACING
    short = pair_weight(near, near_radius)
    found = minimum(jnp.array(PRESSURE), near, short > 0)
    distance = np.linalg.norm(CLOUD.points[:, None] - CLOUD.points[None], axis=-1)
    expected = np.where(distance < near_radius, PRESSURE[None], np.inf).min(axis=1)
    np.testing.assert_array_equal(found, expected)
    wide = np.where(distance < 2.1 * SPACING, PRESSURE[None], np.inf).min(axis=1)
    assert np.any(expected != wide)
    np.testing.assert_array_equal(minimum(jnp.array(PRESSURE), near, w > 0), wide)


def test_absent_pairs_have_no_weight():
    near, w = cloud()
    np.testing.assert_array_equal(np.asarray(w)[~np.asarray(near.present)], 0.0)
    assert np.all(np.asarray(w)[np.asarray(near.present)] > 0)


@pytest.mark.parametrize(
    ("ratio", "rows", "corner"),
    [
        (2.1, (0.676, 0.992, 1.0), 0.426),
        (2.4, (0.664, 0.9645, 1.0), 0.414),
        (3.1, (0.641, 0.918, 0.998), 0.391),
        (4.0, (0.622, 0.868, 0.9696), 0.372),
    ],
)
def test_number_density_of_rows_below_a_surface_and_of_a_corner_is_the_tabulated_one(ratio, rows, corner):
    b = block(2, ratio)
    fraction = np.asarray(number_density(b.w)) / b.n0
    side = b.index.shape[0] ** 0.5
    middle = b.index[:, 0] == side // 2
    for row, expected in enumerate(rows):
        here = fraction[middle & (b.index[:, 1] == row)]
        # Half a unit of the last tabulated digit, three or four of them.
        assert here == pytest.approx(expected, abs=5e-4 if round(expected, 3) == expected else 5e-5)
    assert fraction[0] == pytest.approx(corner, abs=5e-4)
    assert fraction[b.interior] == pytest.approx(1.0, rel=1e-13)
