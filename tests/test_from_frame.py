"""Going on from a frame of a run, with what has changed since then."""

import dataclasses
import math
from typing import Any

import jax
import numpy as np
import pytest
from hasty import by_diagonal

import jaxmps as mps
from jaxmps.flow import Kind

TIMES: dict[str, Any] = {"until": 0.08, "save_every": 0.02, "dt": 0.004}


def tank() -> mps.Case:
    return mps.cases.sloshing(spacing=0.05, height=0.4, depth=0.2, amplitude=10.0)


def scheme(**values) -> mps.Scheme:
    return by_diagonal(mps.schemes.mps(tolerance=1e-10, **values))


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> mps.Run:
    with jax.enable_x64(True):
        return mps.simulate(tank(), scheme(), **TIMES, out=tmp_path_factory.mktemp("whole") / "run.vtkhdf")


def test_a_run_from_a_frame_is_the_rest_of_the_run_with_its_walls_in_time(whole):
    case, frame = tank(), 2
    state = mps.start(case, scheme(), run=mps.read(whole.path), frame=frame)
    assert float(state.time) == pytest.approx(0.04) and int(state.step) == 0
    np.testing.assert_allclose(state.number_density, whole.number_density[frame], rtol=0.05)
    rest = mps.simulate(case, scheme(), **TIMES, start=state)
    np.testing.assert_allclose(rest.time, whole.time[frame:])
    np.testing.assert_allclose(rest.position, whole.position[frame:], atol=1e-9)
    np.testing.assert_allclose(rest.velocity, whole.velocity[frame:], atol=1e-7)
    # The walls by the angle itself, and they do move.
    wall = np.asarray(case.particles.kind) != Kind.FLUID
    own, t = np.asarray(case.particles.position)[wall] - [0.45, 0.0], 0.04
    angle = math.radians(10.0) * math.sin(2.0 * math.pi / 1.919 * t)
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    np.testing.assert_allclose(np.asarray(state.particles.position)[wall], own @ turn + [0.45, 0.0], atol=1e-12)
    assert np.abs(whole.position[2, wall] - whole.position[0, wall]).max() > 0.005


def test_scheme_and_values_may_be_others(whole):
    case = dataclasses.replace(tank(), fluids=mps.Fluid([800.0], [1e-3]))
    wide = scheme(ratio=3.1, viscous=True)
    state = mps.start(case, wide, run=whole, frame=1)
    assert state.neighbors.cutoff == pytest.approx(3.1 * 0.05)
    run = mps.simulate(case, wide, until=0.04, dt=0.004, start=state)
    assert run.status.completed and run.time[0] == pytest.approx(0.02)
    np.testing.assert_array_equal(run.density, 800.0)
    np.testing.assert_allclose(run.position[0], whole.position[1], atol=1e-12)


def test_a_particle_that_had_left_the_flow_is_gone(whole):
    kind, place = whole.kind.copy(), whole.position.copy()
    kind[2, 0], place[2, 0] = Kind.REMOVED, [50.0, 50.0]
    lost = dataclasses.replace(whole, kind=kind, position=place)
    state = mps.start(tank(), scheme(), run=lost, frame=2)
    assert int(state.particles.kind[0]) == Kind.REMOVED and not bool(state.surface[0])
    assert not np.any(np.asarray(state.neighbors.table.idx) == 0)


@pytest.mark.slow
def test_walls_that_have_gone_round_a_period_come_back_into_the_box():
    from test_seams import belt

    case = belt(5.0)
    run = mps.simulate(case, scheme(), until=0.4, save_every=0.2, dt=0.01)
    state = mps.start(case, scheme(), run=run)
    assert bool(np.all(case.box.torus(np.asarray(state.particles.position))[0][:, 0] < 1.0))
    np.testing.assert_allclose(state.particles.position, run.position[-1], atol=1e-9)
    assert np.all(np.asarray(state.particles.position)[:, 0] < 1.0)


def test_a_frame_that_does_not_fit_is_refused_in_one_line(whole):
    kinds = whole.kind.copy()
    kinds[-1, 0] = Kind.WALL
    other = mps.cases.sloshing(spacing=0.05, height=0.4, depth=0.15, amplitude=10.0)
    place = whole.position.copy()
    place[-1, 7] = [5.0, 5.0]
    cases = [
        (other, whole, r"run must have the particles of case, of the shape \(\d+, 2\), got \(\d+, 2\)"),
        (tank(), dataclasses.replace(whole, kind=kinds), r"run must have particles of the same kind as case, .* got 1"),
        (tank(), dataclasses.replace(whole, spacing=0.1), "run must have the spacing of the case, 0.05 m, got 0.1 m"),
        (tank(), dataclasses.replace(whole, position=place), "every particle must lie in the box .* got particle 7 at"),
    ]
    for case, run, words in cases:
        with pytest.raises(ValueError, match=words) as told:
            mps.start(case, scheme(), run=run)
        assert "\n" not in str(told.value)
    with pytest.raises(IndexError, match="frame must be between -5 and 4, got 5"):
        mps.start(tank(), scheme(), run=whole, frame=5)
