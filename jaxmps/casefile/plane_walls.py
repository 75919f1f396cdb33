"""Layers of wall particles along shapes of the plane."""

import math
from itertools import pairwise
from typing import NamedTuple, TypeAlias

import numpy as np
import shapely
from scipy.spatial import KDTree
from shapely.geometry import LineString, box
from shapely.geometry.base import BaseGeometry

from jaxmps.casefile.plane import CLOSE, apart, beyond, outline
from jaxmps.casefile.plates import sturdy
from jaxmps.casefile.shapes import Wall
from jaxmps.cases.lattice import lattice_points

_VOID = 0.8  # [spacings] a place in a wall that is farther than this from all particles is to have one
_MOST = 2_000_000  # places that are looked at together
_CORNER = math.radians(30.0)  # a path that turns by more has a corner, which gets a particle
_MITRE = {"join_style": "mitre", "mitre_limit": 5.0}


Placed: TypeAlias = tuple[np.ndarray, np.ndarray, int]  # particles [m], the number of the wall of each, their layer


class Walls(NamedTuple):
    """Wall particles [m], the layer of each from 0 at the fluid's side, the number of its wall, the region that they
    stand in, and the tanks with all that is beyond their open sides.
    """

    position: np.ndarray
    layer: np.ndarray
    owner: np.ndarray
    solid: BaseGeometry
    tanks: BaseGeometry
    open: BaseGeometry

    def room(self, shape: BaseGeometry) -> BaseGeometry:
        """The part of a shape that fluid can fill: of one that is in a tank, what is outside of it is left out."""
        if shape.intersection(self.tanks).area > 0.0:
            shape = shape.intersection(self.tanks.union(self.open))
        return shape.difference(self.solid)


def walls(tables: list[Wall], counts: list[int], spacing: float, around: BaseGeometry) -> Walls:
    """The layers of all walls together; `counts` has the layers of each, `around` is what else there is.

    Tanks without the obstacles in them are one region: its offset curves at (k + ½) l0 carry the particles, with mitred
    corners, evenly about one spacing apart. Polylines have theirs on one side.
    """
    placed: list[Placed] = []
    solids: list[BaseGeometry] = []
    hollow = shapely.union_all([outline(t) for t in tables if t.side == "outside"])
    closed = [(t, _outline(t, hollow, spacing), n) for t, n in zip(tables, counts, strict=True) if t.polyline is None]
    if closed:
        numbers = np.array([k for k, table in enumerate(tables) if table.polyline is None])
        found, solid = _around_region(closed, spacing, around)
        placed = [(points, numbers[owner], layer) for points, owner, layer in found]
        solids.append(solid)
    for number, (table, count) in enumerate(zip(tables, counts, strict=True)):
        if table.polyline is not None:
            line, sign = LineString(table.polyline), 1.0 if table.side == "left" else -1.0
            solids.append(line.buffer(sign * count * spacing, single_sided=True, join_style="mitre"))
            for k in range(count):
                curve = shapely.offset_curve(line, sign * (k + 0.5) * spacing, **_MITRE)
                for part in shapely.get_parts(curve):
                    points = _along(np.asarray(part.coords), spacing)
                    placed.append((points, np.full(len(points), number), k))
    placed.sort(key=lambda entry: entry[2])  # where walls meet, the layer at the fluid stays
    position = np.concatenate([points for points, *_ in placed] or [np.zeros((0, 2))])
    owner = np.concatenate([numbers for _, numbers, _ in placed] or [np.zeros(0, int)])
    layer = np.concatenate([np.full(len(points), k) for points, _, k in placed] or [np.zeros(0, int)])
    keep = apart(position, CLOSE * spacing)
    tanks = [(t, shape) for t, shape, _ in closed if t.side == "outside"]
    everything = shapely.union_all([around, *(shape for _, shape in tanks)]).envelope.buffer(
        spacing, join_style="mitre"
    )
    opened = shapely.union_all([_opening(t, shape, everything) for t, shape in tanks])
    return Walls(
        position[keep],
        layer[keep],
        owner[keep],
        shapely.union_all(solids),
        shapely.union_all([s for _, s in tanks]),
        opened,
    )


def _outline(table: Wall, hollow: BaseGeometry, spacing: float) -> BaseGeometry:
    shape = outline(table)
    return shape if table.side == "outside" else sturdy(shape, hollow, spacing)


def _around_region(
    closed: list[tuple[Wall, BaseGeometry, int]], spacing: float, around: BaseGeometry
) -> tuple[list[Placed], BaseGeometry]:
    most = max(count for *_, count in closed)
    tanks = [shape for table, shape, _ in closed if table.side == "outside"]
    obstacles = shapely.union_all([shape for table, shape, _ in closed if table.side == "inside"])
    everything = shapely.union_all([around, obstacles, *tanks])
    universe = everything.envelope.buffer(4 * (most + 2) * spacing, join_style="mitre")
    region = (shapely.union_all(tanks) if tanks else universe).difference(obstacles)
    edges = [shapely.boundary(shape) for _, shape, _ in closed]
    layers = np.array([count for *_, count in closed])
    placed = []
    for k in range(most):
        curves = shapely.boundary(region.buffer((k + 0.5) * spacing, **_MITRE))
        for curve in shapely.get_parts(shapely.line_merge(curves)):
            if not tanks and not universe.contains(curve):
                continue
            points = _along(np.asarray(curve.simplify(1e-6 * spacing).coords), spacing)
            nearest = np.argmin([shapely.distance(edge, shapely.points(points)) for edge in edges], axis=0)
            there = k < layers[nearest]
            for index, (table, shape, _) in enumerate(closed):
                there &= (nearest != index) | ~beyond(points, table.open, np.reshape(shape.bounds, (2, 2)))
            placed.append((points[there], nearest[there], k))
    band = region.buffer(most * spacing, **_MITRE).difference(region)
    for table, shape, _ in closed:
        band = band.difference(_opening(table, shape, universe))
    if not tanks:
        band = band.intersection(obstacles)
    points = _voids(band, np.concatenate([np.zeros((0, 2)), *(points for points, *_ in placed)]), spacing)
    away = np.array([shapely.distance(edge, shapely.points(points)) for edge in edges]) / spacing
    nearest, depth = np.argmin(away, axis=0), np.min(away, axis=0)
    deep = (depth >= 1.0) & (depth < layers[nearest])
    placed += [
        (point[None], np.array([n]), int(k))
        for point, n, k in zip(points[deep], nearest[deep], depth[deep], strict=True)
    ]
    return placed, shapely.union_all([band, obstacles])


def _voids(band: BaseGeometry, there: np.ndarray, spacing: float) -> np.ndarray:
    """Particles for the room that is left between layers from two sides, such as in the middle of a thin wall."""
    if band.is_empty:
        return np.zeros((0, 2))
    low, high = np.reshape(band.bounds, (2, 2))
    count = np.ceil((high - low) / (0.25 * spacing)).astype(int) + 1
    tree, found = KDTree(there), []
    for columns in np.array_split(np.arange(count[0]), math.ceil(float(count[0]) * count[1] / _MOST)):
        if len(columns):
            points = lattice_points(range(columns[0], columns[-1] + 1), range(count[1]))
            points = low + 0.25 * spacing * points
            points = points[np.isinf(tree.query(points, distance_upper_bound=_VOID * spacing)[0])]
            found.append(points[shapely.contains_xy(band, *points.T)])
    points = np.concatenate(found)
    farthest = np.argsort(-np.round(KDTree(there).query(points)[0] / spacing, 6), kind="stable")
    return points[farthest][apart(points[farthest], _VOID * spacing)]


def _opening(table: Wall, shape: BaseGeometry, universe: BaseGeometry) -> BaseGeometry:
    low, high = np.reshape(shape.bounds, (2, 2))
    outer = np.reshape(universe.bounds, (2, 2))
    halves = []
    for side in table.open:
        axis, corners = "xy".index(side[1]), outer.copy()
        corners[0 if side[0] == "+" else 1, axis] = (high if side[0] == "+" else low)[axis]
        halves.append(box(*corners.ravel()))
    return shapely.union_all(halves)


def _along(path: np.ndarray, spacing: float) -> np.ndarray:
    """Points on a path about one spacing apart, with one in each corner, and half a spacing from open ends."""
    ring = bool(np.allclose(path[0], path[-1], rtol=0.0, atol=1e-9 * spacing)) and len(path) > 3
    ways = np.diff(path, axis=0)
    before, after = (np.roll(ways, 1, axis=0), ways) if ring else (ways[:-1], ways[1:])
    turn = np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], np.sum(before * after, axis=1))
    corners = np.flatnonzero(np.abs(turn) > _CORNER) + (0 if ring else 1)
    if ring and len(corners):
        path = np.concatenate([path[corners[0] : -1], path[: corners[0] + 1]])
        corners = (corners - corners[0])[1:]
    stops = [0, *corners, len(path) - 1]
    places = []
    for index, (a, b) in enumerate(pairwise(stops)):
        piece = LineString(path[a : b + 1])
        free = (not ring and index == 0, not ring and index == len(stops) - 2)
        # The corner at the start belongs to the piece, the one at the end to the next.
        over = 0.5 * free[0] - 0.5 * free[1]
        count = max(round(piece.length / spacing - over), 0 if over > 0 else 1)
        step = piece.length / (count + over)
        places.append(shapely.line_interpolate_point(piece, step * (np.arange(count) + 0.5 * free[0])))
    return shapely.get_coordinates(np.concatenate(places))
