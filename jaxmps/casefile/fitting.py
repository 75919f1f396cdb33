"""Whether everything in a file of an own geometry fits together: dimensions, shapes, sides, and room in the box."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely

from jaxmps.casefile import meshes, plane
from jaxmps.casefile.models import OwnFile
from jaxmps.casefile.parsing import CaseFileError, attempted
from jaxmps.casefile.shapes import Body, Shape
from jaxmps.flow import Box

MOST_CELLS = 30_000_000
"""Around a shape: there is no device with room for as many particles, and the case alone would take gigabytes."""
MOST_EMPTY = 1_000_000_000
"""In the domain: more than there is memory for in the grid of the pressure's preconditioner."""
_SHAPES = {2: ("polygon", "box", "circle"), 3: ("box", "sphere", "stl")}


def bodies(file: OwnFile) -> Iterator[tuple[str, Body]]:
    """The bodies of all fluids in turn, with the place of each in the file."""
    for i, table in enumerate(file.fluid, 1):
        for j, body in enumerate(table.body, 1):
            yield f"[[fluid]] {i}, [[fluid.body]] {j}", body


class Shapes(NamedTuple):
    fluid: list[Any]
    wall: list[Any]
    bounds: list[Any]


def checked(file: OwnFile, path: Path, dim: int, spacing: float) -> Shapes:
    """Polygons or meshes of all shapes (None for a polyline), once everything in the file fits together."""
    faults: list[str] = []

    def vectors(where: str, **given: list[Any] | None) -> None:
        for key, value in given.items():
            points = [] if value is None else value if isinstance(value[0], list) else [value]
            wrong = [point for point in points if len(point) != dim]
            if wrong:
                faults.append(f"{where}: {key} must have {dim} components, as gravity has, got {wrong[0]}")

    def made(where: str, shape: Shape) -> Any:
        ball = shape.circle or shape.sphere
        vectors(
            where,
            **{k: getattr(shape, k, None) for k in ("polygon", "polyline", "box", "offset", "velocity", "center")},
            **{f"{shape.kind}.center": ball.center if ball else None},
        )
        if isinstance(getattr(shape, "rotation", None), (list, float, int)):
            spin = getattr(shape, "rotation", None)
            if isinstance(spin, list) != (dim == 3):
                rule = "a vector [rad/s] in 3-D" if dim == 3 else "a number [rad/s] in 2-D"
                faults.append(f"{where}: rotation must be {rule}, got {spin}")
        if shape.kind == "polyline" and dim == 2:
            line = getattr(shape, "polyline", [])
            if not any(fault.startswith(f"{where}:") for fault in faults):
                with attempted(where, faults):
                    check_size("polyline", np.array([np.min(line, axis=0), np.max(line, axis=0)]), spacing)
            return None
        if shape.kind not in _SHAPES[dim]:
            faults.append(f"{where}: {shape.kind} must be one of {', '.join(_SHAPES[dim])} in {dim}-D")
        elif not any(fault.startswith(f"{where}:") for fault in faults):
            with attempted(where, faults):
                found = plane.outline(shape) if dim == 2 else meshes.solid(shape, path.parent)
                check_size(shape.kind, np.reshape(found.bounds, (2, dim)), spacing)
                return found
        return None

    vectors("[case]", lower=file.case.lower, upper=file.case.upper)
    vectors("[motion]", center=file.motion.center if file.motion else None)
    sides = "xyz"[:dim]
    faults += [
        f"[case]: periodic must be among {', '.join(sides)} in {dim}-D, got {axis}"
        for axis in file.case.periodic
        if axis not in sides
    ]
    fluid = [made(where, body) for where, body in bodies(file)]
    wall = [made(f"[[wall]] {i}", table) for i, table in enumerate(file.wall, 1)]
    for i, table in enumerate(file.wall, 1):
        faults += [
            f"[[wall]] {i}: open must be among the sides of {dim}-D, got {side}"
            for side in table.open
            if side[1] not in sides
        ]
    _check_probes(file, dim, vectors, faults)
    if faults:
        raise CaseFileError(path, faults)
    lines = [shapely.LineString(t.polyline).bounds for t in file.wall if t.polyline is not None]
    return Shapes(fluid, wall, [shape.bounds for shape in [*fluid, *wall] if shape is not None] + lines)


def _check_probes(file: Any, dim: int, vectors: Callable[..., None], faults: list[str]) -> None:
    for i, probe in enumerate(file.probe, 1):
        where = f"[[probe]] {i}"
        vectors(where, point=getattr(probe, "point", None), segment=getattr(probe, "segment", None))
        if probe.kind == "wave_gauge" and (probe.y is not None) != (dim == 3):
            faults.append(f"{where}: y must be given in 3-D, and in 3-D only, got {probe.y}")


def check_size(kind: str, corners: np.ndarray, spacing: float) -> None:
    """`ValueError` for a shape with more cells in the box around it than any device has room for particles."""
    sizes = corners[1] - corners[0]
    if np.prod(np.maximum(sizes / spacing, 1.0)) <= MOST_CELLS:
        return
    large, cells = (" x ".join(f"{x:.3g}" for x in values) for values in (sizes, sizes / spacing))
    hint = "; a file in millimeters needs scale = 0.001" if kind == "stl" else ""
    raise ValueError(
        f"{kind} must be at most {MOST_CELLS:.0e} spacings in all large, got {large} m, which is {cells} spacings of "
        f"{spacing:g} m: take a larger spacing or a smaller {'scale' if kind == 'stl' else kind}{hint}"
    )


def check_domain(path: Path, box: Box, spacing: float) -> None:
    """`CaseFileError` for a domain that nothing has memory for, empty as it may be."""
    cells = [length / spacing for length in box.lengths]
    if np.prod(cells) > MOST_EMPTY:
        raise CaseFileError(
            path,
            [
                f"[case]: the domain must have at most {MOST_EMPTY:.0e} cells of the spacing {spacing:g} m, got "
                f"{' x '.join(f'{x:.3g}' for x in cells)}, from {box.lower} m to {box.upper} m: see lower and upper"
            ],
        )


def check_inside(path: Path, box: Box, position: np.ndarray, counts: list[int], file: OwnFile) -> None:
    inside = np.all((position >= box.lower) & (position < box.upper), axis=1)
    faults = []
    places = [where for where, _ in bodies(file)] + ["[[wall]]"]
    for where, part, points in zip(
        places, np.split(inside, np.cumsum(counts)), np.split(position, np.cumsum(counts)), strict=True
    ):
        out = points[~part]
        if len(out):
            place = ", ".join(f"{x:.4g}" for x in out[0])
            faults.append(
                f"{where}: particles must lie in the box from {box.lower} m to {box.upper} m, got {len(out)} outside, "
                f"the first at ({place}) m"
            )
    if faults:
        raise CaseFileError(path, faults)
