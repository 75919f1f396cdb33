"""Sources of the pressure equation: what the density or the divergence asks of the pressure."""

import abc
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmps._types import Scalar, as_array


class Compression(NamedTuple):
    """Number density n_i, its rate of change Dn/Dt_i [1/s] and the divergence ⟨∇·u⟩_i [1/s] at an instant."""

    n: Float[Array, " n"]
    rate: Float[Array, " n"]
    divergence: Float[Array, " n"]


class AbstractSource(eqx.Module):
    """A source of the PPE."""

    @abc.abstractmethod
    def __call__(self, predicted: Compression, current: Compression, n0: float, dt: Scalar) -> Float[Array, " n"]:
        """The right-hand side S_i [1/s²] of ∇·(∇p / ρ) = S, from the predicted state * and the current one, step k."""


class DensityDeviation(AbstractSource):
    """S_i = −(γ / Δt²) (n*_i − n0) / n0 ([N11] Eq. 11; Koshizuka & Oka 1996), relaxed by γ.

    γ = 1 is the published form; it corrects the whole error of the density within a step, which at small Δt makes
    pressure spikes that grow as 1/Δt². Codes in use take γ ≈ 0.2.
    """

    relaxation: Scalar = eqx.field(converter=as_array, default=0.2)

    def __call__(self, predicted, current, n0, dt):
        return density_deviation(predicted.n, n0, self.relaxation, dt)


class HigherOrderSource(AbstractSource):
    """S_i = −(1 / (n0 Δt)) (Dn/Dt)*_i (HS; Khayyer & Gotoh 2009).

    The sign is the physical one: where u* compresses, n rises, S < 0 and p > 0. (In print the rate is that of the
    correction, which is the opposite.) It has no memory of n itself.
    """

    def __call__(self, predicted, current, n0, dt):
        return -predicted.rate / (n0 * dt)


class ErrorCompensatingSource(AbstractSource):
    """S_i = −(1 / (n0 Δt)) ((Dn/Dt)* + |α| (Dn/Dt)^k + |(Dn/Dt)^k| α), α = (n^k − n0) / n0 (ECS; Khayyer & Gotoh 2011).

    The error of step k is compensated where it grows: both terms cancel where α and the rate differ in sign, for then
    the error is shrinking by itself. So a static error of the density stays.
    """

    def __call__(self, predicted, current, n0, dt):
        alpha = (current.n - n0) / n0
        compensation = jnp.abs(alpha) * current.rate + jnp.abs(current.rate) * alpha
        return -(predicted.rate + compensation) / (n0 * dt)


class CorrectedDivergence(AbstractSource):
    """S_i = ⟨∇·u*⟩_i / Δt − (γ / Δt²) (n*_i − n0) / n0, with the divergence of the corrected gradient (not in [T13]).

    HS keeps n_i constant, which is incompressible on a lattice but not on one that has been stretched, and it jumps
    whenever a neighbor crosses r_e, for the slope of the weight does not vanish there. This divergence is exact for
    linear velocities in any arrangement, and continuous. It has no memory of n: γ restores that, as in
    `DensityDeviation`. Take γ of some hundredths in a tank, where voids would open within tenths of a second, and zero
    in a body under tension, where n < n0 along a stretched surface would pull it inward.
    """

    restoring: Scalar = eqx.field(converter=as_array, default=0.03)

    def __call__(self, predicted, current, n0, dt):
        return predicted.divergence / dt + density_deviation(predicted.n, n0, self.restoring, dt)


def density_deviation(n: Float[Array, " n"], n0: float, fraction: Scalar, dt: Scalar) -> Float[Array, " n"]:
    """−(γ / Δt²) (n_i − n0) / n0 [1/s²], which corrects the fraction γ of the density's error ([N11] Eq. 11)."""
    return -(fraction / dt**2) * (n - n0) / n0
