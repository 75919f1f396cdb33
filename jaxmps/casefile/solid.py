"""Shapes of space: watertight meshes on a lattice, which fluid and walls share."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
from scipy.spatial import KDTree
from trimesh import Trimesh

from jaxmps.casefile.plane import beyond, threshold
from jaxmps.casefile.shapes import Shape, Wall
from jaxmps.cases.lattice import lattice_points


def mesh(shape: Shape, folder: Path) -> Trimesh:
    """The mesh of a shape; an STL file lies relative to `folder`.

    Raises `ValueError` if there is no such file, or if its surface has gaps or overlaps and so no inside.
    """
    if shape.box is not None:
        corners = np.array([np.min(shape.box, axis=0), np.max(shape.box, axis=0)])
        if np.any(corners[0] >= corners[1]):
            raise ValueError(f"box must have a volume, got {shape.box} m")
        return trimesh.creation.box(bounds=corners)
    if shape.sphere is not None:
        found = trimesh.creation.icosphere(subdivisions=4, radius=shape.sphere.radius)
        # The corners of the facets lie on the sphere: as a whole they are a little small.
        found.apply_scale((4.0 / 3.0 * np.pi * shape.sphere.radius**3 / found.volume) ** (1.0 / 3.0))
        return found.apply_translation(shape.sphere.center)
    assert shape.stl is not None, "polygon and circle are of two dimensions"
    path = folder / shape.stl
    if not path.is_file():
        raise ValueError(f"stl must be a file that exists, got {path}")
    try:
        found = trimesh.load_mesh(path, file_type="stl")
    except Exception as error:  # the reader raises what it likes
        raise ValueError(f"stl must be an STL file, got {path} ({error})") from None
    if not isinstance(found, Trimesh) or not len(found.faces):
        raise ValueError(f"stl must be an STL file with triangles, got {path}")
    if not found.is_watertight:
        raise ValueError(
            f"stl must be watertight, got {path} with {_loose(found)} edges of {len(found.edges_unique)} that do not "
            "join two triangles"
        )
    if found.volume < 0.0:
        found.invert()
    found.apply_scale(shape.scale)
    return found.apply_translation(shape.offset or [0.0, 0.0, 0.0])


def _loose(found: Trimesh) -> int:
    return int(np.sum(np.bincount(found.edges_unique_inverse) != 2))


class Grid(NamedTuple):
    """A lattice of cells: corner of the first [m], number along each axis, and the spacing [m]."""

    corner: np.ndarray
    shape: tuple[int, ...]
    spacing: float

    @property
    def middles(self) -> np.ndarray:
        return self.corner + (lattice_points(*map(range, self.shape)) + 0.5) * self.spacing


def grid_around(meshes: list[Trimesh], anchor: np.ndarray, margin: float, spacing: float) -> Grid:
    """The cells of the lattice through `anchor` up to `margin` [m] around all meshes."""
    low = np.min([m.bounds[0] for m in meshes], axis=0) - margin
    high = np.max([m.bounds[1] for m in meshes], axis=0) + margin
    first, last = (np.round((edge - anchor) / spacing).astype(int) for edge in (low, high))
    return Grid(anchor + first * spacing, tuple((last - first + 1).tolist()), spacing)


def depths(found: Trimesh, grid: Grid, reach: float) -> np.ndarray:
    """Depth of each cell's middle below the surface [m], negative outside, −∞ or ∞ where it is more than `reach`."""
    position = grid.middles
    depth = np.where(_inside(found, grid).ravel(), np.inf, -np.inf)
    sampled = trimesh.remesh.subdivide_to_size(found.vertices, found.faces, max_edge=grid.spacing, max_iter=20)[0]
    near = np.all((position > found.bounds[0] - reach) & (position < found.bounds[1] + reach), axis=1)
    near = np.flatnonzero(near)
    rough, _ = KDTree(sampled).query(position[near], distance_upper_bound=reach + grid.spacing)
    near = near[np.isfinite(rough)]
    for part in np.array_split(near, len(near) // 20_000 + 1):
        away = trimesh.proximity.closest_point(found, position[part])[1] if len(part) else np.zeros(0)
        depth[part] = np.where(away <= reach, np.sign(depth[part]) * away, depth[part])
    return depth


def _inside(found: Trimesh, grid: Grid) -> np.ndarray:
    """Which cells have their middle inside: one ray along z for each column, whose crossings are counted."""
    across = grid.shape[0] * grid.shape[1]
    columns = lattice_points(range(grid.shape[0]), range(grid.shape[1]))
    # A ray through an edge meets two triangles or none; no edge of a drawing lies exactly there.
    aside = np.array([3.1e-6, 1.7e-6])
    origin = np.empty((across, 3))
    origin[:, :2] = grid.corner[:2] + (columns + 0.5 + aside) * grid.spacing
    origin[:, 2] = min(found.bounds[0, 2], grid.corner[2]) - grid.spacing
    hits, ray, _ = found.ray.intersects_location(origin, np.tile([0.0, 0.0, 1.0], (across, 1)), multiple_hits=True)
    crossings = np.zeros((across, grid.shape[2] + 1), int)
    above = np.ceil((hits[:, 2] - grid.corner[2]) / grid.spacing - 0.5).astype(int)
    np.add.at(crossings, (ray, np.clip(above, 0, grid.shape[2])), 1)
    odd = np.cumsum(crossings, axis=1)[:, :-1] % 2 == 1
    return odd.reshape(grid.shape)


def fill(depth: np.ndarray, found: Trimesh, spacing: float) -> np.ndarray:
    """Which cells are fluid: as many as come closest to the volume over l0³, see `plane.fill`."""
    return depth / spacing >= threshold(depth / spacing, found.volume / spacing**3)


def wall_layers(
    tables: list[Wall], meshes: list[Trimesh], depth: list[np.ndarray], counts: list[int], grid: Grid
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The layer of each cell, 0 at the fluid's side, −1 for no wall; whether the cell lies in something solid, and
    whether it is outside of all tanks, and not beyond an open side.

    A cell outside of all tanks or inside an obstacle is wall of the layer k if its middle is k to k + 1 spacings from
    the surface.
    """
    behind = np.full(np.prod(grid.shape), np.inf)
    if not tables:
        return np.full(len(behind), -1), np.zeros(len(behind), bool), np.zeros(len(behind), bool)
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
    solid = (behind > 0.0) & (behind < most * grid.spacing)
    position = grid.middles
    for k in outside:
        opened = beyond(position, tables[k].open, meshes[k].bounds)
        solid &= (owner != k) | ~opened
        without &= ~opened
    with np.errstate(invalid="ignore"):
        layer = np.floor(np.where(np.isfinite(behind), behind, 0.0) / grid.spacing + 1e-6).astype(int)
    return np.where(solid & (layer < most), layer, -1), solid | obstacles, without
