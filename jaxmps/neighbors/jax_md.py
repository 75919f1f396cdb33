"""jax-md's lists without the rest of jax-md: `import jax_md` itself brings neural potentials and rigid bodies, 10 s."""

import functools
import importlib
import importlib.util
import sys
from typing import Any


@functools.cache
def partition() -> Any:
    """The module `jax_md.partition`; a later `import jax_md` works as ever and has the same module.

    While it is imported, an empty package stands for `jax_md`: its own, which imports all there is, does not run.
    """
    spec = importlib.util.find_spec("jax_md")
    if "jax_md" not in sys.modules and spec is not None:
        sys.modules["jax_md"] = importlib.util.module_from_spec(spec)
        try:
            return importlib.import_module("jax_md.partition")
        except (ImportError, AttributeError):  # a release whose modules need the package: import all of it below
            for name in [name for name in sys.modules if name.startswith("jax_md.")]:
                del sys.modules[name]
        finally:
            del sys.modules["jax_md"]
    return importlib.import_module("jax_md.partition")
