"""The standing wave of Naa, Omata & Kazama 2011, §5.2: their Figs. 9, 10 and 11, and what other schemes make of it.

python examples/standing_wave.py [--out DIR] [--seeds N] [--spacing L0] [--names NAME ...] [--reuse] [--small]

Standard MPS and stochastic MPS with α = 0.02, 0.03, 0.04, published and free of drift, the same with the antisymmetric
gradient of CMPS, which has no drift of its own, and MPS-HS-GC-DS and MPS-CD-GC-DS with and without the stochastic
velocity, five seeds each. With --reuse the runs of an earlier call are read from its files, and only seeds that are
missing there are run. With --small instead the period of a wave of 0.01 m, the honest test of dispersion.
"""

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import seeds as members
from matplotlib.figure import Figure

import jaxmps as mps

LENGTH = 1.0  # m
MODES = 4  # of the cosine fit: crests are sharper than two can be
STANDS = (0.0, 3.0)  # s: while the wave of every scheme stands
GONE = 4.5  # s: when that of the standard method has gone ([N11]: 3.5 s)


class Wave(NamedTuple):
    """Of one run: amplitude of the first mode at its extremes, the decay rate of the energy, fit error and drift."""

    decay: float  # 1/s, of the energy: twice that of the amplitude
    error: float  # mean relative error of the parabola while the wave stands
    drift: float  # m/s, |mean u_x| after the wave of the standard method has gone
    given: float  # J/kg that the noise gave in all


def schemes() -> dict[str, mps.Scheme]:
    basic, stabilized = mps.schemes.mps(), mps.schemes.mps_hs_gc_ds()
    centered = mps.schemes.mps_cd_gc_ds(kept_velocity=1.0)
    stochastic = mps.schemes.stochastic
    # Momentum along the smooth floor is conserved to round-off.
    antisymmetric = dataclasses.replace(basic, gradient=mps.operators.CMPS(), name="mps with the gradient of cmps")
    return {
        "basic": basic,
        "alpha 0.02": stochastic(basic, alpha=0.02),
        "alpha 0.03": stochastic(basic, alpha=0.03),
        "alpha 0.04": stochastic(basic, alpha=0.04),
        "alpha 0.04, drift-free": stochastic(basic, alpha=0.04, drift_free=True),
        "CMPS": antisymmetric,
        "CMPS, alpha 0.04": stochastic(antisymmetric, alpha=0.04),
        "CMPS, alpha 0.04, drift-free": stochastic(antisymmetric, alpha=0.04, drift_free=True),
        "HS-GC-DS": stabilized,
        "HS-GC-DS, alpha 0.04": stochastic(stabilized, alpha=0.04),
        "CD-GC-DS": centered,
        "CD-GC-DS, alpha 0.04": stochastic(centered, alpha=0.04),
    }


def fit(run: mps.Run) -> Any:
    return mps.diagnostics.wave_fit(run, period=LENGTH, modes=MODES)


def measure(run: mps.Run, wave: Any) -> Wave:
    time, signed = run.time, _first_mode(wave)
    inside = (time >= STANDS[0]) & (time <= STANDS[1]) & np.isfinite(signed)
    # Extremes of the first mode, positive and negative: a straight line through the logarithms of their sizes.
    size = np.abs(signed)
    top = np.flatnonzero((size[1:-1] >= size[:-2]) & (size[1:-1] > size[2:])) + 1
    top = np.array([k for k in [0, *top] if inside[k] and size[k] > 1e-3])
    slope = np.polyfit(time[top], np.log(size[top]), 1)[0] if len(top) > 2 else np.nan
    late = time >= min(GONE, 0.75 * time[-1])
    u_x = np.array([u[f, 0].mean() for u, f in zip(run.velocity[late], run.fluid[late], strict=True)])
    return Wave(
        -2.0 * float(slope),
        float(np.nanmean(wave.error[inside])),
        float(np.abs(u_x).mean()),
        run.summary["noise_work"][-1],
    )


def _first_mode(wave: Any) -> np.ndarray:
    """The first mode at the center [m]: its amplitude with the sign of a crest there."""
    return wave.amplitude[:, 0] * np.cos(2.0 * np.pi * (0.5 - wave.crest[:, 0] / LENGTH))


def crests(time: np.ndarray, elevation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and heights [m] of the maxima above the mean level after 0.3 s: vertices of parabolas through the three
    values about each, after a Gaussian of 0.03 s."""
    kernel = np.exp(-0.5 * ((time[:, None] - time) / 0.03) ** 2)
    smooth = kernel @ np.nan_to_num(elevation) / (kernel @ np.isfinite(elevation))
    before, here, after = smooth[:-2], smooth[1:-1], smooth[2:]
    k = np.flatnonzero((here >= before) & (here > after) & (here > 0.0) & (time[1:-1] > 0.3))
    bend = before[k] - 2.0 * here[k] + after[k]
    vertex = 0.5 * (before[k] - after[k]) / bend
    found, height = time[k + 1] + vertex * (time[1] - time[0]), here[k] - 0.125 * (before[k] - after[k]) ** 2 / bend
    apart = np.diff(found, prepend=-1.0) > 0.4
    return found[apart], height[apart]


def compare(runs: dict[str, list[mps.Run]], waves: dict[str, list[Any]]) -> dict[str, list[Wave]]:
    """Prints the table, and what the paper finds, as numbers."""
    measured = {name: [measure(*pair) for pair in zip(runs[name], waves[name], strict=True)] for name in runs}
    print("\nmean over the seeds and its 95 % interval; the decay rate is that of the wave's energy up to 3 s")
    print(f"{'':30}{'decay [1/s]':>18}{'fit error':>12}{'drift [m/s]':>22}{'given [J/kg]':>14}{'lost [J/kg]':>13}")
    for name, several in measured.items():
        decay, drift = (members.interval([getattr(w, field) for w in several]) for field in ("decay", "drift"))
        error, given = (np.mean([getattr(w, field) for w in several]) for field in ("error", "given"))
        lost = np.mean([run.energy[0].sum() - run.energy[-1].sum() for run in runs[name]]) + given
        print(
            f"{name:30}{decay[0]:8.3f} ± {decay[1]:5.3f}{100 * error:11.2f}%{drift[0]:12.2e} ± {drift[1]:7.1e}"
            f"{given:14.4f}{lost:13.4f}"
        )
    reference = mps.cases.standing_wave_reference()
    when, height = crests(reference[:, 0], reference[:, 1])
    print("\ncrests at the center against the nonlinear reference: time, height")
    for name, several in waves.items():
        found = [crests(wave.time, wave.center) for wave in several]
        count = min(len(when), *(len(t) for t, _ in found))
        lag = np.mean([t[:count] / when[:count] - 1.0 for t, _ in found], axis=0) if count else np.array([])
        size = np.mean([h[:count] / height[:count] for _, h in found], axis=0) if count else np.array([])
        print(f"{name:30}" + "  ".join(f"{100 * a:+5.1f}% {b:4.2f}" for a, b in zip(lag, size, strict=True)))
    return measured


def figures(runs: dict[str, list[mps.Run]], waves: dict[str, list[Any]], out: Path) -> None:
    out.mkdir(parents=True, exist_ok=True)
    _height(waves).savefig(out / "height.png", dpi=140)
    _energy(runs).savefig(out / "energy.png", dpi=140)
    _surface(next(iter(runs.values()))[0]).savefig(out / "surface.png", dpi=140)


def _height(waves: dict[str, list[Any]]) -> Figure:
    """Fig. 10: elevation at the center, with all four reference curves."""
    figure = Figure(figsize=(9, 6.4), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True, sharey=True)
    time, nonlinear = mps.cases.standing_wave_reference()[:, :2].T
    end = next(iter(waves.values()))[0].time[-1]
    groups = (("basic", "alpha 0.04"), ("HS-GC-DS", "CD-GC-DS", "CD-GC-DS, alpha 0.04"))
    for ax, names in zip(axes, groups, strict=True):
        ax.plot(time, nonlinear, color="k", lw=1.4, label="nonlinear")
        ax.plot(time, mps.cases.standing_wave_linear(time), color="0.7", lw=0.8, label="linear")
        ax.plot(time, mps.cases.standing_wave_wu_taylor(time), color="0.55", lw=0.8, ls="--", label="Wu & Taylor")
        ax.plot(time, mps.cases.standing_wave_second_order(time), color="0.4", lw=0.8, ls=":", label="second order")
        for name, color in zip((n for n in names if n in waves), ("#2f7fc1", "#d9822b", "#3a9a5b"), strict=False):
            center = np.array([wave.center for wave in waves[name]])
            ax.plot(waves[name][0].time, np.nanmean(center, axis=0), color=color, lw=1.8, label=name)
            ax.fill_between(
                waves[name][0].time, np.nanmin(center, axis=0), np.nanmax(center, axis=0), color=color, alpha=0.25
            )
        ax.set(ylabel="elevation at the center [m]", xlim=(0.0, end))
        ax.legend(ncols=4, fontsize=8, loc="upper right")
    axes[-1].set(xlabel="t [s]")
    return figure


def _energy(runs: dict[str, list[mps.Run]]) -> Figure:
    """Fig. 11: total energy, mean and spread over the seeds."""
    figure = Figure(figsize=(9, 4.2), layout="constrained")
    ax = figure.subplots()
    for (name, several), color in zip(runs.items(), _colors(len(runs)), strict=True):
        total = np.array([run.energy.sum(axis=1) for run in several])
        ax.plot(several[0].time, total.mean(axis=0), color=color, lw=1.6, label=name)
        ax.fill_between(several[0].time, total.min(axis=0), total.max(axis=0), color=color, alpha=0.2)
    ax.set(xlabel="t [s]", ylabel="total energy per unit mass [J/kg]", xlim=(0.0, None))
    ax.legend(fontsize=8)
    return figure


def _surface(run: mps.Run) -> Figure:
    """Fig. 9: the traced surface and both curves through it, at rest and at the second crest."""
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    times = (0.0, min(0.8, run.time[-1]))
    for ax, time in zip(figure.subplots(1, 2, sharey=True), times, strict=True):
        k = int(np.argmin(np.abs(run.time - time)))
        surface = mps.diagnostics.trace(run, period=LENGTH)[k]
        x, y = run.position[k, run.fluid[k]].T
        ax.plot(x, y, ".", ms=3, color="#8fb8de")
        x, y = run.position[k, surface.particles].T.astype(float)
        ax.plot(x, y, "o", ms=3.5, color="#1b2a3a", label="traced")
        fine = np.linspace(0.0, LENGTH, 200)
        parabola = mps.diagnostics.fit_parabola(x, y, LENGTH)
        ax.plot(fine, parabola.a * fine**2 + parabola.b * fine + parabola.c, color="#d9822b", label="parabola")
        ax.set(
            title=f"t = {run.time[k]:.2f} s, mean error {100 * parabola.error:.1f} %", xlabel="x [m]", ylabel="y [m]"
        )
        ax.legend(fontsize=8, loc="lower right")
    return figure


def _colors(count: int) -> list[Any]:
    import matplotlib

    return [matplotlib.colormaps["tab10"](k % 10) for k in range(count)]


def small_wave(spacing: float = 0.01, until: float = 3.5) -> dict[str, float]:
    """Prints the mean period of a wave of 0.01 m relative to that of linear theory, between the first and the last zero
    of its first mode. That is measured by the volume of the particles: the surface has but two heights at the start.
    """
    case, periods = mps.cases.standing_wave(spacing=spacing, amplitude=0.01, floor="mirror"), {}
    expected = 2.0 * np.pi / float(mps.cases.standing_wave_frequency())
    for name in ("HS-GC-DS", "CD-GC-DS"):
        run = mps.simulate(case, schemes()[name], until=until, save_every=0.01)
        mode = 2.0 * spacing**2 / LENGTH * np.cos(2.0 * np.pi * (run.position[..., 0] / LENGTH - 0.5)).sum(axis=1)
        k = np.flatnonzero((mode[:-1] > 0.0) != (mode[1:] > 0.0))
        zero = run.time[k] + 0.01 * mode[k] / (mode[k] - mode[k + 1])
        periods[name] = 2.0 * float(zero[-1] - zero[0]) / (len(zero) - 1) / expected
        print(f"{name}: {len(zero) - 1} half periods, on average {100 * (periods[name] - 1):+.1f} % of linear theory")
    return periods


def main(
    spacing: float = 0.02,
    until: float = 6.0,
    save_every: float = 0.02,
    seeds: Sequence[int] = (0, 1, 2, 3, 4),
    names: Sequence[str] | None = None,
    floor: str = "mirror",
    out: str = "out/standing_wave",
    reuse: bool = False,
) -> dict[str, list[Wave]]:
    """Runs, prints the tables and draws the figures."""
    case, runs = mps.cases.standing_wave(spacing=spacing, floor=floor), {}
    for name, scheme in schemes().items():
        if names is not None and name not in names:
            continue
        folder = Path(out) / name.replace(", ", "_").replace(" ", "_")
        runs[name] = members.runs(folder, case, scheme, seeds, until, save_every, reuse)
    waves = {name: [fit(run) for run in several] for name, several in runs.items()}
    measured = compare(runs, waves)
    figures(runs, waves, Path(out))
    return measured


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", default="out/standing_wave")
    parser.add_argument("--floor", default="mirror", choices=("mirror", "wall"))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--spacing", type=float, default=0.02, help="m")
    parser.add_argument("--names", nargs="+", help="some of the schemes only, such as CD-GC-DS")
    parser.add_argument("--reuse", action="store_true")
    parser.add_argument("--small", action="store_true")
    arguments = parser.parse_args()
    if arguments.small:
        small_wave()
    else:
        main(
            spacing=arguments.spacing,
            seeds=range(arguments.seeds),
            names=arguments.names,
            floor=arguments.floor,
            out=arguments.out,
            reuse=arguments.reuse,
        )
