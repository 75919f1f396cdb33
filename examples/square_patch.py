"""The rotating square patch of Tsuruta, Khayyer & Gotoh 2013, §3.1 (Fig. 2), against what is known of it.

python examples/square_patch.py [--out DIR]

MPS-HS-GC breaks up, MPS-HS-GC-DS holds together, MPS-CD-GC-DS does so with the right pressure. Printed are the
quantities that are known exactly or from a boundary-element solution, a table of survival, and the convergence.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from scipy.spatial import KDTree

import jaxmps as mps
from jaxmps.cases import SQUARE_PATCH_REFERENCE


def compared() -> dict[str, mps.Scheme]:
    """The schemes of the figure."""
    return {
        "mps_hs_gc": mps.schemes.mps_hs_gc(),
        "mps_hs_gc_ds": mps.schemes.mps_hs_gc_ds(),
        # The density is not restored: nothing may pull at a surface that is being stretched.
        "mps_cd_gc_ds": mps.schemes.mps_cd_gc_ds(restoring=0.0),
    }


class Row(NamedTuple):
    """The patch at one time: ratios to the start, relative errors against the reference, or fractions."""

    time: float
    energy: float  # kinetic, over that of the start
    momentum: float  # angular, over that of the start
    tip: float  # largest relative error of the four corner particles
    waist: float
    pressure: float  # at the center: mean within 0.1 L and over ±0.02 s
    noise: float  # standard deviation of the mean within 0.1 L over ±0.02 s, over the reference
    lonely: float  # fraction of particles without a neighbor within 1.5 spacings
    symmetry: float  # 95th percentile of the distance to a particle turned by 90°, in spacings
    closest: float  # in spacings


def waist(position: np.ndarray, spacing: float, window: int = 10) -> float:
    """Smallest distance [m] of the surface from the center: where rays leave the fluid, averaged over the four sides
    and over `window` degrees.
    """
    angles, radii = np.radians(np.arange(360)), np.arange(0.1, 1.6, 0.1 * spacing)
    points = radii[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    wet = KDTree(position).query(points)[0] <= spacing
    # Discs of one spacing reach 0.45 spacings beyond the fluid, which ends half a spacing outside the centers.
    leave = np.where(wet.all(axis=0), radii[-1], radii[np.argmin(wet, axis=0)]) - 0.45 * spacing
    side = leave.reshape(4, 90).mean(axis=0)
    return float(np.convolve(np.concatenate([side, side[: window - 1]]), np.ones(window) / window, "valid").min())


def measure(run: mps.Run) -> list[Row]:
    """One row for each time of the reference that the run has reached; ω = 1 rad/s, L = 1 m."""
    start, rows = run.position[0], []
    corners = [int(np.argmin(np.hypot(*(start - 0.5 * np.array(c)).T))) for c in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    momentum = np.mean(
        run.position[..., 1] * run.velocity[..., 0] - run.position[..., 0] * run.velocity[..., 1], axis=1
    )
    center = [p[np.hypot(*x.T) < 0.1].mean() for x, p in zip(run.position, run.pressure, strict=True)]
    nearest = mps.diagnostics.nearest(run)
    for time, _, _, r_min, p_center in SQUARE_PATCH_REFERENCE[1:]:
        if time > run.time[-1] + 1e-9:
            break
        k = int(np.argmin(np.abs(run.time - time)))
        x = run.position[k]
        law = np.hypot(*start[corners].T) * np.sqrt(1.0 + time**2)
        near = np.array([p for p, t in zip(center, run.time, strict=True) if abs(t - time) <= 0.0201])
        exact = 1000.0 * p_center
        turned = KDTree(x).query(np.stack([-x[:, 1], x[:, 0]], axis=1))[0]
        rows.append(
            Row(
                time=time,
                energy=run.energy[k, 0] / run.energy[0, 0],
                momentum=momentum[k] / momentum[0],
                tip=float(np.abs(np.hypot(*x[corners].T) / law - 1.0).max()),
                waist=waist(x, run.spacing) / r_min - 1.0,
                pressure=near.mean() / exact - 1.0,
                noise=near.std() / abs(exact),
                lonely=float(np.mean(nearest[k] > 1.5)),
                symmetry=float(np.percentile(turned, 95) / run.spacing),
                closest=float(nearest[k].min()),
            )
        )
    return rows


def show(name: str, run: mps.Run) -> list[Row]:
    """Prints the table of a run."""
    rows, summary = measure(run), run.summary
    print(f"\n{name}: {run.status}, {summary['steps']} steps")
    print(
        f"closest pair {summary['closest_pair']:.3f} spacings, {summary['stabilized_pairs']:.1f} pairs stabilized in a "
        f"step, work of the stabilizer {summary['stabilizer_work'] / run.time[-1]:+.2e} W/kg"
    )
    print("  ωt   energy  momentum     tip   waist  pressure  noise  lonely  symmetry  closest")
    for r in rows:
        print(
            f"{r.time:4.2f}   {r.energy:6.4f}    {r.momentum:6.4f}  {r.tip:6.4f}  {r.waist:+.3f}    {r.pressure:+.3f}"
            f"  {r.noise:.3f}  {r.lonely:.4f}    {r.symmetry:6.3f}    {r.closest:.3f}"
        )
    return rows


def survival(spacing: float, until: float, seeds: int, steps: Sequence[float | None]) -> dict[str, list[list[float]]]:
    """Times of break-up for seeds of a jitter of 0.02 spacings, of MPS-HS-GC also for several time steps."""
    case, found = mps.cases.square_patch(spacing=spacing), {}
    corner = float(np.hypot(*case.particles.velocity[0]))
    print("\nbreak-up [s]: some speed above ten times that of the corners, or two particles closer than 0.1 spacings")
    print("scheme         time step   " + "  ".join(f"seed {seed}" for seed in range(seeds)))
    for name, scheme in compared().items():
        found[name] = []
        for dt in steps if name == "mps_hs_gc" else steps[:1]:
            times = []
            for seed in range(seeds):
                jittered = mps.cases.jitter(case, 0.02, jax.random.key(seed))
                run = mps.simulate(jittered, scheme, until=until, save_every=until / 200, dt=dt, progress=False)
                times.append(mps.diagnostics.breakup(run, corner))
            found[name].append(times)
            label = "0.1 d / u_max" if dt is None else f"{1e3 * dt:g} ms"
            told = "  ".join("  none" if np.isinf(t) else f"{t:6.2f}" for t in times)
            print(f"{name:12}  {label:>13}  {told}")
    return found


def converge(spacings: Sequence[float], until: float) -> dict[float, tuple[float, float]]:
    """Mean relative errors of a corner particle's distance from the center: against the exact tip of the fluid, and
    against the same law for the place where the particle starts, half a spacing inside.
    """
    errors = {}
    print("\nmps_cd_gc_ds, spacing [m]   mean error against (L/√2) √(1 + ω²t²)   against r(0) √(1 + ω²t²)")
    for spacing in spacings:
        case = mps.cases.square_patch(spacing=spacing)
        run = mps.simulate(case, compared()["mps_cd_gc_ds"], until=until, save_every=0.05, progress=False)
        r = np.hypot(*run.position[:, int(np.argmax(np.sum(run.position[0], axis=1)))].T)
        tip = np.asarray(mps.cases.square_patch_tip(run.time)[0])
        errors[spacing] = tuple(float(np.mean(np.abs(r / law - 1.0))) for law in (tip, tip * r[0] / tip[0]))
        print(f"{spacing:25.3f}   {errors[spacing][0]:37.4f}   {errors[spacing][1]:24.4f}   {run.status}")
    return errors


def main(
    spacing: float = 0.02,
    until: float = 2.0,
    spacings: Sequence[float] = (0.04, 0.02, 0.01),
    seeds: int = 5,
    steps: Sequence[float | None] = (None, 1e-3, 5e-4),
    out: str = "out/square_patch",
) -> tuple[dict[str, list[Row]], dict[str, list[list[float]]], dict[float, tuple[float, float]]]:
    """All tables and the figure, which goes to the folder `out`. Returns what was printed."""
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    case, runs, rows = mps.cases.square_patch(spacing=spacing), [], {}
    for name, scheme in compared().items():
        runs.append(mps.simulate(case, scheme, until=until, save_every=0.01, progress=False))
        rows[name] = show(name, runs[-1])
    times = (0.84, 1.5, 2.0) if until >= 2.0 else (0.5 * until, until)
    figure = mps.plotting.panels(runs, times, limits=(-130.0, 10.0), extent=(-1.6, 1.6, -1.6, 1.6))
    figure.savefig(folder / "square_patch.png", dpi=80, bbox_inches="tight")
    broken = survival(spacing, until, seeds, steps)
    errors = converge(spacings, until)
    print(f"figure: {folder / 'square_patch.png'}")
    return rows, broken, errors


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", default="out/square_patch")
    main(out=parser.parse_args().out)
