"""What of a case has derivatives, and what says that it has none."""

import dataclasses
import inspect

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hasty import by_diagonal, quick

import jaxmps as mps
from jaxmps.casefile.arguments import arguments, case_factories, scheme_factories
from jaxmps.flow.motion import Rigid, Sine

VALUES = {"gravity", "angular_velocity", "period", "phase"}
"""What is no geometry, and has a derivative; densities and viscosities beside."""
COARSE = {"settling": 0.0125, "surfacing": 0.0125, "sloshing": 0.05}


def has_derivative(name: str) -> bool:
    return name in VALUES or name.endswith(("density", "viscosity"))


def numbers(name: str) -> dict[str, float]:
    """The arguments of a case that are numbers."""
    found = {k: p.default for k, p in arguments(case_factories()[name]).items() if not isinstance(p.default, str)}
    return {k: 0.2 if v is None else v for k, v in found.items()} | {"spacing": COARSE.get(name, 0.1)}


ALL = [(case, name) for case in case_factories() for name in numbers(case)]


@pytest.mark.parametrize(("case", "name"), [pair for pair in ALL if not has_derivative(pair[1])])
def test_a_geometry_says_that_it_has_no_derivative_and_what_has(case, name):
    make, value = case_factories()[case], numbers(case)[name]
    for transform in (jax.grad, jax.jit):
        with pytest.raises(ValueError, match=rf"^{name} must be a plain .* has no derivative\. .* by gravity") as told:
            transform(lambda x: make(**{**numbers(case), name: x}).gravity[0])(value)
        assert "\n" not in str(told.value)


@pytest.mark.parametrize(("case", "name"), [pair for pair in ALL if has_derivative(pair[1])])
def test_what_is_no_geometry_has_the_derivative_of_central_differences(case, name):
    make, given = case_factories()[case], numbers(case)

    def leaves(x):
        floats = jax.tree.leaves(eqx.filter(make(**{**given, name: x}), eqx.is_inexact_array))
        return sum(jnp.sum(jnp.cos(jnp.arange(leaf.size)) * leaf.ravel()) for leaf in floats)

    x = max(given[name], 1e-3) if name.endswith("viscosity") else given[name]  # which may not be negative
    h = 1e-4 * max(abs(x), 1e-3)
    assert float(jax.grad(leaves)(x)) == pytest.approx(float(leaves(x + h) - leaves(x - h)) / (2 * h), rel=1e-4)
    assert float(jax.grad(leaves)(x)) != 0.0


@pytest.mark.filterwarnings("ignore:A JAX array is being set as static")
def test_boxes_spacings_and_radii_of_ones_own_say_so_too():
    case = mps.cases.square_patch(spacing=0.25)
    calls = {
        "box.lower": lambda x: mps.Box((x, 0.0), (1.0, 1.0)).lower[0],
        "box.upper": lambda x: mps.Box((0.0, 0.0), (1.0 + x, 1.0)).upper[0],
        "spacing": lambda x: dataclasses.replace(case, spacing=x).spacing,
    }
    calls |= {f"ratio {k}": lambda x, make=make: make(ratio=2.0 + x).ratio for k, make in scheme_factories().items()}
    calls |= {f"tolerance {k}": lambda x, make=make: make(tolerance=x).ratio for k, make in scheme_factories().items()}
    for name, call in calls.items():
        with pytest.raises(ValueError, match=rf"^{name.split()[0]} must be a plain number"):
            jax.grad(call)(0.1)


@pytest.fixture(scope="module")
def rolling():
    """Water in a tank that sways, off its lattice and in motion: a case whose particles and walls all matter."""
    with jax.enable_x64(True):
        case = mps.cases.hydrostatic(spacing=0.1, length=0.4, height=0.3, freeboard=0.1)
        case = mps.cases.jitter(case, 0.1, jax.random.key(2))
        motion, box = Rigid([0.0, 0.0], sway=Sine(0.02, 9.0)), mps.Box((-0.4, -0.4), (0.9, 0.8))
        moves = np.asarray(case.particles.fluid)[:, None]
        velocity = jnp.array(np.where(moves, np.random.default_rng(3).normal(size=(*moves.shape[:1], 2)) * 0.3, 0.0))
        particles = dataclasses.replace(case.particles, velocity=velocity)
        case = dataclasses.replace(case, motion=motion, box=box, particles=particles)
        scheme = by_diagonal(mps.schemes.mps_cd_gc_ds(tolerance=1e-13))
        yield case, scheme, mps.start(case, scheme)


STEPS = {"steps": 4, "dt": 1e-3}


def test_a_rollout_from_the_case_is_the_one_from_its_start_whatever_the_state_that_lends_its_list(rolling):
    case, scheme, start = rolling
    later, _ = mps.rollout(case, scheme, start, steps=4, dt=1e-3)
    expected = mps.rollout(case, scheme, start, **STEPS)
    for lender in (start, later):
        found = mps.rollout(case, scheme, lender, **STEPS, from_case=True)
        assert int(found[0].step) == 4 and float(found[0].time) == pytest.approx(4e-3)
        for a, b in zip(jax.tree.leaves(found[0].particles), jax.tree.leaves(expected[0].particles), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_derivatives_by_the_particles_of_a_case_are_those_of_central_differences_from_the_case_and_zero_else(rolling):
    case, scheme, start = rolling
    weights = jnp.array(np.random.default_rng(4).normal(size=(2, *case.particles.position.shape)))
    where = lambda c: (c.particles.position, c.particles.velocity)  # noqa: E731

    def loss(values, from_case):
        changed = eqx.tree_at(where, case, values)
        end = mps.rollout(changed, scheme, start, **STEPS, from_case=from_case)[0].particles
        return jnp.sum(weights[0] * end.position) / 0.1 + jnp.sum(weights[1] * end.velocity)

    slopes = quick(jax.value_and_grad(lambda v: loss(v, True)))
    _, gradient = slopes(where(case))
    fluid = np.asarray(case.particles.fluid)[:, None]
    for k in range(2):
        direction = np.random.default_rng(5 + k).normal(size=(*fluid.shape[:1], 2)) * fluid
        ends = []
        for h in (1e-6, -1e-6):
            shifted = list(where(case))
            shifted[k] = shifted[k] + h * direction
            ends.append(float(slopes(tuple(shifted))[0]))
        slope = float(jnp.vdot(gradient[k], direction))
        assert abs(slope) > 1e-3
        assert slope == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-4)
    by_position, by_velocity = jax.grad(lambda v: loss(v, False))(where(case))
    moving = np.asarray(fluid)[:, 0]
    assert not np.any(by_position[moving]) and not np.any(by_velocity)


@pytest.mark.slow
def test_the_angular_velocity_of_a_patch_has_a_derivative_through_a_run():
    scheme, key = by_diagonal(mps.schemes.mps_cd_gc_ds(tolerance=1e-13)), jax.random.key(0)
    start = mps.start(mps.cases.square_patch(spacing=0.25), scheme)

    def end(omega):
        case = mps.cases.square_patch(spacing=0.25, angular_velocity=omega)
        state, _ = mps.rollout(case, scheme, start, steps=3, dt=1e-3, key=key, from_case=True)
        return jnp.sum(state.particles.position[:, 0] * case.particles.position[:, 1])

    value_and_slope = quick(jax.value_and_grad(end))
    slope = float(value_and_slope(jnp.asarray(1.0))[1])
    # Of a rotation: x = x₀ + ω y₀ t to the first order, at t = 3 ms.
    y = np.asarray(mps.cases.square_patch(spacing=0.25).particles.position)[:, 1]
    assert slope == pytest.approx(3e-3 * np.sum(y**2), rel=1e-2)
    plus, minus = (float(value_and_slope(jnp.asarray(1.0 + h))[0]) for h in (1e-4, -1e-4))
    difference = (plus - minus) / 2e-4
    assert slope == pytest.approx(difference, rel=1e-5)


def test_the_names_that_have_derivatives_are_names_of_arguments():
    known = {name for make in case_factories().values() for name in inspect.signature(make).parameters}
    assert known >= VALUES
