"""The pressure Poisson equation (PPE): its sources, its matrix and its solution."""

import abc
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxmps._types import Scalar, as_array
from jaxmps._vectors import take
from jaxmps.linear import AbstractOperator, AbstractPreconditioner, Convergence, solve
from jaxmps.pairs import Pairs
from jaxmps.phases import mean_density

_TIE = 1e-3  # of the diagonal: what ties a lonely clump of particles to zero pressure


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


class PoissonOperator(AbstractOperator):
    """A p_i = Σ_j c_ij (2 / (ρ_i + ρ_j)) (p_i − p_j) for unknown p_i, and A p_i = p_i for known ones.

    The negative Laplacian with the density of the pair. Couplings to known pressures, which are zero here, stay on the
    diagonal, as the `sink`: A is symmetric and, where each part of the flow has a free surface, positive definite.
    Stored slot by slot, `(k, n)`, and summed in a loop that is unrolled: twice as fast on CPUs as `(n, k)`.
    """

    j: Int[Array, "k n"]
    coupling: Float[Array, "k n"]
    sink: Float[Array, " n"]
    diagonal: Float[Array, " n"]

    def __matmul__(self, x):
        product = self.diagonal * x
        for j, coupling in zip(self.j, self.coupling, strict=True):
            product = product - coupling * take(x, j)
        return product

    def magnitude(self, x):
        return 2.0 * self.diagonal * jnp.abs(x)


def poisson_operator(
    pairs: Pairs, coefficient: Float[Array, "n k"], density: Float[Array, " #n"], unknown: Bool[Array, " n"]
) -> PoissonOperator:
    """The matrix of the PPE from the `coefficient` c_ij of the Laplacian; `unknown` marks the rows to solve for.

    A few particles so close to each other that none of them passes for surface are a part of the flow without a known
    pressure. A particle with at most D + 1 partners is therefore tied weakly to zero pressure: else one such pair in
    the spray makes the matrix singular and the whole solve fail.
    """
    if pairs.own_image is not None:  # it has i's own pressure
        coefficient = jnp.where(pairs.own_image, 0.0, coefficient)
    conductance = coefficient * (1.0 / mean_density(density, pairs))
    rows = jnp.where(unknown[:, None], conductance, 0.0)
    diagonal = jnp.sum(rows, axis=-1)
    coupling = jnp.where(pairs.at_j(unknown), rows, 0.0)
    few = jnp.sum(rows > 0, axis=-1) <= pairs.dim + 1
    sink = jnp.sum(rows - coupling, axis=-1)
    tie = jnp.where(few & (sink == 0), _TIE * diagonal, 0.0)
    sink, diagonal = sink + tie, diagonal + tie
    # A particle without any partner keeps p = S/1 harmlessly: it feels no pressure force.
    return PoissonOperator(pairs.j.T, coupling.T, sink, jnp.where(diagonal > 0, diagonal, 1.0))


class PressureEquation(NamedTuple):
    """A p = −S for `unknown` p, zero elsewhere, with the pressure of the last step [Pa] to start from."""

    operator: PoissonOperator
    source: Float[Array, " n"]
    unknown: Bool[Array, " n"]
    previous: Float[Array, " n"]
    preconditioner: AbstractPreconditioner


def solve_pressure(
    equation: PressureEquation, tolerance: float, max_iterations: int
) -> tuple[Float[Array, " n"], Convergence]:
    """p [Pa].

    Without any free surface, in a closed vessel or a periodic box full of fluid, p is known up to a constant only, and
    S must have the mean zero, which is subtracted.
    """
    operator, source, unknown, previous, preconditioner = equation
    b = jnp.where(unknown, -source, 0.0)
    mean = jnp.sum(b) / jnp.maximum(jnp.sum(unknown), 1)
    b = jnp.where(unknown & ~jnp.any(operator.sink > 0), b - mean, b)
    guess = jnp.where(unknown, previous, 0.0)
    return solve(operator, b, guess, preconditioner, tolerance, max_iterations)
