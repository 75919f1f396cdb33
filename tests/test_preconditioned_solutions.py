"""Solutions with the multigrid preconditioner: their derivatives, unusual flows, and whole runs."""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flows import TORUS, Flow, equation, flow, look_up, made, right_hand_side, with_more
from hasty import quick
from jaxtyping import Array

from jaxmps import Kind, State, rollout, schemes
from jaxmps.pressure import ByDiagonal, PoissonOperator, PressureEquation, solve_pressure
from jaxmps.pressure.linear import solve

TOLERANCE, MOST = 1e-12, 1000


class SolvedFlow(NamedTuple):
    p: Array
    system: PressureEquation
    converged: Array
    value: Array
    slopes: tuple[Array, Array]


@quick
def solved(flow: Flow, surface, b, x_bar):
    """x_bar · p with its derivatives in the positions and in b, and what belongs to it."""

    def f(position, b):
        system = equation(flow.at(position), surface, b)
        b = jnp.where(system.unknown, b, 0.0)
        cold = system._replace(source=-b, previous=jnp.zeros_like(b))
        p, convergence = solve_pressure(cold, TOLERANCE, MOST)
        return x_bar @ p, (p, system, convergence.converged)

    graded = jax.value_and_grad(f, (0, 1), has_aux=True)
    (value, (p, system, converged)), slopes = graded(flow.case.particles.position, b)
    return SolvedFlow(p, system, converged, value, slopes)


def dense(operator: PoissonOperator) -> np.ndarray:
    a = np.diag(np.asarray(operator.diagonal))
    for j, coupling in zip(np.asarray(operator.j), np.asarray(operator.coupling), strict=True):
        a[np.arange(len(a)), j] -= coupling
    return a


@pytest.mark.slow
def test_solution_is_that_of_a_direct_solve():
    tank = flow("dam_break", 1)
    surface, b = look_up(tank)[1], right_hand_side(tank)
    found = solved(tank, surface, b, b)
    unknown = np.flatnonzero(found.system.unknown)
    a = dense(found.system.operator)[np.ix_(unknown, unknown)]
    expected = np.zeros(len(b))
    expected[unknown] = np.linalg.solve(a, b[unknown])
    assert found.converged
    # The tolerance times the condition number.
    assert np.linalg.cond(a) < 1e3
    np.testing.assert_allclose(found.p, expected, atol=1e-9 * np.abs(expected).max())


def test_derivatives_are_those_of_central_differences():
    tank, rng = flow("dam_break", 1), np.random.default_rng(3)
    surface, position = look_up(tank)[1], tank.case.particles.position
    b, x_bar, d_b = (jnp.array(rng.normal(size=len(position))) for _ in range(3))
    d_position = jnp.array(rng.normal(size=position.shape))
    *_, value, (by_position, by_b) = solved(tank, surface, b, x_bar)

    def difference(h, along_position, along_b):
        ends = [
            solved(tank.at(position + s * along_position * d_position), surface, b + s * along_b * d_b, x_bar).value
            for s in (h, -h)
        ]
        return float(ends[0] - ends[1]) / (2 * h)

    # Truncation goes as h^2, round-off as 1e-12 / h.
    for found, expected in (
        (jnp.vdot(by_b, d_b), difference(1e-5, 0.0, 1.0)),
        (jnp.vdot(by_position, d_position), difference(1e-5, 1.0, 0.0)),
    ):
        assert abs(expected) > 0.1 * abs(float(value))
        assert float(found) == pytest.approx(expected, rel=1e-6)


@quick
def all_solved(systems, right):
    """Every right-hand side for every system."""

    def one(system, b):
        b = jnp.where(system.unknown, b, 0.0)
        return solve(system.operator, b, jnp.zeros_like(b), system.preconditioner, TOLERANCE, MOST)[0]

    return jax.vmap(jax.vmap(one, (None, 0)), (0, None))(systems, right)


def test_vmap_over_flows_and_right_hand_sides_gives_the_single_solutions():
    flows = [flow(name, 1) for name in ("dam_break", "hydrostatic")]
    surfaces = [look_up(one)[1] for one in flows]
    right = jnp.array(np.random.default_rng(4).normal(size=(3, len(surfaces[0]))))
    alone = [[solved(one, surface, b, b) for b in right] for one, surface in zip(flows, surfaces, strict=True)]
    together = all_solved(jax.tree.map(lambda *x: jnp.array(x), *[singles[0].system for singles in alone]), right)
    for i, k in np.ndindex(2, 3):
        expected = np.asarray(alone[i][k].p)
        np.testing.assert_allclose(together[i, k], expected, atol=1e-9 * np.abs(expected).max())


def test_pair_in_the_air_that_passes_for_inside_leaves_the_tank_alone():
    tank = with_more("dam_break", np.array([[26.0, 30.0], [26.3, 30.0]]))
    first, second = np.flatnonzero(tank.taken)[-2:]
    position = tank.case.particles.position
    tank = tank.at(position.at[second].set(position[first] + jnp.array([0.1, 0.0])))
    alone = eqx.tree_at(
        lambda f: f.case.particles.kind, tank, tank.case.particles.kind.at[jnp.array([first, second])].set(Kind.REMOVED)
    )
    b = right_hand_side(tank)
    surface = look_up(tank)[1]
    assert not surface[first]
    assert not surface[second]
    found = solved(tank, surface, b, b)
    expected = np.asarray(solved(alone, look_up(alone)[1], b, b).p)
    assert found.converged
    assert np.all(np.isfinite(found.p))
    others = np.delete(np.arange(len(b)), [first, second])
    np.testing.assert_allclose(found.p[others], expected[others], atol=1e-9 * np.abs(expected).max())


@quick
def in_torus(flow: Flow, source):
    system = equation(flow, jnp.zeros_like(flow.case.particles.fluid), source)
    return system.operator, *solve_pressure(system, TOLERANCE, MOST)


def test_pressure_differences_in_a_periodic_box_full_of_fluid_are_those_of_a_direct_solve():
    x, y = np.meshgrid(np.arange(32) + 0.5, np.arange(32) + 0.5)
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    zero = np.zeros(len(points), int)
    full = made(TORUS, points, zero + int(Kind.FLUID), zero, np.array([1000.0]))
    source = right_hand_side(full)
    operator, p, convergence = in_torus(full, source)
    assert not np.any(operator.sink)
    assert convergence.converged
    # The constant makes of all solutions the one with the mean zero.
    a = dense(operator)
    expected = np.linalg.solve(a + a.max(), source.mean() - source)
    np.testing.assert_allclose(p - p.mean(), expected, atol=1e-8 * np.abs(expected).max())


@quick
def run(case, scheme, state):
    return rollout(case, scheme, state, steps=10, dt=0.01)


@pytest.mark.slow
def test_rollouts_with_multigrid_and_with_jacobi_agree():
    start = flow("dam_break", 1)
    case = dataclasses.replace(start.case, gravity=jnp.array([0.0, -9.81]))
    number_density, surface = look_up(start)
    zero, first = jnp.zeros(()), jnp.zeros((), jnp.int32)
    state = State(case.particles, start.neighbors, number_density, surface, zero, first, zero)
    scheme = schemes.mps(tolerance=1e-10)
    by_diagonal = eqx.tree_at(lambda s: s.preconditioning, scheme, ByDiagonal())
    (found, info), (expected, _) = run(case, scheme, state), run(case, by_diagonal, state)
    assert not np.any(info.status)
    scale = float(jnp.abs(expected.particles.pressure).max())
    assert scale > 1e3
    np.testing.assert_allclose(found.particles.pressure, expected.particles.pressure, atol=1e-7 * scale)
    np.testing.assert_allclose(found.particles.position, expected.particles.position, atol=1e-8)
