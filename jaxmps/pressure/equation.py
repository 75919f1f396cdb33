"""The pressure Poisson equation (PPE): its matrix and its solution."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxmps._vectors import take
from jaxmps.models import mean_density
from jaxmps.neighbors import Pairs
from jaxmps.pressure.linear import AbstractOperator, AbstractPreconditioner, Convergence, solve
from jaxmps.pressure.parts import LINK, loose_parts, without_mean


class PoissonOperator(AbstractOperator):
    """A p_i = Σ_j c_ij (2 / (ρ_i + ρ_j)) (p_i − p_j) for unknown p_i, and A p_i = p_i for known ones.

    The negative Laplacian with the density of the pair. Couplings to known pressures, which are zero here, stay on the
    diagonal, as the `sink`: A is symmetric and, where each part of the flow has a free surface, positive definite.
    Stored slot by slot, `(k, n)`, and summed in a loop that is unrolled: twice as fast on CPUs as `(n, k)`.

    `summit`: rows that no partner is linked to from above, which `loose_parts` begins with.
    """

    j: Int[Array, "k n"]
    coupling: Float[Array, "k n"]
    sink: Float[Array, " n"]
    diagonal: Float[Array, " n"]
    summit: Bool[Array, " n"]

    def __matmul__(self, x):
        product = self.diagonal * x
        for j, coupling in zip(self.j, self.coupling, strict=True):
            product = product - coupling * take(x, j)
        return product

    def magnitude(self, x):
        return 2.0 * self.diagonal * jnp.abs(x)


def poisson_operator(
    pairs: Pairs,
    coefficient: Float[Array, "n k"],
    density: Float[Array, " #n"],
    unknown: Bool[Array, " n"],
    axis: int | None = None,
) -> PoissonOperator:
    """The matrix of the PPE from the `coefficient` c_ij of the Laplacian; `unknown` marks the rows to solve for.

    `axis`: one that is not periodic, if there is any: along it every part of the flow has a highest row.
    """
    conductance = _without_own_image(coefficient, pairs) * (1.0 / mean_density(density, pairs))
    rows = jnp.where(unknown[:, None], conductance, 0.0)
    coupling = jnp.where(pairs.at_j(unknown), rows, 0.0)
    diagonal, sink = jnp.sum(rows, axis=-1), jnp.sum(rows - coupling, axis=-1)
    summit = _summit(pairs, coupling, diagonal, axis)
    return PoissonOperator(pairs.j.T, coupling.T, sink, _never_empty(diagonal), summit)


def _summit(
    pairs: Pairs, coupling: Float[Array, "n k"], diagonal: Float[Array, " n"], axis: int | None
) -> Bool[Array, " n"]:
    """Rows without a link upward along the axis; all of them where there is none with an upper end."""
    if axis is None:
        return jnp.ones(diagonal.shape, bool)
    return ~jnp.any((coupling > LINK * diagonal[:, None]) & (pairs.r_ij[axis] > 0), axis=-1)


def _without_own_image(coefficient: Float[Array, "n k"], pairs: Pairs) -> Float[Array, "n k"]:
    """A particle's image behind a mirror has its own pressure: between the two there is no difference."""
    return coefficient if pairs.own_image is None else jnp.where(pairs.own_image, 0.0, coefficient)


def _never_empty(diagonal: Float[Array, " n"]) -> Float[Array, " n"]:
    """A particle without any partner is a part by itself: whatever its row, its pressure is zero."""
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

    A part of the flow without any free surface, in a closed vessel, a periodic box full of fluid or a compact drop,
    knows p up to a constant only: there p has the mean zero, as must S, of which the mean is subtracted.
    """
    operator, source, unknown, previous, preconditioner = equation
    part = loose_parts(
        operator.j,
        *jax.lax.stop_gradient((operator.coupling, operator.sink, operator.diagonal)),
        unknown,
        operator.summit,
    )
    b = without_mean(jnp.where(unknown, -source, 0.0), part)
    guess = without_mean(jnp.where(unknown, previous, 0.0), part)
    p, convergence = solve(operator, b, guess, preconditioner, tolerance, max_iterations)
    return without_mean(p, part), convergence
