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


@pytest.fixture(autouse=True, scope="session")
def in_a_hurry() -> None:
    """Programs are compiled in a third of the time; see `hasty.with_care` for those that should not."""
    import hasty  # imports the package, which is to be checked

    hasty.hurry()


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
