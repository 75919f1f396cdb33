"""Runs from their files: as a whole, some of their frames, or frame by frame as they are asked for."""

import json
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import h5py
import numpy as np
import psutil

from jaxmps.flow import Event, Outcome, Status
from jaxmps.io import layout
from jaxmps.io.vtkhdf import FORMAT
from jaxmps.results import Run, Stored

_PLACES = {"position": "Points", **{name: f"PointData/{name}" for name in layout.CHANGING}}

Frames: TypeAlias = slice | int | float | Sequence[int] | Sequence[float] | np.ndarray


def read(path: str | Path, frames: Frames | None = None, lazy: bool | None = False) -> Run:
    """The run in the file at `path`; one that is still going, or was killed, counts as interrupted.

    `frames` are those to be read: their numbers, as a slice, a whole number or several, or times [s], floats, for the
    frames closest to them. Status, summary and metadata are those of the whole run. With `lazy` positions, velocities,
    pressures, number densities, surfaces and kinds stay in the file, and each frame is read when it is asked for, as in
    `run.position[3]`; what needs all frames reads them all. With None that is so for what would take more than half of
    the memory that is free.

    Raises `FileNotFoundError` if there is none, `ValueError` if it is not a run or is damaged, and for times beyond
    those of the run, `IndexError` for frames that are not there.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"there is no run at {path}")
    if not path.is_file() or not h5py.is_hdf5(path):
        raise ValueError(f"{path} is not a jaxmps run: it is no HDF5 file, or a damaged one")
    with _whole(path), layout.open_file(path, "r") as file:
        fault = _fault(file)
        fields, columns = ({}, {}) if fault else (_fields(file), _columns(file))
    if fault:
        raise ValueError(f"{path} is not a jaxmps run: {fault}")
    numbers = _numbers(frames, fields["time"])
    fields |= {name: fields[name][numbers] for name in ("time", "energy")}
    if lazy is None:
        needed = sum(math.prod(shape) * dtype.itemsize for shape, dtype in columns.values()) * len(numbers)
        lazy = needed > 0.5 * psutil.virtual_memory().available
    kept: dict[str, Any] = {}
    for name, (shape, dtype) in columns.items():
        load = partial(_load, path, name, shape, fields["metadata"])
        kept[name] = Stored(load, numbers, (len(numbers), *shape), dtype) if lazy else load(numbers)
    return Run(**fields, **kept, path=path)


@contextmanager
def _whole(path: Path) -> Iterator[None]:
    """`ValueError` that says that a file is damaged in place of what HDF5 says."""
    try:
        yield
    except (OSError, RuntimeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is damaged: {error}") from error


def _fault(file: Any) -> str | None:
    if "jaxmps" not in file or "VTKHDF" not in file:
        return "it has no groups jaxmps and VTKHDF"
    version = file["jaxmps"].attrs["format"]
    return None if version == FORMAT else f"its format is {version}, not {FORMAT}"


def _fields(file: Any) -> dict[str, Any]:
    """What is read in any case."""
    root, own = file["VTKHDF"], file["jaxmps"]
    frames = int(root["Steps"].attrs["NSteps"])
    fields: dict[str, Any] = {name: root[f"PointData/{name}"][:] for name in layout.FIXED}
    fields |= {name: own[name][:frames] for name in ("time", "energy")}
    fields["spacing"] = float(own.attrs["spacing"])
    fields["metadata"] = _metadata(file)
    if "status" in own.attrs:
        fields["status"] = Outcome.from_dict(json.loads(own.attrs["status"]))
        fields["summary"] = json.loads(own.attrs["summary"])
    else:
        last = float(fields["time"][-1]) if frames else 0.0
        fields["status"] = Outcome((Event(int(Status.INTERRUPTED), last, step=frames),))
    return fields


def _metadata(file: Any) -> dict[str, Any]:
    return {key: json.loads(text) for key, text in file["jaxmps/metadata"].attrs.items()}


def _columns(file: Any) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
    """Shape and type of a frame of each column."""
    root, dim = file["VTKHDF"], int(file["jaxmps"].attrs["dim"])
    frames, particles, found = int(root["Steps"].attrs["NSteps"]), int(root["NumberOfPoints"][0]), {}
    for name, place in _PLACES.items():
        stored = root[place]
        if len(stored) < frames * particles:
            raise ValueError(f"{place} has {len(stored)} rows of {frames * particles}")
        dtype = np.dtype(bool) if name == "surface" else stored.dtype
        found[name] = ((particles, dim) if stored.ndim == 2 else (particles,), dtype)
    return found


def _load(path: Path, name: str, shape: tuple[int, ...], metadata: dict[str, Any], numbers: np.ndarray) -> np.ndarray:
    """The frames of these numbers of a column; `ValueError` if there is another run in the file by now."""
    with _whole(path), layout.open_file(path, "r") as file:
        if same := _metadata(file) == metadata:
            found = _rows(file["VTKHDF"][_PLACES[name]], numbers, shape)
    if not same:
        raise ValueError(f"{path} has another run by now: what was not read of the one before is lost")
    return found.astype(bool) if name == "surface" else found


def _rows(stored: Any, numbers: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    particles, inner = shape[0], tuple(slice(0, size) for size in shape[1:])
    found = np.empty((len(numbers), *shape), stored.dtype)
    # Frames that follow one another are read at once.
    for part in np.split(np.arange(len(numbers)), np.flatnonzero(np.diff(numbers) != 1) + 1):
        if len(part):
            rows = slice(numbers[part[0]] * particles, (numbers[part[-1]] + 1) * particles)
            found[part[0] : part[-1] + 1] = stored[rows].reshape(len(part), particles, *stored.shape[1:])[:, :, *inner]
    return found


def _numbers(frames: Any, time: np.ndarray) -> np.ndarray:
    """The numbers of the frames that are asked for."""
    every = np.arange(len(time))
    if frames is None or isinstance(frames, slice):
        return every if frames is None else every[frames]
    wanted = np.atleast_1d(np.asarray(frames))
    if wanted.ndim != 1 or (wanted.size and wanted.dtype.kind not in "iuf"):
        raise ValueError(f"frames must be a slice, whole numbers, or times in s, got {frames!r}")
    if not wanted.size:
        return every[:0]
    if wanted.dtype.kind in "iu":
        outside = (wanted < -len(time)) | (wanted >= len(time))
        if outside.any():
            raise IndexError(f"frame must be between {-len(time)} and {len(time) - 1}, got {wanted[outside][0]}")
        return wanted % len(time)
    if not len(time):
        raise ValueError(f"frames must be none of a run without frames, got times {frames!r} s")
    slack = 1e-6 * max(abs(float(time[0])), abs(float(time[-1])))
    outside = ~((wanted >= time[0] - slack) & (wanted <= time[-1] + slack))
    if outside.any():
        raise ValueError(
            f"frames must be times within the run, from {time[0]:g} s to {time[-1]:g} s, got {wanted[outside][0]:g} s"
        )
    return np.argmin(np.abs(time - wanted[:, None]), axis=1)
