"""Rollouts: segments and windows change memory and derivatives, never the run; recordings; one compilation."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hasty import by_diagonal, options, quick

import jaxmps as mps

DT = 2e-3


def recorded(state):
    return state.particles.position, state.time


def graded(case, scheme, steps, **options):
    """The program of a start and its velocity: the mean square velocity after some steps and its slope, and the run."""

    def loss(velocity, start):
        moving = eqx.tree_at(lambda s: s.particles.velocity, start, velocity)
        run = mps.rollout(case, scheme, moving, steps=steps, dt=DT, record=recorded, **options)
        return jnp.mean(run[0].particles.velocity ** 2), run

    return quick(jax.value_and_grad(loss, has_aux=True))


@pytest.fixture(scope="module")
def twelve_steps():
    """A case, a scheme, and the program of twelve steps in one segment."""
    jax.config.update("jax_enable_x64", True)
    case = mps.cases.jitter(mps.cases.standing_wave(spacing=0.1, depth=0.25), 0.05, jax.random.key(0))
    scheme = by_diagonal(mps.schemes.stochastic(mps.schemes.mps(tolerance=1e-12), alpha=0.03))
    return case, scheme, graded(case, scheme, 12, segment=12)


@pytest.fixture(scope="module")
def flow(twelve_steps):
    case, scheme, program = twelve_steps
    # Into its motion: at first no energy is lost, and none given back.
    moving, given = mps.start(case, scheme), np.zeros(0)
    for _ in range(5):
        (_, (moving, info, _)), _ = program(moving.particles.velocity, moving)
        given = np.asarray(info.given)
    assert given[-4:].min() > 0.0
    return case, scheme, eqx.tree_at(lambda s: s.time, moving, jnp.zeros(()))


@pytest.fixture(scope="module")
def velocity(flow):
    return jnp.array(0.3 * np.random.default_rng(0).normal(size=flow[2].particles.velocity.shape))


@pytest.fixture(scope="module")
def whole(flow, twelve_steps, velocity):
    return twelve_steps[2](velocity, flow[2])


@pytest.mark.parametrize("segment", [None, 5])
@pytest.mark.slow
def test_segments_change_neither_run_nor_derivative(flow, velocity, whole, segment):
    case, scheme, start = flow
    (value, _), slope = graded(case, scheme, 12, segment=segment)(velocity, start)
    (expected, _), expected_slope = whole
    size = float(jnp.abs(expected_slope).max())
    assert float(value) == pytest.approx(float(expected), rel=1e-12)
    np.testing.assert_allclose(slope, expected_slope, rtol=1e-7, atol=1e-9 * size)
    assert np.abs(slope).max() > 1e-6


def with_alpha(scheme, alpha):
    return eqx.tree_at(lambda s: s.noise.alpha, scheme, alpha)


@pytest.fixture(scope="module")
def by_alpha(flow):
    """The sum of the mean square velocities of four steps: its derivative by alpha, not compiled, and the end."""
    case, scheme, _ = flow

    def energies(alpha, begin, key):
        record = lambda s: jnp.mean(s.particles.velocity**2)  # noqa: E731
        options = {"steps": 4, "dt": DT, "record": record, "key": key}
        end, _, every = mps.rollout(case, with_alpha(scheme, alpha), begin, **options)
        return jnp.sum(every), end

    return jax.grad(energies, has_aux=True)


@pytest.fixture(scope="module")
def one_window(by_alpha):
    return quick(by_alpha)


@pytest.mark.slow
def test_the_derivative_in_windows_is_that_of_each_window_by_itself(flow, one_window):
    case, scheme, start = flow
    alpha, key = jnp.asarray(0.03), jax.random.key(0)

    def windows(alpha):
        record = lambda s: jnp.mean(s.particles.velocity**2)  # noqa: E731
        options = {"steps": 8, "dt": DT, "window": 4, "record": record, "key": key}
        return jnp.sum(mps.rollout(case, with_alpha(scheme, alpha), start, **options)[2])

    in_windows = quick(jax.grad(windows))(alpha)
    first, half = one_window(alpha, start, key)
    second, _ = one_window(alpha, half, key)
    assert float(in_windows) == pytest.approx(float(first + second), rel=1e-8)
    assert abs(float(first)) > 1e-9 and abs(float(second)) > 1e-9


@pytest.mark.parametrize(
    ("steps", "segment"), [(7, 3), *(pytest.param(n, s, marks=pytest.mark.slow) for n, s in [(7, None), (6, 6)])]
)
def test_recordings_are_those_of_each_step(flow, velocity, whole, steps, segment):
    case, scheme, start = flow
    start = eqx.tree_at(lambda s: s.particles.velocity, start, velocity)
    roll = quick(lambda start: mps.rollout(case, scheme, start, steps=steps, dt=DT, record=recorded, segment=segment))
    end, info, (position, time) = roll(start)
    np.testing.assert_allclose(time, DT * np.arange(1, steps + 1), rtol=1e-12)
    np.testing.assert_array_equal(position[-1], end.particles.position)
    assert info.dt.shape == (steps,)
    # And of a run that is longer by some.
    (_, (_, _, (of_twelve, _))), _ = whole
    np.testing.assert_allclose(of_twelve[:steps], position, atol=1e-10)


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


@pytest.mark.slow
def test_derivatives_of_members_are_those_of_single_runs(flow, by_alpha, one_window):
    start = flow[2]
    keys, alpha = jax.random.split(jax.random.key(4), 2), jnp.asarray(0.03)
    together, _ = quick(jax.vmap(by_alpha, in_axes=(None, None, 0)))(alpha, start, keys)
    np.testing.assert_allclose(together, [float(one_window(alpha, start, key)[0]) for key in keys], rtol=1e-6)
    assert abs(float(together[0] - together[1])) > 1e-9


@pytest.mark.slow
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
