"""The benchmark runs, its reference is the same method as ours, and its counts are true."""

import json
import runpy
import sys
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmps as mps
from benchmarks import equation
from benchmarks.reference import SOLVERS, Flow, Reference, Solver
from benchmarks.splash import splash
from jaxmps.flow import Kind


@pytest.fixture(scope="module")
def collapse() -> tuple[mps.Case, mps.Scheme, mps.State]:
    """A small dam some tens of steps into its collapse, with solutions to 1e-12."""
    with jax.enable_x64(True):
        case, scheme = mps.cases.dam_break(spacing=0.05), mps.schemes.mps(tolerance=1e-12, viscous=False)
        return case, scheme, run(case, scheme, mps.start(case, scheme), 60)


def run(case: mps.Case, scheme: mps.Scheme, state: mps.State, steps: int) -> mps.State:
    """Step by step, so that only a single one is ever compiled."""
    for _ in range(steps):
        state, _info = mps.rollout(case, scheme, state, steps=1)
    return state


def stirred(state: mps.State) -> mps.State:
    """With random velocities, so that particles collide, a particle that is about to leave through the top, and three
    in the air so close to each other that none of them passes for surface.
    """
    particles = state.particles
    noise = np.random.default_rng(0).normal(0.0, 0.5, particles.velocity.shape)
    velocity = np.where(np.asarray(particles.fluid)[:, None], particles.velocity + noise, 0.0)
    position = np.array(particles.position)
    position[0], velocity[0] = (1.0, 3.99), (0.0, 3.0)
    position[1:4], velocity[1:4] = [(1.0, 1.5), (1.02, 1.5), (1.01, 1.517)], 0.0
    return eqx.tree_at(
        lambda s: (s.particles.position, s.particles.velocity), state, (jnp.asarray(position), jnp.asarray(velocity))
    )


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("disturb", [lambda state: state, stirred], ids=["calm", "stirred"])
def test_the_reference_makes_the_same_steps_as_we_do(collapse, disturb, solver: Solver):
    case, scheme, state = collapse
    state = disturb(state)
    particles = state.particles
    fields = (particles.position, particles.velocity, particles.pressure, particles.kind)
    flow, reference = Flow(*map(np.asarray, fields)), Reference(case, scheme, solver, skin=0.3)
    for steps in (1, 4):
        state = run(case, scheme, state, steps)
        for _ in range(steps):
            flow = reference.step(flow)
        ours = state.particles
        assert np.max(ours.pressure[10:]) > 1000.0
        np.testing.assert_allclose(flow.position, ours.position, rtol=0.0, atol=1e-11)
        np.testing.assert_allclose(flow.velocity, ours.velocity, rtol=0.0, atol=1e-8)
        np.testing.assert_allclose(flow.pressure, ours.pressure, rtol=1e-8, atol=1e-4)
        np.testing.assert_array_equal(flow.kind, ours.kind)
    assert np.sum(flow.kind == Kind.REMOVED) == (1 if disturb is stirred else 0)


def test_the_reference_refuses_other_schemes(collapse):
    with pytest.raises(ValueError, match="standard method"):
        Reference(collapse[0], mps.schemes.mps_hs_gc())


def test_the_equation_is_that_of_the_step_and_its_products_with_the_matrix_are_counted(collapse):
    case, scheme, state = collapse
    predicted = jax.jit(equation.prediction)(case, scheme, state)
    taken = []
    for most_iterations in (3, scheme.max_iterations):
        with equation.counted() as tally:
            limits = {"tolerance": scheme.tolerance, "most_iterations": most_iterations}
            p, convergence = jax.jit(partial(equation.solve, **limits))(case, scheme, predicted)
        taken.append(tally.take())
    after = run(case, scheme, state, 1)
    assert convergence.converged
    np.testing.assert_allclose(np.maximum(p, 0.0), after.particles.pressure, rtol=0.0, atol=1e-5)
    assert 3 <= taken[0] <= 6 < taken[1] < 200


@pytest.mark.parametrize("particles", [2000, 4000])
def test_a_splash_has_the_particles_that_were_asked_for(particles):
    case, again = splash(particles), splash(particles)
    assert len(case.particles.kind) == particles
    np.testing.assert_array_equal(case.particles.position, again.particles.position)
    position = np.asarray(case.particles.position)
    distance = np.linalg.norm(position[:, None] - position[None], axis=-1) + np.eye(particles)
    assert distance.min() > 0.7 * case.spacing
    lonely = (distance.min(axis=1) > 2.1 * case.spacing) & np.asarray(case.particles.fluid)
    assert lonely.sum() > 1


@pytest.mark.slow
def test_the_benchmark_writes_its_table(tmp_path, monkeypatch, capsys):
    file = tmp_path / "table.json"
    monkeypatch.setattr(sys, "argv", ["benchmarks", "--quick", "--sizes", "2k", "--json", str(file)])
    runpy.run_module("benchmarks", run_name="__main__")
    results = json.loads(file.read_text())
    rows = results["step"]
    assert [row["precision"] for row in rows] == ["double", "single"]
    for row in rows:
        assert (row["case"], row["particles"], row["dim"]) == ("dam_break", 2171, 2)
        for positive in ("ms_per_step", "operator_applications", "particle_steps_per_second", "bandwidth_fraction"):
            assert row[positive] > 0
    assert rows[0]["ppe_ms"] > 0 and rows[0]["list_ms"] > 0
    assert results["reference"][0]["particles"] == 2171
    assert all(row["converged"] for row in results["pressure_solve"])
    assert results["machine"]["copy_gb_per_s"] > 0
    assert "part.-steps/s" in capsys.readouterr().out
