"""Sources of the pressure equation: their sign, their size, and what the error compensation compensates."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arrangements import SPACING, block, box_cloud

from jaxmps.kernels import lattice
from jaxmps.models import Compression, CorrectedDivergence, DensityDeviation, ErrorCompensatingSource, HigherOrderSource
from jaxmps.operators import KernelLaplacian, density_rate, divergence, number_density
from jaxmps.pressure import PressureEquation, poisson_operator, solve_pressure
from jaxmps.pressure.linear import Jacobi

RADIUS = 2.1 * SPACING
DT = 1e-3
N0, K = lattice(2.1, 2).n0, lattice(2.1, 2).k

solve = jax.jit(solve_pressure, static_argnums=(1, 2))


def compression(velocity, b) -> Compression:
    u = jnp.asarray(velocity)
    return Compression(number_density(b.w), density_rate(u, b.pairs, RADIUS), divergence(u, b.pairs, b.w, b.n0))


def source(model, predicted: Compression, current: Compression | None = None) -> np.ndarray:
    return np.asarray(model(predicted, predicted if current is None else current, N0, jnp.array(DT)))


def pressure(model, rate: float, density: float = 1000.0) -> tuple[np.ndarray, np.ndarray]:
    """The pressure in a block with u = `rate` · r, zero in its two outer rows, and which particles are inside."""
    b = block(2)
    unknown = jnp.array(b.interior)
    c = KernelLaplacian()(b.pairs, b.w, 2.1, SPACING)
    operator = poisson_operator(b.pairs, c, jnp.full(len(b.points), density), unknown)
    right = jnp.array(source(model, compression(rate * (b.points - 0.6), b)))
    p, convergence = solve(
        PressureEquation(operator, right, unknown, jnp.zeros(len(b.points)), Jacobi(operator.diagonal)), 1e-12, 500
    )
    assert convergence.converged
    return np.asarray(p), b.interior


@pytest.mark.parametrize("model", [HigherOrderSource(), ErrorCompensatingSource(), CorrectedDivergence(0.0)])
def test_compression_gives_positive_and_expansion_negative_pressure_everywhere_inside(model):
    for rate in (-2.0, 2.0):
        p, inside = pressure(model, rate)
        assert np.all(np.sign(p[inside]) == -np.sign(rate))
        np.testing.assert_array_equal(p[~inside], 0.0)


def test_higher_order_source_overstates_the_pressure_by_k_on_a_lattice():
    exact, inside = pressure(CorrectedDivergence(0.0), -2.0)
    found, _ = pressure(HigherOrderSource(), -2.0)
    np.testing.assert_allclose(found[inside], K * exact[inside], rtol=1e-9)


def test_pressure_is_proportional_to_the_density():
    light, inside = pressure(HigherOrderSource(), -2.0, 600.0)
    heavy, _ = pressure(HigherOrderSource(), -2.0, 2650.0)
    np.testing.assert_allclose(heavy[inside] / light[inside], 2650.0 / 600.0, rtol=1e-9)


def test_sources_of_a_linear_velocity_are_its_divergence_over_the_time_step():
    b = block(2)
    matrix = np.random.default_rng(1).normal(size=(2, 2))
    state = compression(b.points @ matrix.T, b)
    expected = np.trace(matrix) / DT
    np.testing.assert_allclose(source(HigherOrderSource(), state)[b.interior], K * expected, rtol=1e-10)
    np.testing.assert_allclose(source(CorrectedDivergence(0.0), state)[b.interior], expected, rtol=1e-10)
    # The corrected divergence is so in any arrangement with neighbors enough, the rate of the number density is not.
    c = box_cloud(2)
    state = compression(c.points @ matrix.T, c)
    full = c.well_placed
    np.testing.assert_allclose(source(CorrectedDivergence(0.0), state)[full], expected, rtol=1e-9)
    assert np.std(source(HigherOrderSource(), state)[full]) > 0.3 * abs(expected)


@pytest.mark.parametrize("model", [HigherOrderSource(), CorrectedDivergence(0.0), ErrorCompensatingSource()])
def test_rigid_motion_has_no_source(model):
    c = box_cloud(2)
    x, y = c.points.T
    u = np.stack([3.0 + 5.0 * y, -2.0 - 5.0 * x], axis=1)
    # Round-off of Dn/Dt, whose terms are up to 1e4 1/s, divided by n0 Δt.
    np.testing.assert_allclose(source(model, compression(u, c)), 0.0, atol=1e-7)


def test_restoring_adds_the_relaxed_deviation_of_the_density():
    predicted = Compression(jnp.array([0.9, 1.0, 1.1]) * N0, jnp.zeros(3), jnp.array([3.0, -1.0, 2.0]))
    found = source(CorrectedDivergence(0.03), predicted)
    np.testing.assert_allclose(found, [3e3 + 3e3, -1e3, 2e3 - 3e3], rtol=1e-10, atol=1e-6)
    deviation = source(DensityDeviation(0.03), predicted)
    np.testing.assert_allclose(found - source(CorrectedDivergence(0.0), predicted), deviation, rtol=1e-10, atol=1e-6)


@pytest.mark.parametrize("alpha", [-0.05, 0.0, 0.02])
@pytest.mark.parametrize("rate", [-40.0, 0.0, 30.0])
def test_compensation_doubles_a_growing_error_and_leaves_a_shrinking_one_alone(alpha, rate):
    current = Compression(jnp.full(3, (1.0 + alpha) * N0), jnp.full(3, rate), jnp.zeros(3))
    found = source(ErrorCompensatingSource(), Compression(*(jnp.zeros(3),) * 3), current)
    grows = alpha * rate > 0.0
    expected = -2.0 * alpha * abs(rate) / (N0 * DT) if grows else 0.0
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10)


def test_compensation_adds_to_the_higher_order_source_of_the_predicted_state():
    predicted = Compression(*(jnp.array(x) for x in np.random.default_rng(2).uniform(1.0, 9.0, (3, 3))))
    still = Compression(jnp.full(3, 0.9 * N0), jnp.zeros(3), jnp.zeros(3))
    # A static error of the density stays: there is no rate.
    np.testing.assert_array_equal(
        source(ErrorCompensatingSource(), predicted, still), source(HigherOrderSource(), predicted)
    )
