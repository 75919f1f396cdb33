"""Curves through surfaces, against curves that are known."""

import numpy as np
import pytest

from jaxmps import Kind, Run, diagnostics

LENGTH, DEPTH, AMPLITUDE = 1.0, 1.0 / 3.0, 0.07
# Both solve systems of a few unknowns and order one in double precision: what is left is rounding.
EXACT = 1e-11


def even(count: int, ends: bool = False) -> np.ndarray:
    """Points over the length: in the middle of equal parts of it, or with one at both ends."""
    return np.linspace(0.0, LENGTH, count) if ends else (np.arange(count) + 0.5) / count * LENGTH


def wave(x: np.ndarray) -> np.ndarray:
    """The standing wave of [N11] at t = 0, its crest in the middle."""
    return DEPTH + AMPLITUDE * np.cos(2.0 * np.pi * (x - LENGTH / 2.0) / LENGTH)


def wave_run(amplitudes: list[float], hole: int | None = None) -> Run:
    """Rows under a wave of each amplitude; in the frame `hole`, without the columns of a tenth of the length."""
    columns, rows, spacing = 50, 10, 0.02
    x, j = np.meshgrid((np.arange(columns) + 0.5) * spacing, np.arange(rows))
    x, j = x.ravel(), j.ravel()
    frames, n = len(amplitudes), len(x)
    # The top row has its centers half a spacing below a surface of the mean height 0.2 m.
    y = 0.2 - (j + 0.5) * spacing + np.multiply.outer(amplitudes, np.cos(2.0 * np.pi * (x - 0.5)))
    kind = np.full((frames, n), Kind.FLUID)
    if hole is not None:
        kind[hole, np.abs(x - 0.3) < 0.05] = Kind.REMOVED
    return Run(
        time=0.1 * np.arange(frames),
        position=np.stack([np.tile(x, (frames, 1)), y], axis=-1),
        velocity=np.zeros((frames, n, 2)),
        pressure=np.zeros((frames, n)),
        number_density=np.zeros((frames, n)),
        surface=np.zeros((frames, n), bool),
        kind=kind,
        phase=np.zeros(n, int),
        density=np.full(n, 1000.0),
        spacing=spacing,
        energy=np.zeros((frames, 2)),
    )


def test_a_parabola_is_found_again_with_its_vertex_and_no_error():
    x = np.random.default_rng(1).uniform(0.0, 2.0, 30)
    found = diagnostics.fit_parabola(x, 3.0 - 0.5 * (x - 0.8) ** 2, 2.0)
    # −(x − 0.8)² / 2 + 3 = −x² / 2 + 0.8 x + 2.68
    np.testing.assert_allclose([found.a, found.b, found.c], [-0.5, 0.8, 2.68], rtol=EXACT)
    np.testing.assert_allclose([found.x_max, found.y_max], [0.8, 3.0], rtol=EXACT)
    assert found.conditioned and found.error < EXACT


def test_parabola_through_a_cosine_has_its_vertex_at_0_760_A():
    # With s = (x − L/2) / L, cos 2πs has the mean 0 and, on s² − 1/12 of the norm 1/180, the projection −1 / 2π²: the
    # parabola is −90 A / π² (s² − 1/12). The sum over 4000 midpoints is off by order 1/4000².
    x = even(4000)
    found = diagnostics.fit_parabola(x, wave(x), LENGTH)
    assert found.y_max - DEPTH == pytest.approx(7.5 / np.pi**2 * AMPLITUDE, rel=1e-6)
    assert found.x_max == pytest.approx(0.5 * LENGTH, rel=1e-9)
    assert found.a == pytest.approx(-90.0 / np.pi**2 * AMPLITUDE / LENGTH**2, rel=1e-6)


def test_parabola_through_51_points_of_a_cosine_has_its_vertex_at_0_745_A():
    # Both ends count, as on the spacing of the paper: Σ cos = −1 where a full period has 0. The even part is two
    # equations in j = −25 to 25, a Σ j⁴ + c Σ j² = Σ j² cos(πj/25) and a Σ j² + 51 c = −1.
    j = np.arange(-25, 26)
    second, fourth, right = np.sum(j**2), np.sum(j**4), np.sum(j**2 * np.cos(np.pi * j / 25.0))
    vertex = (-fourth - second * right) / (51 * fourth - second**2)
    x = even(51, ends=True)
    found = diagnostics.fit_parabola(x, wave(x), LENGTH)
    assert found.y_max - DEPTH == pytest.approx(vertex * AMPLITUDE, rel=1e-10)
    assert vertex == pytest.approx(0.745, abs=5e-4)


@pytest.mark.parametrize(("count", "ends", "percent"), [(51, True, 4.0), (4000, False, 3.8)])
def test_the_error_of_that_parabola_is_near_4_percent_and_below_the_4_5_of_the_paper(count, ends, percent):
    x = even(count, ends)
    found = diagnostics.fit_parabola(x, wave(x), LENGTH)
    # The definition, on the curve that the fit gives.
    curve = found.a * x**2 + found.b * x + found.c
    assert found.error == pytest.approx(np.mean(np.abs(curve - wave(x)) / curve), rel=1e-9)
    assert 100.0 * found.error == pytest.approx(percent, abs=0.05)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("tilt", [0.0, 1e-3, -0.2])
def test_where_the_water_is_level_the_vertex_is_in_the_middle(tilt):
    x = even(50)
    bends = np.array([0.0, 1e-16, -1e-9, 9e-3])  # |a| L < 0.01
    y = DEPTH + tilt * (x - 0.5) + bends[:, None] * (x - 0.5) ** 2
    found = diagnostics.fit_parabola(np.tile(x, (4, 1)), y, LENGTH)
    assert not found.conditioned.any()
    np.testing.assert_array_equal(found.x_max, 0.5 * LENGTH)
    np.testing.assert_allclose(found.y_max, DEPTH, rtol=EXACT)
    np.testing.assert_allclose(found.error, 0.0, atol=EXACT)
    assert diagnostics.fit_parabola(x, y[3], LENGTH, flat=0.005).conditioned


@pytest.mark.filterwarnings("error")
def test_a_vertex_outside_is_held_at_the_end_of_the_length():
    x = even(20)
    right = diagnostics.fit_parabola(x, 2.0 - 0.1 * (x - 7.0) ** 2 + 10.0, LENGTH)
    left = diagnostics.fit_parabola(x, 2.0 - 0.1 * (x + 7.0) ** 2 + 10.0, LENGTH)
    assert right.conditioned and left.conditioned
    np.testing.assert_allclose([right.x_max, left.x_max], [1.0, 0.0], atol=EXACT)
    np.testing.assert_allclose([right.y_max, left.y_max], [12.0 - 0.1 * 36.0, 12.0 - 0.1 * 49.0], rtol=EXACT)


@pytest.mark.filterwarnings("error")
def test_the_error_has_no_meaning_where_the_fit_is_below_the_floor():
    x = even(50)
    found = diagnostics.fit_parabola(x, wave(x) - DEPTH, LENGTH)
    assert np.isnan(found.error) and np.isfinite(found.y_max)


@pytest.mark.filterwarnings("error")
def test_too_few_points_give_nan_and_no_warning():
    x = np.array([[0.1, 0.2, np.nan, np.nan], [np.nan] * 4, [0.3, 0.3, 0.3, 0.3], [0.1, 0.2, 0.4, 0.9]])
    parabola, cosine = diagnostics.fit_parabola(x, 1.0 + x, LENGTH), diagnostics.fit_cosine(x, 1.0 + x, LENGTH, 1)
    for found in (parabola.a, parabola.x_max, parabola.y_max, parabola.error, cosine.mean, cosine.center):
        np.testing.assert_array_equal(np.isnan(found), [True, True, True, False])
    assert not parabola.conditioned.any()
    assert np.isnan(diagnostics.fit_cosine(x[:, :2], x[:, :2], LENGTH).amplitude).all()
    assert diagnostics.fit_parabola(np.zeros((2, 0)), np.zeros((2, 0)), LENGTH).y_max.shape == (2,)


def cosines(x: np.ndarray) -> np.ndarray:
    """Mean 0.3, amplitudes 0.05 and 0.01, crests at 0.7 and 0.2 (and 1.2, half the length of 2 on)."""
    return 0.3 + 0.05 * np.cos(np.pi * (x - 0.7)) + 0.01 * np.cos(2.0 * np.pi * (x - 0.2))


@pytest.mark.parametrize("seed", range(3))
def test_cosines_are_found_again_from_points_at_uneven_distances(seed):
    x = np.random.default_rng(seed).uniform(0.0, 2.0, 25)
    found = diagnostics.fit_cosine(x, cosines(x), 2.0)
    np.testing.assert_allclose(found.mean, 0.3, rtol=EXACT)
    np.testing.assert_allclose(found.amplitude, [0.05, 0.01], rtol=1e3 * EXACT)
    np.testing.assert_allclose(found.crest, [0.7, 0.2], rtol=1e3 * EXACT)
    np.testing.assert_allclose(found.center, cosines(np.array(1.0)), rtol=EXACT)


def test_fits_of_many_frames_are_those_of_each_frame_without_its_padding():
    random = np.random.default_rng(7)
    x, y = np.full((2, 2, 3, 40), np.nan)
    counts = random.integers(12, 40, (2, 3))
    for place in np.ndindex(2, 3):
        some = random.permutation(40)[: counts[place]]
        x[place][some] = random.uniform(0.0, 2.0, len(some))
        y[place][some] = cosines(x[place][some]) + random.normal(0.0, 0.01, len(some))
    for fit in (diagnostics.fit_parabola, diagnostics.fit_cosine):
        together = fit(x, y, 2.0)
        for place in np.ndindex(2, 3):
            there = np.isfinite(x[place])
            alone = fit(x[place][there], y[place][there], 2.0)
            for all_frames, one in zip(together, alone, strict=True):
                np.testing.assert_allclose(all_frames[place], one, rtol=1e-9)


def test_the_wave_of_a_run_is_above_its_still_level_and_nan_where_the_surface_is_broken():
    amplitudes = [0.07, 0.0, -0.04, 0.05]
    run = wave_run(amplitudes, hole=3)
    # All of the top row is traced, and the fit has the 50 points of the curve itself.
    found = diagnostics.wave_fit(run, 1.0)
    np.testing.assert_array_equal(found.complete, [True, True, True, False])
    np.testing.assert_array_equal(found.time, run.time)
    for measured in (found.vertex, found.error, found.center, found.amplitude[:, 0], found.crest[:, 0]):
        np.testing.assert_array_equal(np.isnan(measured), ~found.complete)
    np.testing.assert_allclose(found.center[:3], amplitudes[:3], atol=EXACT)
    np.testing.assert_allclose(found.amplitude[:3], [[0.07, 0.0], [0.0, 0.0], [0.04, 0.0]], atol=EXACT)
    # A crest at the seam may be found at either end.
    np.testing.assert_allclose((found.crest[[0, 2], 0] + 0.25) % 1.0, [0.75, 0.25], atol=EXACT)
    # 50 midpoints in place of the integral: 0.760 A to a thousandth.
    np.testing.assert_allclose(found.vertex[:3], 7.5 / np.pi**2 * np.array(amplitudes[:3]), atol=1e-4)


def test_the_left_end_and_the_level_can_be_given():
    run = wave_run([0.07])
    run.position[..., 0] -= 0.5
    found = diagnostics.wave_fit(run, 1.0, level=0.15, left=-0.5)
    np.testing.assert_allclose(found.center, 0.12, atol=EXACT)
    np.testing.assert_allclose(found.crest[:, 0], 0.5, atol=EXACT)


def test_what_cannot_be_fitted_is_refused():
    x = even(10)
    with pytest.raises(ValueError, match=r"modes must be 1 or more, got 0"):
        diagnostics.fit_cosine(x, x, LENGTH, 0)
    with pytest.raises(ValueError, match=r"length must be greater than zero, got 0 m"):
        diagnostics.fit_parabola(x, x, 0.0)
