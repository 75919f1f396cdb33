"""The pressure equation by itself: its solution as in a step, and the counted work of that."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any
from unittest.mock import patch

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

import jaxmps as mps
from benchmarks.states import Flow
from benchmarks.timing import compiled
from jaxmps.pressure import Convergence, PoissonOperator, solve_pressure
from jaxmps.stepping import Prediction, largest_step, predict, pressure_equation

MOST_ITERATIONS = 20_000
"""Of a cold solve: more than any needs, to count what it takes instead of giving up."""


def prediction(case: mps.Case, scheme: mps.Scheme, state: mps.State) -> Prediction:
    """The explicit part of the step from `state`, whose pressure equation is to be solved."""
    return predict(case, scheme, state, largest_step(case, scheme, state.particles), jax.random.key(0))


def solve(
    case: mps.Case,
    scheme: mps.Scheme,
    predicted: Prediction,
    tolerance: float,
    most_iterations: int,
    cold: bool = False,
) -> tuple[Float[Array, " n"], Convergence]:
    """p [Pa] by matrix, preconditioner and solver as in a step; from the previous pressure, or, `cold`, from zero."""
    equation = pressure_equation(case, scheme, predicted)
    if cold:
        equation = equation._replace(previous=jnp.zeros_like(equation.previous))
    return solve_pressure(equation, tolerance, most_iterations)


def products(operator: PoissonOperator, x: Float[Array, " n"], number: int) -> Float[Array, " n"]:
    """x after so many products with the matrix, scaled so that it neither grows nor dies out."""
    scale = 0.6 / jnp.max(operator.diagonal)
    return jax.lax.fori_loop(0, number, lambda _, x: scale * (operator @ x), x)


class Tally:
    """How often the matrix was applied, by its size. The finest one is what is counted."""

    def __init__(self) -> None:
        self._of_size: Counter[int] = Counter()

    def tick(self, size: int) -> None:
        self._of_size[size] += 1

    def take(self) -> int:
        """The number since the last call, after all that is under way."""
        jax.effects_barrier()
        number = self._of_size[max(self._of_size)] if self._of_size else 0
        self._of_size.clear()
        return number


@contextmanager
def counted() -> Iterator[Tally]:
    """What is traced within counts each product with the matrix that is really made, whoever asks for it.

    That costs time: not for what is timed.
    """
    tally, plain = Tally(), PoissonOperator.__matmul__

    def apply(self, x):
        jax.debug.callback(lambda: tally.tick(x.shape[0]))
        return plain(self, x)

    with patch.object(PoissonOperator, "__matmul__", apply):
        yield tally


def row(flow: Flow, x64: bool) -> dict[str, Any]:
    """Products with the matrix that the solution takes from zero, to 1e-6 in double and 1e-5 in single precision."""
    tolerance = 1e-6 if x64 else 1e-5
    _, case, scheme, state = flow
    predicted = compiled(prediction, case, scheme, state, hasty=True)(case, scheme, state)
    with counted() as tally:
        cold = partial(solve, tolerance=tolerance, most_iterations=MOST_ITERATIONS, cold=True)
        _, convergence = compiled(cold, case, scheme, predicted, hasty=True)(case, scheme, predicted)
    return {
        "case": flow.name,
        "particles": len(case.particles.kind),
        "unknowns": int(jnp.sum(state.particles.has_pressure & ~predicted.surface)),
        "dim": case.dim,
        "scheme": scheme.name,
        "precision": "double" if x64 else "single",
        "tolerance": tolerance,
        "operator_applications": tally.take(),
        "residual": float(convergence.residual),
        "converged": bool(convergence.converged),
    }
