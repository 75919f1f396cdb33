"""Surge front and energy of the collapsing column, against experiments and the original method's own computation.

python examples/dam_break.py [--out DIR]

The front is compared at three resolutions with Koshizuka & Oka 1996 and Martin & Moyce 1952; then the case of Naa,
Omata & Kazama 2011 (2171 particles) runs for 15 s.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from matplotlib.figure import Figure

import jaxmps as mps
from jaxmps.cases.dam_break import KOSHIZUKA_OKA_EXPERIMENT, KOSHIZUKA_OKA_MPS, MARTIN_MOYCE_EXPERIMENT

T = np.linspace(1.0, 2.9, 77)
"""Dimensionless times at which fronts are compared: from the collapse well under way to just before the far wall."""


class Front(NamedTuple):
    """A front Z on `T`, and its deviations, relative: largest and smallest over T."""

    z: np.ndarray
    against_mps: tuple[float, float]
    ahead_of_experiment: float
    against_martin_moyce: tuple[float, float]


def measure(run: mps.Run, company: float = 1.5) -> Front:
    """Z = x_front / a on the dimensionless times T = t √(2g / a), against what others found."""
    case = run.metadata["case"]
    front = mps.diagnostics.surge_front(run.position, run.fluid, run.spacing, company)
    time = run.time * np.sqrt(2.0 * case["gravity"] / case["width"])
    z = np.interp(T, time, front / case["width"], right=np.nan)

    def deviation(data: np.ndarray) -> tuple[float, float]:
        relative = z / np.interp(T, *data) - 1.0
        return float(np.nanmin(relative)), float(np.nanmax(relative))

    experiment = deviation(KOSHIZUKA_OKA_EXPERIMENT)[1]
    return Front(z, deviation(KOSHIZUKA_OKA_MPS), experiment, deviation(MARTIN_MOYCE_EXPERIMENT))


def fronts(spacings: tuple[float, ...], until: float, folder: Path) -> dict[float, Front]:
    """Runs the collapse at each spacing, prints the table and draws the fronts."""
    scheme, found = mps.schemes.mps(), {}
    figure = Figure(figsize=(6.6, 4.6), layout="constrained")
    ax = figure.subplots()
    print("spacing [m]  steps   Z / Z(K&O MPS) - 1     Z / Z(K&O exp.) - 1   with single drops   Z / Z(M&M exp.) - 1")
    for spacing in spacings:
        run = mps.simulate(mps.cases.dam_break(spacing=spacing), scheme, until=until, save_every=0.004)
        run.status.check()
        front = found[spacing] = measure(run)
        drops = measure(run, company=np.inf).ahead_of_experiment
        print(
            f"{spacing:11.3f} {run.summary['steps']:6d}   {front.against_mps[0]:+.3f} to {front.against_mps[1]:+.3f}"
            f"   {front.ahead_of_experiment:14.3f} at most   {drops:13.3f}   "
            f"{front.against_martin_moyce[0]:+.3f} to {front.against_martin_moyce[1]:+.3f}"
        )
        ax.plot(T, front.z, label=f"this code, spacing {spacing:g} m")
    finest = found[min(spacings)].z
    for spacing in spacings:
        distance = np.abs(found[spacing].z - finest)
        print(f"distance to the finest, spacing {spacing:g} m: mean {distance.mean():.4f}, max {distance.max():.4f}")
    ax.plot(*KOSHIZUKA_OKA_MPS, "k^", mfc="none", label="MPS, Koshizuka & Oka 1996")
    ax.plot(*KOSHIZUKA_OKA_EXPERIMENT, "ko", mfc="none", label="experiment, Koshizuka & Oka 1996")
    ax.plot(*MARTIN_MOYCE_EXPERIMENT, "ks", mfc="none", label="experiment, Martin & Moyce 1952")
    ax.set(xlabel="T = t √(2g/a)", ylabel="Z = front / a", title="Surge front of the dam break")
    ax.legend()
    figure.savefig(folder / "front.png", dpi=120)
    return found


def energies(spacing: float, until: float, folder: Path) -> mps.Run:
    """The long run: its energy, printed and drawn, and its frames in a file."""
    case, scheme = mps.cases.dam_break(spacing=spacing), mps.schemes.mps()
    run = mps.simulate(case, scheme, until=until, save_every=0.05, out=folder / "long.vtkhdf", overwrite=True)
    run.status.check()
    total = run.energy.sum(axis=1)
    print(f"{run.summary['steps']} steps to {run.time[-1]:g} s, {run.summary['fluid_particles']} fluid particles left")
    print("t [s]   energy [J/kg]   kinetic")
    for t in (0.0, 1.0, 2.0, 4.0, 6.0, 10.0, 15.0):
        if t <= until:
            i = int(np.argmin(np.abs(run.time - t)))
            print(f"{run.time[i]:5.2f} {total[i]:12.3f} {run.energy[i, 0]:12.4f}")
    mps.plotting.energy(run).savefig(folder / "energy.png", dpi=120)
    return run


def main(
    spacings: tuple[float, ...] = (0.04, 0.02, 0.01),
    until: float = 0.52,
    long_spacing: float = 0.02,
    long_until: float = 15.0,
    out: str = "out/dam_break",
) -> tuple[dict[float, Front], mps.Run]:
    """Both parts; the figures go to the folder `out`."""
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    found = fronts(spacings, until, folder)
    run = energies(long_spacing, long_until, folder)
    print(f"figures and data: {folder}")
    return found, run


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", default="out/dam_break")
    main(out=parser.parse_args().out)
