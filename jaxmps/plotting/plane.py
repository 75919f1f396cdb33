"""What there is to see in two dimensions: particles as discs of their true size, walls in grey, probes."""

from typing import Any

import numpy as np

from jaxmps.diagnostics import Probe
from jaxmps.flow import Kind
from jaxmps.plotting.colors import DUMMY, INK, WALL
from jaxmps.plotting.shell import carried
from jaxmps.results import Run


class Plane:
    """The artists of a picture in axes of matplotlib; `mapped` is the last of them, with the colors of the fluid."""

    flat = True

    def __init__(
        self, axes: Any, run: Run, ever: np.ndarray, frames: range, probes: list[Probe], mapped: dict[str, Any]
    ):
        self.axes, self._run, self._ever = axes, run, ever
        kinds = [np.flatnonzero(run.kind[frames[0]] == kind) for kind in (Kind.DUMMY, Kind.WALL)]
        start = run.position[frames[0]]
        greys = zip(kinds, (DUMMY, WALL), strict=True)
        self._walls = [(here, self._discs(start[here], facecolors=grey)) for here, grey in greys]
        self.mapped = self._discs(start[ever], array=np.zeros(len(ever)), **mapped)
        self._probes = [(probe, *self._probe(probe)) for probe in probes]
        fixed = np.concatenate(kinds)
        rest = all(np.array_equal(run.position[k, fixed], start[fixed]) for k in frames)
        walls = [] if rest else [artist for _, artist in self._walls]
        seen = [] if rest else [artist for _, *artists in self._probes for artist in artists]
        self.moving = [*walls, self.mapped, *seen]
        """Artists that differ from frame to frame."""

    def show(self, index: int, values: np.ndarray) -> None:
        """Everything at its place in a frame, the fluid with these values."""
        run = self._run
        # Not every artist takes a change of number: particles that have left go nowhere instead.
        position = np.where(run.fluid[index, self._ever, None], run.position[index, self._ever], np.nan)
        for here, artist in self._walls:
            artist.set_offsets(run.position[index, here])
        self.mapped.set_offsets(position)
        self.mapped.set_array(values)
        for probe, line, name in self._probes:
            if probe.kind != "wave_gauge":  # a gauge stands where it is
                points = carried(run, np.array(probe.place), index)
                line.set_data(*points.T)
                name.xy = points.mean(axis=0)

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Where in the axes points [m] are."""
        return points

    def _discs(self, offsets: np.ndarray, **style: Any) -> Any:
        from matplotlib.collections import EllipseCollection

        sizes = ([self._run.spacing], [self._run.spacing], [0.0])
        return self.axes.add_collection(
            EllipseCollection(*sizes, units="x", offsets=offsets, offset_transform=self.axes.transData, lw=0, **style),
            autolim=False,
        )

    def _probe(self, probe: Probe) -> tuple[Any, Any]:
        axes, points = self.axes, np.array(probe.place)
        if probe.kind == "wave_gauge":
            line = axes.axvline(points[0, 0], color=INK, lw=1.0, ls="--")
            x, y = points[0, 0], axes.get_ylim()[1]
        else:
            (line,) = axes.plot(*points.T, color=INK, lw=2.0, marker="o", ms=5.0, mfc="white")
            x, y = points.mean(axis=0)
        right = x > np.mean(axes.get_xlim())
        style = {"color": INK, "fontsize": 8, "textcoords": "offset points", "ha": "right" if right else "left"}
        return line, axes.annotate(probe.name, (x, y), (-4 if right else 4, -10), **style)


def decorate(axes: Any, low: np.ndarray, high: np.ndarray) -> None:
    """Labels, limits [m] and a true aspect."""
    axes.set(xlabel="x [m]", ylabel="y [m]", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.set_aspect("equal")
    axes.tick_params(length=3)
    axes.spines[:].set_color("#9aa0a6")
    axes.spines[["top", "right"]].set_visible(False)
