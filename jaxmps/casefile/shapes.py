"""Shapes of a case file as pydantic models: of fluid, and of walls along them."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Length = Annotated[float, Field(gt=0.0)]
Vector = Annotated[list[float], Field(min_length=2, max_length=3)]
Side = Literal["-x", "+x", "-y", "+y", "-z", "+z"]


class Table(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, frozen=True)


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


class Wall(Shape):
    """`[[wall]]`: layers of particles outside of a shape (a tank), inside of it (an obstacle), or along a polyline.

    A `plate` is a box or a polyline made as thick as it must be to part what is on its two sides.
    """

    polyline: Annotated[list[Vector], Field(min_length=2)] | None = None
    side: Literal["outside", "inside", "left", "right"] | None = None
    layers: Annotated[int, Field(ge=1)] | None = None
    thickness: Length | None = None
    open: list[Side] = []
    plate: bool = False

    @classmethod
    def kinds(cls) -> tuple[str, ...]:
        return "polyline", *super().kinds()

    @model_validator(mode="after")
    def _sides(self):
        if self.plate and self.kind not in ("box", "polyline"):
            raise ValueError(f"plate must be given with a box or a polyline, got a {self.kind}")
        sides = ("left", "right") if self.polyline is not None else ("outside", "inside")
        sides = (sides if self.polyline is not None else ("inside",)) if self.plate else sides
        if self.side not in sides and not (self.plate and self.side is None):
            what = "plate" if self.plate else self.kind
            raise ValueError(f"side must be {' or '.join(sides)} for a {what}, got {self.side or 'none'}")
        if self.layers is not None and self.thickness is not None:
            raise ValueError(f"must have layers or thickness, got both: {self.layers} and {self.thickness:g} m")
        if self.open and self.side != "outside":
            raise ValueError(f'open must be given with side = "outside" only, got {self.open}')
        return self
