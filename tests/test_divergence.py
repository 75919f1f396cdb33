"""Divergence, rate of the number density, and the Laplacians: closed forms on lattices and in random clouds."""

import jax.numpy as jnp
import numpy as np
import pytest
from arrangements import DIMENSIONS, SPACING, block, box_cloud, cloud, table

from jaxmps.kernels import lattice
from jaxmps.operators import (
    Corrected,
    HigherOrderLaplacian,
    KernelLaplacian,
    density_rate,
    divergence,
    laplacian,
    number_density,
    pair_weight,
)
from jaxmps.operators.gradient import moments

RADIUS = 2.1 * SPACING
PRESSURE = np.random.default_rng(4).uniform(-1e4, 1e4, 150)


@DIMENSIONS
def test_divergence_of_a_linear_velocity_is_exact_in_any_arrangement(dim):
    c = box_cloud(dim)
    matrix = np.random.default_rng(9).normal(size=(dim, dim))
    found = divergence(jnp.array(c.points @ matrix.T + 3.0), c.pairs, c.w, c.n0)
    exact = c.well_placed
    np.testing.assert_allclose(found[exact], np.trace(matrix), atol=1e-10)


@DIMENSIONS
def test_divergence_is_the_trace_of_the_corrected_gradient(dim):
    c = box_cloud(dim)
    u = jnp.array(np.random.default_rng(10).normal(size=c.points.shape))
    gradients = [Corrected()(u[:, axis], jnp.ones_like(c.w), c.pairs, c.w, c.n0) for axis in range(dim)]
    expected = sum(gradients[axis][:, axis] for axis in range(dim))
    np.testing.assert_allclose(divergence(u, c.pairs, c.w, c.n0), expected, rtol=1e-9, atol=1e-9)
    unit = moments(c.pairs, c.w, c.n0, 0.05)[~c.well_placed]
    np.testing.assert_array_equal(unit, np.broadcast_to(np.eye(dim), unit.shape))


@DIMENSIONS
def test_rate_of_the_number_density_is_that_of_the_moving_particles(dim):
    c = box_cloud(dim)
    u = np.random.default_rng(11).normal(size=c.points.shape)
    found = density_rate(jnp.array(u), c.pairs, RADIUS)
    h = 1e-8  # no pair crosses r_e within it
    plus, minus = (number_density(pair_weight(table(c.points + s * u, 1.1 * RADIUS), RADIUS)) for s in (h, -h))
    difference = np.asarray(plus - minus) / (2 * h)
    # The truncation error is h² / r² of the closest pair, round-off 1e-16 / h, both relative to w ≈ 1e2 of that pair.
    np.testing.assert_allclose(found, difference, rtol=1e-5, atol=1e-6 * np.abs(difference).max())


@pytest.mark.parametrize(("dim", "ratio", "k"), [(2, 2.1, 1.4175), (2, 3.1, 1.2378), (3, 2.1, 1.0731)])
def test_rate_of_the_number_density_on_a_lattice_overstates_the_divergence_by_k(dim, ratio, k):
    b = block(dim, ratio)
    matrix = np.random.default_rng(12).normal(size=(dim, dim))
    found = density_rate(b.points @ jnp.array(matrix.T), b.pairs, ratio * SPACING)[b.interior]
    np.testing.assert_allclose(found, -lattice(ratio, dim).k * b.n0 * np.trace(matrix), rtol=1e-11)
    # Half a unit of the last tabulated digit.
    np.testing.assert_allclose(found, -k * b.n0 * np.trace(matrix), rtol=0.5e-4 / k)


# Laplacians


@pytest.mark.parametrize(("dim", "ratio"), [(2, 2.1), (2, 3.1), (3, 2.1)])
def test_higher_order_laplacian_is_too_strong_as_published_and_exact_if_consistent(dim, ratio):
    b = block(dim, ratio)
    found = {}
    for consistent in (False, True):
        c = HigherOrderLaplacian(consistent)(b.pairs, b.w, ratio, SPACING)
        phi = b.points[:, 0] ** 2
        found[consistent] = np.asarray(jnp.sum(c * (phi[b.pairs.j] - phi[:, None]), axis=1))[b.interior]
    np.testing.assert_allclose(found[True], 2.0, rtol=1e-11)
    factor = {2: 1.5, 3: 1.0}[dim] * lattice(ratio, dim).k
    np.testing.assert_allclose(found[False], 2.0 * factor, rtol=1e-11)
    if ratio == 2.1:
        assert factor == pytest.approx({2: 2.126, 3: 1.0731}[dim], abs=5e-4)


@pytest.mark.parametrize("model", [KernelLaplacian(), HigherOrderLaplacian(), HigherOrderLaplacian(False)])
def test_coefficients_of_a_laplacian_are_those_of_its_pairs_and_symmetric(model):
    near, w = cloud()
    c = np.asarray(model(near, w, 2.1, SPACING))
    np.testing.assert_array_equal(c > 0, np.asarray(w) > 0)
    dense = np.zeros((150, 150))
    np.add.at(dense, (np.arange(150)[:, None], np.asarray(near.j)), c)
    np.testing.assert_allclose(dense, dense.T, rtol=1e-12)


def test_coefficients_of_the_kernel_are_those_of_the_laplacian():
    near, w = cloud()
    n0, lam = lattice(2.1, 2)[:2]
    p = jnp.array(PRESSURE)
    c = KernelLaplacian()(near, w, 2.1, SPACING)
    expected = laplacian(p, near, w, n0, lam * SPACING**2)
    np.testing.assert_allclose(jnp.sum(c * (p[near.j] - p[:, None]), axis=1), expected, rtol=1e-11)
