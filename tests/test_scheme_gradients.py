"""Derivatives of runs with the schemes of [T13] and ours: reverse mode, forward mode and central differences."""

import functools
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hasty import quick

import jaxmps
from jaxmps import cases, schemes

STEPS, DT = 8, 1e-3
LEAVES = {
    "cmps_hs": ("position", "velocity", "density", "gravity"),
    "mps_hs_gc_ds": ("alpha_ds", "kept_velocity", "position", "velocity", "density", "gravity"),
    "mps_cd_gc_ds": ("alpha_ds", "kept_velocity", "restoring", "position", "velocity", "density", "gravity"),
}
ALL = [(scheme, leaf) for scheme, leaves in LEAVES.items() for leaf in leaves]


@functools.cache
def problem(name: str) -> SimpleNamespace:
    """Two layers of a fluid off its lattice, the upper one lighter, that is being compressed: pairs overlap."""
    case = cases.two_layer(spacing=0.1, length=0.4, lower_height=0.3, upper_height=0.3, freeboard=0.2)
    moves = np.asarray(case.particles.fluid)[:, None]
    rng = np.random.default_rng(2)
    lattice = case.particles.position
    position = np.asarray(lattice)
    velocity = rng.normal(size=position.shape) - 2.0 * (position - [0.2, 0.3])
    position = position + np.where(moves, rng.uniform(-0.025, 0.025, position.shape), 0.0)
    scheme = getattr(schemes, name)(tolerance=1e-13)
    start = jaxmps.start(case, scheme)
    every = {
        "alpha_ds": lambda s: s.stabilizer.alpha_ds,
        "kept_velocity": lambda s: s.stabilizer.kept_velocity,
        "restoring": lambda s: s.source.restoring,
    }
    tunables = {leaf: every[leaf] for leaf in LEAVES[name] if leaf in every}
    values = {leaf: where(scheme) for leaf, where in tunables.items()}
    values |= {"density": case.fluids.density, "gravity": case.gravity}
    values["position"] = jnp.array(position)
    values["velocity"] = jnp.array(np.where(moves, velocity, 0.0))
    weights = jnp.array(rng.normal(size=(2, *position.shape)))

    def loss(v):
        """A generic function of the end: no symmetry hides an error."""
        changed = scheme
        for leaf, where in tunables.items():
            changed = eqx.tree_at(where, changed, v[leaf])
        new_case = eqx.tree_at(lambda c: (c.fluids.density, c.gravity), case, (v["density"], v["gravity"]))
        flow = v["position"], v["velocity"]
        new_start = eqx.tree_at(lambda s: (s.particles.position, s.particles.velocity), start, flow)
        state, info = jaxmps.rollout(new_case, changed, new_start, steps=STEPS, dt=DT)
        end = state.particles
        value = jnp.sum(weights[0] * end.position) / 0.1 + jnp.sum(weights[1] * end.velocity)
        return value + jnp.sum(weights[1, :, 0] * end.pressure) / 1e4, (state, info)

    reverse = quick(jax.value_and_grad(loss, has_aux=True))
    (_, end), gradient = reverse(values)
    return SimpleNamespace(values=values, loss=loss, reverse=reverse, end=end, gradient=gradient, lattice=lattice)


def along(p: SimpleNamespace, leaf: str) -> dict[str, jax.Array]:
    """A direction of one value, random unless it is a single number, all others at rest."""
    value = p.values[leaf]
    direction = np.random.default_rng(6).normal(size=value.shape) if value.ndim else np.ones(())
    return {**jax.tree.map(jnp.zeros_like, p.values), leaf: jnp.array(direction)}


def slope(p: SimpleNamespace, tangent: dict[str, jax.Array]) -> float:
    return float(sum(jnp.vdot(p.gradient[k], tangent[k]) for k in tangent))


@pytest.mark.parametrize("name", LEAVES)
def test_the_run_is_a_generic_one(name):
    state, info = problem(name).end
    assert not np.any(info.status)
    p = np.asarray(state.particles.pressure)
    assert p.max() > 100.0
    assert (p.min() < -100.0) == (name != "cmps_hs")
    assert 3 < int(info.surface_count[-1]) < len(p) // 2
    assert (np.asarray(info.stabilized) > 2).all() == name.endswith("ds")


@pytest.mark.parametrize(("name", "leaf"), ALL)
def test_reverse_mode_is_central_differences(name, leaf):
    p = problem(name)
    tangent = along(p, leaf)
    reverse = slope(p, tangent)
    size = float(jnp.max(jnp.abs(p.values[leaf])))
    # Not zero: a change of the value by its own size is felt.
    assert abs(reverse) * size > 1e-3
    # Small enough to meet no kink of a mask or a minimum, large enough for the solver's tolerance of 1e-13. HS even
    # jumps when a pair crosses r_e, as one does within 1e-6 m of its way.
    h = (1e-8 if leaf == "position" else 1e-6) * size
    near = (jax.tree.map(lambda x, t, s=s: x + s * h * t, p.values, tangent) for s in (1, -1))
    plus, minus = (float(p.reverse(values)[0][0]) for values in near)
    assert reverse == pytest.approx((plus - minus) / (2 * h), rel=1e-4)


def test_forward_mode_is_reverse_mode():
    p = problem("mps_cd_gc_ds")
    forward = quick(lambda v, t: jax.jvp(lambda x: p.loss(x)[0], (v,), (t,))[1])
    for leaf in LEAVES["mps_cd_gc_ds"]:
        tangent = along(p, leaf)
        assert float(forward(p.values, tangent)) == pytest.approx(slope(p, tangent), rel=1e-8), leaf


@pytest.mark.parametrize("name", LEAVES)
def test_derivatives_of_a_run_from_rest_on_a_lattice_are_finite(name):
    # No velocity and no overlap, where roots have no derivative.
    p = problem(name)
    rest = {**p.values, "position": p.lattice, "velocity": jnp.zeros_like(p.lattice)}
    (_, (_, info)), gradient = p.reverse(rest)
    assert not np.any(info.stabilized[0])
    for leaf in gradient.values():
        assert np.all(np.isfinite(leaf))
