"""A frame of a run: its particles as discs of their true size."""

import functools
import io
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxmps.flow import Kind
from jaxmps.plotting.colors import DUMMY, WALL, quantity, scale
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

    `color` is one of `COLORS`; `limits` are the values at the ends of its scale, by default
    percentiles of the frame. Walls are grey; they are left out in three dimensions. Draws into `ax`
    if given, of projection `3d` for three dimensions. Raises `ValueError` for an unknown color,
    `IndexError` for a frame that is not there.
    """
    count = len(run)
    if not -count <= index < count:
        raise IndexError(f"index must be between {-count} and {count - 1}, got {index}")
    index %= count
    scene = Scene(run, color, limits, range(index, index + 1), ax)
    scene.show(index)
    return scene.figure


class Scene:
    """The artists of a picture; `show` sets them to one of the `frames`, which fix the scales."""

    def __init__(
        self,
        run: Run,
        color: str,
        limits: tuple[float, float] | None,
        frames: range,
        ax: Any = None,
        bar: bool = True,
    ):
        self.run, self._shown = run, quantity(color)
        self._solid = run.position.shape[2] == 3
        if ax is not None and (ax.name == "3d") != self._solid:
            raise ValueError(f"ax must have the projection 3d for runs in 3-D only, got {ax.name!r}")
        self.colormap, self._norm, extend = scale(run, self._shown, limits, frames)
        low, high = _extent(run, frames)
        self.axes = _axes(low, high) if ax is None else ax
        self.figure: Any = self.axes.figure
        self._ever = np.flatnonzero(run.fluid.any(axis=0))
        mapped = {"cmap": self.colormap, "norm": self._norm}
        self.fluid = (_solid if self._solid else _flat)(self.axes, run, self._ever, low, high, mapped)
        self.title = self.axes.set_title("", loc="left", fontsize=11)
        if bar:
            self._color_bar(extend)
        step = np.diff(run.time).min() if len(run) > 1 else 0.0
        self._digits = int(np.clip(1 - np.floor(np.log10(step)), 1, 9)) if step > 0 else 3

    def show(self, index: int) -> None:
        """Sets fluid and title to a frame."""
        here, run = self._ever, self.run
        # Not every artist takes a change of number: particles that have left go nowhere instead.
        position = np.where(run.fluid[index, here, None], run.position[index, here], np.nan)
        if self._solid:
            self.fluid._offsets3d = tuple(np.asarray(position, float).T)
        else:
            self.fluid.set_offsets(position)
        self.fluid.set_array(np.asarray(self._shown.values(run, index)[here], float))
        time = f"t = {run.time[index]:.{self._digits}f} s"
        self.title.set_text(" · ".join([*heading(run), time]))

    def _color_bar(self, extend: str) -> None:
        if self._solid:
            # Insets of 3-D axes would turn with them.
            box = self.axes.get_position(original=True)
            place = (box.x1 + 0.03, box.y0 + 0.22 * box.height, 0.02, 0.56 * box.height)
            inset = self.figure.add_axes(place)
        else:
            inset = self.axes.inset_axes((1.03, 0.0, 0.03, 1.0))
        bar = self.figure.colorbar(self.fluid, cax=inset, extend=extend)
        bar.outline.set_visible(False)
        if self._shown.classes is None:
            bar.set_label(self._shown.label)
        else:
            names = self._shown.classes(self.run)
            bar.set_ticks(np.arange(len(names)), labels=names)
            bar.ax.tick_params(length=0)
            bar.ax.minorticks_off()


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
    """Corners of what there is to see [m]; of the fluid, all but stray drops."""
    places = [run.position[k][run.fluid[k]] for k in frames[:: -(-len(frames) // 40)]]
    fluid = np.concatenate(places)
    fluid = fluid[np.isfinite(fluid).all(axis=1)]
    kinds = (Kind.WALL,) if run.position.shape[2] == 3 else (Kind.WALL, Kind.DUMMY)
    walls = run.position[frames[0]][np.isin(run.kind[frames[0]], kinds)]
    corners = np.percentile(fluid, [0.2, 99.8], axis=0) if len(fluid) else walls
    seen = np.concatenate([corners, walls])
    return seen.min(axis=0) - run.spacing, seen.max(axis=0) + run.spacing


def _axes(low: np.ndarray, high: np.ndarray) -> Any:
    solid, size = len(low) == 3, high - low
    if solid:
        return new_figure(8.0, 4.8).add_axes((0.0, 0.0, 0.82, 0.93), projection="3d")
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


def _flat(axes: Any, run: Run, ever: np.ndarray, low: np.ndarray, high: np.ndarray, mapped: dict[str, Any]) -> Any:
    from matplotlib.collections import EllipseCollection

    def discs(offsets: np.ndarray, **style: Any) -> Any:
        sizes = ([run.spacing], [run.spacing], [0.0])
        return axes.add_collection(
            EllipseCollection(*sizes, units="x", offsets=offsets, offset_transform=axes.transData, lw=0, **style),
            autolim=False,
        )

    for kind, grey in ((Kind.DUMMY, DUMMY), (Kind.WALL, WALL)):
        discs(run.position[0][run.kind[0] == kind], facecolors=grey)
    axes.set(xlabel="x [m]", ylabel="y [m]", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.set_aspect("equal")
    axes.tick_params(length=3)
    axes.spines[:].set_color("#9aa0a6")
    axes.spines[["top", "right"]].set_visible(False)
    return discs(run.position[0][ever], array=np.zeros(len(ever)), **mapped)


def _solid(axes: Any, run: Run, ever: np.ndarray, low: np.ndarray, high: np.ndarray, mapped: dict[str, Any]) -> Any:
    from matplotlib.ticker import MaxNLocator
    from mpl_toolkits.mplot3d.proj3d import proj_transform

    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    for axis, length in zip((axes.xaxis, axes.yaxis, axes.zaxis), high - low, strict=True):
        axis.set_major_locator(MaxNLocator(max(2, round(6 * length / max(high - low)))))
        axis.set_pane_color("#f4f6f8")
    axes.set_box_aspect(high - low, zoom=1.15)
    axes.view_init(elev=22.0, azim=-64.0)
    axes.apply_aspect()
    # Across the line of sight a spacing is not foreshortened.
    center, azimuth = 0.5 * (low + high), np.radians(axes.azim)
    across = run.spacing * np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    x, y, z = np.stack([center, center + across], axis=1)
    seen = np.stack(proj_transform(x, y, z, axes.get_proj())[:2], axis=1)
    pixels = np.linalg.norm(np.diff(axes.transData.transform(seen), axis=0))
    points = pixels * 72.0 / axes.figure.dpi
    style = {"s": points**2, "linewidths": 0.25, "edgecolors": "#12305088", "depthshade": False}
    return axes.scatter(*run.position[0][ever].T, c=np.zeros(len(ever)), **style, **mapped)
