"""Particles for other programs and from them: CSV, .prof, and VTK's .vtu and .vtp."""

import warnings
from collections.abc import Mapping
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from jaxmps._types import as_array
from jaxmps.flow import Kind, Particles
from jaxmps.io.text import TYPES, Dialect, Types, read_csv, read_prof, write_csv, write_prof
from jaxmps.results import Run, at_frame, needed, padded

FORMATS = ("csv", "prof", "vtu", "vtp")
"""Suffixes of the files that `export` writes and `particles_from` reads."""


def export(run: Run, path: str | Path, frame: int = -1, *, types: Types = TYPES, overwrite: bool = False) -> Path:
    """Writes a frame of a run, in the format of the suffix of `path`: .csv, .prof, .vtu or .vtp; SI units.

    Text has 17 digits: doubles come back as they were. A .prof has three components, a type for each particle, and no
    phase; `types` are what its numbers mean, each a `Kind` or a `Kind` and a phase. Raises `ValueError` for another
    suffix or a kind or phase without a number, `IndexError` for a frame that is not there, `FileExistsError` for a file
    that is there, unless `overwrite`, and `ImportError` for .vtu and .vtp without PyVista.
    """
    path = Path(path)
    form, columns, time = _format(path), at_frame(run, frame), float(run.time[frame])
    if path.exists() and not overwrite:
        raise FileExistsError(f"{path} exists already: choose another path, or allow it to be overwritten")
    if form == "csv":
        write_csv(path, columns, time)
    elif form == "prof":
        write_prof(path, columns, time, types)
    else:
        cloud = run.to_pyvista(frame)
        (cloud if form == "vtp" else cloud.cast_to_unstructured_grid()).save(path)
    return path


def particles_from(
    path: str | Path,
    *,
    dim: int | None = None,
    types: Types = TYPES,
    columns: Mapping[str, str] | None = None,
    separator: str | None = ",",
    decimal: str = ".",
) -> Particles:
    """The particles in a .csv, .prof, .vtu or .vtp, to make a `Case` of with spacing, fluids, box and gravity.

    A CSV has a header with x, y, for three dimensions z, and any of u, v, w, pressure, kind and phase, with units in
    brackets or without. Where they have other names, `columns` gives the file's for ours, as in
    {"x": "Points:0", "y": "Points:1", "u": "velocity:0", "v": "velocity:1"}; its other columns are not read then.
    `separator` stands between values, None for any blanks, and `decimal` may be a comma.

    The files of VTK may have the point data velocity, pressure, kind and phase. What is absent is fluid of phase 0
    without velocity and pressure. The formats other than CSV have three components: they are taken as of two dimensions
    if the third is zero throughout, or as `dim` says. `types` are what the numbers of a .prof mean, of which number
    density and pressure may be absent.

    Raises `FileNotFoundError` if there is no file, `ValueError`, with the line, if something is wrong with it.
    """
    path = Path(path)
    form = _format(path)
    if dim not in (None, 2, 3):
        raise ValueError(f"dim must be 2 or 3, got {dim}")
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    dialect = Dialect(columns, separator, decimal)
    if form != "csv" and dialect != Dialect():
        raise ValueError(f"columns, separator and decimal must be given for a .csv only, got {path.name}")
    found = read_csv(path, dialect) if form == "csv" else read_prof(path, types) if form == "prof" else _read_vtk(path)
    nothing = np.zeros(len(found["position"]))
    found = {
        "velocity": np.zeros_like(found["position"]),
        "pressure": nothing,
        "kind": nothing,
        "phase": nothing,
    } | found
    _check(path, found)
    flat = not np.any(found["position"][:, 2:]) and not np.any(found["velocity"][:, 2:])
    if dim is None:
        dim = 2 if flat and not (form == "csv" and "z" in found) else 3
    if dim == 2 and not flat:
        raise ValueError(f"{path} must have no third components for dim = 2, got some other than zero")
    return Particles(
        position=as_array(padded(found["position"])[:, :dim]),
        velocity=as_array(padded(found["velocity"])[:, :dim]),
        pressure=as_array(found["pressure"]),
        kind=jnp.asarray(found["kind"], jnp.int8),
        phase=jnp.asarray(found["phase"], jnp.int32),
    )


def _format(path: Path) -> str:
    form = path.suffix.lower().removeprefix(".")
    if form not in FORMATS:
        raise ValueError(f"path must end in one of .{', .'.join(FORMATS)}, got {path.name}")
    return form


def _read_vtk(path: Path) -> dict[str, np.ndarray]:
    pyvista = needed("pyvista")
    try:
        with pyvista.VtkErrorCatcher(raise_errors=True), warnings.catch_warnings(action="ignore"):
            mesh = pyvista.read(path)
        found = {name: np.asarray(mesh.point_data[name]) for name in mesh.point_data.keys()}  # noqa: SIM118
        return {**found, "position": np.asarray(mesh.points)}
    except Exception as error:  # VTK's errors have no type of their own
        raise ValueError(f"{path} must be a VTK file of particles, got one that cannot be read") from error


def _check(path: Path, found: Mapping[str, np.ndarray]) -> None:
    """`ValueError` unless there are particles with finite values and known kinds."""
    count = len(found["position"])
    if not count:
        raise ValueError(f"{path} must have at least one particle, got none")
    for name in ("position", "velocity", "pressure"):
        values = found[name]
        if values.shape[:1] != (count,) or values.ndim != (1 if name == "pressure" else 2):
            raise ValueError(f"{path}: {name} must be given for each of {count} particles, got shape {values.shape}")
        finite = np.isfinite(values).reshape(count, -1).all(axis=1)
        if not finite.all():
            worst = int(np.argmin(finite))
            raise ValueError(f"{path}, particle {worst}: {name} must be finite, got {values[worst]}")
    for name, most in (("kind", max(Kind)), ("phase", np.inf)):
        values = found[name]
        known = (values == np.round(values)) & (values >= 0) & (values <= most)
        if not known.all():
            worst = int(np.argmin(known))
            kinds = ", ".join(f"{kind} ({kind.name.lower()})" for kind in Kind)
            rule = f"one of {kinds}" if name == "kind" else "a whole number of 0 or more"
            raise ValueError(f"{path}, particle {worst}: {name} must be {rule}, got {values[worst]:g}")
