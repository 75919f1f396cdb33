"""A tank that rolls or sways, and the linear theory of the waves in it."""

import math
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmps._types import ArrayLike
from jaxmps.cases.lattice import WATER, cells, materials, tank_case
from jaxmps.flow import Box, Case
from jaxmps.flow.motion import Rigid, Sine
from jaxmps.validation import at_most, between, fixed, number, one_of, positive


def sloshing(
    *,
    spacing: float = 0.0062,
    length: float = 0.9,
    height: float = 0.508,
    depth: float = 0.093,
    kind: Literal["roll", "sway"] = "roll",
    amplitude: float = 4.0,
    period: float = 1.919,
    phase: float = 0.0,
    tilt: float = 0.0,
    gravity: float = 9.81,
    density: float = WATER["density"],
    viscosity: float = WATER["viscosity"],
    ratio: float = 2.1,
) -> Case:
    """A rectangular tank, open at the top, that rolls about the middle of its floor or sways, as a sine from t = 0.

    The defaults are the tank of Souto-Iglesias, Botia-Vera, Martín & Pérez-Arribas 2011 (SPHERIC benchmark 10, lateral
    impact of water) at its first resonance, with an exact sine for the recorded motion. `amplitude` is in degrees for
    a "roll" and in m for a "sway", `period` in s, `phase` in degrees: at 0 the motion begins at its full speed, at −90
    from rest. `tilt` in degrees is the slope of the surface at t = 0, down to the right. Lengths in m, rounded to whole
    spacings; the inner lower left corner is the origin at t = 0.

    `sloshing_linear` is the elevation for small amplitudes. `jaxmps.diagnostics.relative` gives a run in the frame of
    the tank.
    """
    lengths = {"spacing": spacing, "length": length, "height": height, "depth": depth}
    for name, value in lengths.items():
        positive(name, fixed(name, value), "m")
    at_most("spacing", spacing, "length", length, "m")
    at_most("spacing", spacing, "depth", depth, "m")
    at_most("depth", depth, "height", height, "m")
    # The box has room for the motion.
    fixed("amplitude", amplitude)
    rolls = one_of("kind", kind, ("roll", "sway")) == "roll"
    swing = between("amplitude", amplitude, -45.0, 45.0, "degrees") if rolls else number("amplitude", amplitude, "m")
    slope = math.tan(math.radians(between("tilt", fixed("tilt", tilt), -45.0, 45.0, "degrees")))
    columns, rows, top = (cells(value, spacing) for value in (length, depth, height))
    middle = 0.5 * columns * spacing
    rise = abs(slope) * middle
    at_most("tilt", rise, "the freeboard", top * spacing - depth, "m of rise at the wall")

    def surface(position: np.ndarray) -> np.ndarray:
        return np.where(position[:, 1] < rows * spacing + slope * (middle - position[:, 0]), 0, -1)

    still = tank_case(
        name="sloshing",
        parameters={
            **lengths,
            "kind": kind,
            "amplitude": amplitude,
            "period": period,
            "phase": phase,
            "tilt": tilt,
            "gravity": gravity,
            "density": density,
            "viscosity": viscosity,
            "ratio": ratio,
        },
        block=(columns, math.ceil(rows + rise / spacing - 1e-9)),
        inside=(columns, rows),
        wall_height=top,
        headroom=(top + 3) * spacing,
        spacing=spacing,
        ratio=ratio,
        gravity=gravity,
        fluids=materials({"density": density}, {"viscosity": viscosity}),
        phase=surface,
    )
    signal = Sine(
        math.radians(swing) if rolls else swing,
        2.0 * math.pi / positive("period", period, "s"),
        number("phase", phase, "degrees") * (math.pi / 180.0),
    )
    motion = Rigid([middle, 0.0], **{kind: signal})
    return _moving(still, motion, swing, rolls)


def _moving(still: Case, motion: Rigid, swing: float, rolls: bool) -> Case:
    """The case with its motion in a box that has room for it."""
    lower, upper = np.array(still.box.lower), np.array(still.box.upper)
    if rolls:
        # The change of the angle since t = 0 is at most twice the amplitude.
        reach = 2.0 * abs(math.radians(swing))
        corners = np.array([[x, y] for x in (lower[0], upper[0]) for y in (lower[1], upper[1])])
        center = np.asarray(motion.center)
        turned = [
            center + (corners - center) @ np.array([[math.cos(a), math.sin(a)], [-math.sin(a), math.cos(a)]])
            for a in np.linspace(-reach, reach, 65)
        ]
        lower, upper = np.min(turned, axis=(0, 1)), np.max(turned, axis=(0, 1))
    else:
        reach = np.array([2.0 * abs(swing), 0.0])
        lower, upper = lower - reach, upper + reach
    margin = still.spacing
    box = Box(tuple((lower - margin).tolist()), tuple((upper + margin).tolist()))
    values: dict[str, Any] = {"particles": still.particles, "fluids": still.fluids, "gravity": still.gravity}
    return Case(**values, spacing=still.spacing, box=box, name=still.name, parameters=still.parameters, motion=motion)


def sloshing_frequency(
    mode: ArrayLike = 1, length: ArrayLike = 0.9, depth: ArrayLike = 0.093, gravity: ArrayLike = 9.81
) -> Float[Array, "*modes"]:
    """Natural angular frequency ω_n [rad/s] of small waves in a tank: ω_n² = g k_n tanh k_n h, k_n = nπ / L."""
    wavenumber = math.pi * jnp.asarray(mode) / jnp.asarray(length)
    return jnp.sqrt(jnp.asarray(gravity) * wavenumber * jnp.tanh(wavenumber * jnp.asarray(depth)))


def sloshing_linear(
    time: ArrayLike,
    position: ArrayLike = 0.0,
    *,
    amplitude: ArrayLike,
    frequency: ArrayLike,
    phase: ArrayLike = 0.0,
    length: ArrayLike = 0.9,
    depth: ArrayLike = 0.093,
    gravity: ArrayLike = 9.81,
    modes: int = 40,
) -> Float[Array, "*points"]:
    """Elevation η [m] at a time [s] and a `position` x [m] from the left wall, of a tank that sways from rest by
    x_w = A (sin(ωt + φ) − sin φ): `amplitude` A [m], angular `frequency` ω [rad/s], `phase` φ [rad].

    Linear potential theory (Faltinsen 1978), summed over the odd `modes` of a tank of the `length` L and `depth` h [m]:
    the others stay at rest. In the frame of the tank let η = Σ β_n cos k_n x and the potential of the relative motion
    be Σ b_n cos k_n x cosh k_n (y + h) / cosh k_n h, which is tangential at floor and walls. The surface moves with the
    water, β_n' = k_n tanh(k_n h) b_n, and is free of pressure, b_n' + g β_n + x_w'' c_n = 0, where x − L/2 = Σ c_n cos
    k_n x has c_n = −4L / (nπ)² for odd n. So β_n'' + ω_n² β_n = P_n x_w'', P_n = 4 tanh(k_n h) / (nπ). From rest,

        β_n = P_n ∫ cos ω_n(t − τ) x_w'(τ) dτ
            = P_n A ω (cos φ (ω sin ωt − ω_n sin ω_n t) + sin φ (ω cos ωt − ω cos ω_n t)) / (ω² − ω_n²),

    with the start's jump of the velocity. At ω = ω_n this is 0 / 0; take a frequency beside it. Times and positions
    broadcast.
    """
    n = jnp.arange(1, 2 * modes, 2)
    t, x = jnp.asarray(time)[..., None], jnp.asarray(position)[..., None]
    k, own, w = math.pi * n / jnp.asarray(length), sloshing_frequency(n, length, depth, gravity), jnp.asarray(frequency)
    push = 4.0 * jnp.tanh(k * jnp.asarray(depth)) / (math.pi * n) * jnp.asarray(amplitude) * w
    sines = jnp.cos(phase) * (w * jnp.sin(w * t) - own * jnp.sin(own * t))
    cosines = jnp.sin(phase) * w * (jnp.cos(w * t) - jnp.cos(own * t))
    return jnp.sum(push * (sines + cosines) / (w**2 - own**2) * jnp.cos(k * x), axis=-1)
