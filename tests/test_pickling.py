"""What the package makes goes through pickle and `copy.deepcopy`, and on in another process as in this one."""

import copy
import multiprocessing
import pickle
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
import pytest
from hasty import by_diagonal

import jaxmps as mps
from jaxmps.flow.motion import Rigid, Table


def flow() -> tuple[mps.Case, mps.Scheme, mps.State]:
    """A wave with a mirror, some steps on its way, whose list is not of the usual size."""
    case = mps.cases.standing_wave(spacing=0.1, floor="mirror")
    scheme = by_diagonal(mps.schemes.stochastic(mps.schemes.mps(), alpha=0.01))
    start = mps.start(case, scheme, skin=0.2, capacity=26)
    return case, scheme, mps.rollout(case, scheme, start, steps=2, dt=4e-3)[0]


def after(case: mps.Case, scheme: mps.Scheme, state: mps.State) -> list[np.ndarray]:
    end, info = mps.rollout(case, scheme, state, steps=2, dt=4e-3)
    return [np.asarray(x) for x in jax.tree.leaves((end, info))]


@pytest.mark.parametrize("way", [lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy, copy.copy])
def test_what_comes_back_is_of_the_same_type_and_goes_on_with_what_was_compiled(way):
    there = flow()
    back = way(there)
    assert jax.tree.structure(back) == jax.tree.structure(there)  # which is what `jit` goes by
    assert bool(eqx.tree_equal(back, there))
    assert back[2].neighbors.capacity == 26 and not bool(back[2].neighbors.overflow)
    for a, b in zip(after(*back), after(*there), strict=True):
        np.testing.assert_array_equal(a, b)


def test_in_3d_with_periods_and_a_moving_wall_too():
    case = mps.cases.hydrostatic(spacing=0.1, length=0.2, height=0.2, depth=0.2)
    motion = Rigid([0.0] * 3, sway=Table([0.0, 1.0], [0.0, 0.1], interpolation="linear"))
    case = eqx.tree_at(lambda c: c.motion, case, motion, is_leaf=lambda x: x is case.motion)
    state = mps.start(case, mps.schemes.mps())
    assert bool(eqx.tree_equal(pickle.loads(pickle.dumps((case, state))), (case, state)))


def test_a_run_and_what_ended_it_come_back():
    case, scheme, state = flow()
    with pytest.warns(mps.SimulationWarning):
        run = mps.simulate(case, scheme, until=0.2, dt=0.1, start=state)
    back = pickle.loads(pickle.dumps(run))
    assert back.status == run.status and back.summary == run.summary and back.metadata == run.metadata
    np.testing.assert_array_equal(back.position, run.position)


CARRY_ON = """
import pickle, sys
import jax
jax.config.update("jax_enable_x64", True)
with open(sys.argv[1], "rb") as file:
    case, scheme, state = pickle.load(file)
import jaxmps as mps
found = jax.tree.leaves(mps.rollout(case, scheme, state, steps=2, dt=4e-3))
with open(sys.argv[2], "wb") as file:
    pickle.dump([jax.device_get(x) for x in found], file)
"""


@pytest.mark.slow
def test_a_process_of_its_own_carries_a_state_on(tmp_path: Path):
    there, back = tmp_path / "there", tmp_path / "back"
    there.write_bytes(pickle.dumps(flow()))
    subprocess.run([sys.executable, "-c", CARRY_ON, str(there), str(back)], check=True)
    for a, b in zip(pickle.loads(back.read_bytes()), after(*flow()), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_processes_that_are_spawned_take_states():
    jax.block_until_ready(flow())  # JAX has run: a process that is forked now would hang
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        times = pool.map(_time, [flow()[2]])
    assert times == pytest.approx([float(flow()[2].time)])  # in single precision: each process sets its own


def _time(state: mps.State) -> float:
    return float(state.time)
