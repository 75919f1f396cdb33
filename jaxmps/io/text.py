"""Particles as text: CSV with units in its header, and the .prof of the MPS textbooks. Faults are told by line."""

import csv
import itertools
import math
import shlex
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

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


class Dialect(NamedTuple):
    """How a CSV is written: its names for our columns, if they are others, what separates values (None for blanks), and
    the decimal sign. `ValueError` for what is none.
    """

    columns: Mapping[str, str] | None = None
    separator: str | None = ","
    decimal: str = "."

    def check(self) -> None:
        if self.separator is not None and (len(self.separator) != 1 or self.separator in '"\r\n'):
            raise ValueError(f"separator must be one character, or None for blanks, got {self.separator!r}")
        if self.decimal not in (".", ",") or self.decimal == self.separator:
            raise ValueError(f"decimal must be . or , and not the separator, got {self.decimal!r}")
        if self.columns is not None:
            unknown = [name for name in self.columns if name not in _CSV]
            if unknown or not {"x", "y"} <= set(self.columns):
                raise ValueError(f"columns must name x, y and others of {', '.join(_CSV)}, got {list(self.columns)}")

    def parts(self, line: str) -> list[str]:
        """The values of a line as text."""
        if self.separator is None:
            return shlex.split(line) if '"' in line else line.split()
        parts = next(csv.reader([line], delimiter=self.separator)) if '"' in line else line.split(self.separator)
        return [part.strip() for part in parts]


def read_csv(path: Path, dialect: Dialect) -> dict[str, np.ndarray]:
    """The columns of a CSV by their names without units; lines that are empty are left out. Where the dialect names
    columns, all others are left out, whatever they hold.
    """
    dialect.check()
    lines = _lines(path)
    number, header = next(lines, (1, ""))
    theirs, said = dialect.parts(header), f"{path}, line {number}: columns must be"
    if dialect.columns is None:
        names = [name.split("[")[0].strip() for name in theirs]
        unknown = [name for name in names if name not in _CSV]
        if not {"x", "y"} <= set(names) or unknown or len(set(names)) < len(names):
            raise ValueError(f"{said} x, y and others of {', '.join(_CSV)}, each once, got {header[:200]}")
        places = list(range(len(names)))
    else:
        names = list(dialect.columns)
        if any(theirs.count(name) != 1 for name in dialect.columns.values()):
            wanted = ", ".join(dialect.columns.values())
            raise ValueError(f"{said} {wanted}, each once, got {header[:200]}")
        places = [theirs.index(name) for name in dialect.columns.values()]
    rows = _rows(path, lines, dialect, len(theirs), places)
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
    blanks = Dialect(separator=None)
    rows = _rows(path, itertools.chain([first] if first[1] else [], lines), blanks, width, list(range(width)))
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
            # Blanks at the end of a line, but not the tabs that separate nothing from nothing.
            yield from ((number, line.strip(" \r\n")) for number, line in enumerate(file, 1) if line.strip())
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} must be a text file, got bytes that are none: {error.reason}") from error


def _rows(path: Path, lines: Iterable[tuple[int, str]], dialect: Dialect, width: int, places: list[int]) -> np.ndarray:
    """The numbers at some places of lines that have `width` of them."""
    rows, comma = [], dialect.decimal == ","
    what = f"{width} numbers" if len(places) == width else f"{width} values, with numbers in those that are read"
    for number, line in lines:
        parts = dialect.parts(line)
        if len(parts) != width:
            raise ValueError(f"{path}, line {number}: there must be {what}, got {len(parts)}")
        try:
            row = [float(parts[k].replace(",", ".") if comma else parts[k]) for k in places]
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: there must be {what}, got {line[:200]}") from error
        if not all(map(math.isfinite, row)):
            raise ValueError(f"{path}, line {number}: numbers must be finite, got {line[:200]}")
        rows.append(row)
    return np.array(rows, np.float64).reshape(-1, len(places))
