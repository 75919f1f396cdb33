"""The reference step as a run to be timed beside ours, with whichever solver is the fastest at its size."""

import copy
import time
from typing import Any

import numpy as np

import jaxmps as mps
from benchmarks.reference import SOLVERS, Flow, Reference


class ReferenceRun:
    """The reference on a flow of ours: each call makes so many steps from it, with a list already made."""

    def __init__(self, name: str, case: mps.Case, scheme: mps.Scheme, state: mps.State, steps: int):
        self.name, self.case, self.steps, self.calls = name, case, steps, 0
        particles = state.particles
        fields = (particles.position, particles.velocity, particles.pressure)
        self.flow = Flow(*(np.asarray(field, float) for field in fields), np.asarray(particles.kind))
        self.tried = {solver: self._try(Reference(case, scheme, solver)) for solver in SOLVERS}
        self.stepper = Reference(case, scheme, min(SOLVERS, key=lambda solver: self.tried[solver]))
        self.stepper.list.pairs(self.flow.position, self.flow.kind)
        self._list, self.builds = self.stepper.list, 0

    def _try(self, stepper: Reference) -> float:
        """The shortest time of a step [ms] in three, or in as many as have begun within a second."""
        stepper.list.pairs(self.flow.position, self.flow.kind)
        spent: list[float] = []
        while len(spent) < 3 and sum(spent) < 1.0:
            began = time.perf_counter()
            stepper.step(self.flow)
            spent.append(time.perf_counter() - began)
        return 1e3 * min(spent)

    def __call__(self) -> None:
        flow, self.stepper.list = self.flow, copy.copy(self._list)
        for _ in range(self.steps):
            flow = self.stepper.step(flow)
        self.builds += self.stepper.list.builds - self._list.builds
        self.calls += 1


def row(run: ReferenceRun, seconds: float) -> dict[str, Any]:
    """The row of the table, given the time of a call [s]; the parts are means over all calls."""
    particles, made = len(run.case.particles.kind), run.calls * run.steps
    parts = {name: 1e3 * spent / made for name, spent in run.stepper.seconds.items()}
    return {
        "case": run.name,
        "particles": particles,
        "dim": run.case.dim,
        "precision": "double",
        "steps": run.steps,
        "solver": run.stepper.solver,
        "one_step_ms_by_solver": run.tried,
        "ms_per_step": 1e3 * seconds / run.steps,
        "list_ms": parts["list"],
        "operators_ms": parts["operators"],
        "ppe_ms": parts["matrix"] + parts["preconditioner"] + parts["solve"],
        "matrix_ms": parts["matrix"],
        "preconditioner_ms": parts["preconditioner"],
        "solve_ms": parts["solve"],
        "operator_applications": run.stepper.applications / made,
        "rebuilds_per_step": run.builds / made,
        "particle_steps_per_second": particles * run.steps / seconds,
    }
