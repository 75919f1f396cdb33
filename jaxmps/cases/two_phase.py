"""Two fluids of different density in a tank: grains that settle or surface in water, and layers at rest."""

from typing import Any

import numpy as np
from jaxtyping import Array, Float, Int

from jaxmps._types import ArrayLike
from jaxmps.cases.hydrostatic import hydrostatic_pressure
from jaxmps.cases.lattice import WATER, cells, materials, tank_case
from jaxmps.flow import Case
from jaxmps.validation import at_most, fixed, not_negative, positive

_TANK = {"length": 0.25, "height": 0.2, "depth": 0.175}
_RADIUS = 0.0125
_CENTERS = np.array([[0.025 * (k + 1), 0.071 + 0.0175 * k] for k in range(5)])


def settling(
    *,
    spacing: float = 0.0025,
    density: float = WATER["density"],
    grain_density: float = 2650.0,
    viscosity: float = 0.0,
    grain_viscosity: float = 0.0,
    gravity: float = 9.81,
    ratio: float = 2.1,
) -> Case:
    """Five round groups of a heavier fluid, A to E, that sink in water at rest ([T13] §3.2.1).

    A tank 0.25 m long with walls 0.2 m high, filled to 0.175 m; group k = 0 … 4 has the diameter 0.025 m and the center
    x = 0.025 (k + 1), y = 0.071 + 0.0175 k, which the paper prints in whole millimeters. The defaults make 7000 fluid
    particles, 80 in each group. `spacing` in m, densities in kg/m³, viscosities in m²/s (the paper gives none),
    `gravity` in m/s². Water and walls are phase 0, the grains phase 1, and `grain_groups` tells which group is which.
    `ratio` is r_e / l0 of the scheme to be used.
    """
    arguments: dict[str, float] = {
        "spacing": spacing,
        "density": density,
        "grain_density": grain_density,
        "viscosity": viscosity,
        "grain_viscosity": grain_viscosity,
        "gravity": gravity,
        "ratio": ratio,
    }
    return _grains("settling", arguments)


def surfacing(
    *,
    spacing: float = 0.0025,
    density: float = WATER["density"],
    grain_density: float = 600.0,
    viscosity: float = 0.0,
    grain_viscosity: float = 0.0,
    gravity: float = 9.81,
    ratio: float = 2.1,
) -> Case:
    """The case `settling` with a fluid lighter than water in its groups, which rise ([T13] §3.2.2)."""
    arguments: dict[str, float] = {
        "spacing": spacing,
        "density": density,
        "grain_density": grain_density,
        "viscosity": viscosity,
        "grain_viscosity": grain_viscosity,
        "gravity": gravity,
        "ratio": ratio,
    }
    return _grains("surfacing", arguments)


def _grains(name: str, arguments: dict[str, float]) -> Case:
    spacing = positive("spacing", fixed("spacing", arguments["spacing"]), "m")
    at_most("spacing", spacing, "the radius of a group", _RADIUS, "m")
    length = cells(_TANK["length"], spacing)
    return tank_case(
        name=name,
        parameters=arguments | {"fluids": ("water", "grains")},
        block=(length, cells(_TANK["depth"], spacing)),
        inside=(length, 0),
        wall_height=cells(_TANK["height"], spacing),
        headroom=2.0 * _TANK["height"],
        spacing=spacing,
        ratio=arguments["ratio"],
        gravity=arguments["gravity"],
        fluids=materials(
            {key: arguments[key] for key in ("density", "grain_density")},
            {key: arguments[key] for key in ("viscosity", "grain_viscosity")},
        ),
        # A particle on the rim belongs to the group, whatever the round-off.
        phase=lambda position: np.min(_distances(position), axis=1) <= _RADIUS * (1.0 + 1e-9),
    )


def _distances(position: np.ndarray) -> np.ndarray:
    return np.linalg.norm(position[:, None] - _CENTERS, axis=-1)


def grain_groups(position: Float[ArrayLike, "n 2"], phase: Int[ArrayLike, " n"]) -> Int[np.ndarray, " n"]:
    """The group of each particle of `settling` or `surfacing`: 0 to 4 for A to E, −1 for water and walls.

    `position` [m] is the one at t = 0, as in a case or in the first frame of a run; jitter is no matter.
    """
    nearest = np.argmin(_distances(np.asarray(position)), axis=1)
    return np.where(np.asarray(phase) == 1, nearest, -1)


SETTLING_ACCELERATION = np.array([[-0.52, -3.67], [-0.99, -3.63], [-1.03, -3.69], [-0.93, -3.80], [-0.47, -4.03]])
"""Mean acceleration (a_x, a_y) [m/s²] of the groups A to E of `settling` at t = 0, without viscosity.

The pressure equation with the density of each place, solved by finite volumes on a grid of a quarter of the default
spacing, computed for this project. On a grid of the spacing itself a_y is 5 to 6 % smaller. A single disc in unbounded
fluid would have g (ρ_d − ρ) / (ρ_d + ρ) = 4.43 m/s² downward.
"""
SURFACING_ACCELERATION = np.array([[0.55, 1.84], [1.09, 1.88], [1.18, 1.96], [1.11, 2.05], [0.59, 2.24]])
"""As `SETTLING_ACCELERATION`, for `surfacing`; a single disc in unbounded fluid would have 2.45 m/s² upward."""


def two_layer(
    *,
    spacing: float = 0.01,
    length: float = 0.2,
    lower_height: float = 0.1,
    upper_height: float = 0.1,
    freeboard: float = 0.1,
    lower_density: float = WATER["density"],
    upper_density: float = 600.0,
    lower_viscosity: float = 0.0,
    upper_viscosity: float = 0.0,
    gravity: float = 9.81,
    ratio: float = 2.1,
) -> Case:
    """A tank with one fluid on another; at rest, with the pressure of `two_layer_pressure`, if the upper is lighter.

    Lengths in m, rounded to whole spacings, `freeboard` the height of the walls above the upper layer; densities in
    kg/m³, viscosities in m²/s. The lower layer and the walls are phase 0, the upper layer is phase 1. `ratio` is
    r_e / l0 of the scheme to be used.
    """
    lengths = {"length": length, "lower_height": lower_height, "upper_height": upper_height}
    positive("spacing", fixed("spacing", spacing), "m")
    for name, value in lengths.items():
        at_most("spacing", spacing, name, positive(name, fixed(name, value), "m"), "m")
    not_negative("freeboard", fixed("freeboard", freeboard), "m")
    density = {"lower_density": lower_density, "upper_density": upper_density}
    viscosity = {"lower_viscosity": lower_viscosity, "upper_viscosity": upper_viscosity}
    parameters: dict[str, Any] = {
        "spacing": spacing,
        **lengths,
        "freeboard": freeboard,
        **density,
        **viscosity,
        "gravity": gravity,
        "ratio": ratio,
        "fluids": ("lower", "upper"),
    }
    across, lower, upper = (cells(value, spacing) for value in lengths.values())
    return tank_case(
        name="two_layer",
        parameters=parameters,
        block=(across, lower + upper),
        inside=(across, 0),
        wall_height=lower + upper + cells(freeboard, spacing),
        headroom=(lower + upper + 3) * spacing + freeboard,
        spacing=spacing,
        ratio=ratio,
        gravity=gravity,
        fluids=materials(density, viscosity),
        phase=lambda position: position[:, 1] > lower * spacing,
    )


def two_layer_pressure(
    elevation: ArrayLike,
    interface: float,
    surface: float,
    lower_density: float = 1000.0,
    upper_density: float = 600.0,
    gravity: float = 9.81,
) -> Float[Array, "*points"]:
    """The weight of both layers [Pa] above the elevation y [m], for an interface and a surface at these heights [m].

    p = ρ₂ g (H₂ − y) above the interface H₁ and ρ₂ g (H₂ − H₁) + ρ₁ g (H₁ − y) below it; zero above the surface H₂.
    """
    upper = hydrostatic_pressure(elevation, surface, upper_density, gravity)
    return upper + hydrostatic_pressure(elevation, interface, lower_density - upper_density, gravity)
