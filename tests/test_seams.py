"""Nothing happens at the seam of a periodic axis, neither to walls that move along it nor to what is measured there."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hasty import by_diagonal

import jaxmps as mps
from jaxmps.flow.motion import Rigid, Table
from jaxmps.running.upkeep import happened

BELT = 5.0  # m/s


def belt(speed: float) -> mps.Case:
    """Water over a floor in a channel of 1 m that goes round in a circle; both move along at the same speed."""
    case = mps.cases.standing_wave(spacing=0.1, length=1.0, depth=0.3, amplitude=0.05)
    fluid = case.particles.fluid[:, None]
    motion = Rigid([0.0, 0.0], sway=Table([0.0, 10.0], [0.0, 10.0 * speed], interpolation="linear"))
    particles = dataclasses.replace(case.particles, velocity=jnp.where(fluid, jnp.array([speed, 0.0]), 0.0))
    return dataclasses.replace(case, particles=particles, motion=motion)


def test_a_flow_and_its_floor_that_move_round_a_period_are_the_ones_that_stand():
    scheme = mps.schemes.mps(tolerance=1e-10)
    moved, still = (mps.simulate(belt(speed), scheme, until=0.5, save_every=0.1, dt=0.01) for speed in (BELT, 0.0))
    assert moved.status.completed and not moved.status.events
    gone = np.array([BELT, 0.0]) * moved.time[:, None, None]  # two and a half periods
    apart = moved.position - gone - still.position
    apart[..., 0] -= np.round(apart[..., 0])
    np.testing.assert_allclose(apart, 0.0, atol=1e-6)
    np.testing.assert_allclose(moved.velocity, still.velocity + np.array([BELT, 0.0]), atol=1e-5)
    assert np.all((moved.position[..., 0] >= 0.0) & (moved.position[..., 0] < 1.0))
    assert np.abs(still.velocity).max() > 0.05  # the wave has begun to fall

    seen = mps.diagnostics.relative(moved, belt(BELT).motion)
    apart = seen.position - still.position
    apart[..., 0] -= np.round(apart[..., 0])
    np.testing.assert_allclose(apart, 0.0, atol=1e-6)
    wall = still.kind[0] != mps.Kind.FLUID
    np.testing.assert_allclose(seen.position[:, wall], still.position[:, wall], atol=1e-9)


def test_a_step_of_the_floor_by_more_than_a_spacing_is_told_at_the_seam_as_elsewhere():
    with pytest.warns(mps.SimulationWarning, match="more than one spacing .* displacement in spacings 2"):
        run = mps.simulate(belt(20.0), by_diagonal(mps.schemes.mps()), until=0.2, dt=0.01)
    assert run.status.fatal is not None and run.status.fatal.value == pytest.approx(
        2.0, rel=1e-3
    )  # the water falls, too


def two(x: tuple[float, float], pressure: float = 0.0) -> mps.Run:
    """Two fluid particles 0.3 m above the floor, in a channel of 1 m that goes round."""
    position = np.array([[[x[0], 0.3], [x[1], 0.3]]])
    ones, zeros = np.ones((1, 2)), np.zeros((1, 2))
    metadata = {"box": {"lower": [0.0, 0.0], "upper": [1.0, 1.0], "periodic": [True, False], "mirror": None}}
    fields = {"pressure": pressure * ones, "number_density": ones, "surface": zeros > 0, "kind": zeros.astype(int)}
    return mps.Run(
        time=np.zeros(1), position=position, velocity=0.0 * position, phase=np.zeros(2, int), density=np.ones(2),
        spacing=0.1, energy=np.zeros((1, 2)), metadata=metadata, **fields,
    )  # fmt: skip


def test_what_is_measured_sees_images():
    across = two((0.02, 0.96), pressure=7.0)
    np.testing.assert_allclose(mps.diagnostics.nearest(across), 0.6)
    unknown = dataclasses.replace(across, metadata={})
    np.testing.assert_allclose(mps.diagnostics.nearest(unknown), 9.4)
    # Both are 0.05 m from the seam, from where either has the weight of the other's mirror image.
    np.testing.assert_allclose(mps.diagnostics.pressure_at(two((0.05, 0.95), 7.0), [[0.99, 0.3]]), 7.0)
    assert mps.diagnostics.pressure_at(two((0.05, 0.5), 7.0), [[0.99, 0.3]])[0, 0] == pytest.approx(7.0)
    np.testing.assert_allclose(mps.diagnostics.wave_height(two((0.02, 0.5)), 0.97), 0.35)


def test_the_closest_pair_of_a_run_that_ended_in_clusters_may_lie_across_the_seam():
    case = belt(0.0)
    position = np.array(case.particles.position)
    position[:2] = [[0.001, 0.2], [0.999, 0.2]]
    state = mps.start(case, by_diagonal(mps.schemes.mps()))
    state = eqx.tree_at(lambda s: s.particles.position, state, jnp.array(position))
    event = happened(case, state, mps.Status.CLUSTERED)
    assert event.value == pytest.approx(0.02) and event.particle in (0, 1)


def test_the_radius_of_a_tip_is_taken_to_the_nearest_image():
    case = belt(0.0)
    state = mps.start(case, by_diagonal(mps.schemes.mps()))
    far = mps.diagnostics.tip_radius(case, state, center=np.array([0.0, 0.15]), width=1e-3)
    # Along x nothing is farther than half the period: the columns beside x = 0.5, and of these the farthest row.
    x, y = np.asarray(case.particles.position)[np.asarray(case.particles.fluid)].T
    away = np.hypot(np.minimum(x, 1.0 - x), y - 0.15)
    assert float(far) == pytest.approx(away.max(), rel=1e-3) and away.max() < 0.55
