"""Quantities with useful derivatives: against closed forms, against the plain ones, and against central differences."""

import dataclasses
import inspect
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hasty import by_diagonal, quick

import jaxmps as mps
from jaxmps import diagnostics
from jaxmps.flow import Energy, at_rest

SPACING = 0.05


@pytest.fixture(scope="module")
def patch():
    jax.config.update("jax_enable_x64", True)
    case = mps.cases.jitter(mps.cases.square_patch(spacing=SPACING), 0.05, jax.random.key(0))
    return case, mps.start(case, mps.schemes.mps_hs_gc_ds())


@pytest.fixture(scope="module")
def wave():
    jax.config.update("jax_enable_x64", True)
    case = mps.cases.standing_wave(spacing=0.02, floor="mirror")
    return case, mps.start(case, mps.schemes.mps())


def shifted(state, position):
    return eqx.tree_at(lambda s: s.particles.position, state, position)


def test_smooth_maximum_tends_to_the_maximum_and_leaves_out_what_does_not_count():
    values = jnp.array([1.0, 3.0, 2.9, 7.0])
    counts = jnp.array([True, True, True, False])
    found = [float(diagnostics.smooth_maximum(values, width, counts)) for width in (1.0, 0.1, 0.001)]
    assert found[0] < found[1] < 3.0
    assert found[2] == pytest.approx(3.0, abs=1e-12)
    e = np.exp(np.array([1.0, 3.0, 2.9]))
    assert found[0] == pytest.approx(e @ [1.0, 3.0, 2.9] / e.sum(), rel=1e-12)
    assert float(diagnostics.smooth_maximum(-1e9 * values, 1e-3)) == pytest.approx(-1e9)


def test_tip_radius_of_the_patch_is_that_of_its_corners(patch):
    case, state = patch
    r = np.linalg.norm(np.asarray(state.particles.position), axis=1)
    found = float(diagnostics.tip_radius(case, state, np.zeros(2)))
    # The mean of the four corners, of which the jitter makes one the outermost; the next particle is 0.7 l0 further in.
    assert np.sort(r)[-5] < found < r.max()
    moved = dataclasses.replace(state.particles, position=state.particles.position + jnp.array([0.3, -2.0]))
    center = np.asarray(state.particles.position).mean(axis=0)
    around = float(diagnostics.tip_radius(case, state, center))
    assert float(diagnostics.tip_radius(case, dataclasses.replace(state, particles=moved))) == pytest.approx(around)


def test_smallest_distance_is_that_of_the_closest_pair(patch):
    case, state = patch
    position = state.particles.position
    apart = np.asarray(jnp.linalg.norm(position[:, None] - position, axis=-1)) + np.eye(len(position))
    found = float(diagnostics.smallest_distance(case, state, width=1e-4))
    assert found == pytest.approx(apart.min() / SPACING, abs=1e-3)
    # One pair far below all others: no smoothing is felt.
    i, j = 210, 211
    close = shifted(state, position.at[i].set(position[j] + jnp.array([0.3 * SPACING, 0.0])))
    assert float(diagnostics.smallest_distance(case, close)) == pytest.approx(0.3, abs=1e-6)


def test_front_position_is_the_surge_front_of_a_straight_front():
    case = mps.cases.dam_break(spacing=SPACING)
    state = mps.start(case, mps.schemes.mps())
    # The next column, one spacing behind, counts e⁻⁴ as much.
    assert float(diagnostics.front_position(case, state)) == pytest.approx(0.5, abs=0.03 * SPACING)


def test_elevation_of_a_wave_is_its_depth_and_its_mean_is_exact(wave):
    case, state = wave
    x = np.linspace(0.0, 1.0, 51)  # every spacing: the kernels then add up to one
    found = np.asarray(diagnostics.elevation(case, state, x))
    expected = 1.0 / 3.0 + 0.07 * np.cos(2.0 * np.pi * (x - 0.5))
    # Columns of whole particles; the kernel is as wide as 12 spacings and so lowers the crest by 2 %.
    np.testing.assert_allclose(found, expected, atol=0.004)
    assert found[:-1].mean() == pytest.approx(834 * 0.02**2, rel=1e-9)
    np.testing.assert_allclose(found[0], found[-1], rtol=1e-12)


def test_pressure_roughness_is_zero_for_smooth_pressure_and_counts_noise_in_full(wave):
    case, state = wave
    position = state.particles.position
    smooth = eqx.tree_at(lambda s: s.particles.pressure, state, 2000.0 - 3000.0 * position[:, 1])
    # At the mirror, where the images have the pressure of the particles, a linear one has a kink.
    assert float(diagnostics.pressure_roughness(case, smooth)) < 0.08
    sign = jnp.where((jnp.arange(len(position)) % 7) < 3, 1.0, -1.0)
    noise = eqx.tree_at(lambda s: s.particles.pressure, state, 5.0 * sign)
    assert float(diagnostics.pressure_roughness(case, noise)) > 0.7
    constant = eqx.tree_at(lambda s: s.particles.pressure, state, jnp.full(len(position), 9.0))
    assert float(diagnostics.pressure_roughness(case, constant)) == pytest.approx(0.0, abs=1e-12)
    assert float(diagnostics.pressure_roughness(case, state)) == 0.0  # no pressure at all


def info(kinetic, potential):
    nothing: Any = dict.fromkeys(mps.StepInfo._fields)
    return mps.StepInfo(**{**nothing, "energy": Energy(jnp.array(kinetic), jnp.array(potential))})


def test_energy_error_is_relative_to_the_kinetic_energy():
    steps = info([1.0, 2.0, 3.0], [100.0, 99.0, 97.0])
    assert float(diagnostics.energy_error(steps)) == pytest.approx(np.sqrt(1.0 / 3.0) / 2.0)
    assert float(diagnostics.energy_error(steps, np.array([101.0, 101.0, 100.0]))) == 0.0


def test_wave_height_error_compares_at_the_times_of_the_reference():
    time, reference = jnp.linspace(0.0, 1.0, 101), np.linspace(-0.5, 2.0, 26)
    wave = np.sin(reference)
    assert float(diagnostics.wave_height_error(time, jnp.sin(time), reference, wave)) < 1e-5
    assert float(diagnostics.wave_height_error(time, 1.1 * jnp.sin(time), reference, wave)) == pytest.approx(
        0.1, rel=1e-3
    )
    assert float(diagnostics.wave_height_error(time, 0.0 * time, reference, wave)) == pytest.approx(1.0)


LOSSES = {
    "tip radius": diagnostics.tip_radius,
    "front": diagnostics.front_position,
    "distance": diagnostics.smallest_distance,
    "elevation": lambda case, state: diagnostics.elevation(case, state, 0.13) ** 2,
    "roughness": diagnostics.pressure_roughness,
}


@pytest.mark.parametrize("name", LOSSES)
def test_derivatives_are_central_differences_and_not_zero(patch, name):
    case, state = patch
    rng = np.random.default_rng(1)
    pressure = jnp.array(rng.normal(size=len(state.particles.kind)))
    state = eqx.tree_at(lambda s: s.particles.pressure, state, pressure)
    loss = quick(lambda position: LOSSES[name](case, shifted(state, position)))
    position, direction = state.particles.position, rng.normal(size=state.particles.position.shape)
    slope = float(jnp.vdot(quick(jax.grad(lambda x: LOSSES[name](case, shifted(state, x))))(position), direction))
    h = 1e-6 * SPACING
    difference = float(loss(position + h * direction) - loss(position - h * direction)) / (2.0 * h)
    assert abs(difference) > 1e-4
    assert slope == pytest.approx(difference, rel=1e-4)


def still() -> mps.Case:
    """A patch without gravity, motion and pressure."""
    case = mps.cases.square_patch(spacing=0.2)
    return dataclasses.replace(case, particles=at_rest(case.particles.position, case.particles.kind))


TIMES = jnp.linspace(0.0, 1.0, 3)
AT_REST: dict[str, Any] = {
    "elevation": lambda case, state, info: diagnostics.elevation(case, state, jnp.array([0.0, 0.1])),
    "energy_error": lambda case, state, info: diagnostics.energy_error(info),
    "energy_error to a reference": lambda case, state, info: diagnostics.energy_error(info, info.energy.total),
    "front_position": lambda case, state, info: diagnostics.front_position(case, state),
    "mechanical_energy": lambda case, state, info: diagnostics.mechanical_energy(
        state.particles, case.density, case.gravity
    ),
    "observation": lambda case, state, info: diagnostics.observation(case, state, gauges=[0.0]),
    "pressure_roughness": lambda case, state, info: diagnostics.pressure_roughness(case, state),
    "smallest_distance": lambda case, state, info: diagnostics.smallest_distance(case, state),
    "smooth_maximum": lambda case, state, info: diagnostics.smooth_maximum(state.particles.pressure, 1.0),
    "smooth_maximum of none": lambda case, state, info: diagnostics.smooth_maximum(
        state.particles.pressure, 1.0, state.particles.kind == mps.Kind.WALL
    ),
    "tip_radius": lambda case, state, info: diagnostics.tip_radius(case, state),
    "tip_radius about a particle": lambda case, state, info: diagnostics.tip_radius(
        case, state, state.particles.position[0]
    ),
    "volume_fraction": lambda case, state, info: diagnostics.volume_fraction(case, state),
    "wave_height_error": lambda case, state, info: diagnostics.wave_height_error(
        TIMES, 0.0 * TIMES + state.particles.velocity[0, 1], TIMES, 0.0 * TIMES
    ),
    "all that a step tells": lambda case, state, info: info,
    "the state": lambda case, state, info: state,
}


@pytest.mark.parametrize("name", ["mps", pytest.param("mps_cd_gc_ds", marks=pytest.mark.slow)])
def test_at_rest_everything_that_can_be_differentiated_has_finite_derivatives(name):
    case = still()
    scheme = by_diagonal(mps.schemes.stochastic(getattr(mps.schemes, name)(viscous=True)))
    start = mps.start(case, scheme)

    @quick
    @jax.jacrev
    def derivatives(leaves):
        case, scheme, start = eqx.combine(leaves, static)
        state, info = mps.rollout(case, scheme, start, steps=2, dt=1e-3)
        found = {label: measure(case, state, info) for label, measure in AT_REST.items()}
        # The sum of all numbers of each: with weights, so that none cancel by symmetry.
        floats = {label: jax.tree.leaves(eqx.filter(tree, eqx.is_inexact_array)) for label, tree in found.items()}
        return {
            label: sum(jnp.sum(jnp.cos(jnp.arange(x.size)) * x.ravel()) for x in each) for label, each in floats.items()
        }

    leaves, static = eqx.partition((case, scheme, start), eqx.is_inexact_array)
    for label, gradient in derivatives(leaves).items():
        for path, leaf in jax.tree_util.tree_leaves_with_path(gradient):
            assert np.all(np.isfinite(leaf)), (label, jax.tree_util.keystr(path))


def test_no_objective_is_left_out_of_that():
    public = inspect.getmembers(diagnostics.objectives, inspect.isfunction)
    own = {name for name, made in public if made.__module__ == diagnostics.objectives.__name__}
    assert {label.split()[0] for label in AT_REST} >= own
    assert "energy_error" in own


def test_a_maximum_over_none_is_zero():
    assert float(diagnostics.smooth_maximum(jnp.array([3.0, 4.0]), 0.1, jnp.zeros(2, bool))) == 0.0
