"""Particles as text: CSV with units in its header, and the .prof of the MPS textbooks. Faults are told by line."""

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from jaxmps.flow import Kind

_CSV = {
    "kind": "",
    "phase": "",
    **dict.fromkeys("xyz", "m"),
    **dict.fromkeys("uvw", "m/s"),
    "pressure": "Pa",
    "number_density": "",
    "surface": "",
    "density": "kg/m^3",
    "time": "s",
}
_WHOLE = ("kind", "phase", "surface")
_PROF = (9, 8, 7)  # numbers in a line: type, position, velocity, and pressure, number density if they are there

Types = Mapping[int, Kind | tuple[Kind, int]]
TYPES: Types = {0: Kind.FLUID, 2: Kind.WALL, 3: Kind.DUMMY, -1: Kind.REMOVED}
"""What the types of a .prof mean by default, as in the textbooks' codes: 0 fluid, 2 wall, 3 dummy wall, −1 ghost."""


def write_csv(path: Path, columns: Mapping[str, np.ndarray], time: float) -> None:
    """A line for each particle; 17 digits, so that doubles come back as they were."""
    table = {name: values for name, values in columns.items() if values.ndim == 1}
    for names, vectors in (("xyz", columns["position"]), ("uvw", columns["velocity"])):
        table |= dict(zip(names, vectors.T, strict=False))
    table["time"] = np.full(len(columns["kind"]), time)
    names = [name for name in _CSV if name in table]
    header = ",".join(f"{name} [{_CSV[name]}]" if _CSV[name] else name for name in names)
    formats = ["%d" if name in _WHOLE else "%.17g" for name in names]
    rows = np.stack([np.asarray(table[name], np.float64) for name in names], axis=1)
    np.savetxt(path, rows, formats, ",", header=header, comments="")


def read_csv(path: Path) -> dict[str, np.ndarray]:
    """The columns of a CSV by their names without units; lines that are empty are left out."""
    lines = _lines(path)
    number, header = next(lines, (1, ""))
    names = [name.split("[")[0].strip(' "') for name in header.split(",")]
    unknown = [name for name in names if name not in _CSV]
    if not {"x", "y"} <= set(names) or unknown or len(set(names)) < len(names):
        raise ValueError(
            f"{path}, line {number}: columns must be x, y and others of {', '.join(_CSV)}, each once, got "
            f"{header[:200]}"
        )
    rows = _rows(path, lines, ",", len(names))
    found = dict(zip(names, rows.T, strict=True))
    for vector, parts in (("position", "xyz"), ("velocity", "uvw")):
        there = [found[part] for part in parts[: 3 if "z" in found else 2] if part in found]
        if there and len(there) != (3 if "z" in found else 2):
            raise ValueError(f"{path}, line {number}: columns must have all or none of {', '.join(parts)}, got {names}")
        if there:
            found[vector] = np.stack(there, axis=1)
    return found


def write_prof(path: Path, columns: Mapping[str, np.ndarray], time: float, types: Types) -> None:
    """Time [s], number of particles, and a line for each: type, position, velocity, pressure, number density."""
    numbers = {meaning: number for number, meaning in reversed(_meanings(types).items())}
    pairs = list(zip(columns["kind"].tolist(), columns["phase"].tolist(), strict=True))
    missing = sorted(set(pairs) - set(numbers))
    if missing:
        kind, phase = missing[0]
        raise ValueError(f"types must have a number for {Kind(kind).name.lower()} of phase {phase}, got {_told(types)}")
    vectors = (np.pad(columns[name], ((0, 0), (0, 3 - columns[name].shape[1]))) for name in ("position", "velocity"))
    scalars = (columns["pressure"], columns["number_density"])
    rows = np.column_stack([[numbers[pair] for pair in pairs], *vectors, *scalars]).astype(np.float64)
    np.savetxt(path, rows, ["%d"] + ["%.17g"] * 8, header=f"{time:.17g}\n{len(rows)}", comments="")


def read_prof(path: Path, types: Types) -> dict[str, np.ndarray]:
    """The columns of a .prof, with kind and phase as `types` has them."""
    lines = _lines(path)
    head = [next(lines, (k, "")) for k in (1, 2)]
    try:
        time, count = float(head[0][1]), int(head[1][1])
    except ValueError:
        time, count = math.nan, -1
    if not math.isfinite(time) or count < 0:
        raise ValueError(
            f"{path} must begin with lines of the time [s] and the number of particles, got {head[0][1][:40]!r} and "
            f"{head[1][1][:40]!r}"
        )
    first = next(lines, (0, ""))
    width = next((width for width in _PROF if len(first[1].split()) == width), _PROF[0])
    rows = _rows(path, itertools.chain([first] if first[1] else [], lines), None, width)
    if len(rows) != count:
        raise ValueError(f"{path} must have {count} lines of particles, as line {head[1][0]} says, got {len(rows)}")
    meanings = _meanings(types)
    known = np.isin(rows[:, 0], list(meanings))
    if not known.all():
        worst = int(np.argmin(known))
        raise ValueError(f"{path}, particle {worst}: type must be one of {_told(types)}, got {rows[worst, 0]:g}")
    kind, phase = (np.array([meanings[int(t)][k] for t in rows[:, 0]], int) for k in (0, 1))
    found = {"kind": kind, "phase": phase, "position": rows[:, 1:4], "velocity": rows[:, 4:7]}
    return found | dict(zip(("pressure", "number_density"), rows[:, 7:].T, strict=False))


def _meanings(types: Types) -> dict[int, tuple[int, int]]:
    pairs = {number: value if isinstance(value, tuple) else (value, 0) for number, value in types.items()}
    return {number: (int(kind), phase) for number, (kind, phase) in pairs.items()}


def _told(types: Types) -> str:
    return ", ".join(
        f"{number} ({Kind(kind).name.lower()}{f' of phase {phase}' if phase else ''})"
        for number, (kind, phase) in _meanings(types).items()
    )


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Lines that are not empty, with their numbers."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            yield from ((number, line.strip()) for number, line in enumerate(file, 1) if line.strip())
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} must be a text file, got bytes that are none: {error.reason}") from error


def _rows(path: Path, lines: Iterable[tuple[int, str]], separator: str | None, width: int) -> np.ndarray:
    rows = []
    for number, line in lines:
        parts = line.split(separator)
        if len(parts) != width:
            raise ValueError(f"{path}, line {number}: there must be {width} numbers, got {len(parts)}")
        try:
            row = [float(part) for part in parts]
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: there must be {width} numbers, got {line[:200]}") from error
        if not all(map(math.isfinite, row)):
            raise ValueError(f"{path}, line {number}: numbers must be finite, got {line[:200]}")
        rows.append(row)
    return np.array(rows, np.float64).reshape(-1, width)
