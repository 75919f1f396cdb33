"""Derivatives of runs by all that is a number: reverse mode, forward mode and central differences.

Every scheme runs with viscosity and with the stochastic velocity, so that all its models are passed through.
"""

import functools
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hasty import by_diagonal, quick

import jaxmps
from jaxmps import cases, schemes

DT = 5e-4
SCHEMES = ("mps", "cmps_hs", "mps_hs_gc", "mps_hs_gc_ds", "mps_cd_gc_ds")
FLOW = ("position", "velocity", "density", "gravity", "viscosity", "dt")
LEAVES = {
    "mps": ("noise.alpha", "source.relaxation", "collision.restitution"),
    "cmps_hs": ("noise.alpha", "collision.restitution"),
    "mps_hs_gc": ("noise.alpha",),
    "mps_hs_gc_ds": ("noise.alpha", "stabilizer.alpha_ds", "stabilizer.kept_velocity"),
    "mps_cd_gc_ds": ("noise.alpha", "stabilizer.alpha_ds", "stabilizer.kept_velocity", "source.restoring"),
}
THRESHOLDS = {"free_surface.beta", "free_surface.asymmetry", "free_surface.sparse", "collision.distance"}
"""Where they lie decides between branches, which have no derivative."""
TIME_STEP = {"time_step.courant", "time_step.gravity_limit", "viscosity.limit"}
"""Not asked while dt is given."""
SHORT = ("mps", "mps_cd_gc_ds")
"""What takes the time is to compile a scheme, and these two have most models: 12 steps; slowly all and 50."""


def run(name: str, *more: str, short: bool = True):
    """The parameters `name`, `steps` and, if there are, more."""
    return pytest.param(name, 12 if short else 50, *more, marks=() if short else pytest.mark.slow)


RUNS = [run(name) for name in SHORT] + [run(name, short=False) for name in SCHEMES]
RUN = pytest.mark.parametrize(("name", "steps"), RUNS)
ALL = [(scheme, leaf) for scheme in SCHEMES for leaf in (*LEAVES[scheme], *FLOW)]
LEAF_OF_RUN = [run(*pair) for pair in ALL if pair[0] in SHORT] + [run(*pair, short=False) for pair in ALL]


def named_leaves(scheme) -> dict[str, jax.Array]:
    return {jax.tree_util.keystr(path).lstrip("."): x for path, x in jax.tree_util.tree_leaves_with_path(scheme)}


def with_leaves(scheme, values):
    leaves, tree = jax.tree.flatten(scheme)
    names = list(named_leaves(scheme))
    return jax.tree.unflatten(tree, [values.get(name, leaf) for name, leaf in zip(names, leaves, strict=True)])


def make(name: str, steps: int, tolerance: float) -> SimpleNamespace:
    """Two layers of a viscous fluid off its lattice, the upper one lighter, that is being compressed: pairs overlap."""
    case = cases.two_layer(spacing=0.1, length=0.4, lower_height=0.3, upper_height=0.3, freeboard=0.2)
    moves = np.asarray(case.particles.fluid)[:, None]
    rng = np.random.default_rng(2)  # from numpy, the same numbers in both precisions
    lattice = np.asarray(case.particles.position)
    velocity = 0.5 * rng.normal(size=lattice.shape) - 2.0 * (lattice - [0.2, 0.3])
    position = lattice + np.where(moves, rng.uniform(-0.025, 0.025, lattice.shape), 0.0)
    scheme = schemes.stochastic(getattr(schemes, name)(viscous=True, tolerance=tolerance), alpha=0.05)
    if steps < 50 and name != "mps":
        scheme = by_diagonal(scheme)
    start = jaxmps.start(case, scheme)
    weights = jnp.array(rng.normal(size=(2, *position.shape)))
    values = named_leaves(scheme) | {
        "density": case.fluids.density,
        "gravity": jnp.array([1.0, -20.0]),
        "viscosity": jnp.full(2, 0.1),
        "position": jnp.array(position),
        "velocity": jnp.array(np.where(moves, velocity, 0.0)),
        "dt": jnp.array(DT),
    }
    values = {leaf: jnp.array(np.asarray(x)) for leaf, x in values.items()}  # not weakly typed: one compilation for all

    def seen(state):
        """What chooses branches: neighbors, the surface, and where the pressure is cut off; then the pressure."""
        r, p = state.particles.position, state.particles.pressure
        near = jnp.sum((r[:, None] - r) ** 2, axis=-1) < (2.1 * case.spacing) ** 2
        return (near, state.surface, p == 0), p

    def loss(v):
        """A generic function of the end and of all pressures: no symmetry hides an error."""
        fluids = (v["density"], v["viscosity"], v["gravity"])
        changed = eqx.tree_at(lambda c: (c.fluids.density, c.fluids.viscosity, c.gravity), case, fluids)
        flow = v["position"], v["velocity"]
        begin = eqx.tree_at(lambda s: (s.particles.position, s.particles.velocity), start, flow)
        key = jax.random.key(1)
        state, info, (chosen, pressure) = jaxmps.rollout(
            changed, with_leaves(scheme, v), begin, steps=steps, dt=v["dt"], key=key, record=seen
        )
        end = state.particles
        value = jnp.sum(weights[0] * end.position) / 0.1 + jnp.sum(weights[1] * end.velocity)
        return value + jnp.sum(weights[1, :, 0] * jnp.mean(pressure, axis=0)) / 1e4, (info, chosen, pressure)

    reverse = quick(jax.value_and_grad(loss, has_aux=True))
    return SimpleNamespace(
        values=values, loss=loss, reverse=reverse, lattice=lattice, pressed=np.asarray(case.particles.has_pressure)
    )


@functools.cache
def problem(name: str, steps: int) -> SimpleNamespace:
    p = make(name, steps, 1e-13)
    (p.value, p.aux), p.gradient = p.reverse(p.values)
    p.forward = quick(lambda v, t: jax.jvp(p.loss, (v,), (t,), has_aux=True))
    return p


def along(p: SimpleNamespace, leaf: str) -> dict[str, jax.Array]:
    """A direction of one value, random unless it is a single number, all others at rest."""
    value = p.values[leaf]
    direction = np.random.default_rng(6).normal(size=value.shape) if value.ndim else np.ones(())
    return {**jax.tree.map(jnp.zeros_like, p.values), leaf: jnp.array(direction, value.dtype)}


def slope(p: SimpleNamespace, tangent: dict[str, jax.Array]) -> float:
    return float(sum(jnp.vdot(p.gradient[k], tangent[k]) for k in tangent))


@RUN
def test_the_run_is_a_generic_one_and_no_leaf_is_left_out(name, steps):
    p = problem(name, steps)
    info, (near, surface, zero), pressure = p.aux
    assert not np.any(info.status)
    assert pressure.max() > 1000.0
    clipped = name in ("mps", "cmps_hs")
    assert (pressure.min() < -100.0) == (not clipped)
    assert np.any(zero & ~surface & p.pressed) == clipped
    assert 3 < surface[-1].sum() < surface.shape[1] // 2
    assert np.any(near[0] != near[-1])
    assert np.any(np.asarray(info.given) > 0.0)
    assert (np.asarray(info.stabilized)[:16] > 2).all() == name.endswith("ds")  # while the compression lasts
    known = {*LEAVES[name], *THRESHOLDS, *TIME_STEP}
    assert set(p.values) - set(FLOW) <= known


@pytest.mark.parametrize(("name", "steps", "leaf"), LEAF_OF_RUN)
def test_reverse_mode_is_forward_mode_and_central_differences(name, steps, leaf):
    p = problem(name, steps)
    tangent = along(p, leaf)
    reverse = slope(p, tangent)
    _, forward, _ = p.forward(p.values, tangent)
    size = float(jnp.max(jnp.abs(p.values[leaf])))
    # Not zero: a change of the value by its own size is felt.
    assert abs(reverse) * size > 1e-3
    assert float(forward) == pytest.approx(reverse, rel=1e-8)
    # Large enough for the solver's tolerance of 1e-13, and so small that every choice of every step stays the same.
    h = (1e-8 if leaf == "position" else 1e-7) * size
    ends = []
    for sign in (1.0, -1.0):
        values = jax.tree.map(lambda x, t, s=sign: x + s * h * t, p.values, tangent)
        value, _, (info, chosen, _) = p.forward(values, tangent)
        for there, here in zip((*chosen, info.stabilized), (*p.aux[1], p.aux[0].stabilized), strict=True):
            np.testing.assert_array_equal(there, here)
        ends.append(float(value))
    assert reverse == pytest.approx((ends[0] - ends[1]) / (2 * h), rel=1e-4)


@RUN
def test_thresholds_and_unused_limits_have_no_derivative(name, steps):
    p = problem(name, steps)
    for leaf in (THRESHOLDS | TIME_STEP) & set(p.values):
        assert float(p.gradient[leaf]) == 0.0


@RUN
def test_derivatives_of_a_run_from_rest_on_a_lattice_are_finite(name, steps):
    # No velocity and no overlap, where roots have no derivative.
    p = problem(name, steps)
    rest = {**p.values, "position": jnp.array(p.lattice), "velocity": jnp.zeros_like(p.values["velocity"])}
    (_, (info, _, _)), gradient = p.reverse(rest)
    assert not np.any(info.stabilized[0])
    for leaf in gradient.values():
        assert np.all(np.isfinite(leaf))


@pytest.mark.parametrize("precision", ["single"], indirect=True)
@pytest.mark.parametrize(("name", "steps"), [run(name, short=False) for name in SCHEMES])
def test_single_precision_gives_the_derivatives_of_double(name, steps, precision):
    # Without noise, whose draws differ between the precisions.
    with jax.enable_x64(True):
        double = problem(name, steps)
        expectations = double.reverse({**double.values, "noise.alpha": jnp.zeros(())})[1]
    single = make(name, steps, 1e-6)
    assert single.values["velocity"].dtype == jnp.float32
    gradient = single.reverse({**single.values, "noise.alpha": jnp.zeros(())})[1]
    for leaf in (*LEAVES[name][1:], *FLOW):
        found, expected = np.asarray(gradient[leaf], float), np.asarray(expectations[leaf])
        assert np.all(np.isfinite(found)), leaf
        assert np.linalg.norm(found - expected) < 0.01 * np.linalg.norm(expected), leaf


@pytest.mark.slow
def test_derivative_by_the_time_step_that_the_scheme_chooses():
    # From rest, where the speed has no derivative.
    case = cases.hydrostatic(spacing=0.1, length=0.4, height=0.4, freeboard=0.1)
    scheme = by_diagonal(schemes.mps(tolerance=1e-13))
    start = jaxmps.start(case, scheme)

    @quick
    def value_and_slopes(scheme, gravity, velocity):
        def loss(scheme, gravity, velocity):
            moving = eqx.tree_at(lambda s: s.particles.velocity, start, velocity)
            end, _ = jaxmps.rollout(eqx.tree_at(lambda c: c.gravity, case, gravity), scheme, moving, steps=3)
            return jnp.sum(end.particles.position**2) + jnp.sum(end.particles.velocity)

        return jax.value_and_grad(loss, argnums=(0, 1, 2))(scheme, gravity, velocity)

    rest = case.gravity, start.particles.velocity
    slopes = value_and_slopes(scheme, *rest)[1]
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(slopes))
    by_scheme, _, by_velocity = slopes
    assert np.any(np.asarray(by_velocity) != 0.0)
    limit, h = scheme.time_step.gravity_limit, 1e-6
    near = (eqx.tree_at(lambda s: s.time_step.gravity_limit, scheme, limit + s * h) for s in (1, -1))
    plus, minus = (float(value_and_slopes(changed, *rest)[0]) for changed in near)
    assert float(by_scheme.time_step.gravity_limit) == pytest.approx((plus - minus) / (2 * h), rel=1e-4)
    assert abs(plus - minus) > 1e-9
