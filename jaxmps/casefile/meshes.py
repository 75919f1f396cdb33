"""Closed surfaces in space: read from STL files or made, taken apart into bodies, and what of space is inside of them.

Inside is where a surface winds around: bodies that overlap are one, however often they do, and a surface with its
normals to the inside of another body makes a hole in it.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh
from trimesh import Trimesh

from jaxmps.casefile.shapes import Shape


class Solid(NamedTuple):
    """Bodies, each with a closed surface of its own, less the holes in them."""

    bodies: tuple[Trimesh, ...]
    holes: tuple[Trimesh, ...] = ()

    @property
    def bounds(self) -> np.ndarray:
        """Lower and upper corner [m]."""
        bounds = np.array([body.bounds for body in self.bodies])
        return np.array([bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)])

    @property
    def apart(self) -> bool:
        """Whether the bodies cannot overlap: the boxes around them do not."""
        low, high = (np.array([body.bounds[k] for body in self.bodies]) for k in (0, 1))
        meet = np.all((low[:, None] < high[None]) & (low[None] < high[:, None]), axis=2)
        return bool(meet.sum() == len(self.bodies))


def solid(shape: Shape, folder: Path) -> Solid:
    """The solid of a shape; an STL file lies relative to `folder`.

    Raises `ValueError` if there is no such file, or if its surface has gaps and so no inside.
    """
    if shape.box is not None:
        corners = np.array([np.min(shape.box, axis=0), np.max(shape.box, axis=0)])
        if np.any(corners[0] >= corners[1]):
            raise ValueError(f"box must have a volume, got {shape.box} m")
        return Solid((trimesh.creation.box(bounds=corners),))
    if shape.sphere is not None:
        found: Any = trimesh.creation.icosphere(subdivisions=4, radius=shape.sphere.radius)
        # The corners of the facets lie on the sphere: as a whole they are a little small.
        found.apply_scale((4.0 / 3.0 * np.pi * shape.sphere.radius**3 / found.volume) ** (1.0 / 3.0))
        return Solid((found.apply_translation(shape.sphere.center),))
    assert shape.stl is not None, "polygon and circle are of two dimensions"
    path = folder / shape.stl
    if not path.is_file():
        raise ValueError(f"stl must be a file that exists, got {path}")
    try:
        scene = trimesh.load_scene(path, file_type="stl")
    except Exception as error:  # the reader raises what it likes
        raise ValueError(f"stl must be an STL file, got {path} ({error})") from None
    blocks = [_merged(block) for block in scene.geometry.values() if isinstance(block, Trimesh) and len(block.faces)]
    if not blocks:
        raise ValueError(f"stl must be an STL file with triangles, got {path}")
    if any(_loose(block) for block in blocks):  # of several blocks, all together may be the surface of one body
        blocks = [_merged(trimesh.util.concatenate(blocks))]
    if lost := _loose(blocks[0]):
        raise ValueError(
            f"stl must be watertight, got {path} with {lost} edges of {len(blocks[0].edges_unique)} that do not join "
            "two triangles"
        )
    found = _sorted([body for block in blocks for body in _bodies(block)])
    for body in (*found.bodies, *found.holes):
        body.apply_scale(shape.scale)
        body.apply_translation(shape.offset or [0.0, 0.0, 0.0])
    return found


def _merged(found: Any) -> Trimesh:
    """With corners at one place made one corner, and without what is no triangle then."""
    found = found.copy()
    found.merge_vertices()
    a, b, c = found.faces.T
    found.update_faces((a != b) & (b != c) & (c != a))
    if np.all(_faces_of_edges(found) == 2):
        if not found.is_winding_consistent:
            trimesh.repair.fix_winding(found)
        return found
    # Two bodies that share a face: there its two sides cancel.
    corners = np.sort(found.faces, axis=1)
    turns = np.array([(0, 1, 2), (1, 2, 0), (2, 0, 1)])
    sign = np.where(np.any(np.all(np.argsort(found.faces, axis=1)[:, None] == turns, axis=2), axis=1), 1, -1)
    _, index = np.unique(corners, axis=0, return_inverse=True)
    found.update_faces(np.bincount(index.ravel(), weights=sign)[index.ravel()] != 0)
    return found


def _faces_of_edges(found: Trimesh) -> np.ndarray:
    return np.bincount(found.edges_unique_inverse)


def _loose(found: Trimesh) -> int:
    """Edges at which a surface has a gap: of those with two triangles none, of others those that not as many triangles
    run along in one direction as in the other.
    """
    forth = np.where(found.edges[:, 0] < found.edges[:, 1], 1.0, -1.0)
    net = np.bincount(found.edges_unique_inverse, weights=forth)
    return int(np.sum((_faces_of_edges(found) != 2) & (net != 0)))


def _bodies(found: Trimesh) -> list[Trimesh]:
    """The pieces of a closed surface that have no corner in common. One with edges of four triangles stays whole."""
    if np.all(_faces_of_edges(found) == 2):
        return list(found.split(only_watertight=False))
    return [found]


def _sorted(pieces: list[Trimesh]) -> Solid:
    """A piece with its normals to its inside is a hole if it lies in another body, and else drawn inside out."""
    bodies = [piece for piece in pieces if piece.volume >= 0.0]
    holes = []
    for piece in pieces:
        if piece.volume >= 0.0:
            continue
        if any(_within(piece, body) for body in bodies):
            holes.append(piece)
        else:
            piece.invert()
            bodies.append(piece)
    return Solid(tuple(bodies), tuple(holes))


def _within(piece: Trimesh, body: Trimesh) -> bool:
    low, high = body.bounds
    if np.any(piece.bounds[0] < low) or np.any(piece.bounds[1] > high):
        return False
    some = piece.vertices[:: max(len(piece.vertices) // 50, 1)]
    return bool(np.all(body.contains(some)))


def crossings(found: Trimesh, columns: np.ndarray, below: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where upright rays at `columns` `(c, 2)` [m] from the height `below` [m] on meet a surface: number of the ray,
    height [m], and 1 where it goes in, −1 where it comes out.
    """
    origin = np.column_stack([columns, np.full(len(columns), below)])
    up = np.tile([0.0, 0.0, 1.0], (len(columns), 1))
    hits, ray, triangle = found.ray.intersects_location(origin, up, multiple_hits=True)
    hits = np.reshape(hits, (-1, 3))  # of none it has one dimension
    return ray, hits[:, 2], np.where(found.face_normals[triangle, 2] < 0.0, 1, -1)


def thickness(found: Solid) -> float:
    """The way [m] straight through a body: its median over the surface, of the thickest body."""
    return max(_thickness(body) for body in found.bodies)


def _thickness(body: Trimesh) -> float:
    points, face = trimesh.sample.sample_surface(body, 200, seed=0)[:2]
    inward = -body.face_normals[face]
    size = float(np.max(np.ptp(body.bounds, axis=0)))
    hits, ray, _ = body.ray.intersects_location(points + 1e-6 * size * inward, inward, multiple_hits=False)
    return float(np.median(np.linalg.norm(hits - points[ray], axis=1))) if len(hits) else 0.0
