"""Four flows side by side, as the README shows them: a dam break, a rolling tank, a tank of one's own, an ensemble.

python examples/strip.py [--out DIR] [--finer F]
"""

import argparse
from pathlib import Path
from typing import Any

import jax
import numpy as np
from matplotlib.figure import Figure

import jaxmps as mps

TANK = Path(__file__).parent / "cases" / "l_shaped_tank.toml"
SHOWN = {"dam break": 0.9, "rolling tank": 2.46, "own geometry": 0.6}
"""The time of the picture [s]."""
SHAPE = 0.8  # of a picture, height over width


def flows(finer: float, length: float) -> dict[str, mps.Run]:
    """The three runs, with spacings divided by `finer`, up to `length` times the time that is shown."""
    own = mps.casefile.CaseFile(TANK).build(spacing=0.02 / finer)
    made = {
        "dam break": (mps.cases.dam_break(spacing=0.02 / finer), mps.schemes.mps()),
        "rolling tank": (mps.cases.sloshing(spacing=0.01 / finer, height=0.3), mps.schemes.mps_cd_gc_ds()),
        "own geometry": (own.case, own.scheme),
    }
    return {
        name: mps.simulate(*parts, until=length * SHOWN[name], save_every=length * SHOWN[name] / 4)
        for name, parts in made.items()
    }


def dams(members: int, finer: float, length: float) -> mps.Ensemble:
    """Dam breaks from starts that differ by a hundredth of a spacing."""
    case = mps.cases.dam_break(spacing=0.04 / finer)
    keys = jax.random.split(jax.random.key(0), members)
    starts = [mps.cases.jitter(case, 0.01, key) for key in keys]
    times = {"until": 1.2 * length, "save_every": 0.02 * length}
    return mps.ensemble(starts, mps.schemes.mps(), keys=keys, **times, keep_frames=False)


def draw_flow(ax: Any, name: str, run: mps.Run) -> None:
    """Particles by their speed, and the walls where they are now."""
    from matplotlib.collections import EllipseCollection

    place, fluid = run.position[-1], run.fluid[-1]
    speed = np.linalg.norm(run.velocity[-1], axis=1)
    water = {"array": speed[fluid], "cmap": "GnBu_r", "clim": (0.0, 1.2 * np.quantile(speed[fluid], 0.98))}
    for shown, style in (
        (run.kind[-1] == mps.Kind.DUMMY, {"fc": "#d0d4d9"}),
        (run.kind[-1] == mps.Kind.WALL, {"fc": "#808790"}),
        (fluid, water),
    ):
        size = [run.spacing]
        ax.add_collection(
            EllipseCollection(
                size, size, [0.0], units="x", offsets=place[shown], offset_transform=ax.transData, lw=0, **style
            )
        )
    left, right = place[~fluid, 0].min() - run.spacing, place[~fluid, 0].max() + run.spacing
    low = place[~fluid, 1].min() - run.spacing
    height = SHAPE * (right - left)
    # A shallow tank stands in the middle of its picture.
    low -= max(0.0, 0.5 * (low + height - place[:, 1].max()))
    ax.set(xlim=(left, right), ylim=(low, low + height), aspect="equal")
    ax.set_axis_off()
    ax.set_title(f"{name}, t = {run.time[-1]:.2f} s", fontsize=13)


def draw(runs: dict[str, mps.Run], many: mps.Ensemble, path: Path) -> None:
    figure = Figure(figsize=(15.0, 3.4))
    for number, (name, run) in enumerate(runs.items()):
        draw_flow(figure.add_axes((0.005 + 0.244 * number, 0.04, 0.235, 0.84)), name, run)
    band = figure.add_axes((0.785, 0.16, 0.205, 0.72))
    mps.plotting.bands(many, ["top"], ax=[band])
    band.set_title(f"{len(many)} dam breaks", fontsize=13)
    figure.savefig(path, dpi=110)


def main(
    finer: float = 1.0, members: int = 64, length: float = 1.0, out: str = "out/strip"
) -> tuple[dict[str, mps.Run], mps.Ensemble]:
    """`finer` divides the spacings, `length` shortens the times."""
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    runs, many = flows(finer, length), dams(members, finer, length)
    for run in runs.values():
        run.status.check()
    print(f"energy at the end: {many.mean('energy')[-1]:.3f} ± {np.sqrt(many.variance('energy')[-1]):.3f} J/kg")
    draw(runs, many, folder / "strip.png")
    return runs, many


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", default="out/strip")
    parser.add_argument("--finer", type=float, default=1.0)
    given = parser.parse_args()
    main(given.finer, out=given.out)
