"""The tables of an own geometry made into an ordinary `Case`."""

from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import shapely

from jaxmps.casefile import plane, plane_walls, solid
from jaxmps.casefile.fitting import Shapes, bodies, check_domain, check_inside, checked
from jaxmps.casefile.models import OwnFile
from jaxmps.casefile.motion import motion
from jaxmps.casefile.parsing import CaseFileError, attributed
from jaxmps.casefile.plates import gaps, obstacles, with_plates
from jaxmps.casefile.shapes import Body, Wall
from jaxmps.cases.lattice import dummy_layers, materials
from jaxmps.flow import Box, Case, Kind, at_rest


class Layout(NamedTuple):
    """Particles of a geometry: fluid of each body, and walls with their layers and the number of the wall of each.

    `asked` is the area [m²] or volume [m³] of each body that is to be filled, `thickness` [m] that of each obstacle;
    other walls have an infinite one. `gaps`: obstacles with a place at which a part of them has no particles.
    """

    bodies: list[np.ndarray]
    asked: list[float]
    wall: np.ndarray
    layer: np.ndarray
    owner: np.ndarray
    thickness: tuple[float, ...] = ()
    gaps: tuple[tuple[int, tuple[float, ...]], ...] = ()


def build(file: OwnFile, path: Path, ratio: float, spacing: float | None = None) -> tuple[Case, Layout]:
    """The case of the file, with `spacing` [m] instead of its own if given. Raises `CaseFileError`."""
    spacing = file.case.spacing if spacing is None else spacing
    dim = len(file.case.gravity)
    file = with_plates(file, path, ratio, spacing)
    shapes = checked(file, path, dim, spacing)
    thickness = obstacles(file, path, shapes.wall, spacing)
    counts = [_layers(wall, ratio, spacing) for wall in file.wall]
    arrange = _in_plane if dim == 2 else _in_space
    layout = attributed(path, "[case]", lambda: arrange(file, shapes, counts, spacing))
    layout = layout._replace(thickness=thickness, gaps=gaps(file, shapes.wall, layout.wall, spacing))
    faults = [
        f"[[wall]] {index}: must have room for a particle at the spacing {spacing:g} m, got none: it is small, lies in "
        "other walls, or is open on all sides"
        for index in range(1, len(file.wall) + 1)
        if not np.any(layout.owner == index - 1)
    ]
    if faults:
        raise CaseFileError(path, faults)
    for (where, _), points in zip(bodies(file), layout.bodies, strict=True):
        if not len(points):
            raise CaseFileError(
                path, [f"{where}: must have room for a particle at the spacing {spacing:g} m, got none"]
            )
    fluid = np.concatenate(layout.bodies)
    position = np.concatenate([fluid, layout.wall])
    kind = np.where(layout.layer == 0, Kind.WALL, Kind.DUMMY)
    phase = [i for i, table in enumerate(file.fluid) for _ in table.body]
    phases = np.repeat(phase, [len(points) for points in layout.bodies])
    box = _domain(
        file, path, position, np.concatenate([np.reshape(bounds, (2, dim)) for bounds in shapes.bounds]), spacing
    )
    check_inside(path, box, position, [len(points) for points in layout.bodies], file)
    particles = at_rest(
        position,
        np.concatenate([np.full(len(fluid), Kind.FLUID), kind]),
        np.concatenate([phases, np.zeros(len(layout.wall), int)]),
    )
    velocity = [_velocity(body, points) for (_, body), points in zip(bodies(file), layout.bodies, strict=True)]
    velocity = np.concatenate([*velocity, np.zeros_like(layout.wall)])
    particles = eqx.tree_at(lambda p: p.velocity, particles, jnp.asarray(velocity, particles.position.dtype))
    densities = {f"density of {t.name or i}": t.density for i, t in enumerate(file.fluid)}
    viscosities = {f"viscosity of {t.name or i}": t.viscosity for i, t in enumerate(file.fluid)}
    fluids = attributed(path, "[[fluid]]", lambda: materials(densities, viscosities))
    moved = attributed(path, "[motion]", lambda: motion(file.motion, dim))
    name, gravity = file.case.name or path.stem, file.case.gravity

    def make() -> Case:
        return Case(particles, fluids, gravity, spacing, box, name=name, motion=moved)

    return attributed(path, "[case]", make), layout


def _layers(wall: Wall, ratio: float, spacing: float) -> int:
    if wall.thickness is not None:
        return max(round(wall.thickness / spacing), 1)
    return wall.layers or 1 + dummy_layers(ratio)


def _in_plane(file: OwnFile, shapes: Shapes, counts: list[int], spacing: float) -> Layout:
    around = shapely.union_all([*shapes.fluid, *(shapely.box(*bounds) for bounds in shapes.bounds)])
    walls = plane_walls.walls(file.wall, counts, spacing, around)
    rooms = [walls.room(shape) for shape in shapes.fluid]
    placed, anchors = [], []
    for k, room in enumerate(rooms):
        touching = [j for j in range(k) if room.distance(rooms[j]) < spacing]
        anchors.append(anchors[touching[0]] if touching else np.array(room.bounds[:2]))
        placed.append(plane.fill(room, spacing, anchors[k], walls.position))
    asked = [_left(room, rooms[k + 1 :]).area for k, room in enumerate(rooms)]
    return _without_overlap(placed, asked, walls.position, walls.layer, walls.owner, spacing)


def _left(room: Any, later: list[Any]) -> Any:
    return room.difference(shapely.union_all(later)) if later else room


def _in_space(file: OwnFile, shapes: Shapes, counts: list[int], spacing: float) -> Layout:
    outside = [mesh for table, mesh in zip(file.wall, shapes.wall, strict=True) if table.side == "outside"]
    anchor = (outside or shapes.fluid)[0].bounds[0]
    reach = (max(counts, default=0) + 1) * spacing
    grid = solid.grid_around([*shapes.fluid, *shapes.wall], anchor, reach, spacing)
    depth = [solid.depths(mesh, grid, reach) for mesh in shapes.wall]
    walls = solid.wall_layers(file.wall, [mesh.bounds for mesh in shapes.wall], depth, counts, grid)
    position, placed, asked = grid.middles, [], []
    sizes = [solid.volume(mesh, spacing) for mesh in shapes.fluid]
    inside = [
        solid.fill(solid.depths(mesh, grid, spacing), size, spacing)
        for mesh, size in zip(shapes.fluid, sizes, strict=True)
    ]
    for k, (cells, size) in enumerate(zip(inside, sizes, strict=True)):
        free = cells & ~walls.solid
        if inside[k + 1 :]:
            free &= ~np.any(inside[k + 1 :], axis=0)
        if np.any(free & ~walls.without):
            free &= ~walls.without
        placed.append(position[free])
        # What walls and later bodies take of it is known as cells only.
        asked.append(size - spacing**3 * float(np.sum(cells & ~free)))
    there = walls.layer >= 0
    return _without_overlap(placed, asked, position[there], walls.layer[there], walls.owner[there], spacing)


def _without_overlap(
    placed: list[np.ndarray],
    asked: list[float],
    wall: np.ndarray,
    layer: np.ndarray,
    owner: np.ndarray,
    spacing: float,
) -> Layout:
    """Of two fluid particles too close to one another that of the later body stays; walls stay in any case."""
    order = [wall, *placed[::-1]]
    keep = plane.apart(np.concatenate(order), plane.CLOSE * spacing)
    parts = np.split(keep, np.cumsum([len(points) for points in order])[:-1])
    fluid = [points[kept] for points, kept in zip(placed, parts[:0:-1], strict=True)]
    return Layout(fluid, asked, wall[parts[0]], layer[parts[0]], owner[parts[0]])


def _velocity(body: Body, points: np.ndarray) -> np.ndarray:
    velocity = np.broadcast_to(np.asarray(body.velocity or [0.0] * points.shape[1]), points.shape).copy()
    if body.rotation is not None:
        offset = points - (np.mean(points, axis=0) if body.center is None else np.asarray(body.center))
        if isinstance(body.rotation, list):
            velocity += np.cross(np.asarray(body.rotation), offset)
        else:
            velocity += body.rotation * np.stack([-offset[:, 1], offset[:, 0]], axis=1)
    return velocity


def _domain(file: OwnFile, path: Path, position: np.ndarray, corners: np.ndarray, spacing: float) -> Box:
    """The box of the file; else that around all particles, with headroom against gravity or, without it, all round."""
    table, dim = file.case, position.shape[1]
    gravity = np.asarray(table.gravity)
    shapes = np.array([corners.min(axis=0), corners.max(axis=0)])
    low, high = position.min(axis=0) - 0.5 * spacing, position.max(axis=0) + 0.5 * spacing
    low, high = np.minimum(low, shapes[0]), np.maximum(high, shapes[1])
    room = table.headroom
    if not gravity.any():
        room = 0.5 * np.max(shapes[1] - shapes[0]) if room is None else room
        low, high = low - room, high + room
    else:
        up = int(np.argmax(np.abs(gravity)))
        room = max(float(np.ptp(shapes[:, up])), 3.0 * spacing) if room is None else room
        end = high if gravity[up] < 0 else low
        end[up] += room if gravity[up] < 0 else -room
    periodic = tuple(axis in table.periodic for axis in "xyz"[:dim])
    # A period is that of the drawing, to which walls and fluid must fit.
    low, high = np.where(periodic, shapes[0], low), np.where(periodic, shapes[1], high)
    low = low if table.lower is None else np.asarray(table.lower)
    high = high if table.upper is None else np.asarray(table.upper)
    found = attributed(path, "[case]", lambda: Box(tuple(low.tolist()), tuple(high.tolist()), periodic))
    check_domain(path, found, spacing)
    return found
