"""Measures of runs, on runs that are made by hand."""

import dataclasses

import numpy as np
import pytest

from jaxmps import Kind, Run, diagnostics
from jaxmps.flow import Event, Outcome, Status
from jaxmps.plotting import panels

SPACING = 0.1


def lattice_run(frames: int = 3, rows: int = 6, columns: int = 10) -> Run:
    """Fluid at rest over a floor of walls, at the same place in all frames; the two top rows are of phase 1."""
    x, y = np.meshgrid(np.arange(columns), np.arange(-1, rows), indexing="ij")
    place = (np.stack([x.ravel(), y.ravel()], axis=1) + 0.5) * SPACING
    kind = np.where(place[:, 1] < 0.0, Kind.WALL, Kind.FLUID)
    n = len(place)
    return Run(
        time=0.1 * np.arange(frames),
        position=np.tile(place, (frames, 1, 1)),
        velocity=np.zeros((frames, n, 2)),
        pressure=np.zeros((frames, n)),
        number_density=np.full((frames, n), 6.54),
        surface=np.tile(place[:, 1] > (rows - 1) * SPACING, (frames, 1)),
        kind=np.tile(kind, (frames, 1)),
        phase=(place[:, 1] > (rows - 2) * SPACING).astype(int),
        density=np.full(n, 1000.0),
        spacing=SPACING,
        energy=np.zeros((frames, 2)),
    )


def test_nearest_neighbors_on_a_lattice_are_one_spacing_away():
    run = lattice_run()
    nearest = diagnostics.nearest(run)
    np.testing.assert_allclose(nearest[run.fluid], 1.0, rtol=1e-12)
    assert np.all(np.isinf(nearest[~run.fluid]))


def test_a_run_breaks_up_with_the_first_frame_in_which_a_particle_is_fast_or_a_pair_is_close():
    run = lattice_run()
    i, j = np.flatnonzero(run.fluid[0])[:2]
    assert diagnostics.breakup(run, 1.0) == np.inf
    run.velocity[2, i] = [7.1, -7.1]  # 10.04 m/s
    assert diagnostics.breakup(run, 1.0) == run.time[2]
    assert diagnostics.breakup(run, 1.1) == np.inf
    run.position[1, j] = run.position[1, i] + [0.09 * SPACING, 0.0]
    assert diagnostics.breakup(run, 1.1) == run.time[1]
    assert diagnostics.breakup(run, 1.1, closest=0.08) == np.inf


def test_a_run_that_ended_before_its_time_has_broken_up_then():
    outcome = Outcome((Event(int(Status.TIME_STEP_TOO_LARGE), 0.2, 17),))
    run = dataclasses.replace(lattice_run(), status=outcome)
    assert diagnostics.breakup(run, 1.0) == run.time[-1]


def test_heights_and_depths_of_a_level_tank():
    run = lattice_run(rows=6)
    np.testing.assert_allclose(diagnostics.mean_height(run), 6 * SPACING, rtol=1e-12)
    np.testing.assert_allclose(diagnostics.surface_height(run), 5.5 * SPACING, rtol=1e-12)
    assert not diagnostics.deep_surface(run).any()


def test_a_surface_particle_under_the_water_is_deep_and_one_at_a_trough_is_not():
    run = lattice_run(rows=6)
    x, y = run.position[0].T
    run.surface[1, (np.abs(x - 0.45) < 1e-9) & (np.abs(y - 0.25) < 1e-9)] = True
    assert diagnostics.deep_surface(run).sum(axis=1).tolist() == [0, 1, 0]
    # In the third frame the right half of the tank is two rows lower: its new surface is not deep.
    right = x > 0.5
    run.position[2, right & (y > 0.4)] = [0.05, 0.05]
    run.surface[2, right & (y > 0.4)] = False
    run.surface[2, right & (np.abs(y - 0.35) < 1e-9)] = True
    deep = diagnostics.deep_surface(run)[2]
    assert not deep[x > 0.5 + 2 * SPACING].any()


def test_speed_is_the_root_mean_square_of_one_phase():
    run = lattice_run()
    run.velocity[1, run.phase == 1] = [3.0, 4.0]
    np.testing.assert_allclose(diagnostics.speed(run, 1), [0.0, 5.0, 0.0])
    np.testing.assert_allclose(diagnostics.speed(run, 0), 0.0)


def test_panels_show_every_run_at_every_time_and_say_which_ended_early(tmp_path):
    whole = lattice_run()
    short = lattice_run(frames=2)
    whole.velocity[:] = 0.3
    figure = panels([whole, short], [0.1, 0.2], "phase", arrow=0.5)
    titles = [ax.get_title(loc="left") for ax in figure.axes if ax.get_title(loc="left")]
    assert titles == ["t = 0.10 s", "t = 0.20 s", "t = 0.10 s", "ended at t = 0.10 s"]
    quivers = [q for ax in figure.axes for q in ax.collections if type(q).__name__ == "Quiver"]
    assert len(quivers) == 4 and quivers[0].scale == quivers[3].scale
    figure.savefig(tmp_path / "panels.png")
    with pytest.raises(ValueError, match=r"arrow must be greater than zero, got -1 m/s"):
        panels([whole], [0.1], arrow=-1.0)
