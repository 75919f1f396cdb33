"""What all tests share: annotations are checked at run time, figures need no screen, numbers are double.

A test for both precisions says `@pytest.mark.parametrize("precision", ["single", "double"], indirect=True)`.
"""

import atexit
import os
import shutil
import tempfile
from collections.abc import Iterator

os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # else each program from the cache comes with pages of warnings
# Programs are compiled with little care, see `hasty`: those of notebooks and commands, too, which inherit this.
os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + " --xla_backend_optimization_level=0"
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    # What one worker or command has compiled, the others need not.
    os.environ["JAX_COMPILATION_CACHE_DIR"] = tempfile.mkdtemp(prefix="jaxmps-tests-")
    atexit.register(shutil.rmtree, os.environ["JAX_COMPILATION_CACHE_DIR"], ignore_errors=True)

import jax
import jaxtyping
import pytest

jaxtyping.install_import_hook("jaxmps", "beartype.beartype")

SLOW = (
    "test_the_benchmark_writes_its_table",
    "test_crests_keep_time[mps_hs_gc_ds]",
    "test_the_sloshing_example_follows_linear_theory",
    "test_the_recovery_example_finds_both_velocities",
    "test_single_precision_gives_the_derivatives_of_double[mps-single]",
    "test_single_precision_gives_the_derivatives_of_double[mps_hs_gc-single]",
    "test_single_precision_gives_the_derivatives_of_double[cmps_hs-single]",
    "test_gradients.py::test_single_precision_gives_the_derivatives_of_double",
    "test_a_run_that_was_killed_becomes_the_one_that_was_not[stochastic-single]",
    "test_a_run_that_was_killed_becomes_the_one_that_was_not[stabilized-double]",
    "test_two_fluids_of_one_density_flow_as_one[mps_hs_gc_ds]",
    "test_memory_grows_with_the_root_of_the_steps",
    "test_rollouts_with_multigrid_and_with_jacobi_agree",
    "test_preconditioned_solutions.py::test_solution_is_that_of_a_direct_solve",
    "test_single_and_double_precision_agree_on_the_front",
    "test_layers_stay_at_rest[mps_cd_gc_ds]",
)
"""Tests that take long and show, at other values, what shorter ones show: `make test-all` runs them, too."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if any(name in item.nodeid for name in SLOW):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(autouse=True, scope="session")
def in_a_hurry() -> None:
    """Programs are compiled in a third of the time; see `hasty.with_care` for those that should not."""
    import hasty  # imports the package, which is to be checked

    hasty.hurry()


@pytest.fixture(autouse=True, scope="session")
def nothing_is_told_on_the_way() -> Iterator[None]:
    """Runs print no lines of progress, which they do after ten seconds: a test that waits for its turn takes longer."""
    from jaxmps.running import display

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(display, "EVERY", 86_400.0)
        yield


@pytest.fixture(autouse=True)
def precision(request: pytest.FixtureRequest) -> Iterator[str]:
    """ "double" unless a test is parametrized otherwise; JAX is set accordingly while the test runs."""
    name = getattr(request, "param", "double")
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", name == "double")
    yield name
    jax.config.update("jax_enable_x64", before)


@pytest.fixture
def unchecked() -> Iterator[None]:
    """Annotations are not checked: for what the package itself says to arguments of a wrong type."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture(autouse=True, scope="module")
def compiled_programs_are_dropped() -> Iterator[None]:
    """Those of a file of tests, at its end: each maps memory, of which a process may have only so many pieces."""
    yield
    jax.clear_caches()
