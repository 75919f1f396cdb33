"""Compiling ahead of time, and timing in turns."""

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxmps._compilation import compiler_options


class Compiled(NamedTuple):
    """An executable in its precision, the time that its compilation took [s], and the memory that it needs [bytes]:
    arguments, results and temporaries.
    """

    function: Callable[..., Any]
    seconds: float
    memory: int
    x64: bool

    def __call__(self, *arguments: Any) -> Any:
        with jax.enable_x64(self.x64):
            return jax.block_until_ready(self.function(*arguments))


def compiled(function: Callable[..., Any], *arguments: Any, hasty: bool = False) -> Compiled:
    """`function` compiled for `arguments` in the present precision, with the options of all our compiled functions.

    Hastily what is run once and not timed: that takes little more than half as long.
    """
    options = dict(compiler_options() or {}, **({"xla_backend_optimization_level": 0} if hasty else {}))
    began = time.perf_counter()
    executable = jax.jit(function, compiler_options=options or None).lower(*arguments).compile()
    seconds = time.perf_counter() - began
    memory = executable.memory_analysis()
    parts = ("argument_size_in_bytes", "output_size_in_bytes", "temp_size_in_bytes")
    return Compiled(executable, seconds, sum(getattr(memory, part, 0) for part in parts), jax.config.jax_enable_x64)


def medians(runs: Sequence[Callable[[], Any]], turns: int) -> list[float]:
    """The median time [s] of each of `runs`, all of them in turn: a machine whose speed drifts is unfair to none."""
    spent: list[list[float]] = [[] for _ in runs]
    for _ in range(turns):
        for times, run in zip(spent, runs, strict=True):
            began = time.perf_counter()
            run()
            times.append(time.perf_counter() - began)
    return [float(np.median(times)) for times in spent]
