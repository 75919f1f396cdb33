"""What instruments would read in a run: pressure at points and walls, and the height of the surface."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from jaxmps.diagnostics.surface import surge_front
from jaxmps.flow import Kind
from jaxmps.results import Run, box_of
from jaxmps.validation import positive

_RADIUS = 2.1  # [spacings] of the mean of a pressure


def pressure_at(
    run: Run, points: Sequence[Any] | np.ndarray, radius: float | None = None
) -> Float[np.ndarray, "m points"]:
    """Pressure [Pa] in each frame at `points` `(points, d)` [m]: the mean over the fluid and wall particles within
    `radius` [m] (2.1 spacings), weighted with (1 − r / radius)².

    It is zero, the pressure of the air, where no fluid particle is that near. Raises `ValueError` for points of another
    dimension and a radius that is not positive.
    """
    places = np.atleast_2d(np.asarray(points, float))
    if places.shape[-1] != run.position.shape[-1]:
        raise ValueError(f"points must have {run.position.shape[-1]} components, got {places.shape[-1]}")
    reach = _RADIUS * run.spacing if radius is None else positive("radius", radius, "m")
    box = box_of(run)
    inside, periods = box.torus(places)
    pressure = np.zeros((len(run), len(places)))
    for k in range(len(run)):
        counts = np.isin(run.kind[k], (Kind.FLUID, Kind.WALL)) & np.isfinite(run.position[k]).all(axis=1)
        position, p, wet = run.position[k][counts], run.pressure[k][counts], run.fluid[k][counts]
        tree = KDTree(box.torus(position)[0], boxsize=periods) if len(position) else None
        near = tree.query_ball_point(inside, reach) if tree else [[]] * len(places)
        for i, indices in enumerate(near):
            if np.any(wet[indices]):
                away = np.linalg.norm(box.apart(position[indices] - places[i]), axis=1)
                w = (1.0 - away / reach) ** 2
                pressure[k, i] = np.sum(w * p[indices]) / max(np.sum(w), np.finfo(float).tiny)
    return pressure


def pressure_along(
    run: Run, start: Sequence[float] | np.ndarray, end: Sequence[float] | np.ndarray, radius: float | None = None
) -> tuple[Float[np.ndarray, "points d"], Float[np.ndarray, "m points"]]:
    """Points about one spacing apart on the segment from `start` to `end` [m], such as the face of a wall, and the
    pressure there [Pa] by `pressure_at`. The points are the middles of equal pieces: their mean is that of the segment.
    """
    a, b = np.asarray(start, float), np.asarray(end, float)
    count = max(round(float(np.linalg.norm(b - a)) / run.spacing), 1)
    points = a + (np.arange(count)[:, None] + 0.5) / count * (b - a)
    return points, pressure_at(run, points, radius)


def wave_height(run: Run, place: float | Sequence[float], width: float = 1.0) -> Float[np.ndarray, " m"]:
    """Height of the surface [m] at x, in 3-D at (x, y), in each frame: as far as the fluid within `width` spacings to
    the side goes up from the lowest particle without a gap of 1.5 spacings, plus half a spacing. NaN where it is dry.

    Spray, and water under a roof, are above such a gap and do not count.
    """
    at = np.atleast_1d(np.asarray(place, float))
    if len(at) != run.position.shape[-1] - 1:
        raise ValueError(f"place must have {run.position.shape[-1] - 1} components, got {len(at)}")
    box, heights = box_of(run), np.full(len(run), np.nan)
    for k in range(len(run)):
        fluid = run.position[k][run.fluid[k]]
        aside = box.apart(fluid - np.append(at, 0.0))[:, :-1]
        near = np.linalg.norm(aside, axis=1) <= width * run.spacing * (1.0 + 1e-6)
        height = np.sort(fluid[near, -1])
        if len(height):
            gaps = np.flatnonzero(np.diff(height) > 1.5 * run.spacing)
            heights[k] = height[gaps[0] if len(gaps) else -1] + 0.5 * run.spacing
    return heights


class Probe(NamedTuple):
    """An instrument: `kind` is pressure, wall_pressure, wave_gauge or front, `place` its point or points [m].

    A wall_pressure has its two ends, a wave_gauge its x (in 3-D x and y), a front has no place.
    """

    name: str
    kind: str
    place: tuple[tuple[float, ...], ...] = ()
    radius: float | None = None

    @property
    def unit(self) -> str:
        """Of the readings: Pa or m."""
        return "Pa" if self.kind.endswith("pressure") else "m"

    def measure(self, run: Run) -> Float[np.ndarray, " m"]:
        """The reading in each frame; that of a wall_pressure is the mean along its segment."""
        if self.kind == "pressure":
            return pressure_at(run, self.place, self.radius)[:, 0]
        if self.kind == "wall_pressure":
            start, end = self.place
            return pressure_along(run, start, end, self.radius)[1].mean(axis=1)
        if self.kind == "wave_gauge":
            return wave_height(run, self.place[0])
        if self.kind == "front":
            return surge_front(run.position, run.fluid, run.spacing)
        raise ValueError(f"kind must be one of pressure, wall_pressure, wave_gauge, front, got {self.kind}")


def probes(run: Run, instruments: Sequence[Probe]) -> dict[str, Float[np.ndarray, " m"]]:
    """Time and readings in columns, each with its unit in the name, such as "gate [Pa]"."""
    return {"time [s]": run.time} | {f"{p.name} [{p.unit}]": p.measure(run) for p in instruments}
