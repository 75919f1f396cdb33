"""Shapes of space on a lattice, which fluid and walls share."""

from typing import Any, NamedTuple

import numpy as np
import trimesh
from scipy import ndimage
from scipy.spatial import KDTree
from trimesh import Trimesh

from jaxmps.casefile.meshes import Solid, crossings
from jaxmps.casefile.plane import beyond, threshold
from jaxmps.casefile.shapes import Wall
from jaxmps.cases.lattice import few, lattice_points

# A ray through an edge meets two triangles or none; no edge of a drawing lies exactly there.
_ASIDE = np.array([3.1e-6, 1.7e-6])  # [spacings]
# A middle in the surface itself is inside or outside as its ray tells, so that a slab has as many rows as it should.
_TINY = 1e-9  # [spacings]


class Grid(NamedTuple):
    """A lattice of cells: corner of the first [m], number along each axis, and the spacing [m]."""

    corner: np.ndarray
    shape: tuple[int, ...]
    spacing: float

    @property
    def middles(self) -> np.ndarray:
        return self.corner + (lattice_points(*map(range, self.shape)) + 0.5) * self.spacing


def grid_around(solids: list[Solid], anchor: np.ndarray, margin: float, spacing: float) -> Grid:
    """The cells of the lattice through `anchor` up to `margin` [m] around all solids."""
    low = np.min([m.bounds[0] for m in solids], axis=0) - margin
    high = np.max([m.bounds[1] for m in solids], axis=0) + margin
    few(float(np.prod((high - low) / spacing)))
    first, last = (np.round((edge - anchor) / spacing).astype(int) for edge in (low, high))
    return Grid(anchor + first * spacing, tuple((last - first + 1).tolist()), spacing)


def depths(found: Solid, grid: Grid, reach: float) -> np.ndarray:
    """Depth of each cell's middle below the surface [m], negative outside, −∞ or ∞ where it is more than `reach`.

    Where bodies overlap it is the larger of their depths: what of their surfaces lies in another body does not count.
    """
    depth = np.full(np.prod(grid.shape), -np.inf)
    for body in found.bodies:
        depth = np.maximum(depth, _depths(body, grid, reach))
    for hole in found.holes:
        depth = np.minimum(depth, -_depths(hole, grid, reach))
    return depth


def _depths(body: Trimesh, grid: Grid, reach: float) -> np.ndarray:
    position = grid.middles
    depth = np.where(_inside(body, grid).ravel(), np.inf, -np.inf)
    sampled = trimesh.remesh.subdivide_to_size(body.vertices, body.faces, max_edge=grid.spacing, max_iter=20)[0]
    near = np.all((position > body.bounds[0] - reach) & (position < body.bounds[1] + reach), axis=1)
    near = np.flatnonzero(near)
    rough, _ = KDTree(sampled).query(position[near], distance_upper_bound=reach + grid.spacing)
    near = near[np.isfinite(rough)]
    for part in np.array_split(near, len(near) // 20_000 + 1):
        away = trimesh.proximity.closest_point(body, position[part])[1] if len(part) else np.zeros(0)
        away = np.maximum(away, _TINY * grid.spacing)
        depth[part] = np.where(away <= reach, np.sign(depth[part]) * away, depth[part])
    return depth


def _inside(body: Trimesh, grid: Grid) -> np.ndarray:
    """Which cells have their middle inside: along a ray in each column it is counted how often the surface winds."""
    columns = lattice_points(range(grid.shape[0]), range(grid.shape[1]))
    place = grid.corner[:2] + (columns + 0.5 + _ASIDE) * grid.spacing
    over = np.flatnonzero(np.all((place > body.bounds[0, :2]) & (place < body.bounds[1, :2]), axis=1))
    winding = np.zeros((len(columns), grid.shape[2] + 1), int)
    ray, height, turn = crossings(body, place[over], min(body.bounds[0, 2], grid.corner[2]) - grid.spacing)
    above = np.ceil((height - grid.corner[2]) / grid.spacing - 0.5).astype(int)
    np.add.at(winding, (over[ray], np.clip(above, 0, grid.shape[2])), turn)
    return (np.cumsum(winding, axis=1)[:, :-1] != 0).reshape(grid.shape)


def volume(found: Solid, spacing: float) -> float:
    """The volume [m³]; where bodies overlap, by columns of half a spacing, which count what they share once."""
    holes = sum(abs(float(hole.volume)) for hole in found.holes)
    if found.apart:
        return sum(float(body.volume) for body in found.bodies) - holes
    low, high = found.bounds
    step = 0.5 * spacing
    count = np.ceil((high[:2] - low[:2]) / step - 1e-6).astype(int)
    columns = low[:2] + (lattice_points(*map(range, count)) + 0.5 + _ASIDE) * step
    met = [crossings(body, columns, low[2] - spacing) for body in found.bodies]
    ray, height, turn = (np.concatenate(values) for values in zip(*met, strict=True))
    order = np.lexsort((height, ray))
    inside = np.cumsum(turn[order])[:-1] != 0  # it is zero again at the end of each ray
    return float(np.sum(np.diff(height[order])[inside])) * step**2 - holes


def fill(depth: np.ndarray, size: float, spacing: float) -> np.ndarray:
    """Which cells are fluid: as many as come closest to the volume `size` [m³] over l0³, see `plane.fill`."""
    return depth / spacing >= threshold(depth / spacing, size / spacing**3)


class Layers(NamedTuple):
    """Of each cell the `layer`, 0 at the fluid's side, −1 for no wall; whether it lies in something `solid`; whether it
    is outside of all tanks (`without`), and not beyond an open side; and the number of the wall that it is part of.
    """

    layer: np.ndarray
    solid: np.ndarray
    without: np.ndarray
    owner: np.ndarray


def wall_layers(
    tables: list[Wall], bounds: list[np.ndarray], depth: list[np.ndarray], counts: list[int], grid: Grid
) -> Layers:
    """The layers of all walls. A cell outside of all tanks or inside an obstacle is wall of the layer k if its middle
    is k to k + 1 spacings from the surface, the latter included: the cell before it may be in front of the surface.
    """
    behind = np.full(np.prod(grid.shape), np.inf)
    if not tables:
        nothing = np.zeros(len(behind), bool)
        return Layers(np.full(len(behind), -1), nothing, nothing, nothing.astype(int))
    owner, obstacles = np.zeros(len(behind), int), np.zeros(len(behind), bool)
    outside = [k for k, table in enumerate(tables) if table.side == "outside"]
    for k in outside:
        owner = np.where(-depth[k] < behind, k, owner)
        behind = np.minimum(behind, -depth[k])
    if not outside:
        behind[:] = -np.inf
    without = behind > 0.0
    for k, table in enumerate(tables):
        if table.side == "inside":
            owner = np.where(depth[k] > behind, k, owner)
            behind = np.maximum(behind, depth[k])
            obstacles |= depth[k] > 0.0
    most = np.array(counts, int)[owner]
    layer = np.ceil(np.where(np.isfinite(behind), behind, 0.0) / grid.spacing - 1e-6).astype(int) - 1
    solid = (behind > 0.0) & np.isfinite(behind) & (layer < most)
    layer = np.maximum(layer, 0)  # right behind the surface
    # In the foot of an obstacle, surfaces that other walls cover do not count: a wall has something open beside it.
    beside: Any = ndimage.binary_dilation((behind <= 0.0).reshape(grid.shape), np.ones((3, 3, 3), bool))
    layer = np.where((layer == 0) & ~beside.ravel() & (most > 1), 1, layer)
    position = grid.middles
    for k in outside:
        opened = beyond(position, tables[k].open, bounds[k])
        solid &= (owner != k) | ~opened
        without &= ~opened
    return Layers(np.where(solid, layer, -1), solid | obstacles, without, owner)
