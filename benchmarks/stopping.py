"""What accuracy of the pressure costs: products with the matrix, and the error that is left, for each stopping rule.

python -m benchmarks.stopping

In five flows, in double precision, the pressure equations of some steps are solved to several tolerances: with
multigrid from the last pressure, as a step does it, and from zero, and with Jacobi from zero. The error is that of the
pressure against a solve to 1e-12, as a norm and as a mean, which would show a bias. The default of `Scheme.tolerance`
rests on this table.
"""

from collections.abc import Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxmps as mps
from benchmarks import equation
from benchmarks.timing import compiled
from jaxmps.pressure import AbstractPreconditioning, ByDiagonal, ByMultigrid

TOLERANCES = (1e-3, 1e-4, 1e-5)
WAYS = (("multigrid, last pressure", ByMultigrid(), False), ("multigrid", ByMultigrid(), True))
WAYS += (("Jacobi", ByDiagonal(), True),)
SAMPLES, APART = 4, 5  # equations from each flow, and the steps from one to the next


def flows() -> Iterator[tuple[str, mps.Case, mps.Scheme, float]]:
    """Name, case, scheme and the time [s] from which on equations are taken."""
    yield "dam, collapse", mps.cases.dam_break(spacing=0.01), mps.schemes.mps(), 0.2
    yield "dam, splash", mps.cases.dam_break(spacing=0.02), mps.schemes.mps(), 0.9
    yield "hydrostatic", mps.cases.hydrostatic(spacing=0.005), mps.schemes.mps(), 0.05
    yield "patch", mps.cases.square_patch(spacing=0.02), mps.schemes.mps_cd_gc_ds(restoring=0.0), 0.2
    yield "settling", mps.cases.settling(), mps.schemes.mps_hs_gc_ds(), 0.05


def preconditioned(scheme: mps.Scheme, by: AbstractPreconditioning) -> mps.Scheme:
    return eqx.tree_at(lambda s: s.preconditioning, scheme, by)


def samples(case: mps.Case, scheme: mps.Scheme, begin: float) -> list[mps.State]:
    """States some steps apart."""
    state, found = mps.start(case, scheme), []
    while float(state.time) < begin:
        state, _ = mps.rollout(case, scheme, state, steps=20)
    for _ in range(SAMPLES):
        state, _ = mps.rollout(case, scheme, state, steps=APART)
        found.append(state)
    return found


def table(name: str, case: mps.Case, scheme: mps.Scheme, begin: float) -> None:
    states = samples(case, scheme, begin)
    predict = compiled(equation.prediction, case, scheme, states[0], hasty=True)
    predicted = [predict(case, scheme, state) for state in states]

    def solve(case, scheme, prediction, tolerance, cold):
        return equation.solve(case, scheme, prediction, tolerance, 5000, cold)[0]

    def exactly(case, scheme, prediction):
        return solve(case, scheme, prediction, 1e-12, True)

    exact = compiled(exactly, case, scheme, predicted[0], hasty=True)
    expected = [exact(case, scheme, p) for p in predicted]
    for way, by, cold in WAYS:
        for tolerance in TOLERANCES:
            method = preconditioned(scheme, by)
            with equation.counted() as tally:
                run = compiled(
                    lambda *a, tolerance=tolerance, cold=cold: solve(*a, tolerance, cold),
                    *(case, method, predicted[0]),
                    hasty=True,
                )
            off = [run(case, method, p) - e for p, e in zip(predicted, expected, strict=True)]
            products = tally.take() / len(off)
            pairs = list(zip(off, expected, strict=True))
            error = max(float(jnp.linalg.norm(o) / jnp.linalg.norm(e)) for o, e in pairs)
            bias = np.mean([float(jnp.sum(o) / jnp.sum(jnp.abs(e))) for o, e in pairs])
            print(f"{name:14s} {way:24s} {tolerance:9.0e} {products:8.1f} {error:9.1e} {bias:+9.1e}", flush=True)


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    print("flow           solved by                tolerance products  error max bias mean")
    for flow in flows():
        table(*flow)


if __name__ == "__main__":
    main()
