"""How the standing wave of `standing_wave` moves: theory of first and second order, and a nonlinear solution.

Of the wave of length L, depth h and amplitude A that starts from rest under the surface η = A cos θ, θ = k (x − L/2),
k = 2π/L, these functions give the elevation η above the mean level. They are differentiable in all their arguments.
"""

import importlib.resources
import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmps._types import ArrayLike


def standing_wave_frequency(
    length: ArrayLike = 1.0, depth: ArrayLike = 1.0 / 3.0, gravity: ArrayLike = 9.81
) -> Float[Array, "*waves"]:
    """Angular frequency ω [rad/s] of a small standing wave, ω² = g k tanh kh, k = 2π / `length`; its period is 2π/ω."""
    wavenumber = 2.0 * math.pi / jnp.asarray(length)
    return jnp.sqrt(jnp.asarray(gravity) * wavenumber * jnp.tanh(wavenumber * jnp.asarray(depth)))


def standing_wave_linear(
    time: ArrayLike,
    length: ArrayLike = 1.0,
    depth: ArrayLike = 1.0 / 3.0,
    amplitude: ArrayLike = 0.07,
    gravity: ArrayLike = 9.81,
    *,
    position: ArrayLike | None = None,
) -> Float[Array, "*points"]:
    """Elevation η = A cos ωt cos θ [m] of a small wave at a time [s] and `position` x [m], by default the center.

    ω is `standing_wave_frequency`. Times and positions broadcast; lengths in m, `gravity` in m/s².
    """
    swing = jnp.cos(standing_wave_frequency(length, depth, gravity) * jnp.asarray(time))
    return jnp.asarray(amplitude) * swing * jnp.cos(_phase(length, position))


def standing_wave_second_order(
    time: ArrayLike,
    length: ArrayLike = 1.0,
    depth: ArrayLike = 1.0 / 3.0,
    amplitude: ArrayLike = 0.07,
    gravity: ArrayLike = 9.81,
    *,
    position: ArrayLike | None = None,
) -> Float[Array, "*points"]:
    """Elevation [m] with an error of the order A³ at any depth; arguments as those of `standing_wave_linear`.

    η = A cos ωt cos θ + (kA²/8) [(σ + 1/σ) (1 − cos ω₂t) + (3 − σ²)/σ³ (cos 2ωt − cos ω₂t)] cos 2θ,
    σ = tanh kh, ω² = gkσ, ω₂² = 2gk tanh 2kh.

    From both conditions at the free surface, expanded about the mean level to the second order: with the potential
    φ₂ = a(t) cos 2θ cosh 2k(y + h) / cosh 2kh and η₂ = b(t) cos 2θ they are

    b′ − (ω₂²/g) a = −(A²gk²/2ω) sin 2ωt,
    a′ + g b = (A²/4) (g²k²/ω² − ω²) sin² ωt + (A²ω²/2) cos² ωt,

    with a = b = 0 at t = 0. The wave of the frequency ω₂ is free: it is there because the surface starts as a pure
    cosine, and with it the heights of the crests beat. It takes kA ≪ 1, and A ≪ k²h³ in shallow water.
    """
    wavenumber = 2.0 * math.pi / jnp.asarray(length)
    sigma = jnp.tanh(wavenumber * jnp.asarray(depth))
    forced = 2.0 * standing_wave_frequency(length, depth, gravity) * jnp.asarray(time)
    free = jnp.cos(_free_frequency(length, depth, gravity) * jnp.asarray(time))
    shape = (sigma + 1.0 / sigma) * (1.0 - free) + (3.0 - sigma**2) / sigma**3 * (jnp.cos(forced) - free)
    second = wavenumber * jnp.asarray(amplitude) ** 2 / 8.0 * shape * jnp.cos(2.0 * _phase(length, position))
    return standing_wave_linear(time, length, depth, amplitude, gravity, position=position) + second


def standing_wave_wu_taylor(
    time: ArrayLike,
    length: ArrayLike = 1.0,
    depth: ArrayLike = 1.0 / 3.0,
    amplitude: ArrayLike = 0.07,
    gravity: ArrayLike = 9.81,
) -> Float[Array, "*points"]:
    """Elevation [m] at the center after Wu & Eatock Taylor 1994, of second order in deep water only.

    η = A cos ωt + (1/8g) [2ω²A² cos 2ωt + (A²/ω²) (k²g² + ω⁴) − (A²/ω²) (k²g² + 3ω⁴) cos ω₂t],
    with the ω and ω₂ of `standing_wave_second_order`; arguments in its units.

    [N11] §5.2 takes its analytic curve from that paper (Applied Ocean Research 16, 363) but does not print it; the form
    here is the one commonly ascribed to it, not checked against the paper. It differs from that exact to second order
    in the share of cos 2ωt − cos ω₂t alone, kσA²/4 instead of kA² (3 − σ²)/8σ³: the same for σ = tanh kh = 1. Elsewhere
    its error is of the order A², as that of linear theory: with the defaults it is up to 2.4 mm away from the exact
    second order, and its first crest is 2 % lower.
    """
    frequency = standing_wave_frequency(length, depth, gravity)
    gk, g = 2.0 * math.pi / jnp.asarray(length) * jnp.asarray(gravity), jnp.asarray(gravity)
    forced = 2.0 * frequency**2 * jnp.cos(2.0 * frequency * jnp.asarray(time))
    mean = gk**2 / frequency**2 + frequency**2
    free = (gk**2 / frequency**2 + 3.0 * frequency**2) * jnp.cos(
        _free_frequency(length, depth, gravity) * jnp.asarray(time)
    )
    second = jnp.asarray(amplitude) ** 2 / (8.0 * g) * (forced + mean - free)
    return standing_wave_linear(time, length, depth, amplitude, gravity) + second


def standing_wave_reference() -> Float[np.ndarray, "times 3"]:
    """Time [s], surface elevation η [m] at the center and at the sides, for the defaults of `standing_wave` to 6 s.

    A fully nonlinear inviscid solution by mixed boundary elements, computed for this project: within 2 % to 3.3 s and
    5 % after 4 s. With kA = 0.44 the heights of its crests beat; the wave of second order is not the truth here.
    """
    source = importlib.resources.files("jaxmps.cases").joinpath("data", "standing_wave_nonlinear.csv")
    with source.open(encoding="utf-8") as lines:
        return np.loadtxt(lines, delimiter=",")


def _free_frequency(length: ArrayLike, depth: ArrayLike, gravity: ArrayLike) -> Array:
    """ω₂ [rad/s], of a small wave of half the length."""
    return standing_wave_frequency(0.5 * jnp.asarray(length), depth, gravity)


def _phase(length: ArrayLike, position: ArrayLike | None) -> Array:
    """θ = k (x − L/2); zero at the center."""
    if position is None:
        return jnp.zeros(())
    return 2.0 * math.pi * (jnp.asarray(position) / jnp.asarray(length) - 0.5)
