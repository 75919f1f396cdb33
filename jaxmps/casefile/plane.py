"""Shapes of the plane: polygons, and particles that fill them."""

from collections.abc import Sequence

import numpy as np
import shapely
from scipy.spatial import KDTree
from shapely.geometry import Point, Polygon, box
from shapely.geometry.base import BaseGeometry

from jaxmps.casefile.shapes import Shape
from jaxmps.cases.lattice import lattice_points

CLOSE = 0.7
"""[spacings] Particles nearer than that to one another are no arrangement to start from."""
_SLACK = 0.25  # [spacings] particles stand this far in front of or behind the edge of a shape, to get its mass right


def outline(shape: Shape) -> Polygon:
    """The polygon of a closed shape. Raises `ValueError` if it crosses itself or has no area."""
    if shape.polygon is not None:
        found = Polygon(shape.polygon)
        if not found.is_valid:
            raise ValueError(f"polygon must not cross itself or touch itself, got {shapely.is_valid_reason(found)} m")
    elif shape.box is not None:
        found = box(*np.min(shape.box, axis=0), *np.max(shape.box, axis=0))
    else:
        ball = shape.circle
        assert ball is not None, "sphere and stl are of three dimensions"
        found = Point(ball.center).buffer(ball.radius, quad_segs=128)
    if found.area <= 0.0:
        raise ValueError(f"{shape.kind} must have an area, got none")
    return found


def fill(shape: BaseGeometry, spacing: float, anchor: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """Particles `(n, 2)` [m] in the middle of the cells of a lattice that starts at `anchor`, not too close to `walls`.

    Cells whose middle lies within a quarter of a spacing of the edge count or not so that the number of particles comes
    closest to the area over l0²; those at equal depth all count or all do not.
    """
    if shape.is_empty:
        return np.zeros((0, 2))
    low, high = np.reshape(shape.bounds, (2, 2))
    first, last = np.floor((low - anchor) / spacing).astype(int) - 1, np.ceil((high - anchor) / spacing).astype(int) + 1
    cells = lattice_points(*(range(a, b) for a, b in zip(first, last, strict=True)))
    position = anchor + (cells + 0.5) * spacing
    shapely.prepare(shape)
    points = shapely.points(position)
    away = shapely.distance(shapely.boundary(shape), points) / spacing
    depth = np.where(shapely.covers(shape, points), away, -away)
    if len(walls):
        blocked = np.isfinite(KDTree(walls).query(position, distance_upper_bound=CLOSE * spacing * (1.0 - 1e-9))[0])
        position, depth = position[~blocked], depth[~blocked]
    return position[depth >= threshold(depth, shape.area / spacing**2)]


def threshold(depth: np.ndarray, count: float) -> float:
    """The depth [spacings], within ± a quarter, that leaves as close to `count` cells of at least that depth."""
    candidates = np.unique(np.round(depth[np.abs(depth) <= _SLACK], 6)) - 1e-6
    candidates = np.append(candidates, _SLACK + 1e-6)
    ranked = np.sort(depth)
    left = len(depth) - np.searchsorted(ranked, candidates)
    off = np.abs(left - count)
    best = candidates[off <= off.min() + 1e-9]
    return float(best[np.argmin(np.abs(best))])


def beyond(points: np.ndarray, sides: Sequence[str], bounds: np.ndarray) -> np.ndarray:
    """Which points lie beyond `bounds` (lower and upper corner) on one of these sides, such as "+y"."""
    out = np.zeros(len(points), bool)
    for side in sides:
        x, (low, high) = points[:, "xyz".index(side[1])], bounds[:, "xyz".index(side[1])]
        out |= x > high if side[0] == "+" else x < low
    return out


def apart(position: np.ndarray, distance: float) -> np.ndarray:
    """Which points stay if of two closer than `distance` [m] the earlier one stays."""
    keep = np.ones(len(position), bool)
    if len(position):
        close = KDTree(position).query_pairs(distance * (1.0 - 1e-9), output_type="ndarray")
        for i, j in close[np.lexsort((close[:, 0], close[:, 1]))]:
            keep[j] &= ~keep[i]
    return keep
