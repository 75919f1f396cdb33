"""A tank that sways a little, against linear theory, and one that rolls at resonance until the water hits its walls.

python examples/sloshing.py [--out DIR] [--spacing L0] [--until T]

The small waves: the elevation at the left wall of a tank of 0.9 m that sways from rest, below its first resonance and
next to it, and the free waves after a tilt, whose frequency is that of the first mode. The elevation is that of the
first three odd modes of the water's volume, β_n = (2 / L) Σ l0² cos k_n x_i, which needs no surface to be found.
"""

import argparse
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import curve_fit

import jaxmps as mps

LENGTH, DEPTH = 0.9, 0.3  # m
SWAY = 0.015  # m
RATIOS = (0.8, 1.1)  # of the frequency to that of the first mode
TILT = 3.0  # degrees


class Sway(NamedTuple):
    """Elevation at the left wall [m] against time [s], measured and by theory; how much as large, and as fast."""

    time: np.ndarray
    measured: np.ndarray
    theory: np.ndarray

    @property
    def amplitude(self) -> float:
        return float(self.measured.std() / self.theory.std())

    @property
    def largest(self) -> float:
        return float(np.abs(self.measured).max() / np.abs(self.theory).max())

    @property
    def frequency(self) -> float:
        """By the number by which time must be stretched for the best fit of the theory."""
        stretched = lambda t, size, pace: size * np.interp(pace * t, self.time, self.theory)  # noqa: E731
        most = 0.9 * self.time[-1]
        early = self.time <= most
        return float(curve_fit(stretched, self.time[early], self.measured[early], (1.0, 1.0))[0][1])


def tank(spacing: float, **changes: Any) -> mps.Case:
    return mps.cases.sloshing(spacing=spacing, length=LENGTH, height=0.5, depth=DEPTH, **changes)


def inside(case: mps.Case) -> tuple[float, float]:
    """Length and depth in whole spacings [m]."""
    given, spacing = dict(case.parameters), case.spacing
    return round(given["length"] / spacing) * spacing, round(given["depth"] / spacing) * spacing


def modes(case: mps.Case, run: mps.Run, numbers: tuple[int, ...] = (1, 3, 5)) -> np.ndarray:
    """Amplitudes β_n [m] in each frame `(m, modes)`, in the frame of the tank."""
    seen, length = mps.diagnostics.relative(run, case.motion), inside(case)[0]
    phases = np.array(numbers) * math.pi / length * seen.position[:, :, :1]
    wet = seen.fluid[:, :, None]
    return 2.0 / length * run.spacing**2 * np.sum(np.where(wet, np.cos(phases), 0.0), axis=1)


def sway(spacing: float, ratio: float, until: float) -> Sway:
    """A tank that sways at `ratio` times its first natural frequency, from rest."""
    frequency = ratio * float(mps.cases.sloshing_frequency(1, LENGTH, DEPTH))
    motion = {"kind": "sway", "amplitude": SWAY, "period": 2.0 * math.pi / frequency, "phase": -90.0}
    case = tank(spacing, **motion)
    run = mps.simulate(case, mps.schemes.mps_hs_gc_ds(), until=until, save_every=0.02)
    run.status.check()
    length, depth = inside(case)
    theory = mps.cases.sloshing_linear(
        run.time, amplitude=SWAY, frequency=frequency, phase=-0.5 * math.pi, length=length, depth=depth
    )
    return Sway(run.time, modes(case, run).sum(axis=1), np.asarray(theory))


def free(spacing: float, until: float) -> tuple[float, float]:
    """Frequency of the first mode after a tilt over that of theory, and the rate of its decay [1/s]."""
    case = tank(spacing, amplitude=0.0, tilt=TILT)
    run = mps.simulate(case, mps.schemes.mps_hs_gc_ds(), until=until, save_every=0.02)
    run.status.check()
    beta, own = modes(case, run)[:, 0], float(mps.cases.sloshing_frequency(1, *inside(case)))

    def decaying(t, size, frequency, phase, decay):
        return size * np.exp(-decay * t) * np.cos(frequency * t + phase)

    _, frequency, _, decay = curve_fit(decaying, run.time, beta, (beta[0], own, 0.0, 0.1))[0]
    return frequency / own, decay


def resonance(spacing: float, until: float) -> tuple[mps.Run, np.ndarray]:
    """The rolling tank of the benchmark in its own frame, and the pressure [Pa] at its left wall at the still level."""
    case = mps.cases.sloshing(spacing=spacing)
    run = mps.simulate(case, mps.schemes.mps_cd_gc_ds(), until=until, save_every=0.02)
    run.status.check()
    seen = mps.diagnostics.relative(run, case.motion)
    return run, mps.diagnostics.pressure_at(seen, [[0.0, 0.093]])[:, 0]


def draw(waves: dict[float, Sway], run: mps.Run, pressure: np.ndarray, path: Path) -> None:
    figure = Figure(figsize=(7.2, 8.0), layout="constrained")
    axes = figure.subplots(len(waves) + 2, 1)
    for ax, (ratio, wave) in zip(axes, waves.items(), strict=False):
        ax.plot(wave.time, 100.0 * wave.theory, "k", lw=1.0, label="linear theory")
        ax.plot(wave.time, 100.0 * wave.measured, "C3", lw=1.2, label="MPS-HS-GC-DS")
        ax.set(ylabel="elevation [cm]", title=f"left wall, sway of {SWAY} m at {ratio:g} ω₁", xlabel="time [s]")
    axes[0].legend(loc="upper left")
    axes[-2].plot(run.time, pressure, lw=1.0)
    axes[-2].set(xlabel="time [s]", ylabel="pressure [Pa]", title="roll of 4° at ω₁: left wall, still level")
    last = int(np.argmax(pressure))
    shown = run.kind[last] < 3
    colors = np.where(run.fluid[last], run.pressure[last], np.nan)[shown]
    axes[-1].scatter(*run.position[last][shown].T, s=1.0, c="0.7")
    axes[-1].scatter(*run.position[last][shown].T, s=1.0, c=colors, cmap="viridis")
    axes[-1].set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title=f"t = {run.time[last]:.2f} s", ylim=(-0.1, 0.4))
    figure.savefig(path, dpi=110)


def main(
    spacing: float = 0.01, until: float = 5.0, rolling: float = 0.0062, out: str = "out/sloshing"
) -> tuple[dict[float, Sway], tuple[float, float]]:
    """`spacing` of the small waves and of the `rolling` tank [m]; `until` in s."""
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    waves = {ratio: sway(spacing, ratio, until) for ratio in RATIOS}
    print("frequency / first mode   amplitude, largest and frequency over those of theory")
    for ratio, wave in waves.items():
        print(f"{ratio:22.2f}   {wave.amplitude:.3f}   {wave.largest:.3f}   {wave.frequency:.3f}")
    pace, decay = free(spacing, until)
    print(f"free waves after a tilt: frequency over that of theory {pace:.3f}, decay {decay:.3f} 1/s", flush=True)
    run, pressure = resonance(rolling, until)
    print(f"rolling tank at resonance: up to {pressure.max():.0f} Pa at the wall at the still level")
    draw(waves, run, pressure, folder / "sloshing.png")
    return waves, (pace, decay)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", default="out/sloshing")
    parser.add_argument("--spacing", type=float, default=0.01)
    parser.add_argument("--until", type=float, default=5.0)
    given = parser.parse_args()
    main(given.spacing, given.until, out=given.out)
