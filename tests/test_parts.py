"""Parts of a flow without a known pressure: each has the mean zero by itself, and the rest does not notice."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flows import PLANE, SPACE, Flow, equation, look_up, made, particles_of
from hasty import quick
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

import jaxmps as mps
from jaxmps import Kind, Status
from jaxmps.flow import at_rest
from jaxmps.pressure import ByDiagonal, solve_pressure
from jaxmps.pressure.linear import Jacobi

CROWDED, CROWDED_SPACE = PLANE._replace(slots=48), SPACE._replace(slots=64)
TOLERANCE = 1e-11


def hexagons(count: int, distance: float) -> np.ndarray:
    """The `count` points of a hexagonal lattice that are nearest to its origin."""
    a, b = np.meshgrid(np.arange(-6, 7), np.arange(-6, 7))
    points = np.stack([a + 0.5 * b, np.sqrt(0.75) * b], axis=-1).reshape(-1, 2)
    return distance * points[np.argsort(np.hypot(*points.T), kind="stable")[:count]]


def above_a_tank(*clumps: np.ndarray) -> Flow:
    """The clumps in the air above a column of water between walls."""
    points, kind, phase, density = particles_of("dam_break", 1)
    placed = [clump + np.array([8.0 + 14.0 * k, 30.0]) for k, clump in enumerate(clumps)]
    more = np.concatenate([np.zeros((0, 2)), *placed])
    fluid = np.full(len(more), Kind.FLUID)
    together = np.concatenate([points, more]), np.concatenate([kind, fluid]), np.concatenate([phase, 0 * fluid])
    return made(CROWDED, *together, density)


def blocks(shape, *sides: tuple[int, ...]) -> Flow:
    """Blocks of fluid three spacings and more apart, without walls."""
    parts = [np.stack(np.meshgrid(*map(np.arange, s), indexing="ij"), -1).reshape(-1, len(s)) * 0.9 for s in sides]
    shift = np.eye(len(sides[0]))[0]
    points = np.concatenate([part + 9.0 * k * shift for k, part in enumerate(parts)])
    return made(shape, points, np.full(len(points), Kind.FLUID), np.zeros(len(points), int), np.array([1000.0]))


def right_side(flow: Flow) -> jax.Array:
    """Noise with a mean that differs from place to place."""
    noise = np.random.default_rng(0).normal(size=len(flow.taken))
    return jnp.array(1.0 + noise + np.asarray(flow.case.particles.position)[:, 0], float)


def solution(flow: Flow, surface, source):
    system = equation(flow, surface, source)._replace(previous=jnp.ones_like(source))
    p, convergence = solve_pressure(system, TOLERANCE, 4000)
    return p, convergence, system


solve = quick(solution)


def by_hand(system) -> np.ndarray:
    """The least-squares solution of the least norm, component by component of the graph."""
    n, j, coupling = len(system.source), np.asarray(system.operator.j), np.asarray(system.operator.coupling)
    rows = np.broadcast_to(np.arange(n), j.shape)
    graph = coo_array((coupling.ravel(), (rows.ravel(), j.ravel())), shape=(n, n)).toarray()
    matrix = np.diag(np.asarray(system.operator.diagonal)) - graph
    _, part = connected_components(graph > 0, directed=False)
    p, unknown = np.zeros(n), np.asarray(system.unknown)
    for label in np.unique(part[unknown]):
        own = np.flatnonzero((part == label) & unknown)
        block, b = matrix[np.ix_(own, own)], -np.asarray(system.source)[own]
        if not np.any(np.asarray(system.operator.sink)[own]):
            p[own] = np.linalg.pinv(block, rcond=1e-10) @ (b - b.mean()) if len(own) > 1 else 0.0
        else:
            p[own] = np.linalg.solve(block, b)
    return p


def assert_right(flow: Flow, surface) -> np.ndarray:
    p, convergence, system = solve(flow, surface, right_side(flow))
    assert convergence.converged and float(convergence.residual) < 2.0 * TOLERANCE
    expected = by_hand(system)
    np.testing.assert_allclose(p, expected, atol=1e-7 * np.abs(expected).max())
    return np.asarray(p)


@pytest.mark.parametrize("distance", [0.6, 0.75, 0.9, 0.95])
@pytest.mark.parametrize("count", [7, 19, 50])
def test_a_clump_of_spray_leaves_the_tank_alone(count, distance):
    flow, tank = above_a_tank(hexagons(count, distance)), above_a_tank()
    n = len(particles_of("dam_break", 1)[0])
    surface = np.array(look_up(tank)[1])
    surface[n:] = False  # of the clump nothing passes for surface
    p = assert_right(flow, jnp.array(surface))
    alone, *_ = solve(tank, jnp.array(surface), right_side(tank))
    np.testing.assert_allclose(p[:n], alone[:n], rtol=1e-7, atol=1e-7 * float(jnp.abs(alone).max()))
    # Its own pressure is of the size that its source makes over its width, whatever that of the tank.
    assert abs(p[n : n + count].mean()) < 1e-9 * np.abs(p).max() and np.abs(p).max() < 1e7


@pytest.mark.parametrize("shape", [CROWDED, CROWDED_SPACE], ids=["2-D", "3-D"])
def test_two_closed_blocks_have_their_own_means(shape):
    flow = blocks(shape, *[(5, 6, 4), (4, 3, 5)] if shape is CROWDED_SPACE else [(7, 5), (4, 6)])
    p = assert_right(flow, jnp.zeros(len(flow.taken), bool))
    first = 120 if shape is CROWDED_SPACE else 35
    for part in (p[:first], p[first : flow.taken.sum()]):
        assert abs(part.mean()) < 1e-9 * np.abs(part).max() and np.abs(part).max() > 0.0


def test_of_two_blocks_one_with_a_surface_only_the_other_is_loose():
    flow = blocks(CROWDED, (7, 5), (4, 6))
    surface = np.zeros(len(flow.taken), bool)
    surface[:7] = True
    p = assert_right(flow, jnp.array(surface))
    assert abs(p[7:35].mean()) > 1e-3 * np.abs(p[:35]).max() and abs(p[35:59].mean()) < 1e-9 * np.abs(p).max()


def test_a_ring_around_a_bubble_and_a_drop_in_the_bubble_are_two_parts():
    angle = np.arange(60) / 60 * 2.0 * np.pi
    ring = np.concatenate([r * np.stack([np.cos(angle), np.sin(angle)], axis=1) for r in (8.5, 9.4)])
    points = np.concatenate([ring, hexagons(7, 0.8)])
    flow = made(CROWDED, points, np.full(127, Kind.FLUID), np.zeros(127, int), np.array([1000.0]))
    p = assert_right(flow, jnp.zeros(len(flow.taken), bool))
    assert max(abs(p[:120].mean()), abs(p[120:127].mean())) < 1e-9 * np.abs(p).max()


def test_side_by_side_each_flow_is_what_it_is_alone():
    flows = [above_a_tank(hexagons(19, 0.8)), above_a_tank(hexagons(7, 0.7), hexagons(12, 0.9))]
    n = len(particles_of("dam_break", 1)[0])
    surface = jnp.array(look_up(above_a_tank())[1]).at[n:].set(False)
    together = jax.tree.map(lambda *x: jnp.stack(x), *[(f, right_side(f)) for f in flows])
    found = quick(jax.vmap(lambda f, s: solution(f, surface, s)[0]))(*together)
    for p, flow in zip(found, flows, strict=True):
        alone, *_ = solve(flow, surface, right_side(flow))
        np.testing.assert_allclose(p, alone, atol=1e-8 * float(jnp.abs(alone).max()))


def test_derivatives_are_those_of_central_differences():
    flow, rng = above_a_tank(hexagons(19, 0.8)), np.random.default_rng(1)
    n = len(particles_of("dam_break", 1)[0])
    surface = jnp.array(look_up(above_a_tank())[1]).at[n:].set(False)
    position, source = flow.case.particles.position, right_side(flow)
    weights, d_source, d_position = (jnp.array(rng.normal(size=x.shape)) for x in (source, source, position))

    def value(h):
        system = equation(flow.at(position + h * d_position), surface, source + h * d_source)
        p, _ = solve_pressure(system._replace(preconditioner=Jacobi(system.operator.diagonal)), TOLERANCE, 4000)
        return weights @ p

    slope = quick(lambda h: (value(h), jax.grad(value)(h)))
    _, found = slope(jnp.zeros(()))
    assert abs(float(found)) > 1.0
    for h in (1e-4, 1e-5, 1e-6):
        difference = float(slope(jnp.asarray(h))[0] - slope(jnp.asarray(-h))[0]) / (2 * h)
        assert float(found) == pytest.approx(difference, rel=2e-4)


@pytest.mark.slow
def test_water_at_rest_keeps_its_pressure_under_a_drop_as_compact_as_a_solid():
    case = mps.cases.hydrostatic(spacing=0.1, length=1.0, height=0.5, freeboard=1.5)
    p = case.particles
    drop = hexagons(7, 0.07) + np.array([0.5, 1.3])
    count = len(p.kind)
    more = at_rest(np.concatenate([p.position, drop]), np.concatenate([p.kind, np.zeros(7, int)]))
    with_drop = mps.Case(more, case.fluids, case.gravity, case.spacing, case.box)
    scheme = dataclasses.replace(mps.schemes.mps_cd_gc_ds(), preconditioning=ByDiagonal())
    ends = [mps.simulate(c, scheme, until=0.02, dt=0.005).pressure[-1] for c in (case, with_drop)]
    np.testing.assert_allclose(ends[1][:count], ends[0], atol=2e-3 * 1000.0 * 9.81 * 0.5)


def test_a_solve_that_fails_ends_the_run_at_its_last_good_state():
    case = mps.cases.dam_break(spacing=0.1, width=0.5, height=1.0, tank_length=1.0, tank_height=1.0)
    scheme = dataclasses.replace(mps.schemes.mps(), preconditioning=ByDiagonal(), max_iterations=1)
    with pytest.warns(mps.SimulationWarning, match="the pressure solve failed"):
        run = mps.simulate(case, scheme, until=0.1, dt=0.005)
    end = run.status.fatal
    assert end is not None and end.value is not None and end.status == Status.SOLVE_FAILED
    assert end.value > 0.1 and "larger max_iterations" in end.advice
    assert np.isfinite(run.pressure).all()
