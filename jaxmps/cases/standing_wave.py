"""A standing wave between periodic sides."""

import math
from typing import Any, Literal

import numpy as np

from jaxmps.cases.lattice import WATER, cells, materials, tank_case
from jaxmps.flow import Case
from jaxmps.validation import at_most, between, fixed, one_of, positive

_FIRST = (0.5, 0.45)  # place of the first particle [spacings]


def standing_wave(
    *,
    spacing: float = 0.02,
    length: float = 1.0,
    depth: float = 1.0 / 3.0,
    amplitude: float = 0.07,
    gravity: float = 9.81,
    density: float = WATER["density"],
    viscosity: float = 0.0,
    floor: Literal["wall", "mirror"] = "wall",
    ratio: float = 2.1,
) -> Case:
    """Water of the mean depth h under the surface η = A cos(k (x − L/2)), at rest at t = 0 ([N11] §5.2).

    The wavelength is the `length` L of the domain, k = 2π/L, and the crest is at its center; the domain is periodic in
    x. Lengths in m, L rounded to whole spacings; `gravity` in m/s², `density` in kg/m³, `viscosity` in m²/s: zero by
    default, as the paper solves Euler's equation.

    Columns of particles at x = (i + ½) l0 with rows at y = (j + 0.45) l0 up to h + η: the defaults make the 834 fluid
    particles of the paper (rows from ½ l0 would make 832). The `floor` is y = 0: with "wall" one row of
    wall and rows of dummies that continue the lattice below the water, with "mirror" that of the paper, without
    particles. `ratio` is r_e / l0 of the scheme to be used.
    """
    lengths = {"spacing": spacing, "length": length, "depth": depth}
    for name, value in lengths.items():
        positive(name, fixed(name, value), "m")
    at_most("spacing", spacing, "length", length, "m")
    at_most("spacing", spacing, "depth", depth, "m")
    between("amplitude", fixed("amplitude", amplitude), 0.0, depth, "m")
    parameters: dict[str, Any] = {
        **lengths,
        "amplitude": amplitude,
        "gravity": gravity,
        "density": density,
        "viscosity": viscosity,
        "floor": one_of("floor", floor, ("wall", "mirror")),
        "ratio": ratio,
    }
    columns, crest = cells(length, spacing), depth + amplitude
    wavenumber = 2.0 * math.pi / (columns * spacing)

    def phase(position: np.ndarray) -> np.ndarray:
        x, y = position.T
        surface = depth - amplitude * np.cos(wavenumber * x)  # cos(k (x − L/2)) = −cos(kx)
        return np.where(y <= surface, 0, -1)

    return tank_case(
        name="standing_wave",
        parameters=parameters,
        block=(columns, math.ceil(crest / spacing) + 1),
        inside=(columns, 0),
        wall_height=0,
        headroom=2.0 * crest,
        spacing=spacing,
        ratio=ratio,
        gravity=gravity,
        fluids=materials({"density": density}, {"viscosity": viscosity}),
        phase=phase,
        periodic=(True, False),
        mirror=1 if floor == "mirror" else None,
        first=_FIRST,
    )
