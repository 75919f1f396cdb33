"""The standing wave: its particles between periodic sides, and the theory beside it."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxmps import Kind
from jaxmps.cases import standing_wave, standing_wave_frequency, standing_wave_reference


@pytest.mark.parametrize("precision", ["single", "double"], indirect=True)
def test_wave_has_the_834_fluid_particles_of_the_paper(precision):
    kind = np.asarray(standing_wave().particles.kind)
    assert np.bincount(kind).tolist() == [834, 50, 2 * 50]


@pytest.mark.parametrize(("ratio", "thick"), [(2.0, 2), (2.1, 3), (3.1, 4)])
def test_columns_go_on_through_the_floor_as_far_as_the_radius_needs(ratio, thick):
    case = standing_wave(ratio=ratio)
    position, kind = np.asarray(case.particles.position) / 0.02, np.asarray(case.particles.kind)
    columns, rows = position[:, 0] - 0.5, position[:, 1] - 0.45
    np.testing.assert_allclose(columns, np.round(columns), atol=1e-9)
    np.testing.assert_allclose(rows, np.round(rows), atol=1e-9)
    rows = np.round(rows)
    np.testing.assert_array_equal(np.unique(rows[kind != Kind.FLUID]), np.arange(-thick, 0))
    np.testing.assert_array_equal(np.unique(rows[kind == Kind.WALL]), [-1])
    assert np.all(np.bincount(np.round(columns).astype(int)[kind == Kind.WALL]) == 1)
    # No gap in a column, and none of its particles above the surface.
    for i in range(50):
        column = np.sort(rows[(kind == Kind.FLUID) & (np.round(columns) == i)])
        np.testing.assert_array_equal(column, np.arange(len(column)))
        surface = (1.0 / 3.0 + 0.07 * np.cos(2.0 * np.pi * ((i + 0.5) * 0.02 - 0.5))) / 0.02
        assert column[-1] + 0.45 <= surface < column[-1] + 1.45


def test_crest_stands_at_the_center_and_troughs_at_the_sides():
    case = standing_wave(spacing=0.01)
    x, y = np.asarray(case.particles.position)[np.asarray(case.particles.fluid)].T
    top = np.array([y[np.isclose(x, (i + 0.5) * 0.01)].max() for i in range(100)]) + 0.005
    np.testing.assert_allclose(top, top[::-1], atol=1e-12)
    assert top[49] == pytest.approx(1.0 / 3.0 + 0.07, abs=0.01)
    assert top[0] == pytest.approx(1.0 / 3.0 - 0.07, abs=0.01)
    assert len(x) * 0.01**2 == pytest.approx(1.0 / 3.0, rel=2e-3)


def test_box_is_periodic_along_the_wave_with_the_wavelength_as_its_period():
    case = standing_wave(spacing=0.03)
    assert case.box.periodic == (True, False)
    assert case.box.lower[0] == 0.0
    assert case.box.upper[0] == pytest.approx(33 * 0.03)
    assert np.all(np.asarray(case.box.contains(case.particles.position)))
    # The first and the last column are neighbors.
    first, last = jnp.array([0.015, 0.0]), jnp.array([33 * 0.03 - 0.015, 0.0])
    np.testing.assert_allclose(case.box.displacement(last - first), [-0.03, 0.0], atol=1e-12)


def test_wave_starts_at_rest_and_inviscid():
    case = standing_wave()
    assert np.all(np.asarray(case.particles.velocity) == 0.0)
    assert np.all(np.asarray(case.particles.pressure) == 0.0)
    assert np.asarray(case.gravity).tolist() == [0.0, -9.81]
    assert np.asarray(case.fluids.viscosity).tolist() == [0.0]


def test_still_water_is_a_wave_without_amplitude():
    case = standing_wave(spacing=0.05, depth=0.25, amplitude=0.0)
    assert np.bincount(np.asarray(case.particles.kind)).tolist() == [20 * 5, 20, 40]


def test_frequency_is_that_of_linear_theory():
    assert standing_wave_frequency() == pytest.approx(7.7328, rel=1e-5)
    assert 2.0 * np.pi / standing_wave_frequency() == pytest.approx(0.81253, rel=1e-5)
    # Deep water, ω² = gk, and shallow water, ω = k √(gh).
    assert standing_wave_frequency(1.0, 10.0, 10.0) == pytest.approx(np.sqrt(20.0 * np.pi))
    assert standing_wave_frequency(100.0, 0.1, 10.0) == pytest.approx(0.02 * np.pi, rel=1e-4)


def test_reference_starts_with_the_case_and_has_crests_that_beat():
    time, center, sides = standing_wave_reference().T
    assert time[0] == 0.0
    assert time[-1] == 6.0
    assert np.allclose(np.diff(time), 0.008)
    assert (center[0], sides[0]) == (0.07, -0.07)
    # Times and heights before the filter; the solution is good to some 2 %.
    for t, eta in [(0.860, 0.130), (1.65, 0.065), (2.52, 0.098), (3.31, 0.113)]:
        near = np.abs(time - t) < 0.2
        assert time[near][np.argmax(center[near])] == pytest.approx(t, abs=0.02)
        assert center[near].max() == pytest.approx(eta, rel=0.035)
    for t, eta in [(0.45, -0.0544), (1.195, -0.067), (2.11, -0.052), (2.92, -0.062)]:
        near = np.abs(time - t) < 0.2
        assert center[near].min() == pytest.approx(eta, rel=0.035)


BAD = [0.0, -1.0, float("nan"), float("inf"), float("-inf"), "0.1", None, True, 1j, [0.1]]


@pytest.mark.parametrize(
    "name", ["spacing", "length", "depth", "amplitude", "gravity", "density", "viscosity", "ratio"]
)
def test_bad_argument_is_refused_by_name_and_value(unchecked, name):
    for value in BAD:
        if value == 0.0 and name in ("amplitude", "gravity", "viscosity"):
            continue
        shown = f"{value:g}" if isinstance(value, float) else repr(value)
        with pytest.raises(ValueError) as caught:
            standing_wave(**{name: value})  # type: ignore[arg-type]
        assert str(caught.value).startswith(f"{name} must be")
        assert shown in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"amplitude": 0.4}, "amplitude must be between 0 and 0.333333 m, got 0.4 m"),
        ({"spacing": 0.5}, r"spacing must be at most depth \(0.333333 m\), got 0.5 m"),
        ({"spacing": 0.02, "length": 0.01}, r"spacing must be at most length \(0.01 m\), got 0.02 m"),
    ],
)
def test_lengths_that_do_not_fit_are_refused_with_their_limit(arguments, said):
    with pytest.raises(ValueError, match=said):
        standing_wave(**arguments)
