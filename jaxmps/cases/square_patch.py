"""A square of fluid that rotates without walls and without gravity, and the solutions that are known for it."""

import dataclasses
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmps._types import ArrayLike
from jaxmps.cases.lattice import WATER, cells, lattice_points, materials
from jaxmps.flow import Box, Case, Kind, at_rest
from jaxmps.validation import at_most, between, fixed, not_zero, positive


def square_patch(
    *,
    spacing: float = 0.02,
    side: float = 1.0,
    angular_velocity: float = 1.0,
    density: float = WATER["density"],
    viscosity: float = 0.0,
    reach: float = 2.0,
    ratio: float = 2.1,
) -> Case:
    """A square of fluid around the origin that starts as a rigid body in rotation, u = ω (y, −x) ([T13] §3.1).

    The pressure is negative throughout and the square becomes a star with four arms. The defaults make 2500 particles
    in the middle of their cells, all fluid. `spacing` and `side` in m, the side rounded to whole spacings;
    `angular_velocity` ω in rad/s, clockwise if positive; `density` in kg/m³, `viscosity` in m²/s. [T13] gives neither
    density nor viscosity: here they are those of inviscid water.

    Particles start with the pressure of `square_patch_pressure`. Without viscosity the kinetic energy ρω²L⁴/12 and
    the angular momentum ρωL⁴/6 (clockwise) per unit depth stay what they are. The domain is the square
    |x|, |y| < `reach` · `side`, `reach` 1 to 10: particles beyond it leave the flow, and the tips of the arms, at
    (L/√2) √(1 + ω²t²) from the center, come that far at the earliest at ωt = √(2 reach² − 1). There are no walls, so
    that nothing depends on `ratio`, r_e / l0 of the scheme to be used.
    """
    positive("spacing", fixed("spacing", spacing), "m")
    at_most("spacing", spacing, "side", positive("side", fixed("side", side), "m"), "m")
    not_zero("angular_velocity", angular_velocity, "rad/s")
    fluids = materials({"density": density}, {"viscosity": viscosity})
    between("reach", fixed("reach", reach), 1.0, 10.0, "sides")
    positive("ratio", fixed("ratio", ratio), "spacings")
    parameters: dict[str, Any] = {
        "spacing": spacing,
        "side": side,
        "angular_velocity": angular_velocity,
        "density": density,
        "viscosity": viscosity,
        "reach": reach,
        "ratio": ratio,
    }
    count = cells(side, spacing)
    points = lattice_points(range(count), range(count))
    particles = at_rest((points - 0.5 * (count - 1)) * spacing, np.full(len(points), Kind.FLUID))
    x, y = particles.position.T
    particles = dataclasses.replace(
        particles,
        velocity=angular_velocity * jnp.stack([y, -x], axis=-1),
        pressure=square_patch_pressure(x, y, count * spacing, angular_velocity, density),
    )
    edge = reach * side
    return Case(
        particles=particles,
        fluids=fluids,
        gravity=[0.0, 0.0],
        spacing=spacing,
        box=Box((-edge, -edge), (edge, edge)),
        name="square_patch",
        parameters=tuple(parameters.items()),
    )


_TERMS = 50


def square_patch_pressure(
    x: ArrayLike, y: ArrayLike, side: float = 1.0, angular_velocity: float = 1.0, density: float = 1000.0
) -> Float[Array, "*points"]:
    """Pressure [Pa] at t = 0 at the points x, y [m]: ∇²p = 2ρω² in the square, p = 0 on its sides and outside.

    The usual double Fourier series in sin(mπ(x/L + ½)) sin(nπ(y/L + ½)), summed over one of its indices:

    p = ρω² [x² − L²/4 + (8L²/π³) Σ_k (−1)^((k−1)/2) / k³ · cos(kπx/L) cosh(kπy/L) / cosh(kπ/2)],  k = 1, 3, 5, …

    x² − L²/4 satisfies the equation and vanishes at x = ±L/2; the sum is harmonic and cancels it at y = ±L/2. At the
    center p = −0.147343 ρω²L². As p is symmetric in x and y, the smaller one goes into cosh: fastest convergence.
    """
    across, along = jnp.abs(jnp.asarray(x) / side), jnp.abs(jnp.asarray(y) / side)
    far, near = jnp.maximum(across, along), jnp.minimum(jnp.minimum(across, along), 0.5)

    def term(k: int) -> Array:
        # cosh(kπ near) / cosh(kπ/2), without the overflow of either.
        ratio = jnp.exp(k * math.pi * (near - 0.5)) * (1.0 + jnp.exp(-2.0 * k * math.pi * near))
        return (-1) ** (k // 2) / k**3 * jnp.cos(k * math.pi * far) * ratio / (1.0 + math.exp(-k * math.pi))

    harmonic = 8.0 / math.pi**3 * sum(term(k) for k in range(1, 2 * _TERMS, 2))
    return density * (angular_velocity * side) ** 2 * jnp.where(far < 0.5, far**2 - 0.25 + harmonic, 0.0)


def square_patch_tip(
    time: ArrayLike, side: float = 1.0, angular_velocity: float = 1.0
) -> tuple[Float[Array, "*times"], Float[Array, "*times"]]:
    """Distance of the corners from the center [m], and the angle [rad] by which they have turned, at a time [s].

    r = (L/√2) √(1 + ω²t²) and atan(ωt), in the sense of the rotation: exact for an inviscid fluid. The pressure is zero
    on both sides of a corner, thus of the order d^(π/α) at the distance d from a corner of the angle α. As α < π its
    gradient vanishes there: a corner feels no force and moves on along its first tangent, as long as it stays sharp.
    """
    turned = angular_velocity * jnp.asarray(time)
    return side / math.sqrt(2.0) * jnp.sqrt(1.0 + turned**2), jnp.arctan(turned)


SQUARE_PATCH_REFERENCE = np.array(
    [
        [0.00, 0.70711, 0.00, 0.50000, -0.14735],
        [0.20, 0.72111, 11.31, 0.49656, -0.14483],
        [0.40, 0.76158, 21.80, 0.48690, -0.13779],
        [0.60, 0.82462, 30.96, 0.47247, -0.12757],
        [0.84, 0.92347, 40.03, 0.45091, -0.11341],
        [1.00, 1.00000, 45.00, 0.43500, -0.10388],
        [1.20, 1.10454, 50.19, 0.41435, -0.09264],
        [1.50, 1.27475, 56.31, 0.38335, -0.07795],
        [1.80, 1.45602, 60.95, 0.35398, -0.06602],
        [2.00, 1.58114, 63.43, 0.33596, -0.05944],
    ]
)
"""One row for each time ωt: r_tip / L, angle of the tip [degrees], r_min / L, pressure at the center / (ρω²L²).

The inviscid flow; r_min is the smallest distance of the surface from the center. Radius and angle of the tip are those
of `square_patch_tip`, exact; the others are a nonlinear vortical boundary-element solution with 240 nodes a quarter,
computed for this project. Its energy is constant to 1e-4 up to ωt = 1.
"""
