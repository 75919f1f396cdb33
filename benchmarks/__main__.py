"""Speed of the step, of its pressure solve, of gradients and ensembles, and of the same step with SciPy.

python -m benchmarks [--json FILE] [--quick] [--sizes 2k,8k,...]

The dam break some tens of steps into its collapse (fewer at the largest sizes), in both precisions. At each size our
runs and the reference take turns, after a warm-up; the table shows medians. `--quick` keeps to what ends within a
minute. What the columns mean is told in `benchmarks/steps.py` and `benchmarks/traffic.py`; the products with the matrix
are counted where they are made, in a run of its own.
"""

import argparse
import itertools
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax

import jaxmps as mps
from benchmarks import equation, machine, states, steps, table, variants, yardstick
from benchmarks.splash import splash
from benchmarks.timing import medians


class Size(NamedTuple):
    """A dam break by its spacing [m]; steps that are timed at once, chunks of these to warm up, and turns."""

    make: Callable[..., mps.Case]
    spacing: float
    steps: int
    chunks: int
    turns: int


SIZES = {
    "2k": Size(mps.cases.dam_break, 0.02, 20, 4, 5),
    "8k": Size(mps.cases.dam_break, 0.009, 20, 4, 5),
    "32k": Size(mps.cases.dam_break, 0.0042, 10, 5, 5),
    "128k": Size(mps.cases.dam_break, 0.00205, 6, 5, 3),
    "512k": Size(mps.cases.dam_break, 0.00101, 4, 5, 3),
    "30k-3d": Size(mps.cases.dam_break_3d, 0.0174, 10, 4, 3),
    "240k-3d": Size(mps.cases.dam_break_3d, 0.0073, 4, 5, 3),
}
QUICK = ("2k", "8k")
GRADIENT_STEPS = 200
GRADIENTS, ENSEMBLES = ("2k", "8k"), ("2k",)
REAL_SPLASH = (0.6, 1.2)
"""Times [s] at which a run at the smallest size is looked at."""


class Report:
    """The results so far: lines on the screen, and a file that is complete whenever one of them has been added."""

    def __init__(self, file: Path | None):
        self.file = file
        self.results: dict[str, Any] = {"machine": machine.describe()}
        self.results |= {key: [] for key in ("step", "reference", "pressure_solve", "gradient", "ensemble")}
        print(", ".join(f"{key} {value}" for key, value in self.results["machine"].items()))

    def add(self, key: str, columns: dict[str, table.Column], row: dict[str, Any], **shown: Any) -> None:
        self.results[key].append(row)
        table.tell(columns, row | shown)
        if self.file:
            self.file.write_text(json.dumps(self.results, indent=2))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="file for the results")
    parser.add_argument("--quick", action="store_true", help=f"only {', '.join(QUICK)}, and less of each")
    parser.add_argument("--sizes", help=f"some of {','.join(SIZES)}")
    options = parser.parse_args(arguments)
    names = options.sizes.split(",") if options.sizes else list(QUICK if options.quick else SIZES)
    if unknown := set(names) - set(SIZES):
        parser.error(f"unknown sizes {', '.join(sorted(unknown))}; there are {', '.join(SIZES)}")

    report = Report(options.json)
    table.head(table.STEP)
    runs = {name: _steps(name, options.quick, report) for name in names}
    table.head(table.SOLVE)
    solved = [(name, run) for name, several in runs.items() for run in several]
    for name, run in solved[:1] if options.quick else solved:
        with jax.enable_x64(run.x64):
            for flow in _flows(name, run, options.quick):
                report.add("pressure_solve", table.SOLVE, equation.row(flow, run.x64))
    if options.quick:
        return
    with jax.enable_x64(True):
        table.head(table.GRADIENT)
        for name in filter(runs.__contains__, GRADIENTS):
            report.add("gradient", table.GRADIENT, variants.gradient(runs[name][0].flow, GRADIENT_STEPS, 3))
        table.head(table.ENSEMBLE)
        for name in filter(runs.__contains__, ENSEMBLES):
            run = runs[name][0]
            report.add("ensemble", table.ENSEMBLE, variants.ensemble(run.flow, run.steps, 3))


def _steps(name: str, quick: bool, report: Report) -> list[steps.StepRun]:
    """Both precisions and the reference in turn.

    In a quick run the parts of the step are measured in double only, and single precision at the smallest size.
    """
    size, runs = SIZES[name], []
    for x64 in (True, False) if name == QUICK[0] or not quick else (True,):
        with jax.enable_x64(x64):
            case = size.make(spacing=size.spacing)
            runs.append(steps.StepRun(case.name, case, size.steps, size.chunks, parts=x64 or not quick))
    others = [yardstick.ReferenceRun(*runs[0].flow, size.steps)] if runs[0].flow.case.dim == 2 else []
    calls = itertools.chain(*(run.calls for run in runs), others)
    times = iter(medians(list(calls), 3 if quick else size.turns))
    fastest = 0.0
    for run in runs:
        spent = list(itertools.islice(times, len(run.calls)))
        row = steps.row(run, spent, report.results["machine"]["copy_gb_per_s"])
        report.add("step", table.STEP, row, by=row["precision"])
        fastest = fastest or row["particle_steps_per_second"]
    for other, seconds in zip(others, times, strict=True):
        row = yardstick.row(other, seconds)
        row["ours_is_times_as_fast"] = fastest / row["particle_steps_per_second"]
        report.add("reference", table.STEP, row, by=f"SciPy, {row['solver']}")
    return runs


def _flows(name: str, run: steps.StepRun, quick: bool) -> Iterator[states.Flow]:
    """The flows whose pressure is solved for: those of the case itself, and others of the same number of particles."""
    case, particles = run.flow.case, len(run.flow.case.particles.kind)
    yield run.flow._replace(name=f"{case.name} in collapse")
    if quick:
        yield states.begin("splash", splash(particles))
        return
    yield states.begin(f"{case.name} at rest", case)
    if case.dim == 2:
        yield from states.flows(particles)
    if name == QUICK[0] and run.x64:
        yield from states.simulated(case, REAL_SPLASH)


if __name__ == "__main__":
    main()
