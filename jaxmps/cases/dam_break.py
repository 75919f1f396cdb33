"""A column of water that collapses in a tank, and what experiments and other computations found."""

from typing import Any

import numpy as np

from jaxmps.cases.lattice import WATER, cells, materials, tank_case
from jaxmps.flow import Case
from jaxmps.validation import at_most, fixed, positive


def dam_break(
    *,
    spacing: float = 0.02,
    width: float = 0.5,
    height: float = 1.0,
    tank_length: float = 2.0,
    tank_height: float = 2.0,
    gravity: float = 9.81,
    density: float = WATER["density"],
    viscosity: float = WATER["viscosity"],
    ratio: float = 2.1,
) -> Case:
    """A water column at the left wall of an open tank, held by a gate that vanishes at t = 0 ([N11] §5.1).

    The defaults make the paper's 2171 particles: 25 × 50 fluid, 3 × 107 + 6 × 100 wall. Lengths in m, `gravity` in
    m/s², `density` in kg/m³, `viscosity` in m²/s; lengths are rounded to whole spacings. Floor and left wall are
    y = 0 and x = 0. As in the paper, whose particles stand on both ends of 0 ≤ x ≤ 2 m, the tank is one spacing longer
    than `tank_length`. `ratio` is r_e / l0 of the scheme to be used and sets the thickness of the walls.
    """
    lengths = _check_lengths(
        spacing=spacing, width=width, height=height, tank_length=tank_length, tank_height=tank_height
    )
    parameters: dict[str, Any] = dict(lengths, gravity=gravity, density=density, viscosity=viscosity, ratio=ratio)
    return tank_case(
        name="dam_break",
        parameters=parameters,
        block=(cells(width, spacing), cells(height, spacing)),
        inside=(cells(tank_length, spacing) + 1, 0),
        wall_height=cells(tank_height, spacing),
        headroom=tank_height + 2.0 * height,
        spacing=spacing,
        ratio=ratio,
        gravity=gravity,
        fluids=materials({"density": density}, {"viscosity": viscosity}),
    )


def dam_break_3d(
    *,
    spacing: float = 0.02,
    width: float = 0.3,
    depth: float = 0.4,
    height: float = 0.4,
    tank_length: float = 1.0,
    tank_height: float = 0.5,
    gravity: float = 9.81,
    density: float = WATER["density"],
    viscosity: float = WATER["viscosity"],
    ratio: float = 2.1,
) -> Case:
    """A dam break in a tank of three dimensions, x along the tank, y across (`depth`), z upward; else as `dam_break`.

    The column spans the tank from side wall to side wall; the defaults make 22 000 particles, 6000 of them fluid.
    """
    lengths = _check_lengths(
        spacing=spacing, width=width, height=height, tank_length=tank_length, tank_height=tank_height
    )
    at_most("spacing", spacing, "depth", positive("depth", fixed("depth", depth), "m"), "m")
    parameters: dict[str, Any] = dict(
        lengths, depth=depth, gravity=gravity, density=density, viscosity=viscosity, ratio=ratio
    )
    across = cells(depth, spacing)
    return tank_case(
        name="dam_break_3d",
        parameters=parameters,
        block=(cells(width, spacing), across, cells(height, spacing)),
        inside=(cells(tank_length, spacing) + 1, across, 0),
        wall_height=cells(tank_height, spacing),
        headroom=tank_height + 2.0 * height,
        spacing=spacing,
        ratio=ratio,
        gravity=gravity,
        fluids=materials({"density": density}, {"viscosity": viscosity}),
    )


def _check_lengths(**lengths: float) -> dict[str, float]:
    for name, value in lengths.items():
        positive(name, fixed(name, value), "m")
    at_most("spacing", lengths["spacing"], "width", lengths["width"], "m")
    at_most("spacing", lengths["spacing"], "height", lengths["height"], "m")
    at_most("width", lengths["width"], "tank_length", lengths["tank_length"], "m")
    at_most("height", lengths["height"], "tank_height", lengths["tank_height"], "m")
    return lengths


# Surge front: dimensionless time T = t √(2g/a) against Z = x_front / a, a the width of a column that is twice as high.
KOSHIZUKA_OKA_EXPERIMENT = np.array(
    [
        [0, 0.381, 0.769, 1.153, 1.537, 1.935, 2.323, 2.719, 3.096],
        [1, 1.111, 1.252, 1.505, 1.892, 2.241, 2.615, 3.003, 3.624],
    ]
)
"""T and Z of the experiment in Koshizuka & Oka 1996 (Nuclear Science and Engineering 123, 421)."""
KOSHIZUKA_OKA_MPS = np.array(
    [
        [0.591, 1.095, 1.536, 2.043, 2.278, 2.604, 2.943],
        [1.205, 1.637, 2.100, 2.707, 3.004, 3.481, 3.997],
    ]
)
"""T and Z of the MPS computation in Koshizuka & Oka 1996."""
MARTIN_MOYCE_EXPERIMENT = np.array(
    [
        [0.41, 0.84, 1.19, 1.43, 1.63, 1.83, 1.98, 2.20, 2.32, 2.51, 2.65, 2.83, 2.98, 3.11, 3.33],
        [1.11, 1.22, 1.44, 1.67, 1.89, 2.11, 2.33, 2.56, 2.78, 3.00, 3.22, 3.44, 3.67, 3.89, 4.11],
    ]
)
"""T and Z of Martin & Moyce 1952 (Phil. Trans. R. Soc. A 244, 312), Table 2, n² = 2, a = 2.25 in."""
