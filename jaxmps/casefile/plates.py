"""Walls with fluid on both sides: plates, made as thick as they must be, and bodies too thin to be walls."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import shapely
import trimesh
from scipy.spatial import KDTree
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from jaxmps.casefile.meshes import Solid, thickness
from jaxmps.casefile.models import OwnFile
from jaxmps.casefile.parsing import CaseFileError, attempted
from jaxmps.casefile.shapes import Wall
from jaxmps.cases.lattice import dummy_layers

_BARE = 1.3  # [spacings] from the surface of a wall to its next particle: too far, for it is 0.5 to 0.9


def rows_of_plate(ratio: float) -> int:
    """Rows of particles in a plate: one of walls on either side, and between them dummies that complete the
    neighborhoods of both. Neither fluid nor walls on one side feel those on the other, which are r_e away or more.
    """
    return 2 + dummy_layers(ratio)


def with_plates(file: OwnFile, path: Path, ratio: float, spacing: float) -> OwnFile:
    """The file with its plates made into obstacles of that thickness. Raises `CaseFileError` for one that is to be too
    thin, or whose polyline meets its own end.
    """
    faults: list[str] = []
    walls = []
    for index, table in enumerate(file.wall, 1):
        with attempted(f"[[wall]] {index}", faults):
            walls.append(_thickened(table, ratio, spacing) if table.plate else table)
    if faults:
        raise CaseFileError(path, faults)
    return file.model_copy(update={"wall": walls})


def _thickened(table: Wall, ratio: float, spacing: float) -> Wall:
    least = rows_of_plate(ratio)
    rows = table.layers if table.thickness is None else round(table.thickness / spacing)
    if rows is not None and rows < least:
        given = f"{rows} layers" if table.thickness is None else f"{table.thickness:g} m"
        raise ValueError(
            f"a plate must be at least {least} layers, {least * spacing:g} m, thick at the spacing {spacing:g} m, got "
            f"{given}"
        )
    changed = {"side": "inside", "plate": False, "thickness": None, "polyline": None}
    if table.polyline is not None:
        if any(len(point) != 2 for point in table.polyline):
            return table  # which is told where all other shapes are checked
        rows = rows or least
        outline = _around(LineString(table.polyline), rows * spacing, table.side)
        return table.model_copy(update=changed | {"polygon": outline, "layers": rows})
    assert table.box is not None
    if len({len(corner) for corner in table.box}) > 1:
        return table
    corners = np.sort(np.array(table.box), axis=0)
    axis = int(np.argmin(corners[1] - corners[0]))
    drawn = corners[1, axis] - corners[0, axis]
    rows = max(rows or least, round(drawn / spacing))
    corners[:, axis] = corners[:, axis].mean() + 0.5 * rows * spacing * np.array([-1.0, 1.0])
    return table.model_copy(update=changed | {"box": corners.tolist(), "layers": rows})


def _around(line: LineString, width: float, side: str | None) -> list[list[float]]:
    """Corners of the strip of that width [m] around a line, or to one side of it."""
    if side is None:
        strip = line.buffer(0.5 * width, cap_style="flat", join_style="mitre")
    else:
        strip = line.buffer(width if side == "left" else -width, single_sided=True, join_style="mitre")
    if not isinstance(strip, Polygon) or strip.is_empty or strip.interiors:
        raise ValueError("the polyline of a plate must not close: draw its two parts as two plates")
    return [list(corner) for corner in strip.exterior.coords[:-1]]


def sturdy(shape: Polygon, hollow: BaseGeometry, spacing: float) -> BaseGeometry:
    """An obstacle with room for a row of particles: one just as thick as a spacing gets a thousandth more, not beyond
    the tanks around it, the polygons `hollow`.
    """
    if thickness_of(shape) > (1.0 + 1e-3) * spacing:
        return shape
    thicker = shape.buffer(1.5e-3 * spacing, join_style="mitre")
    return thicker.intersection(hollow).union(shape) if hollow.intersects(shape) else thicker


def thickness_of(shape: Polygon | Solid) -> float:
    """How thick a body is [m]: in the plane the largest circle in it, in space the way through it."""
    if isinstance(shape, Polygon):
        return 2.0 * float(shapely.length(shapely.maximum_inscribed_circle(shape)))
    return thickness(shape)


def obstacles(file: OwnFile, path: Path, shapes: list[Polygon | Solid | None], spacing: float) -> tuple[float, ...]:
    """How thick each obstacle is [m], infinite for other walls.

    `CaseFileError` for those thinner than a spacing, through which fluid would flow.
    """
    pairs = list(zip(file.wall, shapes, strict=True))
    found = tuple(math.inf if t.side != "inside" or shape is None else thickness_of(shape) for t, shape in pairs)
    faults = []
    for index, (thick, (table, _)) in enumerate(zip(found, pairs, strict=True), 1):
        if thick < spacing * (1.0 - 1e-3):
            drawn = "with" if table.kind == "box" else "as a box or a polyline with"
            faults.append(
                f"[[wall]] {index}: must be at least as thick as the spacing {spacing:g} m to stop the fluid, got "
                f"{thick:.3g} m: draw it thicker, or {drawn} plate = true"
            )
    if faults:
        raise CaseFileError(path, faults)
    return found


def gaps(
    file: OwnFile, shapes: list[Any], position: np.ndarray, spacing: float
) -> tuple[tuple[int, tuple[float, ...]], ...]:
    """Obstacles by their numbers, and for each a place [m] on its surface that has no wall particle near it: a part of
    it is too thin. What is outside of all tanks needs none.
    """
    tanks = [np.reshape(s.bounds, (2, -1)) for t, s in zip(file.wall, shapes, strict=True) if t.side == "outside"]
    found = []
    for index, (table, shape) in enumerate(zip(file.wall, shapes, strict=True), 1):
        if table.side != "inside" or shape is None:
            continue
        points = _on_surface(shape, spacing)
        held = [np.all((points > low) & (points < high), axis=1) for low, high in tanks]
        points = points[np.any(held, axis=0)] if held else points
        bare = KDTree(position).query(points)[0] > _BARE * spacing if len(points) else np.zeros(0, bool)
        if bare.any():
            found.append((index, tuple(points[bare][0].tolist())))
    return tuple(found)


def _on_surface(shape: Polygon | Solid, spacing: float) -> np.ndarray:
    if isinstance(shape, Polygon):
        edge = shape.boundary
        steps = np.arange(0.0, edge.length, 0.5 * spacing)
        return shapely.get_coordinates(shapely.line_interpolate_point(edge, steps))
    return np.concatenate([trimesh.sample.sample_surface(body, 2000, seed=0)[0] for body in shape.bodies])
