"""The weight function and the constants of the lattice."""

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmps.kernels import lattice, weight

TABLE = [
    # dim, ratio, n0, lambda / l0^2, neighbors, K
    (2, 2.1, 6.5397, 1.3884, 12, 1.4175),
    (2, 2.4, 9.7747, 1.7708, 20, 1.5230),
    (2, 3.1, 18.9764, 2.4485, 28, 1.2378),
    (2, 4.0, 35.6092, 3.7071, 44, 1.1178),
    (3, 2.1, 14.4186, 1.7017, 32, 1.0731),
    (3, 4.0, 123.99, 5.212, 250, 1.0054),
]


@pytest.mark.parametrize(("dim", "ratio", "n0", "lam", "neighbors", "k"), TABLE)
def test_lattice_constants_are_the_tabulated_sums(dim, ratio, n0, lam, neighbors, k):
    found = lattice(ratio, dim)
    digits = 2 if n0 > 100 else 4
    # Half a unit of the last tabulated digit.
    assert found.n0 == pytest.approx(n0, abs=0.5 * 10.0**-digits)
    assert found.lam == pytest.approx(lam, abs=0.5 * 10.0 ** -(digits + 1 if digits == 2 else 4))
    assert found.neighbors == neighbors
    assert found.k == pytest.approx(k, abs=0.5e-4)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("ratio", [1.5, 2.1, 3.0, 4.0])
def test_lattice_constants_are_sums_of_the_weight_over_a_lattice(dim, ratio):
    points = np.array(list(itertools.product(range(-5, 6), repeat=dim)), float)
    distance = np.linalg.norm(points, axis=1)
    distance = jnp.array(distance[distance > 0])
    w = weight(distance, ratio)
    n0, lam, neighbors, k = lattice(ratio, dim)
    assert n0 == pytest.approx(float(w.sum()), rel=1e-13)
    assert lam == pytest.approx(float((w * distance**2).sum() / w.sum()), rel=1e-13)
    assert neighbors == int((w > 0).sum())
    assert k == pytest.approx(float((ratio / distance * (w > 0)).sum() / (dim * w.sum())), rel=1e-13)


@pytest.mark.parametrize("dim", [2, 3])
def test_second_moment_tends_to_its_integral_for_a_large_radius(dim):
    # Integrals over a disk and a ball: 2 pi r_e^4 / 12 and 4 pi r_e^5 / 20. The lattice sum of a function with a kink
    # at its rim is off by about (l0 / r_e)^2 relative to the integral.
    ratio = 20.0
    n0, lam = lattice(ratio, dim)[:2]
    integral = {2: 2 * math.pi * ratio**4 / 12, 3: 4 * math.pi * ratio**5 / 20}[dim]
    assert n0 * lam == pytest.approx(integral, rel=4 / ratio**2)


def test_second_moment_of_a_small_radius_is_not_its_integral():
    # Lambda = r_e^2 / 6 would be wrong by a factor of 1.9 at r_e = 2.1 l0.
    assert lattice(2.1, 2).lam / (2.1**2 / 6) == pytest.approx(1.9, abs=0.05)


@pytest.mark.parametrize("precision", ["single", "double"], indirect=True)
def test_weight_vanishes_at_and_beyond_its_radius(precision):
    radius = 0.042
    distance = radius * jnp.array([1.0, 1.0 + 1e-6, 1.5, 2.0, 1e3, jnp.inf])
    np.testing.assert_array_equal(weight(distance, radius), 0.0)


@pytest.mark.parametrize("k", [0.5, 1.0, 2.0, 9.0])
def test_weight_is_k_at_the_radius_divided_by_one_more_than_k(k):
    assert float(weight(jnp.array(2.1 / (1.0 + k)), 2.1)) == pytest.approx(k, rel=1e-14)


def test_weight_falls_all_the_way_to_its_radius():
    w = np.asarray(weight(jnp.linspace(0.01, 2.1, 200), 2.1))
    assert np.all(np.diff(w) < 0)
    assert np.all(w[:-1] > 0)


def test_derivative_of_the_weight_is_minus_radius_over_squared_distance_inside_and_zero_outside():
    slope = jax.vmap(jax.grad(weight), (0, None))
    inside, outside = jnp.array([0.3, 1.0, 2.0]), jnp.array([2.2, 3.0, 1e3])
    np.testing.assert_allclose(slope(inside, 2.1), -2.1 / inside**2, rtol=1e-14)
    np.testing.assert_array_equal(slope(outside, 2.1), 0.0)
