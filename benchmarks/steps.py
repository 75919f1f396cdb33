"""The step: its time, where that goes, and what it needs.

`ms_per_step` is that of a compiled rollout from some tens of steps into the collapse. The list is a forced rebuild
times the rebuilds that were counted in these steps, and for the remaining updates the look whether one is due. The
pressure equation (PPE) is matrix, preconditioner and solution, measured by itself at the first of these steps and after
the last. The operators are all that remains. Of the products with the matrix, whose number is counted, one takes
`of ms` and moves its bytes (`benchmarks/traffic.py`) at a part `at copy` of the machine's bandwidth.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import jaxmps as mps
from benchmarks import equation
from benchmarks.states import Flow
from benchmarks.timing import compiled
from benchmarks.traffic import bytes_per_product, bytes_per_step
from jaxmps.flow import FATAL, Status
from jaxmps.neighbors import Neighbors, update
from jaxmps.stepping import largest_step, pressure_equation, step

_UPDATES = 4  # of the list in one timed call
_PRODUCTS = 10  # with the matrix in one timed call
_TROUBLE = int(FATAL | Status.TABLE_FULL)


class StepRun:
    """The standard method on the case in one precision, warmed up by so many chunks of steps.

    `calls` are what is to be timed, in turn with what it is compared with: the next steps, and with `parts` these too.
    """

    def __init__(self, name: str, case: mps.Case, steps: int, chunks: int, parts: bool):
        self.steps, self.x64 = steps, bool(jax.config.jax_enable_x64)
        scheme = mps.schemes.mps(viscous=False)
        state = mps.start(case, scheme)
        self.rollout = compiled(lambda *flow: mps.rollout(*flow, steps=steps), case, scheme, state)
        for _ in range(chunks):
            state, info = self.rollout(case, scheme, state)
            if np.any(np.asarray(info.status) & _TROUBLE):
                raise RuntimeError(f"a benchmark must run without trouble, got the status {np.asarray(info.status)}")
        self.flow = Flow(name, case, scheme, state)
        self.last, self.products, self.rebuilds, self.missed = _count(self.flow, steps)
        self.calls: list[Callable[[], Any]] = [lambda: self.rollout(*self.flow[1:])]
        self.calls += _parts(self.flow, self.last) if parts else []


def row(run: StepRun, seconds: Sequence[float], bandwidth: float) -> dict[str, Any]:
    """The row of the table, given the time of each of its calls [s] and the bandwidth of a copy [GB/s]."""
    name, case, scheme, state = run.flow
    particles, total = len(case.particles.kind), seconds[0] / run.steps
    with jax.enable_x64(run.x64):
        moved = bytes_per_step(case, scheme, state, run.products, run.rebuilds)
    return {
        "case": name,
        "particles": particles,
        "dim": case.dim,
        "precision": "double" if run.x64 else "single",
        "steps": run.steps,
        "time_s": float(state.time),
        "ms_per_step": 1e3 * total,
        **(_shares(total, seconds[1:], run.rebuilds) | _product(seconds[-1], state, bandwidth) if seconds[1:] else {}),
        "operator_applications": run.products,
        "missed_tolerance": run.missed,
        "rebuilds_per_step": run.rebuilds,
        "particle_steps_per_second": particles / total,
        "gb_per_step": moved / 1e9,
        "gb_per_s": moved / 1e9 / total,
        "bandwidth_fraction": moved / 1e9 / total / bandwidth,
        "peak_bytes_per_particle": run.rollout.memory / particles,
        "compile_s": run.rollout.seconds,
    }


def _shares(total: float, parts: Sequence[float], rebuilds: float) -> dict[str, float]:
    first, final, renew, keep, _ = parts
    rebuild, look = renew / _UPDATES, keep / _UPDATES
    ppe, neighbors = 0.5 * (first + final), rebuilds * rebuild + max(0.0, 2.0 - rebuilds) * look
    shares = {"ppe": ppe, "list": neighbors, "operators": total - ppe - neighbors, "rebuild": rebuild, "look": look}
    return {f"{part}_ms": 1e3 * spent for part, spent in shares.items()}


def _product(spent: float, state: mps.State, bandwidth: float) -> dict[str, float]:
    seconds, moved = spent / _PRODUCTS, bytes_per_product(state) / 1e9
    return {"product_ms": 1e3 * seconds, "product_bandwidth_fraction": moved / seconds / bandwidth}


def _count(flow: Flow, steps: int) -> tuple[mps.State, float, float, int]:
    """The state after the steps; per step the products with the matrix and the rebuilds of the list; and the number of
    steps whose solution missed its tolerance.
    """

    def roll(case: mps.Case, scheme: mps.Scheme, state: mps.State) -> tuple[mps.State, tuple[Array, Array]]:
        def body(state: mps.State, _: None) -> tuple[mps.State, tuple[Array, Array]]:
            # A step updates the list twice; the first result is gone when it ends.
            before = update(state.neighbors, state.particles.position)
            dt = largest_step(case, scheme, state.particles)
            new, info = step(case, scheme, state, dt, jax.random.key(0))
            return new, (_differ(state.neighbors, before) + _differ(before, new.neighbors), info.status)

        return jax.lax.scan(body, state, None, length=steps)

    with equation.counted() as tally:
        run = compiled(roll, *flow[1:], hasty=True)
    last, (rebuilds, status) = run(*flow[1:])
    missed = int(np.sum(np.asarray(status) & Status.NOT_CONVERGED != 0))
    return last, tally.take() / steps, float(np.mean(np.asarray(rebuilds))), missed


def _differ(a: Neighbors, b: Neighbors) -> Array:
    """1 if the list was made anew: the positions that it was made at are part of it, and differ."""
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return jnp.any(jnp.stack([jnp.any(x != y) for x, y in pairs])).astype(int)


def _parts(flow: Flow, last: mps.State) -> list[Callable[[], Any]]:
    """The pressure equation of the first step and of the one after the last, updates with and without a rebuild, and
    products with the matrix.
    """
    _, case, scheme, state = flow
    predict = compiled(equation.prediction, case, scheme, state, hasty=True)
    first, final = predict(case, scheme, state), predict(case, scheme, last)
    limits = {"tolerance": scheme.tolerance, "most_iterations": scheme.max_iterations}
    solve = compiled(partial(equation.solve, **limits), case, scheme, first)

    # One particle back and forth by twice the skin: each update finds the list out of date.
    here = state.particles.position
    there = here.at[jnp.argmax(state.particles.fluid), -1].add(2.0 * state.neighbors.skin)
    renew = compiled(_updates, state.neighbors, there, here)
    fresh = renew(state.neighbors, there, here)

    matrix = compiled(pressure_equation, case, scheme, first, hasty=True)(case, scheme, first).operator
    vector = matrix.diagonal * jnp.linspace(1.0, 2.0, len(here), dtype=here.dtype)
    multiply = compiled(partial(equation.products, number=_PRODUCTS), matrix, vector)
    return [
        lambda: solve(case, scheme, first),
        lambda: solve(case, scheme, final),
        lambda: renew(fresh, there, here),
        lambda: renew(fresh, here, here),
        lambda: multiply(matrix, vector),
    ]


def _updates(neighbors: Neighbors, odd: Float[Array, "n d"], even: Float[Array, "n d"]) -> Neighbors:
    def body(k: Array, listed: Neighbors) -> Neighbors:
        return update(listed, jnp.where(k % 2 == 0, odd, even))

    return jax.lax.fori_loop(0, _UPDATES, body, neighbors)
