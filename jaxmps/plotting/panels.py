"""Several runs at several times, side by side, with arrows for the velocity."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxmps.flow import Kind
from jaxmps.plotting.flow import Scene, heading, new_figure
from jaxmps.results import Run
from jaxmps.validation import positive

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WIDTH, _ARROWS = 3.4, 900  # width of a panel [in]; how many arrows it may have


def panels(
    runs: Sequence[Run],
    times: Sequence[float],
    color: str = "pressure",
    *,
    arrow: float | None = None,
    limits: tuple[float, float] | None = None,
    extent: tuple[float, float, float, float] | None = None,
) -> "Figure":
    """One row for each run and one column for each of the `times` [s], in two dimensions.

    `color` is one of `COLORS`, `limits` are the values at the ends of its scale. With `arrow` [m/s] the velocities are
    drawn, and an arrow of that speed as their scale. `extent` (left, right, bottom, top) [m] is shown, by default the
    tank. A run that ended before a time shows its last frame, and says so. Raises `ValueError` for runs in 3-D.
    """
    if any(run.position.shape[2] != 2 for run in runs):
        raise ValueError(f"runs must be in 2-D, got {[run.position.shape[2] for run in runs]} dimensions")
    left, right, bottom, top = _tank(runs[0], times) if extent is None else extent
    height = _WIDTH * (top - bottom) / (right - left)
    figure = new_figure(_WIDTH * len(times) + 1.3, (height + 0.45) * len(runs) + 0.5)
    grid: Any = figure.subplots(len(runs), len(times), squeeze=False, sharex=True, sharey=True)
    figure.subplots_adjust(left=0.6 / figure.get_figwidth(), right=1.0 - 0.7 / figure.get_figwidth(), wspace=0.06)
    for run, row in zip(runs, grid, strict=True):
        for time, ax in zip(times, row, strict=True):
            index = int(np.argmin(np.abs(run.time - time)))
            scene = Scene(run, color, limits, range(index, index + 1), ax, bar=ax is row[-1], probes=False)
            scene.show(index)
            missed = time - run.time[index] > 1e-6 + 0.5 * np.diff(run.time, prepend=-1.0).min()
            ended = f"ended at t = {run.time[index]:.2f} s" if missed else f"t = {run.time[index]:.2f} s"
            ax.set(xlim=(left, right), ylim=(bottom, top), xlabel="", ylabel="")
            ax.set_title(" · ".join([*heading(run)[1:], ended]), loc="left", fontsize=9)
            if arrow is not None:
                _draw_arrows(ax, run, index, positive("arrow", arrow, "m/s"), right - left, first=ax is grid[0, 0])
    return figure


def _tank(run: Run, times: Sequence[float]) -> tuple[float, float, float, float]:
    """Corners of all particles of the first frame, walls included, of the walls at the `times` [s], which may move, and
    of the fluid of the last frame [m].
    """
    places = [run.position[0], run.position[-1][run.fluid[-1]]]
    for time in times:
        index = int(np.argmin(np.abs(run.time - time)))
        places.append(run.position[index][np.isin(run.kind[index], (Kind.WALL, Kind.DUMMY))])
    seen = np.concatenate(places)
    (left, bottom), (right, top) = seen.min(axis=0) - run.spacing, seen.max(axis=0) + run.spacing
    return left, right, bottom, top


def _draw_arrows(ax: Any, run: Run, index: int, arrow: float, width: float, first: bool) -> None:
    fluid = np.flatnonzero(run.fluid[index])
    some = np.random.default_rng(0).permutation(fluid)[:_ARROWS]  # a regular choice would show its own pattern
    style = {"angles": "xy", "scale_units": "xy", "scale": arrow / (0.12 * width), "width": 0.003, "color": "#1b1f24"}
    arrows = ax.quiver(*run.position[index, some].T, *run.velocity[index, some].T, **style)
    if first:
        ax.quiverkey(arrows, 0.88, 1.16, arrow, f"{arrow:g} m/s", labelpos="W", fontproperties={"size": 9})
