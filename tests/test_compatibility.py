"""Files of earlier versions are read and carried on.

`data/version_0.1.0` was written by commit d7e2c72 (jax 0.10.1, double precision), when the package had no rooms yet: a
dam break of 101 particles with `stochastic(mps(), alpha=0.01)`, which was inviscid, and key 3, once to its end and once
killed on its way.
"""

import gzip
import warnings
from pathlib import Path

import numpy as np
import pytest

import jaxmps as mps

DATA = Path(__file__).parent / "data" / "version_0.1.0"


@pytest.fixture
def old(tmp_path: Path) -> Path:
    for path in DATA.glob("*.gz"):
        (tmp_path / path.stem).write_bytes(gzip.decompress(path.read_bytes()))
    return tmp_path


def test_a_run_of_version_0_1_0_is_read_with_all_that_it_has(old):
    run = mps.read(old / "whole.vtkhdf")
    assert run.status.completed and run.summary["steps"] == 44
    np.testing.assert_allclose(run.time, [0.0, 0.15, 0.3])
    case = mps.cases.dam_break(spacing=0.25)
    np.testing.assert_array_equal(run.position[0], case.particles.position)
    assert run.position.shape == run.velocity.shape == (3, 101, 2)
    # The column falls: mechanical energy goes over into motion, and some is lost.
    assert run.energy[-1, 0] > 0.0 and run.energy[-1].sum() < run.energy[0].sum()
    assert run.metadata["scheme"]["noise.alpha"] == pytest.approx(0.01)


def test_a_checkpoint_of_version_0_1_0_is_carried_on_to_the_end_that_the_run_had_then(old):
    scheme = mps.schemes.stochastic(mps.schemes.mps(viscous=False), alpha=0.01)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mps.SimulationWarning)  # of other versions of packages than then
        run = mps.resume(old / "killed.vtkhdf", mps.cases.dam_break(spacing=0.25), scheme)
    then = mps.read(old / "whole.vtkhdf")
    assert run.status == then.status and run.summary["steps"] == then.summary["steps"]
    for name in ("time", "position", "velocity", "pressure", "number_density"):
        # What compilers make of it differs by round-off, which grows little in 44 steps.
        np.testing.assert_allclose(getattr(run, name), getattr(then, name), rtol=1e-6, atol=1e-6, err_msg=name)
