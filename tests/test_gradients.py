"""Derivatives of whole runs: reverse against forward mode and central differences."""

from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hasty import quick

import jaxmps
from jaxmps import cases, schemes

STEPS, DT = 10, 1e-3
LEAVES = ("relaxation", "restitution", "viscosity", "gravity", "velocity", "density", "dt")
MASKS = ("beta", "collision distance", "courant", "gravity limit")


def problem(tolerance: float) -> SimpleNamespace:
    """A small dam break of a viscous fluid off its lattice, with two drops above it that collide."""
    case = cases.dam_break(spacing=0.1, width=0.4, height=0.7, tank_length=0.8, tank_height=0.9, viscosity=0.5)
    moves = np.asarray(case.particles.fluid)[:, None]
    # From numpy, the same numbers in both precisions.
    shift = 0.012 * np.random.default_rng(2).uniform(-1, 1, (len(moves), 2))
    position = case.particles.position + jnp.array(np.where(moves, shift, 0.0))
    # The last two particles of the column become drops in free flight, 0.55 spacings apart at 2.5 m/s.
    fluid = np.flatnonzero(np.asarray(case.particles.fluid))
    left, right = fluid[-1], fluid[-2]
    position = position.at[left].set(jnp.array([0.60, 0.55])).at[right].set(jnp.array([0.653, 0.565]))
    case = eqx.tree_at(lambda c: c.particles.position, case, position)
    scheme = schemes.mps(viscous=True, tolerance=tolerance)
    start = jaxmps.start(case, scheme)
    # The column is compressed, so that there is pressure to the end.
    center = np.array([0.2, 0.35])
    velocity = 0.1 * np.random.default_rng(3).normal(size=position.shape) - 2.0 * (np.asarray(position) - center)
    velocity = np.where(moves, velocity, 0.0)
    velocity[left], velocity[right] = [1.5, 0.3], [-1.0, 0.1]
    start = eqx.tree_at(lambda s: s.particles.velocity, start, jnp.array(velocity))
    values = {
        "relaxation": scheme.source.relaxation,
        "restitution": scheme.collision.restitution,
        "viscosity": case.fluids.viscosity,
        "gravity": case.gravity,
        "velocity": start.particles.velocity,
        "density": case.fluids.density,
        "dt": jnp.array(DT, float),
        "beta": scheme.free_surface.beta,
        "collision distance": scheme.collision.distance,
        "courant": scheme.time_step.courant,
        "gravity limit": scheme.time_step.gravity_limit,
    }
    weights = [np.random.default_rng(k).normal(size=position.shape) for k in (4, 5)]

    def run(v):
        new_scheme = eqx.tree_at(
            lambda s: (
                s.source.relaxation,
                s.collision.restitution,
                s.free_surface.beta,
                s.collision.distance,
                s.time_step.courant,
                s.time_step.gravity_limit,
            ),
            scheme,
            (
                v["relaxation"],
                v["restitution"],
                v["beta"],
                v["collision distance"],
                v["courant"],
                v["gravity limit"],
            ),
        )
        new_case = eqx.tree_at(
            lambda c: (c.fluids.viscosity, c.fluids.density, c.gravity),
            case,
            (v["viscosity"], v["density"], v["gravity"]),
        )
        new_start = eqx.tree_at(lambda s: s.particles.velocity, start, v["velocity"])
        return jaxmps.rollout(new_case, new_scheme, new_start, steps=STEPS, dt=v["dt"])

    def loss(v):
        """A generic function of the end: no symmetry hides an error."""
        state, info = run(v)
        end = state.particles
        value = (
            jnp.sum(jnp.array(weights[0]) * end.position) / 0.1
            + jnp.sum(jnp.array(weights[1]) * end.velocity)
            + jnp.sum(jnp.array(weights[1][:, 0]) * end.pressure) / 1e4
        )
        return value, (state, info)

    return SimpleNamespace(values=values, loss=loss, drops=(left, right), case=case)


@pytest.fixture(scope="module")
def double():
    jax.config.update("jax_enable_x64", True)  # module fixtures come before the one that sets it for each test
    p = problem(tolerance=1e-13)
    (_, p.end), p.gradient = quick(jax.value_and_grad(p.loss, has_aux=True))(p.values)
    p.forward = quick(lambda v, t: jax.jvp(lambda x: p.loss(x)[0], (v,), (t,)))
    return p


def direction(values, name):
    """The unit direction of one value, all others at rest; random for the velocities."""
    value = values[name]
    rng = np.random.default_rng(6)
    along = rng.normal(size=value.shape) if value.ndim == 2 else np.ones(value.shape)
    zero = jax.tree.map(jnp.zeros_like, values)
    return {**zero, name: jnp.asarray(along, value.dtype)}


def inner(gradient, tangent) -> float:
    return float(sum(jnp.vdot(gradient[k], tangent[k]) for k in gradient))


def test_the_run_is_a_generic_one(double):
    # Otherwise the tests below would say little: surface and interior, clipped pressures, and a collision.
    end, info = double.end
    assert not np.any(info.status)
    p = np.asarray(end.particles.pressure)
    unknown = np.asarray(double.case.particles.has_pressure) & ~np.asarray(end.surface)
    assert np.sum(unknown & (p == 0)) > 0
    assert np.sum(p > 0) > 3
    left, right = double.drops
    velocity = np.asarray(end.particles.velocity)
    assert velocity[left, 0] < velocity[right, 0]


@pytest.mark.parametrize("name", LEAVES)
def test_reverse_mode_is_forward_mode_and_central_differences(double, name):
    tangent = direction(double.values, name)
    reverse = inner(double.gradient, tangent)
    forward = float(double.forward(double.values, tangent)[1])
    assert np.isfinite(reverse)
    size = float(jnp.max(jnp.abs(double.values[name])))
    # Not zero: a change of the value by its own size is felt.
    assert abs(reverse) * size > 1e-4
    assert forward == pytest.approx(reverse, rel=1e-8)
    # Small enough to meet no kink of a minimum or a mask, large enough for the solver's tolerance of 1e-13.
    h = 1e-6 * size
    near = (jax.tree.map(lambda x, t, s=s: x + s * h * t, double.values, tangent) for s in (1, -1))
    plus, minus = (float(double.forward(values, tangent)[0]) for values in near)
    assert reverse == pytest.approx((plus - minus) / (2 * h), rel=1e-4)


@pytest.mark.parametrize("name", MASKS)
def test_thresholds_and_unused_limits_have_no_derivative(double, name):
    assert float(double.gradient[name]) == 0.0
    assert float(double.forward(double.values, direction(double.values, name))[1]) == 0.0


@pytest.mark.parametrize("precision", ["single"], indirect=True)
def test_single_precision_gives_the_derivatives_of_double(double, precision):
    single = problem(tolerance=1e-6)
    assert single.values["velocity"].dtype == jnp.float32
    gradient = quick(jax.grad(single.loss, has_aux=True))(single.values)[0]
    for name in LEAVES:
        found, expected = np.asarray(gradient[name], float), np.asarray(double.gradient[name])
        assert np.all(np.isfinite(found)), name
        # Round-off of 1e-7 in the number density, divided by dt^2 in the source.
        assert np.linalg.norm(found - expected) < 0.02 * np.linalg.norm(expected), name


def test_derivatives_of_a_run_from_rest_are_finite():
    # At rest the speed has no derivative; the time step is left to the scheme, which asks for it.
    case = cases.hydrostatic(spacing=0.1, length=0.4, height=0.4, freeboard=0.1)
    scheme = schemes.mps()
    start = jaxmps.start(case, scheme)

    def loss(scheme, gravity, velocity):
        moving = eqx.tree_at(lambda s: s.particles.velocity, start, velocity)
        end, _ = jaxmps.rollout(eqx.tree_at(lambda c: c.gravity, case, gravity), scheme, moving, steps=3)
        return jnp.sum(end.particles.position**2) + jnp.sum(end.particles.velocity)

    velocity = start.particles.velocity
    found = quick(jax.grad(loss, argnums=(0, 1, 2)))(scheme, case.gravity, velocity)
    for leaf in jax.tree.leaves(found):
        assert np.all(np.isfinite(leaf))
    assert float(found[0].time_step.gravity_limit) != 0.0
    assert np.any(np.asarray(found[2]) != 0.0)
