"""Flows that blow up are told soon after it begins, and what the advice says; removed particles cost nothing."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hasty import by_diagonal

import jaxmps as mps
from jaxmps import Kind, Status
from jaxmps.flow import at_rest
from jaxmps.flow.status import advice_on
from jaxmps.neighbors import allocate, update
from jaxmps.running import loop


def scheme() -> mps.Scheme:
    return by_diagonal(mps.schemes.mps())


def dam(**sides) -> mps.Case:
    return mps.cases.dam_break(spacing=0.1, **sides)


@pytest.mark.filterwarnings("ignore::jaxmps.SimulationWarning")
def test_a_flow_that_gains_energy_from_nowhere_ends_within_steps_of_doubling_it(monkeypatch):
    # A step that makes all velocities 5 % larger: the energy grows by a tenth in each.
    usual = loop.step

    def growing(case, used, state, dt, key):
        state, info = usual(case, used, state, dt, key)
        gain = 0.05 * 2.0 * info.energy.kinetic
        faster = eqx.tree_at(lambda s: s.particles.velocity, state, 1.05 * state.particles.velocity)
        return faster, info._replace(loss=info.loss - gain)

    monkeypatch.setattr(loop, "step", growing)
    monkeypatch.setattr(loop, "_advance", loop.jit(lambda *a: loop.advance_chunk(*a)))
    run = mps.simulate(dam(), scheme(), until=1.0, save_every=0.02)
    end = run.status.fatal
    assert end is not None and end.value is not None and end.status == Status.RUNAWAY
    # A dam of 1 m has 9.81 J/kg to fall: the run ends before it has twice that.
    assert 0.85 * 9.81 < end.value < 2.0 * 9.81
    assert run.energy[:, 0].max() < 3.0 * 9.81
    assert "collisions" not in run.status.advice and "a stabilizer" in run.status.advice


@pytest.mark.filterwarnings("ignore::jaxmps.SimulationWarning")
def test_a_particle_ten_times_as_fast_as_a_fall_ends_the_run():
    case = dam()
    log = loop.empty_log(case, case.particles)
    assert float(log.scale) == pytest.approx(9.81 * 0.9)  # from the centers of the highest row to those of the lowest
    info = jax.tree.map(lambda x: x[0], mps.rollout(case, scheme(), mps.start(case, scheme()), steps=1, dt=1e-3)[1])
    for factor, ends in ((9.9, False), (10.1, True)):
        fast = info._replace(max_speed=factor * jnp.sqrt(2.0 * log.scale))
        assert bool(int(loop.judged(log, fast, case.particles).status) & Status.RUNAWAY) == ends
    # A jet counts as what the flow has at its start: it may be as fast as its user wants.
    start = mps.start(case, scheme())
    jet = start.particles.velocity.at[0, 1].set(60.0)
    jet = eqx.tree_at(lambda s: s.particles.velocity, start, jet)
    assert mps.simulate(case, scheme(), until=2e-3, dt=1e-3, start=jet).status.completed


def test_flows_that_walls_drive_or_that_begin_at_rest_without_gravity_are_let_be():
    case = mps.cases.square_patch(spacing=0.1)
    still = eqx.tree_at(lambda c: c.particles.velocity, case, 0.0 * case.particles.velocity)
    log = loop.empty_log(still, still.particles)
    assert float(log.scale) == 0.0
    info = mps.rollout(case, scheme(), mps.start(case, scheme()), steps=1, dt=1e-3)[1]
    info = jax.tree.map(lambda x: x[0], info)
    assert int(loop.judged(log, info, still.particles).status) == 0


def test_advice_leaves_out_what_the_scheme_has():
    bare = advice_on(Status.RUNAWAY)
    assert "a scheme with a stabilizer or collisions, or a smaller" in bare
    assert "stabilizer" not in advice_on(Status.RUNAWAY, ("stabilizer", "collisions"))
    assert "a scheme with collisions, or" in advice_on(Status.CLUSTERED, ("stabilizer",))
    assert "double" in advice_on(Status.SOLVE_FAILED) and "double" not in advice_on(Status.SOLVE_FAILED, ("double",))


def test_a_hundred_removed_particles_on_a_line_take_no_slots():
    case = dam()
    p = case.particles
    line = jnp.stack([jnp.linspace(3.0, 3.1, 100), jnp.full(100, 1.5)], axis=1)
    more = mps.Particles(
        jnp.concatenate([p.position, line]),
        jnp.concatenate([p.velocity, jnp.zeros((100, 2))]),
        jnp.concatenate([p.pressure, jnp.zeros(100)]),
        jnp.concatenate([p.kind, jnp.full(100, Kind.REMOVED, p.kind.dtype)]),
        jnp.concatenate([p.phase, jnp.zeros(100, p.phase.dtype)]),
    )
    listed = allocate(more.listed_position, case.box, 0.21, 0.01, 20)
    assert not listed.overflow and allocate(more.position, case.box, 0.21, 0.01, 20).overflow
    n = len(more.kind)
    assert bool(jnp.all(listed.table.idx[-100:] == n)) and not bool(
        jnp.any((listed.table.idx >= n - 100) & (listed.table.idx < n))
    )
    # Also those that are removed later, at the next rebuild.
    gone = dataclasses.replace(more, kind=more.kind.at[:30].set(Kind.REMOVED), position=more.position + 0.02)
    assert not bool(jnp.any(update(listed, gone.listed_position).table.idx < 30))


@pytest.mark.filterwarnings("ignore::jaxmps.SimulationWarning")
def test_an_outflow_of_half_the_water_keeps_the_capacity_and_is_compiled_once(monkeypatch):
    # A jet that leaves the domain through its right side.
    points = np.stack(np.meshgrid(np.arange(12), np.arange(6), indexing="ij"), -1).reshape(-1, 2) * 0.1 + [0.25, 0.25]
    particles = dataclasses.replace(
        at_rest(points, np.zeros(72, int)), velocity=jnp.tile(jnp.array([1.0, 0.0]), (72, 1))
    )
    box = mps.Box((0.0, 0.0), (1.5, 1.0))
    case = mps.Case(particles, mps.Fluid([1000.0], [0.0]), [0.0, 0.0], 0.1, box)
    traced, usual = [], loop.largest_step
    monkeypatch.setattr(loop, "largest_step", lambda *a: traced.append(1) or usual(*a))
    seen = []
    reach = loop.Loop.reach
    monkeypatch.setattr(loop.Loop, "reach", lambda self, *a: (reach(self, *a), seen.append(self.state))[0])
    run = mps.simulate(case, scheme(), until=0.85, save_every=0.05)
    assert run.status.completed and run.summary["fluid_particles"] <= 36 and run.summary["escaped"] >= 36
    assert len(traced) <= 2 and len({s.neighbors.capacity for s in seen}) == 1
