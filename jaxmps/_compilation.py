"""`jit` with the compiler options that our kernels need.

XLA's "ynn" fusions on CPUs (on by default since jax 0.10.2) slow gather-heavy kernels up to threefold, and the first
release that had them compiled some kernels wrongly (jax issue 39103). They are switched off here, where the option
exists; as an XLA flag it would abort the releases that do not know it.
"""

import functools
import platform
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import platformdirs
from jax import Array, lax
from jax.core import Tracer
from jax.custom_batching import custom_vmap

_OPTIONS = {"xla_cpu_experimental_ynn_fusion_type": ""}


@functools.cache
def compiler_options() -> dict[str, Any] | None:
    """The options for this release and backend, None if it does not know them."""
    if jax.default_backend() != "cpu":
        return None
    try:
        with jax.ensure_compile_time_eval():
            jax.jit(lambda x: x + 1, compiler_options=_OPTIONS)(1)
    except Exception:  # the type of the error differs from release to release
        return None
    return _OPTIONS


def jit(function: Callable[..., Any], **keywords: Any) -> Callable[..., Any]:
    """`jax.jit` with our compiler options; the backend is asked at the first call, not at import.

    Inside another transformation the options are left out: JAX takes them at the outermost `jit` only.
    """
    plain = jax.jit(function, **keywords)

    @functools.cache
    def tuned() -> Callable[..., Any]:
        return jax.jit(function, compiler_options=compiler_options(), **keywords)

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        leaves = jax.tree.leaves((args, kwargs))
        traced = any(isinstance(leaf, Tracer) for leaf in leaves)
        return (plain if traced else tuned())(*args, **kwargs)

    return call


@custom_vmap
def materialized(x: Array) -> Array:
    """x, which must be computed before anything that reads it.

    The CPU's compiler fuses what makes an array into every reader of it, also where each element is read many times at
    random, and drops optimization barriers before it does so. A branch that is always taken stops it.
    """
    if jax.default_backend() != "cpu":
        return x
    return lax.cond(jnp.logical_not(x.ravel()[0] == jnp.inf), lambda x: x, jnp.zeros_like, x)


@materialized.def_vmap
def _materialized_batch(axis_size, in_batched, x):
    return materialized(x), in_batched[0]


@jax.custom_jvp
def cotangent_once(x: Array) -> Array:
    """x, of which reverse mode computes the cotangent once, as `materialized` does it with values.

    What flows back to a pair goes on to both its particles, and the compiler would compute it for each.
    """
    return x


@cotangent_once.defjvp
def _cotangent_once_jvp(primals, tangents):
    (x,), (dx,) = primals, tangents
    if jax.default_backend() != "cpu":
        return x, dx
    # Here the predicate must not depend on x: JAX cannot transpose a branch whose predicate is batched.
    return x, lax.cond(lax.optimization_barrier(jnp.array(True)), lambda dx: dx, jnp.zeros_like, dx)


def keep_compiled() -> None:
    """What is compiled from now on is kept on disk for later processes, unless the user's settings say where.

    One folder for each machine: code for one processor does not run on every other that shares a home directory. What
    is kept must not call LAPACK: in a process that has not used it before, such a program crashes (jax issue 28908).
    """
    if jax.config.jax_compilation_cache_dir is None:  # type: ignore[attr-defined]
        folder = platformdirs.user_cache_path("jaxmps") / (platform.node() or "machine")
        jax.config.update("jax_compilation_cache_dir", str(folder))
