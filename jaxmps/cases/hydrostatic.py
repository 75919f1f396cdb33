"""Water at rest in a tank, in two and three dimensions."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmps._types import ArrayLike
from jaxmps.cases.lattice import WATER, cells, materials, tank_case
from jaxmps.flow import Case
from jaxmps.validation import at_most, fixed, not_negative, positive


def hydrostatic(
    *,
    spacing: float = 0.02,
    length: float = 0.4,
    height: float = 0.4,
    depth: float | None = None,
    freeboard: float = 0.2,
    gravity: float = 9.81,
    density: float = WATER["density"],
    viscosity: float = WATER["viscosity"],
    ratio: float = 2.1,
) -> Case:
    """A tank filled to `height`; with a `depth` across, in three dimensions. Lengths in m, rounded to whole spacings.

    The exact state is rest with the pressure of `hydrostatic_pressure`. `freeboard` is the height of the walls above
    the water, `ratio` r_e / l0 of the scheme to be used.
    """
    sides = {"length": length, "height": height}
    sides = sides if depth is None else {"length": length, "depth": depth, "height": height}
    positive("spacing", fixed("spacing", spacing), "m")
    for name, value in sides.items():
        at_most("spacing", spacing, name, positive(name, fixed(name, value), "m"), "m")
    not_negative("freeboard", fixed("freeboard", freeboard), "m")
    block = tuple(cells(value, spacing) for value in sides.values())
    return tank_case(
        name="hydrostatic",
        parameters={
            "spacing": spacing,
            **sides,
            "freeboard": freeboard,
            "gravity": gravity,
            "density": density,
            "viscosity": viscosity,
            "ratio": ratio,
        },
        block=block,
        inside=block,
        wall_height=cells(height + freeboard, spacing),
        headroom=height + freeboard + 3.0 * spacing,
        spacing=spacing,
        ratio=ratio,
        gravity=gravity,
        fluids=materials({"density": density}, {"viscosity": viscosity}),
    )


def hydrostatic_pressure(
    elevation: ArrayLike, surface: float, density: float = 1000.0, gravity: float = 9.81
) -> Float[Array, "*points"]:
    """p = ρ g (H − y) [Pa] at the elevation y [m] under a surface at H [m]; zero above it."""
    return density * gravity * jnp.maximum(surface - jnp.asarray(elevation), 0.0)
