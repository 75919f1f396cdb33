"""What there is to see in three dimensions, with PyVista where it is installed: what is in front hides what is behind.

PyVista draws off screen, and the picture stands in axes of matplotlib, as all others do.
"""

import contextlib
import functools
import itertools
import weakref
from collections.abc import Iterator
from typing import Any

import numpy as np

from jaxmps.diagnostics import Probe
from jaxmps.plotting.colors import INK, WALL
from jaxmps.plotting.rulers import rulers
from jaxmps.plotting.shell import shell
from jaxmps.plotting.solid import AZIMUTH, ELEVATION, probe_line
from jaxmps.results import Run

_SCALE = 2.0  # pixels of the picture for each of the figure
_MARGIN = 1.25  # of what is seen to what there is, for labels
_LIGHT = {"ambient": 0.35, "diffuse": 0.65}  # colors stay those of the scale
_FIRST = (9, 4)  # release of VTK that needs neither screen nor X server


@functools.cache
def available() -> bool:
    """Whether PyVista is there and can draw on this machine."""
    try:
        import pyvista
        import vtkmodules

        if tuple(map(int, vtkmodules.__version__.split(".")[:2])) < _FIRST:
            return False
        with _silent():
            plotter = pyvista.Plotter(off_screen=True, window_size=[16, 16])
            plotter.add_points(np.zeros((1, 3)))
            image = plotter.screenshot(return_img=True)
            plotter.close()
    except Exception:  # where drivers are missing, it raises what it likes
        return False
    return image is not None


class Rendered:
    """As `solid.Solid`, drawn by PyVista; `mapped` is the picture."""

    flat = False  # rulers stand on the picture: all is drawn anew

    def __init__(
        self,
        axes: Any,
        run: Run,
        ever: np.ndarray,
        frames: range,
        probes: list[Probe],
        mapped: dict[str, Any],
        corners: tuple[np.ndarray, np.ndarray],
    ):
        import pyvista

        self.axes, self._run, self._ever, self._probes = axes, run, ever, probes
        self._map, self._norm = mapped["cmap"], mapped["norm"]
        self._shell, (self._low, self._high) = shell(run, frames[0]), corners
        box = axes.get_position()
        inches = axes.figure.get_size_inches() * (box.width, box.height)
        self._pixels = [round(_SCALE * axes.figure.dpi * x) for x in inches]
        with _silent():
            self._plotter: Any = pyvista.Plotter(off_screen=True, window_size=self._pixels)
            weakref.finalize(self, self._plotter.close).atexit = False  # PyVista itself keeps all that are open
            self._plotter.set_background("white")
            self._plotter.disable_anti_aliasing()  # balls would be smaller; matplotlib smooths the picture
            self._look()
        blank = np.full((self._pixels[1], self._pixels[0], 3), 255, np.uint8)
        wide = self._half * self._pixels[0] / self._pixels[1]
        extent = (-wide, wide, -self._half, self._half)
        self.mapped = axes.imshow(blank, interpolation="antialiased", extent=extent, zorder=0)
        axes.set_axis_off()
        self._names = [axes.text(0, 0, f"  {probe.name}", color=INK, fontsize=8) for probe in probes]
        axes.set(xlim=extent[:2], ylim=extent[2:], xlabel="x [m]", ylabel="y [m]")
        rulers(axes, self.seen, corners, 0.03 * self._half)
        self.moving = [self.mapped]

    def show(self, index: int, values: np.ndarray) -> None:
        """Everything at its place in a frame, the fluid with these values."""
        run, here, plotter = self._run, self._ever, self._plotter
        position = _three(run.position[index])
        with _silent():
            there = run.fluid[index, here] & np.isfinite(position[here]).all(axis=1)
            colors = (255 * self._map(self._norm(values[there]))[:, :3]).astype(np.uint8)
            self._points("fluid", position[here[there]], scalars=colors, rgb=True)
            self._points("loose", position[self._shell.loose], color=WALL, opacity=0.15)
            self._surface(position)
            for probe, name in zip(self._probes, self._names, strict=True):
                points = probe_line(run, probe, index, (self._low[2], self._high[2]))
                self._line(probe.name, points)
                name.set_position(self.seen(points[-1]))
            plotter.render()  # else a screenshot shows what was rendered before
            image = plotter.screenshot(return_img=True)
        self.mapped.set_data(image)

    def _look(self) -> None:
        """The eye far away, so that all balls are of one size."""
        plotter, low, high = self._plotter, self._low, self._high
        up, turn = np.radians(ELEVATION), np.radians(AZIMUTH)
        sight = np.array([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)])
        right = np.array([-np.sin(turn), np.cos(turn), 0.0])
        self._screen, self._middle = np.stack([right, np.cross(sight, right)]), 0.5 * (low + high)
        reach = float(np.linalg.norm(high - low))
        plotter.camera_position = [
            (self._middle + 5.0 * reach * sight).tolist(),
            self._middle.tolist(),
            (0.0, 0.0, 1.0),
        ]
        plotter.enable_parallel_projection()
        wide, tall = np.ptp(self.seen(np.array(list(itertools.product(*zip(low, high, strict=True))))), axis=0)
        self._half = 0.5 * _MARGIN * max(float(tall), float(wide) * self._pixels[1] / self._pixels[0])
        plotter.camera.parallel_scale = self._half
        plotter.camera.clipping_range = (3.0 * reach, 7.0 * reach)

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Where in the picture points `(..., 3)` [m] are."""
        return (points - self._middle) @ self._screen.T

    def _points(self, name: str, points: np.ndarray, size: float = 1.0, **style: Any) -> None:
        if not len(points):
            self._plotter.remove_actor(name)
            return
        pixels = size * self._run.spacing / (2.0 * self._half) * self._pixels[1]
        style = {"point_size": pixels, "render_points_as_spheres": True, "reset_camera": False, **_LIGHT, **style}
        self._plotter.add_points(points, name=name, render=False, **style)

    def _surface(self, position: np.ndarray) -> None:
        import pyvista

        style = {"color": WALL, "reset_camera": False, "render": False}
        if len(self._shell.squares):
            faces = np.column_stack([np.full(len(self._shell.squares), 4), self._shell.squares]).ravel()
            used = pyvista.PolyData(position, faces=faces)
            self._plotter.add_mesh(used, name="walls", opacity=0.13, lighting=False, **style)
        if len(self._shell.edges):
            lines = np.column_stack([np.full(len(self._shell.edges), 2), self._shell.edges]).ravel()
            used = pyvista.PolyData(position, lines=lines)
            self._plotter.add_mesh(used, name="edges", line_width=1.2 * _SCALE, lighting=False, **style)

    def _line(self, name: str, points: np.ndarray) -> None:
        import pyvista

        style = {"reset_camera": False, "render": False}
        if len(points) > 1:
            self._plotter.add_mesh(
                pyvista.lines_from_points(points), name=f"{name} line", color=INK, line_width=3, **style
            )
        self._points(f"{name} ends", points, color=INK)


def _three(position: np.ndarray) -> np.ndarray:
    return np.asarray(position, np.float32)


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """VTK tells on stderr that there is no X server, and then does without."""
    from vtkmodules.vtkCommonCore import vtkLogger

    before = vtkLogger.GetCurrentVerbosityCutoff()
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        yield
    finally:
        vtkLogger.SetStderrVerbosity(before)
