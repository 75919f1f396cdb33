"""The pressure equation by itself: what a step hands to the solver, its solution, and the counted work of that."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple
from unittest.mock import patch

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

import jaxmps as mps
from benchmarks.states import Flow
from benchmarks.timing import compiled
from jaxmps import stepping
from jaxmps.linear import Convergence
from jaxmps.neighbors import Pairs
from jaxmps.pressure import PoissonOperator, poisson_operator, solve_pressure

MOST_ITERATIONS = 20_000
"""Of a cold solve: more than any needs, to count what it takes instead of giving up."""


class Equation(NamedTuple):
    """What the matrix, the right-hand side and the guess of a step's pressure equation are made from."""

    near: Pairs
    coefficient: Float[Array, "n k"]
    density: Float[Array, " n"]
    unknown: Bool[Array, " n"]
    source: Float[Array, " n"]
    previous: Float[Array, " n"]


def of_step(case: mps.Case, scheme: mps.Scheme, state: mps.State) -> Equation:
    """The equation of the step from `state`, taken from the step itself while it is traced, so that it is the same."""
    found: dict[str, Any] = {}

    def assemble(near, coefficient, density, unknown):
        found.update(near=near, coefficient=coefficient, density=density, unknown=unknown)
        return poisson_operator(near, coefficient, density, unknown)

    def leave(_, source, unknown, previous, *rest):
        found.update(source=source, previous=previous)
        return jnp.zeros_like(previous), Convergence(jnp.zeros_like(source[0]), jnp.array(True))

    with patch.object(stepping, "poisson_operator", assemble), patch.object(stepping, "solve_pressure", leave):
        dt = stepping.largest_step(case, scheme, state.particles)
        stepping.step(case, scheme, state, dt, jax.random.key(0))
    return Equation(**found)


def solve(
    equation: Equation, tolerance: float, most_iterations: int, cold: bool = False
) -> tuple[Float[Array, " n"], Convergence]:
    """p [Pa] by matrix, preconditioner and solver as in a step; from the previous pressure, or, `cold`, from zero."""
    operator = poisson_operator(equation.near, equation.coefficient, equation.density, equation.unknown)
    guess = jnp.zeros_like(equation.previous) if cold else equation.previous
    return solve_pressure(operator, equation.source, equation.unknown, guess, tolerance, most_iterations)


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
    equation = compiled(of_step, *flow[1:])(*flow[1:])
    with counted() as tally:
        count = compiled(lambda e: solve(e, tolerance, MOST_ITERATIONS, cold=True), equation)
    _, convergence = count(equation)
    return {
        "case": flow.name,
        "particles": len(flow.case.particles.kind),
        "unknowns": int(jnp.sum(equation.unknown)),
        "dim": flow.case.dim,
        "scheme": flow.scheme.name,
        "precision": "double" if x64 else "single",
        "tolerance": tolerance,
        "operator_applications": tally.take(),
        "residual": float(convergence.residual),
        "converged": bool(convergence.converged),
    }
