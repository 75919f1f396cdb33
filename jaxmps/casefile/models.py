"""The tables of a case file, as pydantic models: strict types, no unknown keys, SI units."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Length = Annotated[float, Field(gt=0.0)]
Vector = Annotated[list[float], Field(min_length=2, max_length=3)]
Side = Literal["-x", "+x", "-y", "+y", "-z", "+z"]


class Table(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, frozen=True)


class OwnCase(Table):
    """`[case]` of an own geometry; `gravity` has as many components as the case has dimensions."""

    name: str = Field("", max_length=100)
    spacing: Length
    gravity: Vector
    lower: Vector | None = None
    upper: Vector | None = None
    headroom: Annotated[float, Field(ge=0.0)] | None = None
    periodic: list[Literal["x", "y", "z"]] = []


class Ball(Table):
    center: Vector
    radius: Length


class Shape(Table):
    """A closed shape: one of these, in m. An STL file lies relative to the case file and is scaled, then moved."""

    polygon: Annotated[list[Vector], Field(min_length=3)] | None = None
    box: Annotated[list[Vector], Field(min_length=2, max_length=2)] | None = None
    circle: Ball | None = None
    sphere: Ball | None = None
    stl: str | None = None
    scale: Length = 1.0
    offset: Vector | None = None

    @property
    def kind(self) -> str:
        return next(name for name in self.kinds() if getattr(self, name) is not None)

    @classmethod
    def kinds(cls) -> tuple[str, ...]:
        return "polygon", "box", "circle", "sphere", "stl"

    @model_validator(mode="after")
    def _one_shape(self):
        given = [name for name in self.kinds() if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"must have exactly one of {', '.join(self.kinds())}, got {' and '.join(given) or 'none'}")
        if self.stl is None and (self.offset is not None or self.scale != 1.0):
            raise ValueError("must have scale and offset with an stl file only")
        return self


class Body(Shape):
    """`[[fluid.body]]`: a shape full of fluid, its velocity [m/s] and rotation [rad/s] about `center` [m]."""

    velocity: Vector | None = None
    rotation: float | Annotated[list[float], Field(min_length=3, max_length=3)] | None = None
    center: Vector | None = None


class FluidTable(Table):
    """`[[fluid]]`: density [kg/m³] and kinematic viscosity [m²/s]."""

    name: str = ""
    density: Annotated[float, Field(gt=0.0)]
    viscosity: Annotated[float, Field(ge=0.0)] = 0.0
    body: Annotated[list[Body], Field(min_length=1)]


class Wall(Shape):
    """`[[wall]]`: layers of particles outside of a shape (a tank), inside of it (an obstacle), or along a polyline."""

    polyline: Annotated[list[Vector], Field(min_length=2)] | None = None
    side: Literal["outside", "inside", "left", "right"] | None = None
    layers: Annotated[int, Field(ge=1)] | None = None
    thickness: Length | None = None
    open: list[Side] = []

    @classmethod
    def kinds(cls) -> tuple[str, ...]:
        return "polyline", *super().kinds()

    @model_validator(mode="after")
    def _sides(self):
        sides = ("left", "right") if self.polyline is not None else ("outside", "inside")
        if self.side not in sides:
            raise ValueError(f"side must be {' or '.join(sides)} for a {self.kind}, got {self.side or 'none'}")
        if self.layers is not None and self.thickness is not None:
            raise ValueError(f"must have layers or thickness, got both: {self.layers} and {self.thickness:g} m")
        if self.open and self.side != "outside":
            raise ValueError(f'open must be given with side = "outside" only, got {self.open}')
        return self


class SignalTable(Table):
    """A sine by `amplitude`, `period` [s] and `phase` [rad], or `values` at `times` [s]; in m, of an angle in rad."""

    amplitude: float | None = None
    period: Length | None = None
    phase: float = 0.0
    times: Annotated[list[float], Field(min_length=3)] | None = None
    values: Annotated[list[float], Field(min_length=3)] | None = None

    @model_validator(mode="after")
    def _one_signal(self):
        sine = (self.amplitude is not None, self.period is not None)
        table = (self.times is not None, self.values is not None)
        if sorted([sine, table]) != [(False, False), (True, True)]:
            raise ValueError("must have amplitude and period, or times and values")
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
    wall: list[Wall] = []
    motion: MotionTable | None = None
    probe: list[ProbeTable] = []
    scheme: SchemeTable = SchemeTable()
    run: RunTable = RunTable()


class BuiltinFile(Table):
    """A file that names a built-in case; `casefile.parsing` adds the arguments of the case to `[case]`."""

    case: Table
    probe: list[ProbeTable] = []
    scheme: SchemeTable = SchemeTable()
    run: RunTable = RunTable()
