"""What a run gives back: its frames, as plain host arrays, and how it went."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from jaxmps.description import table
from jaxmps.flow import Kind, Outcome
from jaxmps.results import views
from jaxmps.results.stored import Stored

# A column of a file that is read lazily stands for an array wherever one is used.
if TYPE_CHECKING:
    Frames: TypeAlias = np.ndarray
else:
    Frames = np.ndarray | Stored


@dataclass(frozen=True, eq=False, repr=False)
class Run:
    """The saved frames of a run: m frames of n particles in d dimensions, as numpy arrays.

    Of a run that was read with `lazy`, each frame of a column is read from the file when it is asked for.

    - `time` (m,) [s]
    - `position` (m, n, d) [m]
    - `velocity` (m, n, d) [m/s]
    - `pressure` (m, n) [Pa]
    - `number_density` (m, n) [-]
    - `surface` (m, n), whether the particle is on the free surface
    - `kind` (m, n): 0 fluid, 1 wall, 2 dummy, 3 removed; a particle that leaves is removed
    - `phase` (n,), index of the particle's material
    - `density` (n,) [kg/m³]
    - `spacing` [m], the initial distance of neighboring particles
    - `energy` (m, 2), kinetic and potential [J/kg]
    - `status`, how the run ended
    - `summary` and `metadata`, what was counted and how the run was set up; JSON values
    - `path`, the file of the run, if there is one
    """

    time: np.ndarray
    position: Frames
    velocity: Frames
    pressure: Frames
    number_density: Frames
    surface: Frames
    kind: Frames
    phase: np.ndarray
    density: np.ndarray
    spacing: float
    energy: np.ndarray
    status: Outcome = field(default_factory=Outcome)
    summary: dict[str, Any] = field(default_factory=dict)
    metadata: dict[str, Any] = field(default_factory=dict)
    path: Path | None = None

    @property
    def fluid(self) -> np.ndarray:
        """Which particles are fluid, in each frame: (m, n) bool."""
        return self.kind == Kind.FLUID

    @property
    def phase_names(self) -> list[str]:
        """Names of the phases, as the case has them (`fluids` of its metadata); else "phase 0" and so on."""
        return names_of_phases(self.metadata, int(self.phase.max(initial=0)) + 1)

    def __len__(self) -> int:
        """How many frames there are."""
        return len(self.time)

    def __repr__(self) -> str:
        frames, particles, dim = self.position.shape
        span = f", t = {self.time[0]:.4g} to {self.time[-1]:.4g} s" if frames else ""
        return (
            f"Run({_name(self.metadata, 'case')}, {_name(self.metadata, 'scheme')}: "
            f"{frames} frames of {particles} particles in {dim}-D{span}; {self.status})"
        )

    def _repr_html_(self) -> str:
        frames, particles, dim = self.position.shape
        kinds = self.kind[-1] if frames else np.zeros(0)
        counts = ", ".join(f"{np.sum(kinds == kind)} {kind.name.lower()}" for kind in Kind if np.any(kinds == kind))
        span = f", t = {self.time[0]:.6g} to {self.time[-1]:.6g} s" if frames else ""
        rows = {
            "case": _name(self.metadata, "case"),
            "scheme": _name(self.metadata, "scheme"),
            "particles": f"{particles} in {dim}-D, at the end {counts}",
            "spacing": f"{self.spacing:g} m",
            "frames": f"{frames}{span}",
            "steps": self.summary.get("steps", "unknown"),
            "status": self.status,
        }
        rows |= {"advice": self.status.advice} if self.status.advice else {}
        rows |= {"file": self.path} if self.path else {}
        return table("Run", rows)

    def to_xarray(self) -> Any:
        """All frames as an `xarray.Dataset`: dimensions time, particle and axis, units as attributes.

        Raises `ImportError` without xarray.
        """
        return views.dataset(self)

    def to_pyvista(self, frame: int = -1) -> Any:
        """A frame as a `pyvista.PolyData` with point data, SI units; in 2-D the third component is zero.

        Raises `IndexError` for a frame that is not there, `ImportError` without PyVista.
        """
        return views.cloud(self, frame)


def _name(metadata: dict[str, Any], key: str) -> str:
    described = metadata.get(key)
    if isinstance(described, dict):
        described = described.get("name")
    return described if isinstance(described, str) else f"unnamed {key}"


def names_of_phases(metadata: Mapping[str, Any], count: int) -> list[str]:
    """The names of `count` phases in a run's metadata, made up where there are none."""
    case = metadata.get("case")
    given = case.get("fluids") if isinstance(case, dict) else None
    names = [str(name) for name in given] if isinstance(given, list | tuple) else []
    return [names[k] if k < len(names) and names[k] else f"phase {k}" for k in range(count)]
