"""The dam break of Naa, Omata & Kazama 2011, §5.1, over 15 s: their Figs. 6 and 7.

python examples/stochastic_dam_break.py [--out DIR] [--seeds N] [--alphas A ...] [--reuse]

Basic MPS and stochastic MPS with α = 0.0009, 0.001 and 0.003, five seeds each, and α = 0.2, which the paper warns of.
With --reuse the runs of an earlier call are read from its files, and only seeds that are missing there are run.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
import seeds as members
from matplotlib.figure import Figure
from scipy.stats import ttest_ind

import jaxmps as mps

ALPHAS = (0.0, 0.0009, 0.001, 0.003)
WARNED = 0.2
TIMES = (1.0, 5.0, 9.0, 12.76)  # s, of the pictures; the last is that of the paper


def sloshing(run: mps.Run) -> np.ndarray:
    """Amplitude of the first mode of the water's depth, a = (2/L) ∫ h cos(πx/L) dx [m], in each frame.

    h is the volume of the particles over each place, so that a single drop counts as what it is.
    """
    length = float(run.metadata["case"]["tank_length"])
    x, fluid = run.position[..., 0].astype(float), run.fluid
    return 2.0 / length * run.spacing**2 * np.sum(np.where(fluid, np.cos(np.pi * x / length), 0.0), axis=1)


def disappeared(run: mps.Run, least: float = 2.0) -> float:
    """The time [s] at which the amplitude of the sloshing falls under `least` spacings for good, or that of the end.

    The amplitude is the size of the extremes, to both sides, and between them falls exponentially.
    """
    size, limit = np.abs(sloshing(run)), least * run.spacing
    extremes = np.flatnonzero((size[1:-1] >= size[:-2]) & (size[1:-1] > size[2:])) + 1
    extremes = np.concatenate([[0], extremes])
    high = np.flatnonzero(size[extremes] > limit)
    if not len(high) or high[-1] + 1 == len(extremes):
        return float(run.time[-1]) if len(high) else 0.0
    before, after = extremes[high[-1]], extremes[high[-1] + 1]
    part = np.log(size[before] / limit) / np.log(size[before] / size[after])
    return float(run.time[before] + part * (run.time[after] - run.time[before]))


def table(runs: dict[float, list[mps.Run]]) -> dict[float, list[float]]:
    """Prints when the wave disappears and what energy is left; gives these times."""
    times = {alpha: [disappeared(run) for run in several] for alpha, several in runs.items()}
    end = next(iter(runs.values()))[0].time[-1]
    print("\nmean over the seeds and its 95 % interval; the time at which the sloshing falls under 2 l0")
    print("   alpha     disappeared [s]    energy at the end [J/kg]   given     lost  left  highest [m]")
    for alpha, several in runs.items():
        when = members.interval(times[alpha])
        energy = members.interval([run.energy[-1].sum() for run in several])
        given = np.mean([run.summary["noise_work"][-1] for run in several])
        lost = np.mean([run.energy[0].sum() - run.energy[-1].sum() for run in several]) + given
        gone = sum(int(run.fluid[0].sum() - run.fluid[-1].sum()) for run in several)
        highest = max(float(np.where(run.fluid, run.position[..., 1], 0.0).max()) for run in several)
        print(
            f"{alpha:8g}{when[0]:12.2f} ± {when[1]:5.2f}{energy[0]:20.4f} ± {energy[1]:6.4f}{given:8.4f}{lost:9.4f}"
            f"{gone:6d}{highest:13.2f}"
        )
    if 0.0 in runs and 0.003 in runs and len(runs[0.0]) > 1:
        later = ttest_ind(times[0.003], times[0.0], equal_var=False, alternative="greater")
        low, high = ttest_ind(times[0.003], times[0.0], equal_var=False).confidence_interval()
        gain = np.mean(times[0.003]) - np.mean(times[0.0])
        print(f"with 0.003 later by {gain:.2f} s ({low:.2f} to {high:.2f}), p = {later.pvalue:.3f}")
    print(f"runs end at {end:g} s")
    return times


def figures(runs: dict[float, list[mps.Run]], out: Path) -> None:
    out.mkdir(parents=True, exist_ok=True)
    _curves(runs).savefig(out / "energy.png", dpi=140)
    ends = [runs[alpha][0] for alpha in (max(a for a in runs if a < WARNED), 0.0) if alpha in runs]
    times = [time for time in TIMES if time <= ends[0].time[-1]] or [ends[0].time[-1]]
    mps.plotting.panels(ends, times, "speed", limits=(0.0, 1.0), extent=(-0.06, 2.08, -0.06, 0.9)).savefig(
        out / "frames.png", dpi=110
    )


def _curves(runs: dict[float, list[mps.Run]]) -> Figure:
    """Fig. 7, and the sloshing below it."""
    figure = Figure(figsize=(9, 7), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    for (alpha, several), color in zip(
        runs.items(), ("#1b2a3a", "#2f7fc1", "#3a9a5b", "#d9822b", "#b03060"), strict=False
    ):
        if alpha >= WARNED:
            continue
        time: Any = several[0].time
        for ax, values in (
            (above, [run.energy.sum(axis=1) for run in several]),
            (below, [sloshing(run) for run in several]),
        ):
            ax.plot(time, np.mean(values, axis=0), color=color, lw=1.4, label=f"α = {alpha:g}")
            ax.fill_between(time, np.min(values, axis=0), np.max(values, axis=0), color=color, alpha=0.2, lw=0)
    limit = 2.0 * next(iter(runs.values()))[0].spacing
    below.axhspan(-limit, limit, color="0.85", zorder=0)
    above.set(ylabel="total energy per unit mass [J/kg]", xlim=(0.0, None))
    below.set(ylabel="sloshing, first mode [m]", xlabel="t [s]", ylim=(-0.3, 0.3))
    above.legend()
    return figure


def main(
    spacing: float = 0.02,
    until: float = 15.0,
    save_every: float = 0.05,
    seeds: Sequence[int] = (0, 1, 2, 3, 4),
    alphas: Sequence[float] = ALPHAS,
    out: str = "out/stochastic_dam_break",
    reuse: bool = False,
) -> dict[float, list[float]]:
    """Runs, prints the table and draws the figures; gives the times at which the wave disappeared."""
    case, runs = mps.cases.dam_break(spacing=spacing), {}
    for alpha in (*alphas, WARNED):
        folder = Path(out) / f"alpha_{alpha:g}"
        scheme = mps.schemes.stochastic(mps.schemes.mps(), alpha=alpha)
        # The paper's warning takes a moment to show.
        end = min(until, 1.5) if alpha == WARNED else until
        runs[alpha] = members.runs(folder, case, scheme, seeds, end, save_every, reuse)
    for alpha, several in runs.items():
        for run in several:
            run.metadata["scheme"]["name"] = f"α = {alpha:g}"
    warned = runs.pop(WARNED)
    times = table(runs)
    table({WARNED: warned})
    figures(runs, Path(out))
    return times


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", default="out/stochastic_dam_break")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--alphas", type=float, nargs="+", default=ALPHAS)
    parser.add_argument("--reuse", action="store_true")
    arguments = parser.parse_args()
    main(out=arguments.out, seeds=range(arguments.seeds), alphas=arguments.alphas, reuse=arguments.reuse)
