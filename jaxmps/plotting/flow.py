"""A frame of a run: its particles at their true size, walls and probes."""

import functools
import io
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxmps.diagnostics import Probe
from jaxmps.flow import Kind
from jaxmps.plotting import plane, rendered, solid
from jaxmps.plotting.colors import quantity, scale
from jaxmps.results import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LARGEST = (6.2, 4.6)  # of the axes, in inches
_MARGIN = {"left": 0.75, "right": 1.2, "bottom": 0.6, "top": 0.5}  # in inches


def frame(
    run: Run,
    index: int = -1,
    color: str = "pressure",
    *,
    limits: tuple[float, float] | None = None,
    ax: Any = None,
) -> "Figure":
    """A picture of one frame, the last by default: particles as discs as wide as the spacing.

    `color` is one of `COLORS`; `limits` are the values at the ends of its scale, by default percentiles of the frame; a
    pressure with both signs has a scale with zero in its middle. Walls are grey, where they are at that time; in three
    dimensions they are a shell that can be seen through, drawn by PyVista where it is installed and else by its edges.
    Probes of a case file are red. Draws into `ax` if given, of projection `3d` for three dimensions, and then without
    PyVista. Raises `ValueError` for an unknown color, `IndexError` for a frame that is not there.
    """
    count = len(run)
    if not -count <= index < count:
        raise IndexError(f"index must be between {-count} and {count - 1}, got {index}")
    index %= count
    scene = Scene(run, color, limits, range(index, index + 1), ax)
    scene.show(index)
    return scene.figure


class Scene:
    """The artists of a picture; `show` sets them to one of the `frames`, which fix the scales.

    In three dimensions, without `ax`, PyVista draws what there is to see, if it is there and can.
    """

    def __init__(
        self,
        run: Run,
        color: str,
        limits: tuple[float, float] | None,
        frames: range,
        ax: Any = None,
        bar: bool = True,
        probes: bool = True,
    ):
        self.run, self._shown = run, quantity(color)
        self._solid = run.position.shape[2] == 3
        if ax is not None and (ax.name == "3d") != self._solid:
            raise ValueError(f"ax must have the projection 3d for runs in 3-D only, got {ax.name!r}")
        self.colormap, self._norm, extend = scale(run, self._shown, limits, frames)
        self._ever = np.flatnonzero(run.fluid.any(axis=0))
        instruments = instruments_of(run) if probes else []
        low, high = _extent(run, frames)
        mapped = {"cmap": self.colormap, "norm": self._norm}
        given = (run, self._ever, frames, instruments, mapped)
        if not self._solid:
            self.axes = _plane_axes(low, high) if ax is None else ax
            plane.decorate(self.axes, low, high)
            self._view: Any = plane.Plane(self.axes, *given)
        elif ax is None and rendered.available():
            self.axes = new_figure(8.0, 4.8).add_axes((0.02, 0.0, 0.84, 0.93))
            self._view = rendered.Rendered(self.axes, *given, corners=(low, high))
        else:
            self.axes = new_figure(8.0, 4.8).add_axes((0.0, 0.0, 0.82, 0.93), projection="3d") if ax is None else ax
            solid.decorate(self.axes, low, high)
            self._view = solid.Solid(self.axes, *given)
        self.figure: Any = self.axes.figure
        self.title = self.axes.set_title("", loc="left", fontsize=11)
        if bar:
            self._color_bar(extend)
        step = np.diff(run.time).min() if len(run) > 1 else 0.0
        self._digits = int(np.clip(1 - np.floor(np.log10(step)), 1, 9)) if step > 0 else 3

    @property
    def moving(self) -> tuple[Any, ...]:
        """The artists that differ from frame to frame, if all others stay as they are; else none."""
        return (*self._view.moving, self.title) if self._view.flat else ()

    def show(self, index: int) -> None:
        """Sets fluid, walls, probes and title to a frame."""
        self._view.show(index, np.asarray(self._shown.values(self.run, index)[self._ever], float))
        time = f"t = {self.run.time[index]:.{self._digits}f} s"
        self.title.set_text(" · ".join([*heading(self.run), time]))

    def mark(self, place: np.ndarray, color: str) -> None:
        """A ring around a particle at this place [m], also around one behind others."""
        at = self._view.seen(place)
        self.axes.plot(*at[:, None], ls="none", marker="o", ms=16.0, mfc="none", mec=color, mew=2.0, zorder=5)

    def _color_bar(self, extend: str) -> None:
        from matplotlib.cm import ScalarMappable

        if self._solid:
            # Insets of 3-D axes would turn with them.
            box = self.axes.get_position(original=True)
            place = (min(box.x1, 0.82) + 0.03, box.y0 + 0.22 * box.height, 0.02, 0.56 * box.height)
            inset = self.figure.add_axes(place)
        else:
            inset = self.axes.inset_axes((1.03, 0.0, 0.03, 1.0))
        bar = self.figure.colorbar(ScalarMappable(self._norm, self.colormap), cax=inset, extend=extend)
        bar.outline.set_visible(False)
        if self._shown.classes is None:
            bar.set_label(self._shown.label)
        else:
            names = self._shown.classes(self.run)
            bar.set_ticks(np.arange(len(names)), labels=names)
            bar.ax.tick_params(length=0)
            bar.ax.minorticks_off()


def instruments_of(run: Run) -> list[Probe]:
    """The probes in the case file of a run, of those that have a place."""
    case = run.metadata.get("case")
    found = [Probe(*entry) for entry in case.get("probes", ())] if isinstance(case, dict) else []
    return [probe for probe in found if probe.place]


def heading(run: Run) -> list[str]:
    """Names of case and scheme, as far as they are known."""
    names = (run.metadata.get(key) for key in ("case", "scheme"))
    return [name["name"] for name in names if isinstance(name, dict) and "name" in name]


@functools.cache
def _picture() -> Any:
    from matplotlib.figure import Figure

    class Picture(Figure):
        """A figure that notebooks show by themselves, without pyplot."""

        def _repr_png_(self) -> bytes:
            buffer = io.BytesIO()
            self.savefig(buffer, format="png")
            return buffer.getvalue()

    return Picture


def new_figure(width: float, height: float) -> "Figure":
    """An empty figure of that size [in]."""
    return _picture()(figsize=(width, height), dpi=100)


def _extent(run: Run, frames: range) -> tuple[np.ndarray, np.ndarray]:
    """Corners of what there is to see in the frames [m]; of the fluid, all but stray drops."""
    sample = frames[:: -(-len(frames) // 40)]
    fluid = np.concatenate([run.position[k][run.fluid[k]] for k in sample])
    fluid = fluid[np.isfinite(fluid).all(axis=1)]
    kinds = (Kind.WALL,) if run.position.shape[2] == 3 else (Kind.WALL, Kind.DUMMY)
    walls = np.concatenate([_corners(run.position[k][np.isin(run.kind[k], kinds)]) for k in sample])
    corners = np.percentile(fluid, [0.2, 99.8], axis=0) if len(fluid) else walls
    seen = np.concatenate([corners, walls])
    return seen.min(axis=0) - run.spacing, seen.max(axis=0) + run.spacing


def _corners(points: np.ndarray) -> np.ndarray:
    return np.stack([points.min(axis=0), points.max(axis=0)]) if len(points) else points


def _plane_axes(low: np.ndarray, high: np.ndarray) -> Any:
    size = high - low
    inches = size * min(_LARGEST[0] / size[0], _LARGEST[1] / size[1])
    width = max(inches[0], 1.5) + _MARGIN["left"] + _MARGIN["right"]
    height = max(inches[1], 1.5) + _MARGIN["bottom"] + _MARGIN["top"]
    place = (
        _MARGIN["left"] / width,
        _MARGIN["bottom"] / height,
        1.0 - (_MARGIN["left"] + _MARGIN["right"]) / width,
        1.0 - (_MARGIN["bottom"] + _MARGIN["top"]) / height,
    )
    return new_figure(width, height).add_axes(place)
