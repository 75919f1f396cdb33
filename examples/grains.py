"""What `settling.py` and `surfacing.py` share: the runs of a two-fluid tank, its table and its figure."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

import jaxmps as mps

DEPTH = 0.175  # m, of the water
SCHEMES = ("cmps_hs", "mps_hs_gc", "mps_hs_gc_ds", "mps_cd_gc_ds")
"""Those of the paper, and one that is not in it."""

diagnostics = mps.diagnostics


def groups(run: mps.Run) -> np.ndarray:
    """Mean elevation [m] of the groups A to E in each frame: (m, 5)."""
    group = mps.cases.grain_groups(run.position[0], run.phase)
    return np.stack([run.position[:, group == k, 1].mean(axis=1) for k in range(5)], axis=1)


def arrival(run: mps.Run, half: float, upward: bool) -> list[float]:
    """The first time [s] at which the mean of each group A to E is beyond the height `half` [m], else infinite."""
    sign = 1.0 if upward else -1.0
    beyond = sign * (groups(run) - half) > 0.0
    return [float(run.time[np.argmax(b)]) if b.any() else np.inf for b in beyond.T]


def trapped(run: mps.Run, upward: bool) -> np.ndarray:
    """Fraction of the grains, in each frame, in the half of the water that they should leave."""
    grains, y = run.fluid & (run.phase == 1), run.position[..., 1]
    wrong = y < 0.5 * DEPTH if upward else y > 0.5 * DEPTH
    return np.sum(grains & wrong, axis=1) / np.maximum(grains.sum(axis=1), 1)


def table(run: mps.Run, times: Sequence[float], upward: bool) -> None:
    """Prints how a run went: survival, both phases over time, the surface, and what the stabilizer did."""
    name, summary = run.metadata["scheme"]["name"], run.summary
    broken = diagnostics.breakup(run, reference_speed=0.5)
    print(f"\n{name}: {run.status}, {summary.get('steps', '?')} steps, broken up at {broken:.2f} s")
    if "stabilizer_work" in summary:  # not in the file of a run that was killed
        print(
            f"closest pair {summary['closest_pair']:.3f} spacings, {summary['stabilized_pairs']:.0f} pairs stabilized "
            f"in a step, work of the stabilizer {summary['stabilizer_work'] / run.time[-1]:+.2e} W/kg"
        )
    print("t [s]   mean y of water, A, B, C, D, E [mm]             trapped   rms speed of water   mean height   deep")
    height, speed, deep = diagnostics.mean_height(run), diagnostics.speed(run, 0), diagnostics.deep_surface(run)
    water, stuck = run.fluid & (run.phase == 0), trapped(run, upward)
    for time in times:
        if time > run.time[-1] + 1e-9:
            break
        k = int(np.argmin(np.abs(run.time - time)))
        y = [run.position[k, water[k], 1].mean(), *groups(run)[k]]
        print(
            f"{run.time[k]:5.2f}   {'  '.join(f'{1e3 * v:5.1f}' for v in y)}   {stuck[k]:10.3f}   "
            f"{speed[k]:14.4f} m/s   {height[k] / DEPTH - 1.0:+11.4f}   {deep[k].sum():4d}"
        )
    times_of = arrival(run, 0.5 * DEPTH, upward)
    print(
        f"means of A to E are in the {'upper' if upward else 'lower'} half from t = {np.round(times_of, 2).tolist()} s"
    )
    print(f"worst over the run: height {np.abs(height / DEPTH - 1.0).max():.4f}, deep surface {deep.sum(axis=1).max()}")


def compare(
    case: mps.Case,
    until: float,
    save_every: float,
    times: Sequence[float],
    upward: bool,
    folder: Path,
    schemes: Sequence[str],
    reuse: bool,
) -> list[mps.Run]:
    """Runs the schemes, or reads their runs from the `folder`, prints their tables and draws the paper's figure: both
    fluids and their velocities, one row for each scheme.
    """
    folder.mkdir(parents=True, exist_ok=True)
    runs = []
    for name in schemes:
        file = folder / f"{name}.vtkhdf"
        if not reuse:
            scheme = getattr(mps.schemes, name)()
            mps.simulate(case, scheme, until=until, save_every=save_every, out=file, overwrite=True)
        runs.append(mps.read(file))
        table(runs[-1], times, upward)
    file, shown = folder / f"{case.name}.png", [t for t in times if 0.0 < t <= until] or [until]
    figure = mps.plotting.panels(runs, shown, "phase", arrow=0.5, extent=(-0.008, 0.258, -0.008, 0.212))
    figure.savefig(file, dpi=80, bbox_inches="tight")
    print(f"figure: {file}")
    return runs
