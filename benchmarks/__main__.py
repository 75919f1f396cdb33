"""Time per step of the dam break at several sizes, in both precisions.

python -m benchmarks [--json FILE] [--quick]

Each size runs in chunks of compiled steps, after a warm-up, all sizes in turn and the turns repeated, so that a
machine whose speed drifts is unfair to none; the table shows the median. `quick` keeps to what ends within a minute.
"""

import argparse
import json
import platform
import time
from pathlib import Path

import jax
import numpy as np

import jaxmps as mps

STEPS = 20


def prepare(spacing: float, three: bool, x64: bool):
    """A function that runs `STEPS` steps of the collapse, the number of particles, and the compile time [s]."""
    with jax.enable_x64(x64):
        case = mps.cases.dam_break_3d(spacing=spacing) if three else mps.cases.dam_break(spacing=spacing)
        scheme = mps.schemes.mps()
        state = mps.start(case, scheme)
        began = time.perf_counter()
        # Some steps into the collapse the lattice is broken up and the list gets rebuilt as in a real run.
        for _ in range(4):
            state, info = jax.block_until_ready(mps.rollout(case, scheme, state, steps=STEPS))
        seconds = time.perf_counter() - began

    def run() -> mps.StepInfo:
        with jax.enable_x64(x64):
            return jax.block_until_ready(mps.rollout(case, scheme, state, steps=STEPS))[1]

    assert not np.any(np.asarray(info.status)), "a benchmark must run without trouble"
    return run, len(case.particles.kind), seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    sizes = [(0.02, False), (0.01, False)] if arguments.quick else [(0.02, False), (0.01, False), (0.005, False)]
    sizes += [] if arguments.quick else [(0.02, True)]
    runs = [(*size, x64, *prepare(*size, x64)) for size in sizes for x64 in (True, False)]
    times: list[list[float]] = [[] for _ in runs]
    for _ in range(3 if arguments.quick else 5):
        for spent, (_, _, _, run, _, _) in zip(times, runs, strict=True):
            began = time.perf_counter()
            run()
            spent.append((time.perf_counter() - began) / STEPS)
    rows = [
        {
            "case": "dam_break_3d" if three else "dam_break",
            "dim": 3 if three else 2,
            "particles": particles,
            "precision": "double" if x64 else "single",
            "ms_per_step": 1e3 * float(np.median(spent)),
            "particle_steps_per_second": particles / float(np.median(spent)),
            "first_steps_s": first,
        }
        for spent, (_, three, x64, _, particles, first) in zip(times, runs, strict=True)
    ]
    print(f"{platform.processor() or platform.machine()}, {jax.devices()[0].device_kind}, jax {jax.__version__}")
    print("case          particles  precision  ms/step  particle-steps/s")
    for row in rows:
        print(
            f"{row['case']:12s} {row['particles']:10d}  {row['precision']:9s} {row['ms_per_step']:8.2f} "
            f"{row['particle_steps_per_second']:17.3g}"
        )
    if arguments.json:
        arguments.json.write_text(json.dumps({"step": rows}, indent=2))


if __name__ == "__main__":
    main()
