"""The traced surface, on arrangements of particles whose surface is known."""

import dataclasses
import re

import numpy as np
import pytest
from scipy.spatial import KDTree

from jaxmps import Kind, Run, diagnostics
from jaxmps.cases import standing_wave
from jaxmps.kernels import lattice

SPACING = 0.02
N0 = lattice(2.1, 2).n0


def repeated(points: np.ndarray, period: float = 1.0) -> np.ndarray:
    """Points with their images at both sides."""
    return np.concatenate([points + np.array([shift, 0.0]) for shift in (-period, 0.0, period)])


def number_density(points: np.ndarray, period: float | None = None) -> np.ndarray:
    """Sums of r_e / r − 1 at r_e = 2.1 spacings, over the images at both sides too if there is a period."""
    images = points if period is None else repeated(points, period)
    radius = 2.1 * SPACING
    close = KDTree(points).sparse_distance_matrix(KDTree(images), radius, output_type="coo_matrix").tocoo()
    apart = close.data > 0.0
    return np.bincount(close.row[apart], radius / close.data[apart] - 1.0, minlength=len(points)).astype(float)


def traced(points: np.ndarray, period: float | None = None, **options) -> diagnostics.Surface:
    fluid = np.ones(len(points), bool)
    return diagnostics.trace_surface(
        points, fluid, number_density(points, period), N0, SPACING, period=period, **options
    )


def tank(columns: int = 20, rows: int = 6) -> np.ndarray:
    """A lattice, row by row from the bottom: its top row are the last particles, from left to right."""
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    return np.stack([x.ravel(), y.ravel()], axis=1) * SPACING


def wavy(columns: int = 50, rows: int = 6, amplitude: float = 0.07) -> np.ndarray:
    """Rows one below the other under a cosine over the length 1 m, the top one on the curve and the last in order."""
    points = tank(columns, rows)
    wave = amplitude * np.cos(2.0 * np.pi * points[:, 0] / (columns * SPACING))
    return points + np.stack([np.zeros_like(wave), wave], axis=1)


def plunging(lean: float = 1.5, amplitude: float = 0.25, depth: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """A lattice cut along a cosine of length 1 m that is sheared until it overhangs, and the curve itself."""
    points = tank(50, 40)
    x, y = points.T
    kept = y < depth + amplitude * np.cos(2.0 * np.pi * (x - lean * (y - depth)))
    angle = np.linspace(0.0, 2.0 * np.pi, 4001)
    rise = amplitude * np.cos(angle)
    return points[kept], np.stack([angle / (2.0 * np.pi) + lean * rise, depth + rise], axis=1)


def flat_run(frames: int = 2, columns: int = 20) -> Run:
    """A tank at rest over a row of wall, with a removed particle above it."""
    points = np.concatenate([tank(columns), tank(columns, 1) - [0.0, SPACING], [[0.1, 0.13]]])
    kind = np.repeat([Kind.FLUID, Kind.WALL, Kind.REMOVED], [6 * columns, columns, 1])
    n = len(points)
    return Run(
        time=np.arange(float(frames)),
        position=np.tile(points, (frames, 1, 1)),
        velocity=np.zeros((frames, n, 2)),
        pressure=np.zeros((frames, n)),
        number_density=np.zeros((frames, n)),  # of no use to the trace
        surface=np.zeros((frames, n), bool),
        kind=np.tile(kind, (frames, 1)),
        phase=np.zeros(n, int),
        density=np.full(n, 1000.0),
        spacing=SPACING,
        energy=np.zeros((frames, 2)),
    )


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("period", "slope"), [(None, 0.0), (None, 0.3), (None, -0.3), (20 * SPACING, 0.0)])
def test_an_even_top_row_is_traced_particle_by_particle(period, slope, dtype):
    points = tank()
    points[:, 1] += slope * points[:, 0]
    # The slope makes one corner sharper than a right angle: 0.37 n0.
    found = traced(points.astype(dtype), period, sparsest=0.3)
    assert found.complete and found.reason == ""
    np.testing.assert_array_equal(found.particles, np.arange(100, 120))


def test_strays_above_the_surface_are_left_out_but_not_the_corners():
    # A pair of drops: each has one neighbor, 1.1 / 6.54 = 0.17 n0. A corner has 0.43 n0.
    points = np.concatenate([tank(), [[0.2, 0.14], [0.22, 0.14], [0.01, 0.3]]])
    found = traced(points)
    assert found.complete
    np.testing.assert_array_equal(found.particles, np.arange(100, 120))
    assert 120 in traced(points, sparsest=0.1).particles


@pytest.mark.parametrize("ratio", [1.6, 2.1, 3.1])
def test_every_particle_of_a_sine_is_traced_in_its_hollow_too(ratio):
    found = traced(wavy(), 1.0, ratio=ratio)
    assert found.complete
    np.testing.assert_array_equal(found.particles, np.arange(250, 300))


def test_a_disk_wider_than_the_hollow_is_curved_passes_over_its_ground():
    # 1 / κ = L² / 4π² A = 0.101 m at A = 0.25 m: a disk of half of 6 spacings, 0.06 m, fits, and of 12 does not.
    points = wavy(amplitude=0.25, rows=20)
    ground = int(np.argmin(np.where(np.arange(1000) >= 950, points[:, 1], np.inf)))
    assert ground in traced(points, 1.0, ratio=6.0).particles
    bridged = traced(points, 1.0, ratio=12.0)
    assert bridged.complete and ground not in bridged.particles and bridged.particles[0] == 950


def test_a_notch_one_column_wide_is_bridged_and_one_of_two_is_not():
    points = tank()
    np.testing.assert_array_equal(
        traced(np.delete(points, 108, axis=0)).particles, [*range(100, 108), *range(108, 119)]
    )
    wide = np.delete(points, [108, 109], axis=0)
    found = traced(wide)
    assert found.complete
    np.testing.assert_allclose(
        wide[found.particles[7:12]] / SPACING, [[7.5, 5.5], [8.5, 4.5], [9.5, 4.5], [10.5, 5.5], [11.5, 5.5]]
    )


def test_a_lattice_cut_along_a_wave_gives_the_top_particle_of_each_column():
    particles = standing_wave().particles
    fluid = np.asarray(particles.fluid)
    points = np.asarray(particles.position)
    density = number_density(points, 1.0)
    found = diagnostics.trace_surface(points, fluid, density, N0, SPACING, period=1.0)
    top = [
        max(np.flatnonzero(fluid & (np.abs(points[:, 0] - x) < 1e-9)), key=lambda i: points[i, 1])
        for x in (np.arange(50) + 0.5) * SPACING
    ]
    assert found.complete
    np.testing.assert_array_equal(found.particles, top)


def test_an_overturning_surface_is_followed_back_under_its_crest():
    points, curve = plunging()
    found = traced(points, 1.0)
    assert found.complete and len(set(found.particles)) == len(found.particles)
    way = np.diff(points[found.particles], axis=0)
    way[:, 0] -= np.round(way[:, 0])
    assert np.all(np.linalg.norm(way, axis=1) <= 2.1 * SPACING + 1e-12)
    assert np.any(way[:, 0] < -0.5 * SPACING)
    # The particles are at most a diagonal of the lattice below the curve; and no part of it is cut short.
    assert np.all(KDTree(repeated(curve)).query(points[found.particles])[0] < 1.5 * SPACING)
    assert np.all(KDTree(repeated(points[found.particles])).query(curve)[0] < 2.1 * SPACING)


@pytest.mark.parametrize("shape", [wavy(), plunging()[0]])
@pytest.mark.parametrize("noise", [0.0, 0.15])
def test_the_surface_of_a_periodic_tank_does_not_depend_on_where_its_seam_is(shape, noise):
    # The noise also undoes the ties that rounding would decide, in a way that depends on the seam.
    points = shape + noise * SPACING * np.random.default_rng(3).uniform(-1.0, 1.0, shape.shape)
    expected = traced(points, 1.0)
    assert expected.complete
    for shift in (0.013, 0.25, 0.5, 0.77):
        moved = np.stack([(points[:, 0] + shift) % 1.0 - 0.5, points[:, 1]], axis=1)
        found = traced(moved, 1.0)
        assert found.complete
        assert set(found.particles) == set(expected.particles)
        assert moved[found.particles[0], 0] < -0.5 + 2.1 * SPACING


def test_a_mirrored_tank_without_a_period_has_the_same_surface_from_right_to_left():
    points = tank(30, 8) + 0.1 * SPACING * np.random.default_rng(5).uniform(-1.0, 1.0, (240, 2))
    found, mirrored = traced(points), traced(points * [-1.0, 1.0])
    assert found.complete and mirrored.complete
    np.testing.assert_array_equal(found.particles, mirrored.particles[::-1])


@pytest.mark.parametrize("period", [None, 30 * SPACING])
def test_a_gap_down_to_the_floor_breaks_the_surface_and_is_named(period):
    points = tank(30)
    column = np.arange(180) % 30
    points = points[(column < 12) | (column >= 17)]
    found = traced(points, period)
    assert not found.complete
    edge = np.flatnonzero(np.abs(points[:, 0] - 11.5 * SPACING) < 1e-9)
    named = re.search(r"particle (\d+) at \(0\.23, ", found.reason)
    assert named and int(named.group(1)) in edge
    assert "nothing beyond within 0.042 m" in found.reason
    # What lies left of the gap is given: the top row up to it, and perhaps the side of the gap.
    np.testing.assert_array_equal(points[found.particles[:12], 0], (np.arange(12) + 0.5) * SPACING)
    np.testing.assert_allclose(points[found.particles[:12], 1], 5.5 * SPACING)
    assert np.isin(found.particles[12:], edge).all()


def test_a_gap_with_water_on_the_floor_is_walked_through():
    points = tank(30)
    column, row = np.arange(180) % 30, np.arange(180) // 30
    points = points[(column < 12) | (column >= 17) | (row < 2)]
    found = traced(points)
    assert found.complete
    floor = np.flatnonzero(
        (np.abs(points[:, 1] - 1.5 * SPACING) < 1e-9) & (np.abs(points[:, 0] - 14.5 * SPACING) < 2.1 * SPACING)
    )
    assert len(floor) == 5
    assert np.isin(floor, found.particles).all()


def test_a_single_file_that_stands_out_is_walked_to_its_tip_and_back_and_listed_once():
    points = np.concatenate([tank(), [[9.5 * SPACING, (6.5 + k) * SPACING] for k in range(4)]])
    found = traced(points, sparsest=0.1)
    assert found.complete and len(set(found.particles)) == len(found.particles)
    assert 123 in found.particles and found.particles[-1] == 119


def test_coincident_particles_do_not_hold_the_trace_up():
    points = np.concatenate([tank(), tank()[[105, 110, 119]]])
    found = traced(points)
    assert found.complete
    np.testing.assert_allclose(np.unique(points[found.particles, 0]), (np.arange(20) + 0.5) * SPACING)
    np.testing.assert_allclose(points[found.particles, 1], 5.5 * SPACING)


def test_no_fluid_or_too_little_of_it_is_said_and_not_traced():
    points = tank()
    density = number_density(points)
    none = diagnostics.trace_surface(points, np.zeros(120, bool), density, N0, SPACING)
    assert not none.complete and len(none.particles) == 0
    assert none.reason == "no fluid particle has a number density of 2.62 or more"
    single = traced(points[:1])
    assert not single.complete and len(single.particles) == 0
    alone = diagnostics.trace_surface(points[:1], np.ones(1, bool), np.array([N0]), N0, SPACING, period=1.0)
    assert not alone.complete and "particle 0 at (0.01, 0.01) m" in alone.reason


@pytest.mark.parametrize("period", [None, 20 * SPACING])
def test_particles_that_are_nowhere_do_not_count(period):
    points, density = tank(), number_density(tank(), period)
    points[105] = np.nan
    points[110, 1] = np.inf
    found = diagnostics.trace_surface(points, np.ones(120, bool), density, N0, SPACING, period=period)
    # A hole of one particle is bridged: its neighbors are two spacings apart.
    assert found.complete
    np.testing.assert_array_equal(found.particles, np.setdiff1d(np.arange(100, 120), [105, 110]))
    points[:] = np.nan
    assert not diagnostics.trace_surface(points, np.ones(120, bool), density, N0, SPACING, period=period).complete


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("period", [None, 1.0])
def test_the_trace_of_any_cloud_of_particles_ends(seed, period):
    points = np.random.default_rng(seed).uniform(0.0, 1.0, (1500, 2))
    found = traced(points, period)
    assert len(set(found.particles)) == len(found.particles)
    assert found.complete == (found.reason == "")


def test_a_run_is_traced_frame_by_frame_whatever_radius_its_own_densities_are_of():
    run = flat_run()
    run.position[1, 105] = [0.1, 0.5]  # a drop in the air
    whole, holed = diagnostics.trace(run)
    np.testing.assert_array_equal(whole.particles, np.arange(100, 120))
    np.testing.assert_array_equal(holed.particles, np.setdiff1d(np.arange(100, 120), [105]))
    assert [len(s.particles) for s in diagnostics.trace(run, period=0.4)] == [20, 19]
    assert diagnostics.trace(dataclasses.replace(run, position=run.position[:0], kind=run.kind[:0])) == []


def test_what_cannot_be_traced_is_refused():
    run = flat_run()
    solid = dataclasses.replace(run, position=np.zeros((2, len(run.phase), 3)))
    with pytest.raises(ValueError, match=r"traced in 2-D, got a run in 3-D"):
        diagnostics.trace(solid)
    with pytest.raises(ValueError, match=r"period must exceed twice the search radius \(0\.084 m\), got 0\.08 m"):
        traced(tank(4), 0.08)
    with pytest.raises(ValueError, match=r"ratio must be greater than zero, got -1"):
        traced(tank(), ratio=-1.0)
    with pytest.raises(ValueError, match=r"ratio must exceed the square root of 2, got 1\.4"):
        traced(tank(), ratio=1.4)
