"""The pressure Poisson equation (PPE): its matrix and its solution."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxmps._vectors import take
from jaxmps.models import mean_density
from jaxmps.neighbors import Pairs
from jaxmps.pressure.linear import AbstractOperator, AbstractPreconditioner, Convergence, solve

_TIE = 1e-3  # of the diagonal: what ties a lonely clump of particles to zero pressure


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
    """The matrix of the PPE from the `coefficient` c_ij of the Laplacian; `unknown` marks the rows to solve for."""
    conductance = _without_own_image(coefficient, pairs) * (1.0 / mean_density(density, pairs))
    rows = jnp.where(unknown[:, None], conductance, 0.0)
    coupling = jnp.where(pairs.at_j(unknown), rows, 0.0)
    diagonal, sink = jnp.sum(rows, axis=-1), jnp.sum(rows - coupling, axis=-1)
    tie = _tie(rows, diagonal, sink, pairs.dim)
    return PoissonOperator(pairs.j.T, coupling.T, sink + tie, _never_empty(diagonal + tie))


def _without_own_image(coefficient: Float[Array, "n k"], pairs: Pairs) -> Float[Array, "n k"]:
    """A particle's image behind a mirror has its own pressure: between the two there is no difference."""
    return coefficient if pairs.own_image is None else jnp.where(pairs.own_image, 0.0, coefficient)


def _tie(
    rows: Float[Array, "n k"], diagonal: Float[Array, " n"], sink: Float[Array, " n"], dim: int
) -> Float[Array, " n"]:
    """What ties particles with at most D + 1 partners weakly to zero pressure.

    A few particles so close to each other that none of them passes for surface are a part of the flow without a known
    pressure: one such pair in the spray makes the matrix singular and the whole solve fail.
    """
    few = jnp.sum(rows > 0, axis=-1) <= dim + 1
    return jnp.where(few & (sink == 0), _TIE * diagonal, 0.0)


def _never_empty(diagonal: Float[Array, " n"]) -> Float[Array, " n"]:
    """A particle without any partner keeps p = S/1, which is harmless: it feels no pressure force."""
    return jnp.where(diagonal > 0, diagonal, 1.0)


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
