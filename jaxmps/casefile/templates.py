"""Commented case files to start from: a built-in case with all its arguments, or a tank of one's own."""

import inspect
import json
import textwrap
import typing
from typing import Any

from jaxmps.casefile.arguments import arguments, case_factories, scheme_factories
from jaxmps.casefile.models import RunTable
from jaxmps.validation import one_of

_UNITS = {"density": "kg/m^3", "viscosity": "m^2/s", "gravity": "m/s^2", "angular_velocity": "rad/s"}
_WORDS = {"ratio": "effective radius in spacings; by default that of the scheme", "reach": "in sides"}
_RUN = {
    "until": "s, when the run ends",
    "save_every": "s, from frame to frame",
    "dt": "s, fixed time step; by default as large as the scheme allows",
    "jitter": "spacings, random displacement of the fluid at the start (0 to 0.3)",
    "seed": "of noise and jitter",
    "precision": "single or double",
}
_EXAMPLES = {"dt": 0.001}

TANK = """\
# An L-shaped tank with an obstacle on its floor; water stands in the upright part.
# Lengths are in m, and all other values in SI units. `jaxmps check FILE` draws it before anything runs.

[case]
name = "l_shaped_tank"
spacing = 0.02                     # m, distance of the particles
gravity = [0.0, -9.81]             # m/s^2; two components make a case of two dimensions
headroom = 0.4                     # m, room above the geometry: particles that leave the domain are taken out
# lower = [-0.1, -0.1]             # m, corners of the domain; by default around all that is drawn here
# upper = [1.5, 1.5]
# periodic = ["x"]

[[fluid]]
name = "water"
density = 1000.0                   # kg/m^3
viscosity = 1e-6                   # m^2/s

# A fluid has one or more bodies: polygon, box (two corners), circle = { center = [x, y], radius = r };
# in 3-D box, sphere or stl = "file.stl" (with scale and offset). A later body takes the place of an earlier one.
[[fluid.body]]
box = [[0.0, 0.0], [0.4, 0.8]]
# velocity = [0.0, 0.0]            # m/s
# rotation = 0.0                   # rad/s, counterclockwise (3-D: a vector), about
# center = [0.2, 0.4]              # m, by default its middle

# A wall is layers of particles "outside" of a closed shape (a tank) or "inside" of it (an obstacle),
# or on the "left" or "right" of a polyline, seen from its first point to its last.
[[wall]]
polygon = [[0.0, 0.0], [1.2, 0.0], [1.2, 0.5], [0.4, 0.5], [0.4, 1.0], [0.0, 1.0]]
side = "outside"
open = ["+y"]                      # sides of the tank without a wall
# layers = 3                       # by default what the scheme's radius needs; or thickness = 0.06 in m

# With fluid on both sides a wall must be thick enough: plate = true makes a box or a polyline as thick as it must be.

[[wall]]
box = [[0.8, 0.0], [0.9, 0.12]]
side = "inside"

# Readings in time, written to probes.csv.
[[probe]]
name = "floor"
kind = "pressure"                  # at a point, in Pa
point = [0.1, 0.01]

[[probe]]
name = "right wall"
kind = "wall_pressure"             # mean along a segment, in Pa
segment = [[1.2, 0.0], [1.2, 0.2]]

[[probe]]
name = "gauge"
kind = "wave_gauge"                # height of the surface, in m
x = 0.6

[[probe]]
name = "front"
kind = "front"                     # foremost water, in m
"""


def template(name: str | None = None) -> str:
    """A case file for the built-in case of that name, or one with a tank of its own (`tank`), full of comments."""
    if name in (None, "tank"):
        return TANK + _scheme() + _run(1.0)
    factories = case_factories()
    one_of("case", str(name), ["tank", *factories])
    make = factories[str(name)]
    paragraphs = (inspect.getdoc(make) or "").split("\n\n")
    lines = [line for text in paragraphs for line in ("#", *_wrapped(text))][1:]
    lines += ["", "[case]", f'builtin = "{name}"']
    for argument, parameter in arguments(make).items():
        lines.append(_line(argument, parameter.default, _unit(argument, parameter), commented=argument == "ratio"))
    return "\n".join(lines) + "\n" + _scheme() + _run(2.0)


def _scheme() -> str:
    known = scheme_factories()
    lines = ["", "[scheme]", _line("name", "mps", f"one of {', '.join(known)}")]
    lines.append("# The arguments of the scheme, see `jaxmps schemes mps`, and any value such as source.relaxation.")
    lines += [_line(k, p.default, "", commented=True) for k, p in arguments(known["mps"]).items()]
    lines.append(_line("alpha", 0.04, "stochastic velocity, for any scheme; then also drift_free", commented=True))
    return "\n".join(lines) + "\n"


def _run(until: float) -> str:
    defaults: dict[str, Any] = RunTable(until=until).model_dump()
    lines = ["", "[run]", *(_line(k, v, _RUN[k]) for k, v in defaults.items())]
    return "\n".join(lines) + "\n"


def _line(name: str, value: Any, comment: str, commented: bool = False) -> str:
    commented |= value is None
    shown = _EXAMPLES.get(name, 0.2) if value is None else value
    setting = f"{'# ' * commented}{name} = {json.dumps(shown)}"
    return f"{setting:<34} # {comment}" if comment else setting


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(" ".join(text.split()), 110, initial_indent="# ", subsequent_indent="# ")


def _unit(name: str, parameter: inspect.Parameter) -> str:
    choices = typing.get_args(parameter.annotation)
    unit = _WORDS.get(name) or next((u for end, u in _UNITS.items() if name.endswith(end)), "m")
    if choices and all(isinstance(choice, str) for choice in choices):
        unit = " or ".join(choices)
    return unit + ("; by default left out" if parameter.default is None else "")
