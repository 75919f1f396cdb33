"""Water at rest in two and three dimensions: pressure against ρ g (H − y), height and spurious motion.

python examples/hydrostatic.py [--out DIR]
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from matplotlib.figure import Figure

import jaxmps as mps


class Rest(NamedTuple):
    """How well a tank stays at rest: over the whole run, or over all frames after `settled` where it says mean."""

    pressure: float  # mean pressure of the bottom row, over the exact one
    height: float  # largest deviation of the water's height from its start, relative
    kinetic: float  # largest kinetic energy, over g H


def measure(run: mps.Run, settled: float = 0.2) -> Rest:
    """The figures of a run of `cases.hydrostatic`; pressure is averaged over t ≥ `settled` [s]."""
    fluid, elevation = run.fluid[0], run.position[..., -1]
    height = float(run.metadata["case"]["height"])
    bottom = fluid & (elevation[0] < run.spacing)
    late = run.time >= settled
    p = run.pressure[late][:, bottom].mean()
    exact = mps.cases.hydrostatic_pressure(elevation[late][:, bottom], height).mean()
    mean_height = 2.0 * elevation[:, fluid].mean(axis=1)
    kinetic = run.energy[:, 0].max() / (9.81 * height)
    return Rest(float(p / exact), float(np.abs(mean_height / height - 1.0).max()), float(kinetic))


def profile(run: mps.Run, settled: float) -> tuple[np.ndarray, np.ndarray]:
    """Elevation [m] and pressure [Pa] of each row of fluid, averaged over the row and over t ≥ `settled` [s]."""
    fluid, start = run.fluid[0], run.position[0, :, -1]
    rows = np.unique(np.round(start[fluid] / run.spacing, 3))
    members = [fluid & np.isclose(start / run.spacing, row, atol=0.01) for row in rows]
    late = run.time >= settled
    elevation = [run.position[late][:, row, -1].mean() for row in members]
    return np.array(elevation), np.array([run.pressure[late][:, row].mean() for row in members])


def main(
    spacing: float = 0.02,
    height: float = 0.4,
    until: float = 1.0,
    out: str = "out/hydrostatic",
    names: Sequence[str] = ("2-D", "3-D"),
) -> dict[str, Rest]:
    """Runs the tanks, prints the table and draws the profiles."""
    tanks = {
        "2-D": mps.cases.hydrostatic(spacing=spacing, length=height, height=height),
        "3-D": mps.cases.hydrostatic(spacing=spacing, length=height / 2, depth=height / 2, height=height),
    }
    tanks = {name: tanks[name] for name in names}
    figure = Figure(figsize=(4 * len(tanks), 3.6), layout="constrained")
    axes = figure.subplots(1, len(tanks), sharey=True, squeeze=False)[0]
    results = {}
    print("tank  particles   bottom p / exact   max |height / H - 1|   max kinetic / (g H)")
    for ax, (name, case) in zip(axes, tanks.items(), strict=True):
        run = mps.simulate(case, mps.schemes.mps(), until=until, save_every=until / 50)
        run.status.check()
        result = results[name] = measure(run, 0.2 * until)
        print(
            f"{name}   {run.position.shape[1]:9d}   {result.pressure:16.4f}   {result.height:20.4f}   "
            f"{result.kinetic:19.2e}"
        )
        elevation, pressure = profile(run, 0.2 * until)
        ax.plot(mps.cases.hydrostatic_pressure(elevation, height), elevation, "k-", label="ρ g (H − y)")
        ax.plot(pressure, elevation, "o", ms=4, label="standard MPS, mean")
        ax.set(title=f"{name}, {run.position.shape[1]} particles", xlabel="pressure [Pa]")
        ax.legend()
    axes[0].set_ylabel("elevation [m]")
    Path(out).mkdir(parents=True, exist_ok=True)
    figure.savefig(Path(out) / "profiles.png", dpi=120)
    print(f"figure: {Path(out) / 'profiles.png'}")
    return results


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="out/hydrostatic")
    main(out=parser.parse_args().out)
