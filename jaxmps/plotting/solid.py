"""What there is to see in three dimensions, with matplotlib: fluid as discs, walls as their edges, probes."""

from typing import Any

import numpy as np

from jaxmps.diagnostics import Probe
from jaxmps.plotting.colors import INK, WALL
from jaxmps.plotting.shell import carried, shell
from jaxmps.results import Run

ELEVATION, AZIMUTH = 22.0, -64.0  # of the eye, in degrees


class Solid:
    """The artists of a picture in 3-D axes of matplotlib; `mapped` has the colors of the fluid."""

    flat = False

    def __init__(
        self, axes: Any, run: Run, ever: np.ndarray, frames: range, probes: list[Probe], mapped: dict[str, Any]
    ):
        from mpl_toolkits.mplot3d.art3d import Line3DCollection

        self.axes, self._run, self._ever = axes, run, ever
        start, self._shell = run.position[frames[0]], shell(run, frames[0])
        style = {"colors": WALL, "linewidths": 1.0, "alpha": 0.8}
        self._edges = axes.add_collection3d(Line3DCollection(start[self._shell.edges], **style), autolim=False)
        grey = {"c": WALL, "s": _size(axes, run), "alpha": 0.12, "linewidths": 0.0, "depthshade": False}
        self._loose = axes.scatter(*start[self._shell.loose].T, **grey)
        fluid = {"s": _size(axes, run), "linewidths": 0.25, "edgecolors": "#12305088", "depthshade": False}
        self.mapped = axes.scatter(*start[ever].T, c=np.zeros(len(ever)), **fluid, **mapped)
        self._probes = [(probe, self._probe(probe)) for probe in probes]
        self.moving = [self.mapped]

    def show(self, index: int, values: np.ndarray) -> None:
        """Everything at its place in a frame, the fluid with these values."""
        run, here = self._run, self._ever
        self._edges.set_segments(run.position[index][self._shell.edges])
        self._loose._offsets3d = tuple(np.asarray(run.position[index, self._shell.loose], float).T)
        # Not every artist takes a change of number: particles that have left go nowhere instead.
        position = np.where(run.fluid[index, here, None], run.position[index, here], np.nan)
        self.mapped._offsets3d = tuple(np.asarray(position, float).T)
        self.mapped.set_array(values)
        for probe, line in self._probes:
            line.set_data_3d(*probe_line(run, probe, index, self.axes.get_zlim()).T)

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Where in the axes points [m] are."""
        return points

    def _probe(self, probe: Probe) -> Any:
        points = probe_line(self._run, probe, 0, self.axes.get_zlim())
        (line,) = self.axes.plot(*points.T, color=INK, lw=1.6, marker="o", ms=5.0, mfc="white", zorder=5)
        self.axes.text(*points[-1], f" {probe.name}", color=INK, fontsize=8, zorder=6)
        return line


def probe_line(run: Run, probe: Probe, frame: int, heights: tuple[float, float]) -> np.ndarray:
    """Points `(k, 3)` [m] of a probe in a frame: a gauge stands upright and still, others go with the walls."""
    places = np.array(probe.place)
    if probe.kind == "wave_gauge":
        return np.array([[*places[0], height] for height in heights])
    return carried(run, places, frame)


def decorate(axes: Any, low: np.ndarray, high: np.ndarray) -> None:
    """Labels, limits [m], a true aspect and the place of the eye."""
    from matplotlib.ticker import MaxNLocator

    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    for axis, length in zip((axes.xaxis, axes.yaxis, axes.zaxis), high - low, strict=True):
        axis.set_major_locator(MaxNLocator(max(2, round(6 * length / max(high - low)))))
        axis.set_pane_color("#f4f6f8")
    axes.set_box_aspect(high - low, zoom=1.15)
    axes.view_init(elev=ELEVATION, azim=AZIMUTH)


def _size(axes: Any, run: Run) -> float:
    """Area [points²] of a marker as wide as the spacing."""
    from mpl_toolkits.mplot3d.proj3d import proj_transform

    axes.apply_aspect()
    # Across the line of sight a spacing is not foreshortened.
    limits = np.array([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])
    center, azimuth = limits.mean(axis=1), np.radians(axes.azim)
    across = run.spacing * np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    x, y, z = np.stack([center, center + across], axis=1)
    seen = np.stack(proj_transform(x, y, z, axes.get_proj())[:2], axis=1)
    pixels = np.linalg.norm(np.diff(axes.transData.transform(seen), axis=0))
    return float(pixels * 72.0 / axes.figure.dpi) ** 2
