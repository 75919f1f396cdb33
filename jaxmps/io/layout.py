"""The groups and datasets of a VTKHDF PolyData that grows by a time step at a time.

Connectivity, phase and density are stored once, with offset 0 in every step.
"""

import math
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

CHANGING = ("velocity", "pressure", "number_density", "surface", "kind")
FIXED = ("phase", "density")
# Newer layouts mark a file as open for writing, and it could not be opened after a SIGKILL.
_LIBVER = ("earliest", "v110")
# A dataset of more chunks has its chunk index rebuilt; a SIGKILL amid that could cost frames.
_CHUNKS = 64
_MOST_ROWS = 100_000_000  # of a chunk: HDF5 has none of 4 GiB
_STEP_ROWS = 512


def create(path: Path, particles: int, dtype: np.dtype, frames: int) -> None:
    """Makes the file at `path` one without steps, laid out for about `frames` of them."""
    with h5py.File(path, "w", libver=_LIBVER, locking=False) as file:
        root = file.create_group("VTKHDF")
        root.attrs["Version"] = np.array([2, 0])
        # The readers take a string of fixed length only.
        root.attrs["Type"] = np.bytes_("PolyData")
        _create_mesh(root, particles, dtype, rows=min(particles * math.ceil(frames / _CHUNKS), _MOST_ROWS))
        _create_steps(root)


def open_file(path: Path, mode: str) -> Any:
    """The HDF5 file, unlocked: a viewer may have it open. No cache: appends write nothing twice."""
    return h5py.File(path, mode, libver=_LIBVER, locking=False, rdcc_nbytes=0)


def reserve(path: Path, overwrite: bool) -> None:
    """An empty file at `path`; `FileExistsError` if there is one that must not be replaced."""
    for folder in path.parents:
        if folder.exists() and not folder.is_dir():
            raise NotADirectoryError(f"cannot write {path}: {folder} is not a folder")
    path.parent.mkdir(parents=True, exist_ok=True)
    if overwrite and path.is_file():
        # Not emptied but unlinked: a viewer that has the old file open keeps it whole.
        path.unlink()
    try:
        path.open("xb").close()
    except FileExistsError:
        raise FileExistsError(f"{path} exists already: choose another path, or allow it to be overwritten") from None


@contextmanager
def writing(path: Path) -> Iterator[Any]:
    """The HDF5 file to be written to; one `OSError` that names it if that fails, on a full disk for example."""
    try:
        with open_file(path, "r+") as file:
            yield file
    except (OSError, RuntimeError) as error:
        number = re.search(r"errno = (\d+)", str(error))  # HDF5 tells it amid much else
        cause = os.strerror(int(number[1])) if number else str(error)
        raise OSError(f"{path} could not be written: {cause}") from error


def append_step(root: Any, time: float, columns: Mapping[str, np.ndarray]) -> None:
    """Adds all of a step to group `VTKHDF` but its count: `count_step` does that, in the end."""
    steps = root["Steps"]
    frame, start = int(steps.attrs["NSteps"]), 0
    for name, values in columns.items():
        start = frame * len(values)
        put(root[name], start, values)
    put(steps["Values"], frame, np.array([time], np.float64))
    put(steps["PointOffsets"], frame, np.array([start]))
    for name in ("PartOffsets", "NumberOfParts", "CellOffsets", "ConnectivityIdOffsets"):
        steps[name].resize(frame + 1, axis=0)
    for name, sizes in steps.get("FieldDataSizes", {}).items():
        put(sizes, frame, np.array([[1, len(root["FieldData"][name])]]))
        steps["FieldDataOffsets"][name].resize(frame + 1, axis=0)


def count_step(root: Any) -> None:
    """Makes the step just added count: a reader, or a kill, before sees the earlier steps only."""
    root.file.flush()
    root["Steps"].attrs.modify("NSteps", int(root["Steps"].attrs["NSteps"]) + 1)


def put(dataset: Any, start: int, values: np.ndarray) -> None:
    """Writes `values` from row `start` on, and ends the dataset there."""
    dataset.resize(start + len(values), axis=0)
    dataset[start:] = values


def put_names(root: Any, name: str, values: list[str]) -> None:
    """Strings that hold for all steps, as field data; to a file without steps."""
    # VTK's reader converts from ASCII only, passes on the bytes, and reads beyond the end without offsets and sizes.
    text = np.array([value.encode() for value in values], object)
    root.create_group("FieldData").create_dataset(name, data=text, dtype=h5py.string_dtype("ascii"))
    steps = root["Steps"]
    create_growing(steps.create_group("FieldDataOffsets"), name)
    create_growing(steps.create_group("FieldDataSizes"), name, (2,))


def create_growing(
    group: Any,
    name: str,
    rest: tuple[int, ...] = (),
    dtype: Any = np.int64,
    rows: int = _STEP_ROWS,
    fill: int = 0,
) -> None:
    """An empty dataset of rows of shape `rest`, in chunks of `rows`."""
    shape, limit, chunks = (0, *rest), (None, *rest), (rows, *rest)
    group.create_dataset(name, shape, dtype, maxshape=limit, chunks=chunks, fillvalue=fill)


def _create_mesh(root: Any, particles: int, dtype: np.dtype, rows: int) -> None:
    root["NumberOfPoints"] = np.array([particles])
    for name in ("Vertices", "Lines", "Polygons", "Strips"):
        cells = root.create_group(name)
        count = particles if name == "Vertices" else 0
        cells["NumberOfCells"] = cells["NumberOfConnectivityIds"] = np.array([count])
        cells["Offsets"], cells["Connectivity"] = np.arange(count + 1), np.arange(count)
    data = root.create_group("PointData")
    create_growing(root, "Points", (3,), dtype, rows)
    create_growing(data, "velocity", (3,), dtype, rows)
    create_growing(data, "pressure", (), dtype, rows)
    create_growing(data, "number_density", (), dtype, rows)
    create_growing(data, "surface", (), np.uint8, rows)
    create_growing(data, "kind", (), np.int8, rows)


def _create_steps(root: Any) -> None:
    steps = root.create_group("Steps")
    steps.attrs["NSteps"] = 0
    create_growing(steps, "Values", dtype=np.float64)
    create_growing(steps, "PointOffsets")
    # One part and one mesh serve all steps: these are never written, and read as their fill value.
    create_growing(steps, "PartOffsets")
    create_growing(steps, "NumberOfParts", fill=1)
    create_growing(steps, "CellOffsets", (4,))
    create_growing(steps, "ConnectivityIdOffsets", (4,))
    offsets = steps.create_group("PointDataOffsets")
    for name in CHANGING:
        offsets[name] = steps["PointOffsets"]
    for name in FIXED:
        offsets[name] = steps["PartOffsets"]


def checked(name: str, values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The values, if they have this shape; else `ValueError`."""
    if values.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {values.shape}")
    return values
