"""One HDF5 file per run: group `VTKHDF` for viewers, group `jaxmps` for all else.

`VTKHDF` is a PolyData with time steps, a vertex per particle; in 2-D the third component is zero.
`jaxmps` has the times and energies of the frames, and JSON strings that describe the run.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from jaxmps.description import UNITS
from jaxmps.io import image as images
from jaxmps.io import layout
from jaxmps.results import names_of_phases

FORMAT = 1


class Writer:
    """Writes a run frame by frame; the file is complete and readable after each of them.

    `frames` is about how many there will be. More do no harm, but then a SIGKILL in the very
    instant of writing could.

    Raises `FileExistsError` if there is a file at `path` and `overwrite` is false, another
    `OSError` if the file cannot be written, `ValueError` if an argument is none that fits.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        phase: ArrayLike,
        density: ArrayLike,
        spacing: float,
        dim: int,
        dtype: DTypeLike,
        metadata: Mapping[str, Any],
        overwrite: bool = False,
        frames: int = 64,
    ) -> None:
        phase = np.asarray(phase, np.int32)
        self.path, self._dim, self._dtype = Path(path), dim, np.dtype(dtype)
        self._particles = len(phase)
        if dim not in (2, 3):
            raise ValueError(f"dim must be 2 or 3, got {dim}")
        if self._dtype not in (np.float32, np.float64):
            raise ValueError(f"dtype must be float32 or float64, got {self._dtype}")
        if not self._particles:
            raise ValueError("phase must have at least one particle, got none")
        units = {**UNITS, **metadata.get("units", {})}
        described = {key: _to_json(value) for key, value in {**metadata, "units": units}.items()}
        layout.reserve(self.path, overwrite)
        layout.create(self.path, self._particles, self._dtype, max(frames, 1))
        with layout.open_file(self.path, "r+") as file:
            data = file["VTKHDF/PointData"]
            data["phase"] = phase
            data["density"] = np.broadcast_to(np.asarray(density, self._dtype), phase.shape)
            layout.put_names(file["VTKHDF"], "phase_names", names_of_phases(metadata, int(phase.max()) + 1))
            own = file.create_group("jaxmps")
            own["time"] = file["VTKHDF/Steps/Values"]
            layout.create_growing(own, "energy", (2,), np.float64)
            own.attrs.update(format=FORMAT, dim=dim, spacing=float(spacing))
            own.create_group("metadata").attrs.update(described)

    @classmethod
    def restored(cls, path: str | Path, image: Mapping[str, np.ndarray]) -> "Writer":
        """A writer that goes on with a file as it was when its `image` was taken; `ValueError` if it is not that file.

        Frames added since then, whole or torn, are gone.
        """
        writer = object.__new__(cls)
        writer.path = Path(path)
        images.put_back(writer.path, image)
        with layout.open_file(writer.path, "r") as file:
            root = file["VTKHDF"]
            writer._dim, writer._dtype = int(file["jaxmps"].attrs["dim"]), root["Points"].dtype
            writer._particles = int(root["NumberOfPoints"][0])
        return writer

    def history(self) -> tuple[np.ndarray, np.ndarray]:
        """Times (m,) [s] and energies (m, 2) [J/kg] of the frames so far."""
        with layout.open_file(self.path, "r") as file:
            frames, own = int(file["VTKHDF/Steps"].attrs["NSteps"]), file["jaxmps"]
            return own["time"][:frames], own["energy"][:frames]

    def image(self) -> dict[str, np.ndarray]:
        """What `restored` needs to bring the file back to this instant; its frames are on disk then."""
        return images.take(self.path)

    def append(
        self,
        time: float,
        position: ArrayLike,
        velocity: ArrayLike,
        pressure: ArrayLike,
        number_density: ArrayLike,
        surface: ArrayLike,
        kind: ArrayLike,
        energy: ArrayLike,
    ) -> None:
        """Adds a frame; units and shapes as in `Run`. Raises `ValueError` for another shape."""
        columns = {
            "Points": self._padded("position", position),
            "PointData/velocity": self._padded("velocity", velocity),
            "PointData/pressure": self._column("pressure", pressure, self._dtype),
            "PointData/number_density": self._column("number_density", number_density, self._dtype),
            "PointData/surface": self._column("surface", surface, np.uint8),
            "PointData/kind": self._column("kind", kind, np.int8),
        }
        energies = layout.checked("energy", np.asarray(energy, np.float64), (2,))
        with layout.writing(self.path) as file:
            root = file["VTKHDF"]
            layout.put(file["jaxmps/energy"], int(root["Steps"].attrs["NSteps"]), energies[None])
            layout.append_step(root, float(time), columns)
            layout.count_step(root)

    def put_pressure(self, frame: int, pressure: ArrayLike) -> None:
        """Writes another pressure [Pa] into a frame that is there."""
        values = self._column("pressure", pressure, self._dtype)
        with layout.writing(self.path) as file:
            file["VTKHDF/PointData/pressure"][frame * self._particles : (frame + 1) * self._particles] = values

    def finish(self, status: Mapping[str, Any], summary: Mapping[str, Any]) -> None:
        """Writes how the run ended."""
        with layout.writing(self.path) as file:
            file["jaxmps"].attrs["summary"] = _to_json(summary)
            file["jaxmps"].attrs["status"] = _to_json(status)

    def _column(self, name: str, values: ArrayLike, dtype: DTypeLike) -> np.ndarray:
        return layout.checked(name, np.asarray(values, dtype), (self._particles,))

    def _padded(self, name: str, values: ArrayLike) -> np.ndarray:
        padded = np.zeros((self._particles, 3), self._dtype)
        padded[:, : self._dim] = layout.checked(name, np.asarray(values), (self._particles, self._dim))
        return padded


def _to_json(value: Any) -> str:
    return json.dumps(value, default=lambda x: x.tolist() if hasattr(x, "tolist") else str(x))
