"""The rotating square patch: its particles, and the solutions that stand beside it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmps import Kind
from jaxmps.cases import SQUARE_PATCH_REFERENCE, square_patch, square_patch_pressure, square_patch_tip


def test_patch_is_a_square_of_fluid_around_the_origin_without_walls_and_gravity():
    case = square_patch()
    position = np.asarray(case.particles.position)
    assert position.shape == (2500, 2)
    assert np.all(np.asarray(case.particles.kind) == Kind.FLUID)
    assert np.all(np.asarray(case.gravity) == 0.0)
    np.testing.assert_allclose(np.unique(np.round(position[:, 0], 9)), np.arange(-0.49, 0.5, 0.02), atol=1e-9)
    np.testing.assert_allclose(position.mean(axis=0), 0.0, atol=1e-14)
    assert len(np.unique(np.round(position / 0.02, 3), axis=0)) == 2500
    assert case.box.lower == (-2.0, -2.0)
    assert case.box.upper == (2.0, 2.0)
    assert np.asarray(case.fluids.density).tolist() == [1000.0]
    assert np.asarray(case.fluids.viscosity).tolist() == [0.0]


@pytest.mark.parametrize("omega", [1.0, -2.5])
def test_patch_rotates_as_a_rigid_body_clockwise_if_positive(omega):
    particles = square_patch(spacing=0.05, side=2.0, angular_velocity=omega).particles
    x, y = np.asarray(particles.position).T
    np.testing.assert_array_equal(particles.velocity, np.stack([omega * y, -omega * x], axis=1))
    # Per unit depth: ρωL⁴/6 and ρω²L⁴/12; the sums over N² cell centers fall short of the integrals by 1/N².
    mass, short = 1000.0 * 0.05**2, 1.0 - 1.0 / 40**2
    u, v = np.asarray(particles.velocity).T
    assert mass * np.sum(y * u - x * v) == pytest.approx(1000.0 * omega * 2.0**4 / 6.0 * short)
    assert 0.5 * mass * np.sum(u**2 + v**2) == pytest.approx(1000.0 * omega**2 * 2.0**4 / 12.0 * short)


def test_patch_starts_with_its_exact_pressure():
    particles = square_patch(spacing=0.1, side=0.8, angular_velocity=3.0, density=900.0).particles
    x, y = particles.position.T
    np.testing.assert_allclose(particles.pressure, square_patch_pressure(x, y, 0.8, 3.0, 900.0), rtol=1e-13)
    assert np.all(np.asarray(particles.pressure) < 0.0)


def test_patch_has_the_same_pressure_in_its_mirror_image():
    there, back = (square_patch(spacing=0.1, angular_velocity=w).particles for w in (1.0, -1.0))
    np.testing.assert_array_equal(there.pressure, back.pressure)
    np.testing.assert_array_equal(there.velocity, -back.velocity)


def test_side_is_rounded_to_whole_spacings_and_the_pressure_is_that_of_the_rounded_side():
    case = square_patch(spacing=0.1, side=1.04)
    x, y = case.particles.position.T
    assert len(case.particles.kind) == 100
    np.testing.assert_allclose(case.particles.pressure, square_patch_pressure(x, y, 1.0), rtol=1e-12)


@pytest.mark.parametrize(("place", "value"), [((0, 0), -0.147343), ((0.25, 0), -0.114670), ((0.25, 0.25), -0.090572)])
def test_pressure_has_its_known_values(place, value):
    # In units of ρω²L²; the numbers have six digits.
    x, y = place
    assert square_patch_pressure(x, y, 1.0, 1.0, 1.0) == pytest.approx(value, abs=6e-7)
    scaled = square_patch_pressure(2.0 * x, 2.0 * y, 2.0, -3.0, 800.0)
    assert scaled == pytest.approx(800.0 * 9.0 * 4.0 * value, rel=1e-5)


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.1, 0.43), (-0.43, 0.2), (0.31, -0.31)])
def test_pressure_is_the_double_fourier_series(place):
    x, y = place
    m = np.arange(1, 1200, 2)
    n = m[:, None]
    waves = np.sin(m * np.pi * (x + 0.5)) * np.sin(n * np.pi * (y + 0.5))
    series = -np.sum(32.0 / (np.pi**4 * m * n * (m**2 + n**2)) * waves)
    # The tail of the double series, beyond 600 terms each way, is the larger error.
    assert square_patch_pressure(x, y, 1.0, 1.0, 1.0) == pytest.approx(series, abs=1e-7)


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.2, -0.1), (0.05, 0.44), (-0.4, 0.4), (0.3, 0.3)])
def test_laplacian_of_the_pressure_is_twice_density_times_angular_velocity_squared(place):
    x, y, h = *place, 1e-3
    p = [square_patch_pressure(x + a * h, y + b * h, 1.0, 3.0, 900.0) for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    found = (sum(p) - 4.0 * square_patch_pressure(x, y, 1.0, 3.0, 900.0)) / h**2
    # The second difference errs by h² ∂⁴p / 12, the largest of it near the corners; across a diagonal by the tail too.
    assert found == pytest.approx(2.0 * 900.0 * 9.0, rel=1e-3)


def test_pressure_vanishes_on_the_sides_and_outside():
    s = jnp.linspace(-0.5, 0.5, 41)
    for x, y in ((s, 0.5 + 0 * s), (s, -0.5 + 0 * s), (0.5 + 0 * s, s), (-0.5 + 0 * s, s), (2.0 + s, s), (s, 90.0 + s)):
        np.testing.assert_array_equal(square_patch_pressure(x, y), 0.0)
    inside = square_patch_pressure(s, 0.5 - 1e-9 + 0 * s, 1.0, 1.0, 1.0)
    # The gradient at the middle of a side is 0.67516 ρω²L.
    assert np.max(np.abs(inside)) < 1e-4
    slope = jax.grad(lambda x: square_patch_pressure(x, 0.0, 1.0, 1.0, 1.0))(0.4999999)
    assert slope == pytest.approx(0.67516, rel=1e-3)


def test_tips_move_on_along_their_first_tangent():
    time = np.linspace(0.0, 2.0, 9)
    radius, angle = square_patch_tip(time, 2.0, 1.5)
    # The corner (1, 1) starts with u = 1.5 (1, -1): clockwise from 45 degrees.
    x, y = 1.0 + 1.5 * time, 1.0 - 1.5 * time
    np.testing.assert_allclose(radius, np.hypot(x, y), rtol=1e-12)
    np.testing.assert_allclose(np.pi / 4 - angle, np.arctan2(y, x), atol=1e-12)


def test_reference_begins_with_the_square_and_has_the_exact_tips():
    time, radius, degrees, nearest, center = SQUARE_PATCH_REFERENCE.T
    exact, angle = square_patch_tip(time)
    np.testing.assert_allclose(radius, exact, atol=6e-6)
    np.testing.assert_allclose(degrees, np.degrees(angle), atol=6e-3)
    assert nearest[0] == 0.5
    assert center[0] == pytest.approx(float(square_patch_pressure(0.0, 0.0, 1.0, 1.0, 1.0)), rel=1e-4)


@pytest.mark.parametrize("precision", ["single", "double"], indirect=True)
def test_patch_is_as_good_in_both_precisions(precision):
    particles = square_patch(spacing=0.1).particles
    assert particles.pressure.dtype == (jnp.float32 if precision == "single" else jnp.float64)
    # At (0.05, 0.05), from the double series; single precision loses a digit where the terms cancel.
    np.testing.assert_allclose(particles.pressure[55], -144.851825, rtol=1e-6 if precision == "single" else 1e-8)


BAD = [0.0, float("nan"), float("inf"), float("-inf"), "0.1", None, True, 1j, [0.1]]


@pytest.mark.parametrize("name", ["spacing", "side", "angular_velocity", "density", "viscosity", "reach", "ratio"])
def test_bad_argument_is_refused_by_name_and_value(unchecked, name):
    for value in BAD if name == "angular_velocity" else [-1.0, *BAD]:
        if name == "viscosity" and value == 0.0:
            continue
        shown = f"{value:g}" if isinstance(value, float) else repr(value)
        with pytest.raises(ValueError) as caught:
            square_patch(**{name: value})
        assert name in str(caught.value)
        assert shown in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"angular_velocity": 0.0}, "angular_velocity must be other than zero, got 0 rad/s"),
        ({"spacing": 1.5}, r"spacing must be at most side \(1 m\), got 1.5 m"),
        ({"reach": 0.7}, "reach must be between 1 and 10 sides, got 0.7 sides"),
        ({"spacing": 1e-5}, "spacing must leave at most 5e[+]07 lattice points, got 1.0e[+]10"),
    ],
)
def test_what_makes_no_patch_is_refused_with_its_rule(arguments, said):
    with pytest.raises(ValueError, match=said):
        square_patch(**arguments)
