"""The tables of a case file, as pydantic models: strict types, no unknown keys, SI units."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from jaxmps.casefile.shapes import Body, Length, Table, Vector, Wall


class OwnCase(Table):
    """`[case]` of an own geometry; `gravity` has as many components as the case has dimensions."""

    name: str = Field("", max_length=100)
    spacing: Length
    gravity: Vector
    lower: Vector | None = None
    upper: Vector | None = None
    headroom: Annotated[float, Field(ge=0.0)] | None = None
    periodic: list[Literal["x", "y", "z"]] = Field(default_factory=list)


class FluidTable(Table):
    """`[[fluid]]`: density [kg/m³] and kinematic viscosity [m²/s]."""

    name: str = ""
    density: Annotated[float, Field(gt=0.0)]
    viscosity: Annotated[float, Field(ge=0.0)] = 0.0
    body: Annotated[list[Body], Field(min_length=1)]


class SignalTable(Table):
    """A sine by `amplitude`, `period` [s] and `phase` [rad], or `values` at `times` [s] with an `interpolation` in
    between; in m, of an angle in rad.
    """

    amplitude: float | None = None
    period: Length | None = None
    phase: float | None = None
    times: Annotated[list[float], Field(min_length=2)] | None = None
    values: Annotated[list[float], Field(min_length=2)] | None = None
    interpolation: Literal["pchip", "linear"] | None = None

    @model_validator(mode="after")
    def _one_signal(self):
        sine = (self.amplitude is not None, self.period is not None)
        table = (self.times is not None, self.values is not None)
        if sorted([sine, table]) != [(False, False), (True, True)]:
            raise ValueError("must have amplitude and period, or times and values")
        if self.interpolation is not None and self.times is None:
            raise ValueError("must have interpolation with times and values only")
        if self.phase is not None and self.times is not None:
            raise ValueError("must have phase with amplitude and period only")
        return self


class MotionTable(Table):
    """`[motion]`: all walls move as one body, see `jaxmps.flow.motion.Rigid`; `roll` is about `center` [m]."""

    center: Vector | None = None
    sway: SignalTable | None = None
    heave: SignalTable | None = None
    roll: SignalTable | None = None

    @model_validator(mode="after")
    def _about(self):
        if self.roll is not None and self.center is None:
            raise ValueError("center must be given with roll")
        return self


class PressureProbe(Table):
    """Pressure [Pa] at a point [m]."""

    kind: Literal["pressure"]
    name: str = ""
    point: Vector
    radius: Length | None = None


class WallPressureProbe(Table):
    """Mean pressure [Pa] along a segment of a wall, from one point to another [m]."""

    kind: Literal["wall_pressure"]
    name: str = ""
    segment: Annotated[list[Vector], Field(min_length=2, max_length=2)]
    radius: Length | None = None


class WaveGauge(Table):
    """Height of the surface [m] at x, in 3-D at x and y."""

    kind: Literal["wave_gauge"]
    name: str = ""
    x: float
    y: float | None = None


class FrontProbe(Table):
    """The surge front along x [m]."""

    kind: Literal["front"]
    name: str = ""


ProbeTable = Annotated[
    PressureProbe | WallPressureProbe | WaveGauge | FrontProbe,
    Field(discriminator="kind"),
]


class RunTable(Table):
    """`[run]`: times [s], jitter [spacings], seed and precision; what the command line has options for."""

    until: Length = 2.0
    save_every: Length = 0.02
    dt: Length | None = None
    jitter: Annotated[float, Field(ge=0.0, le=0.3)] = 0.0
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    precision: Literal["single", "double"] = "double"


class SchemeTable(BaseModel):
    """`[scheme]`: the name, and any argument or dotted value of the scheme."""

    model_config = ConfigDict(strict=True, extra="allow", allow_inf_nan=False, frozen=True)
    name: str = "mps"

    @property
    def values(self) -> dict[str, Any]:
        """The values by their dotted names."""
        return dict(_flat(self.model_extra or {}))


def _flat(table: dict[str, Any], prefix: str = ""):
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


class OwnFile(Table):
    """A file with a geometry of its own."""

    case: OwnCase
    fluid: Annotated[list[FluidTable], Field(min_length=1)]
    wall: list[Wall] = Field(default_factory=list)
    motion: MotionTable | None = None
    probe: list[ProbeTable] = Field(default_factory=list)
    scheme: SchemeTable = SchemeTable()
    run: RunTable = RunTable()


class BuiltinFile(Table):
    """A file that names a built-in case; `casefile.parsing` adds the arguments of the case to `[case]`."""

    case: Table
    probe: list[ProbeTable] = Field(default_factory=list)
    scheme: SchemeTable = SchemeTable()
    run: RunTable = RunTable()
