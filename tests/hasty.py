"""Compiling in a third of the time: what most tests compute takes milliseconds, and a step takes seconds to compile."""

import dataclasses
import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import equinox as eqx
import jax

from jaxmps import Scheme, _compilation
from jaxmps.pressure import ByDiagonal

USUAL = _compilation._OPTIONS
USERS = {"xla_backend_optimization_level": 3, "xla_cpu_use_fusion_emitters": True}


@functools.cache
def options() -> dict[str, Any]:
    """What the compiler does not have to do, as far as this release of it knows the options."""
    unoptimized = {"xla_backend_optimization_level": 0}
    for options in ({**unoptimized, "xla_cpu_use_fusion_emitters": False}, unoptimized):
        try:
            with jax.ensure_compile_time_eval():
                jax.jit(lambda x: x + 1, compiler_options=options)(1)
        except Exception:  # the type of the error differs from release to release
            continue
        return options
    return {}


def hurry() -> None:
    """From now on the package compiles with little care, which changes results by round-off only."""
    _compilation._OPTIONS = USUAL | options()
    _compilation.compiler_options.cache_clear()


@contextmanager
def with_care() -> Iterator[None]:
    """What is first compiled here is compiled as users get it."""
    # The environment of the tests switches off what `options` does.
    _compilation._OPTIONS = USUAL | {name: USERS[name] for name in options()}
    _compilation.compiler_options.cache_clear()
    yield
    hurry()


def by_diagonal(scheme: Scheme) -> Scheme:
    """The scheme without multigrid: it compiles in half the time, and its solutions differ by their tolerance."""
    return dataclasses.replace(scheme, preconditioning=ByDiagonal())


def quick(function: Callable[..., Any]) -> Callable[..., Any]:
    """`eqx.filter_jit` in a hurry."""

    @functools.cache
    def compiled():
        return eqx.filter_jit(function, compiler_options=options())  # type: ignore[call-overload]

    return lambda *arguments: compiled()(*arguments)
