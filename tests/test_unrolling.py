"""Rollouts: segments and windows change memory and derivatives, never the run; recordings; one compilation."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hasty import options, quick

import jaxmps as mps
from jaxmps.pressure import ByDiagonal

DT = 2e-3


@pytest.fixture(scope="module")
def flow():
    jax.config.update("jax_enable_x64", True)
    case = mps.cases.jitter(mps.cases.standing_wave(spacing=0.1, depth=0.25), 0.05, jax.random.key(0))
    scheme = mps.schemes.stochastic(mps.schemes.mps(tolerance=1e-12), alpha=0.03)
    scheme = dataclasses.replace(scheme, preconditioning=ByDiagonal())  # which compiles in half the time
    # Into its motion: at first no energy is lost, and none given back.
    moving, info = quick(lambda start: mps.rollout(case, scheme, start, steps=60, dt=DT))(mps.start(case, scheme))
    assert float(info.given[-4:].min()) > 0.0
    return case, scheme, eqx.tree_at(lambda s: s.time, moving, jnp.zeros(()))


def value_and_slope(flow, steps, **options):
    case, scheme, start = flow

    def loss(velocity):
        moving = eqx.tree_at(lambda s: s.particles.velocity, start, velocity)
        end, _ = mps.rollout(case, scheme, moving, steps=steps, dt=DT, **options)
        return jnp.mean(end.particles.velocity**2)

    rng = np.random.default_rng(0)
    velocity = jnp.array(0.3 * rng.normal(size=start.particles.velocity.shape))
    value, slope = quick(jax.value_and_grad(loss))(velocity)
    return float(value), np.asarray(slope)


@pytest.fixture(scope="module")
def whole(flow):
    return value_and_slope(flow, 12, segment=12)


@pytest.mark.parametrize("segment", [pytest.param(None, marks=pytest.mark.slow), 5])
def test_segments_change_neither_run_nor_derivative(flow, whole, segment):
    value, slope = value_and_slope(flow, 12, segment=segment)
    assert value == pytest.approx(whole[0], rel=1e-12)
    np.testing.assert_allclose(slope, whole[1], rtol=1e-7, atol=1e-9 * np.abs(whole[1]).max())
    assert np.abs(slope).max() > 1e-6


def test_the_derivative_in_windows_is_that_of_each_window_by_itself(flow):
    case, scheme, start = flow

    def windows(alpha):
        changed = eqx.tree_at(lambda s: s.noise.alpha, scheme, alpha)
        record = lambda s: jnp.mean(s.particles.velocity**2)  # noqa: E731
        return jnp.sum(mps.rollout(case, changed, start, steps=8, dt=DT, window=4, record=record)[2])

    @quick
    def one_window(alpha, begin):
        def energies(alpha):
            changed = eqx.tree_at(lambda s: s.noise.alpha, scheme, alpha)
            record = lambda s: jnp.mean(s.particles.velocity**2)  # noqa: E731
            end, _, every = mps.rollout(case, changed, begin, steps=4, dt=DT, record=record)
            return jnp.sum(every), end

        return jax.grad(energies, has_aux=True)(alpha)

    alpha = jnp.asarray(0.03)
    in_windows = quick(jax.grad(windows))(alpha)
    first, half = one_window(alpha, start)
    second, _ = one_window(alpha, half)
    assert float(in_windows) == pytest.approx(float(first + second), rel=1e-8)
    assert abs(float(in_windows)) > 1e-9 and abs(float(second)) > 1e-9


@pytest.fixture(scope="module")
def three_steps(flow):
    case, scheme, start = flow
    return quick(lambda start: mps.rollout(case, scheme, start, steps=3, dt=DT))(start)[0].particles.position


@pytest.mark.parametrize(
    ("steps", "segment"), [(7, 3), *(pytest.param(n, s, marks=pytest.mark.slow) for n, s in [(7, None), (6, 6)])]
)
def test_recordings_are_those_of_each_step(flow, three_steps, steps, segment):
    case, scheme, start = flow
    record = lambda s: (s.particles.position, s.time)  # noqa: E731
    roll = quick(lambda start: mps.rollout(case, scheme, start, steps=steps, dt=DT, record=record, segment=segment))
    end, info, (position, time) = roll(start)
    np.testing.assert_allclose(time, DT * np.arange(1, steps + 1), rtol=1e-12)
    np.testing.assert_array_equal(position[-1], end.particles.position)
    assert info.dt.shape == (steps,)
    np.testing.assert_allclose(position[2], three_steps, atol=1e-10)


@pytest.mark.slow
def test_memory_grows_with_the_root_of_the_steps(flow):
    case, scheme, start = flow

    def bytes_for(steps):
        def loss(velocity):
            moving = eqx.tree_at(lambda s: s.particles.velocity, start, velocity)
            return jnp.sum(mps.rollout(case, scheme, moving, steps=steps, dt=DT)[0].particles.velocity)

        lowered = jax.jit(jax.grad(loss), compiler_options=options()).lower(start.particles.velocity)
        memory = lowered.compile().memory_analysis()
        assert memory is not None
        return memory.temp_size_in_bytes / len(case.particles.kind)

    few, many = bytes_for(16), bytes_for(1024)
    assert many < 4.0 * few + 8.5 * 1024  # the solutions of all steps, a number each


def test_derivatives_of_members_are_those_of_single_runs(flow):
    case, scheme, start = flow
    keys = jax.random.split(jax.random.key(4), 2)

    def loss(alpha, key):
        changed = eqx.tree_at(lambda s: s.noise.alpha, scheme, alpha)
        return jnp.mean(mps.rollout(case, changed, start, steps=6, dt=DT, key=key)[0].particles.velocity ** 2)

    alpha, slope = jnp.asarray(0.03), jax.grad(loss)
    together = quick(jax.vmap(slope, in_axes=(None, 0)))(alpha, keys)
    one = quick(slope)
    np.testing.assert_allclose(together, [float(one(alpha, key)) for key in keys], rtol=1e-6)
    assert abs(float(together[0] - together[1])) > 1e-9


def test_one_compilation_serves_the_gradients_at_all_values(flow):
    case, scheme, start = flow
    traced = []

    @eqx.filter_jit
    def slope(scheme, gravity):
        traced.append(1)

        def loss(scheme, gravity):
            heavier = eqx.tree_at(lambda c: c.gravity, case, gravity)
            return jnp.mean(mps.rollout(heavier, scheme, start, steps=3, dt=DT)[0].particles.position ** 2)

        return jax.grad(loss)(scheme, gravity)

    for factor in (1.0, 0.9, 0.7):
        slope(jax.tree.map(lambda x, f=factor: x * f, scheme), case.gravity * factor)
    assert len(traced) == 1


@pytest.mark.parametrize("argument", ["steps", "segment", "window"])
@pytest.mark.parametrize("value", [0, -3, 2.0, True])
def test_numbers_of_steps_must_be_whole_and_positive(flow, argument, value, unchecked):
    case, scheme, start = flow
    with pytest.raises(ValueError, match=f"{argument} must be a whole number of 1 or more, got {value}"):
        mps.rollout(case, scheme, start, **{"steps": 3, argument: value})
