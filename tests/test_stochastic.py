"""The stochastic velocity of [N11] §3: its direction, magnitude and energy, its drift, and that it can be tuned."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hasty import by_diagonal, quick
from jax import random
from scipy.stats import kstest

import jaxmps as mps
from jaxmps.flow import kinetic_energy
from jaxmps.models import AbstractVelocityNoise, DriftFreeVelocity, NoNoise, StochasticVelocity

N = 20_000
ALPHA, LOSS = 0.04, 2e-5
MOST = ALPHA * np.sqrt(2.0 * LOSS)  # the largest magnitude [m/s]
OPEN = {2: (False, False), 3: (False, False, False)}
MODELS = [StochasticVelocity, DriftFreeVelocity]


def make(model):
    return model(ALPHA)


@quick
def steps_of_a_millisecond(case, scheme, state):
    return mps.rollout(case, scheme, state, steps=30, dt=1e-3, record=lambda state: state.loss)


def draw(
    dim,
    model: type[AbstractVelocityNoise] = StochasticVelocity,
    loss=LOSS,
    seed=0,
    periodic=None,
    velocity=None,
    mass=None,
):
    """A velocity of many particles and the noise that it gets."""
    velocity = random.normal(random.key(1), (N, dim)) if velocity is None else velocity
    mass = jnp.ones(len(velocity)) if mass is None else mass
    noise = make(model)(velocity, jnp.asarray(loss, float), mass, periodic or OPEN[dim], random.key(seed))
    return velocity, noise


def cosines(velocity, noise):
    lengths = jnp.linalg.norm(velocity, axis=1) * jnp.linalg.norm(noise, axis=1)
    return np.asarray(jnp.sum(velocity * noise, axis=1) / lengths)


@pytest.mark.parametrize("precision", ["single", "double"], indirect=True)
@pytest.mark.parametrize("dim", [2, 3])
def test_noise_never_points_against_the_velocity(dim, precision):
    for seed in range(5):
        velocity, noise = draw(dim, seed=seed)
        assert float(jnp.min(jnp.sum(velocity * noise, axis=1))) >= 0.0
        assert float(jnp.max(jnp.linalg.norm(noise, axis=1))) <= MOST * (1.0 + 1e-6)


def test_angles_and_magnitudes_are_uniform_and_independent():
    # Kolmogorov-Smirnov at the level 1e-3: a right generator fails for one seed in a thousand, and this one is fixed.
    velocity, noise = draw(2)
    across = np.asarray(velocity[:, 0] * noise[:, 1] - velocity[:, 1] * noise[:, 0])
    along = np.asarray(jnp.sum(velocity * noise, axis=1))
    angle, size = np.arctan2(across, along), np.asarray(jnp.linalg.norm(noise, axis=1))
    assert kstest(angle, "uniform", (-0.5 * np.pi, np.pi)).pvalue > 1e-3
    assert kstest(size, "uniform", (0.0, MOST)).pvalue > 1e-3
    assert abs(np.corrcoef(angle, size)[0, 1]) < 4.0 / np.sqrt(N)
    # Neighbors in memory draw independently.
    assert abs(np.corrcoef(angle[:-1], angle[1:])[0, 1]) < 4.0 / np.sqrt(N)


def test_directions_in_space_are_uniform_on_the_half_sphere():
    # Archimedes: the height of uniform points on a sphere is uniform. About the velocity they have no preferred side.
    velocity, noise = draw(3)
    assert kstest(cosines(velocity, noise), "uniform", (0.0, 1.0)).pvalue > 1e-3
    size = np.asarray(jnp.linalg.norm(noise, axis=1))
    assert kstest(size, "uniform", (0.0, MOST)).pvalue > 1e-3
    one = jnp.broadcast_to(jnp.array([0.3, -2.0, 0.4]), (N, 3))
    _, noise = draw(3, velocity=one)
    axes = np.linalg.svd(np.asarray(one[:1]))[2][1:]
    x, y = axes @ np.asarray(noise).T
    assert kstest(np.arctan2(y, x), "uniform", (-np.pi, 2.0 * np.pi)).pvalue > 1e-3


@pytest.mark.parametrize(("dim", "share"), [(2, 1.0 / np.pi), (3, 0.25)])
def test_energy_given_back_is_what_the_distribution_says(dim, share):
    velocity, noise = draw(dim)
    given = kinetic_energy(velocity + noise, jnp.ones(N)) - kinetic_energy(velocity, jnp.ones(N))
    speed = float(jnp.mean(jnp.linalg.norm(velocity, axis=1)))
    expected = ALPHA * np.sqrt(2.0 * LOSS) * speed * share + ALPHA**2 * LOSS / 3.0
    assert float(given) == pytest.approx(expected, rel=0.02)  # four standard errors of the mean


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("loss", [0.0, -1e-3])
def test_nothing_is_added_where_no_energy_was_lost(model, loss):
    assert np.all(np.asarray(draw(2, model, loss, periodic=(True, False))[1]) == 0.0)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("dim", [2, 3])
def test_particles_at_rest_and_walls_get_nothing(model, dim):
    periodic = (True, *OPEN[dim][1:])
    velocity = random.normal(random.key(1), (100, dim)).at[7].set(0.0)
    velocity = velocity if model is StochasticVelocity else velocity - jnp.mean(velocity, axis=0).at[1:].set(0.0)
    mass = jnp.ones(100).at[20:30].set(0.0)
    _, noise = draw(dim, model, velocity=velocity, mass=mass, periodic=periodic)
    assert np.all(np.asarray(noise[20:30]) == 0.0)
    assert np.all(np.any(np.asarray(noise[30:]) != 0.0, axis=1))
    if model is StochasticVelocity:
        assert np.all(np.asarray(noise[7]) == 0.0)
    alone = draw(dim, model, velocity=jnp.ones((1, dim)), periodic=periodic)[1]
    assert np.all(np.isfinite(np.asarray(alone)))
    nobody = draw(dim, model, velocity=velocity, mass=jnp.zeros(100), periodic=periodic)[1]
    assert np.all(np.asarray(nobody) == 0.0)


@pytest.mark.parametrize("precision", ["single", "double"], indirect=True)
@pytest.mark.parametrize("dim", [2, 3])
def test_drift_free_noise_has_no_momentum_along_periodic_axes_and_the_energy_of_the_published_one(dim, precision):
    mass = random.uniform(random.key(5), (N,), minval=1.0, maxval=3.0)
    velocity = random.normal(random.key(1), (N, dim)) + jnp.array([0.5, 0.2, 0.2][:dim])
    periodic = (True, *OPEN[dim][1:])
    _, noise = draw(dim, DriftFreeVelocity, velocity=velocity, mass=mass, periodic=periodic)
    eps = float(jnp.finfo(noise.dtype).eps)
    momentum = np.abs(np.asarray(mass @ noise) / float(jnp.sum(mass * jnp.linalg.norm(noise, axis=1))))
    assert momentum[0] < 100.0 * eps
    assert np.all(momentum[1:] > 0.01)
    # What the published noise gives about the velocity relative to the mean flow along x.
    flow = velocity.at[:, 0].add(-jnp.sum(mass * velocity[:, 0]) / jnp.sum(mass))
    _, published = draw(dim, velocity=flow, mass=mass)
    given = kinetic_energy(velocity + noise, mass) - kinetic_energy(velocity, mass)
    wanted = kinetic_energy(flow + published, mass) - kinetic_energy(flow, mass)
    assert float(given) == pytest.approx(float(wanted), rel=1e-9 if noise.dtype == jnp.float64 else 5e-2)


def test_drift_free_noise_is_the_published_one_between_walls():
    np.testing.assert_array_equal(draw(2, DriftFreeVelocity)[1], draw(2)[1])


def test_a_block_in_free_fall_loses_no_energy_and_gets_none():
    case = mps.cases.hydrostatic(spacing=0.02, length=0.2, height=0.2)
    # High above the floor, and thrown: nothing touches it for 30 steps of 1 ms.
    fluid = case.particles.fluid[:, None]
    thrown = dataclasses.replace(
        case.particles,
        position=jnp.where(fluid, case.particles.position + jnp.array([0.0, 0.5]), case.particles.position),
        velocity=jnp.where(fluid, jnp.array([0.0, 1.0]), 0.0),
    )
    box = mps.Box(case.box.lower, (case.box.upper[0], 2.0), (False, False))
    case = dataclasses.replace(case, particles=thrown, box=box)
    # Without surface tension or air, a block of fluid in flight has no pressure.
    basic = by_diagonal(mps.schemes.mps(collision_distance=0.0))
    basic = dataclasses.replace(basic, source=mps.schemes.mps_hs_gc().source)
    scheme = mps.schemes.stochastic(basic, alpha=0.05)
    state, info, _ = steps_of_a_millisecond(case, scheme, mps.start(case, scheme))
    # Round-off: of the positions over Δt² in the pressure, and its root in the noise.
    assert float(jnp.max(jnp.abs(state.particles.pressure))) < 1e-4
    assert abs(float(state.loss)) < 1e-8
    assert np.all(np.asarray(info.given) < 1e-8)
    # The mechanical energy itself does fall, by ½ g² Δt² = 5e-5 J/kg in each step: noise for that would give 1e-4.
    total = np.asarray(info.energy.kinetic + info.energy.potential)
    np.testing.assert_allclose(-np.diff(total), 0.5 * 9.81**2 * 1e-6, rtol=1e-3)


def small_wave(**arguments):
    return mps.cases.standing_wave(spacing=0.05, **arguments)


@pytest.mark.slow
def test_one_key_is_one_run_and_another_key_another():
    case, scheme = small_wave(), mps.schemes.stochastic(by_diagonal(mps.schemes.mps()), alpha=0.04)
    first, again, other = (
        mps.simulate(case, scheme, until=0.2, save_every=0.1, key=random.key(seed), progress=False)
        for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(first.position, again.position)
    assert np.max(np.abs(first.position[-1] - other.position[-1])) > 1e-9
    assert first.summary["noise_work"] > 0.0


def test_noise_without_strength_is_the_basic_method():
    case, basic = small_wave(), by_diagonal(mps.schemes.mps())
    runs = [
        steps_of_a_millisecond(case, scheme, mps.start(case, scheme))[0].particles.position
        for scheme in (basic, mps.schemes.stochastic(basic, alpha=0.0))
    ]
    np.testing.assert_allclose(runs[0], runs[1], rtol=0.0, atol=1e-13)  # two programs: round-off
    assert isinstance(basic.noise, NoNoise)


def test_energy_budget_closes():
    # What is left is what was there, less the losses of all steps, plus what the noise gave before them.
    case, scheme = small_wave(), mps.schemes.stochastic(by_diagonal(mps.schemes.mps()), alpha=0.04)
    state = mps.start(case, scheme)
    before = mps.diagnostics.mechanical_energy(state.particles, case.density, case.gravity).total
    state, info, losses = steps_of_a_millisecond(case, scheme, state)
    lost = float(jnp.sum(losses))
    assert float(jnp.sum(info.given)) > 0.0
    after = mps.diagnostics.mechanical_energy(state.particles, case.density, case.gravity).total
    # The loss counts what the noise gave, and the energy half a step back: g·u Δt / 2 at the end, zero at the start.
    half = 0.5e-3 * -9.81 * float(jnp.mean(state.particles.velocity[state.particles.fluid, 1]))
    assert float(after) + half == pytest.approx(float(before) - lost, abs=1e-12)


def test_derivative_by_alpha_passes_through_the_noise():
    case = small_wave()
    scheme = by_diagonal(dataclasses.replace(mps.schemes.mps(tolerance=1e-13), noise=StochasticVelocity(0.04)))

    # From an instant on at which the flow, which gains energy in some steps, has lost some.
    @quick
    def spread(alpha, begin):
        def loss(alpha):
            tuned = eqx.tree_at(lambda s: s.noise.alpha, scheme, alpha)
            end = mps.rollout(case, tuned, begin, steps=3, dt=1e-3, key=random.key(2))[0]
            return jnp.mean(jnp.where(end.particles.fluid, end.particles.velocity[:, 1] ** 2, 0.0)), end

        return jax.value_and_grad(loss, has_aux=True)(alpha)

    alpha, h, begin = jnp.asarray(0.04), 1e-5, mps.start(case, scheme)
    for _ in range(5):
        (_, begin), _ = spread(alpha, begin)
    derivative = float(spread(alpha, begin)[1])
    difference = float(spread(alpha + h, begin)[0][0] - spread(alpha - h, begin)[0][0]) / (2.0 * h)
    assert abs(difference) > 1e-6
    assert derivative == pytest.approx(difference, rel=1e-4)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("model", MODELS)
def test_derivative_by_velocity_and_loss_is_that_of_differences(model, dim):
    velocity = random.normal(random.key(1), (30, dim))
    mass, periodic, target = jnp.ones(30), (True, *OPEN[dim][1:]), random.normal(random.key(8), (30, dim))

    def overlap(velocity, loss):
        return jnp.sum(target * make(model)(velocity, loss, mass, periodic, random.key(3)))

    loss, h = jnp.asarray(LOSS), 1e-6
    along = random.normal(random.key(4), velocity.shape)
    by_velocity, by_loss = jax.grad(overlap, argnums=(0, 1))(velocity, loss)
    difference = (overlap(velocity + h * along, loss) - overlap(velocity - h * along, loss)) / (2.0 * h)
    assert abs(float(difference)) > 1e-6
    assert float(jnp.sum(by_velocity * along)) == pytest.approx(float(difference), rel=1e-6)
    step = 1e-4 * loss
    difference = (overlap(velocity, loss + step) - overlap(velocity, loss - step)) / (2.0 * step)
    assert abs(float(difference)) > 0.1
    assert float(by_loss) == pytest.approx(float(difference), rel=1e-6)
    # At rest and without loss, where the formulas divide by zero, there is nothing, and its derivative is finite.
    nothing = jax.grad(overlap, argnums=(0, 1))(jnp.zeros_like(velocity), jnp.zeros(()))
    assert all(np.all(np.isfinite(np.asarray(part))) for part in nothing)


@pytest.mark.parametrize("alpha", [-0.1, 1.5, float("nan")])
def test_strength_out_of_range_is_refused(alpha):
    with pytest.raises(ValueError, match="alpha must be"):
        mps.schemes.stochastic(mps.schemes.mps(), alpha=alpha)
