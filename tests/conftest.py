"""What all tests share: annotations are checked at run time, figures need no screen, numbers are double.

A test for both precisions says `@pytest.mark.parametrize("precision", ["single", "double"], indirect=True)`.
"""

import atexit
import gc
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # else each program from the cache comes with pages of warnings
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    # What one worker or command has compiled, the others need not: least of all the many small programs between steps.
    os.environ["JAX_COMPILATION_CACHE_DIR"] = tempfile.mkdtemp(prefix="jaxmps-tests-")
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"
    atexit.register(shutil.rmtree, os.environ["JAX_COMPILATION_CACHE_DIR"], ignore_errors=True)
if "JAXMPS_TESTS_FLAGS" not in os.environ:
    # Programs are compiled with little care, see `hasty`: those of notebooks and commands, too, which inherit this.
    # A release of XLA that does not know a flag ends the process: a short one tries them, for all workers.
    little_care = " --xla_backend_optimization_level=0 --xla_cpu_parallel_codegen_split_count=1"
    without_emitters = little_care + " --xla_cpu_use_fusion_emitters=false"
    flags = os.environ.get("XLA_FLAGS", "")
    trial = [sys.executable, "-c", "import jax; jax.devices()"]
    known = subprocess.run(trial, env={**os.environ, "XLA_FLAGS": flags + without_emitters}, capture_output=True)
    os.environ["XLA_FLAGS"] = flags + (little_care if known.returncode else without_emitters)
    os.environ["JAXMPS_TESTS_FLAGS"] = os.environ["XLA_FLAGS"]

import jax
import jaxtyping
import psutil
import pytest

jaxtyping.install_import_hook("jaxmps", "beartype.beartype")
gc.set_threshold(20_000, 10, 10)  # tracing makes millions of small objects, few of them in cycles


def pytest_collection_finish() -> None:
    """What has been imported stays: it need not be searched for cycles again and again."""
    gc.collect()
    gc.freeze()


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
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", before)


CHECKED = {
    "test_box",
    "test_cases",
    "test_collision",
    "test_diagnostics",
    "test_divergence",
    "test_free_surface",
    "test_gradient_models",
    "test_kernels",
    "test_multigrid",
    "test_neighbors",
    "test_operators",
    "test_pressure",
    "test_simulation",
    "test_sources",
    "test_stabilization",
}
"""Files with annotations checked: they call each function of the package, and steps of all kinds of flows."""


@pytest.fixture(autouse=True, scope="module")
def checked_where_it_matters(request: pytest.FixtureRequest) -> Iterator[None]:
    """Elsewhere annotations are not checked: that takes an eighth of the time to trace and compile a step."""
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", request.module.__name__ not in CHECKED)
    yield
    jaxtyping.config.update("jaxtyping_disable", before)


@pytest.fixture(autouse=True, scope="module")
def compiled_programs_are_dropped() -> Iterator[None]:
    """At the end of a file, if they take much memory or many of the 65 530 pieces of it that a process may map."""
    yield
    pieces = Path("/proc/self/maps")
    many = not pieces.exists() or pieces.read_bytes().count(b"\n") > 15_000
    if many or psutil.Process().memory_info().rss > 1.5e9:
        jax.clear_caches()
        gc.collect()
