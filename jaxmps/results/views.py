"""A run as other libraries know it, and as notebooks show it. Run's methods call these functions; see there."""

from typing import Any

import numpy as np

from jaxmps.description import UNITS
from jaxmps.flow import Box, Kind

AXES = "xyz"
_DIMENSIONS = {
    "position": ("time", "particle", "axis"),
    "velocity": ("time", "particle", "axis"),
    "pressure": ("time", "particle"),
    "number_density": ("time", "particle"),
    "surface": ("time", "particle"),
    "kind": ("time", "particle"),
    "phase": ("particle",),
    "density": ("particle",),
}
_POINT_DATA = ("velocity", "pressure", "number_density", "surface", "kind", "phase", "density")


def at_frame(run: Any, frame: int) -> dict[str, np.ndarray]:
    """Everything that a frame has for each particle; `IndexError` if there is no such frame."""
    count = len(run)
    if not -count <= frame < count:
        raise IndexError(f"frame must be between {-count} and {count - 1}, got {frame}")
    columns = {name: getattr(run, name) for name in _DIMENSIONS}
    return {name: values[frame] if _DIMENSIONS[name][0] == "time" else values for name, values in columns.items()}


def box_of(run: Any) -> Box:
    """The box of a run; one without periodic axes if the run is of a version that did not keep it."""
    dim = run.position.shape[-1]
    told = run.metadata.get("box") or {"lower": [0.0] * dim, "upper": [1.0] * dim, "periodic": [False] * dim}
    return Box(*(tuple(told[name]) for name in ("lower", "upper", "periodic")), mirror=told.get("mirror"))


def dataset(run: Any) -> Any:
    xarray = needed("xarray")
    variables: dict[str, Any] = {
        name: (dims, getattr(run, name), {"units": UNITS[name]}) for name, dims in _DIMENSIONS.items()
    }
    for column, name in enumerate(("kinetic_energy", "potential_energy")):
        variables[name] = ("time", run.energy[:, column], {"units": UNITS["energy"]})
    # The CF conventions' way to say what numbers mean.
    meanings = " ".join(kind.name.lower() for kind in Kind)
    variables["kind"][2].update(flag_values=np.array(list(Kind), np.int8), flag_meanings=meanings)
    # Meanings are parted by spaces, which the names themselves therefore must not have.
    names = ["_".join(name.split()) for name in run.phase_names]
    variables["phase"][2].update(flag_values=np.arange(len(names), dtype=np.int32), flag_meanings=" ".join(names))
    variables["spacing"] = ((), run.spacing, {"units": UNITS["spacing"]})
    coordinates = {
        "time": ("time", run.time, {"units": UNITS["time"]}),
        "axis": ("axis", list(AXES[: run.position.shape[2]])),
    }
    names = {key: str((run.metadata.get(key) or {}).get("name", "custom")) for key in ("case", "scheme")}
    return xarray.Dataset(variables, coordinates, {**names, "status": str(run.status)})


def cloud(run: Any, frame: int) -> Any:
    pyvista = needed("pyvista")
    columns = at_frame(run, frame)
    made = pyvista.PolyData(padded(columns["position"]))
    for name in _POINT_DATA:
        values = columns[name]
        values = values.astype(np.uint8) if values.dtype == bool else values
        made.point_data[name] = padded(values) if values.ndim == 2 else values
    # Under this name VTK's own readers look for it.
    made.field_data["TimeValue"] = np.array([run.time[frame]], np.float64)
    made.field_data["phase_names"] = run.phase_names
    made.field_data["spacing"] = np.array([run.spacing], np.float64)
    return made


def padded(values: np.ndarray) -> np.ndarray:
    """Vectors `(n, d)` with three components, the third of which is zero in 2-D."""
    return np.pad(values, ((0, 0), (0, 3 - values.shape[1])))


def needed(package: str) -> Any:
    """A package that is not installed with this one; `ImportError` says how to get it."""
    import importlib

    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise ImportError(f"{package} is needed for this: pip install 'jaxmps[exchange]'") from error
