"""How the pressure equation is preconditioned."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxmps.flow import Box
from jaxmps.neighbors import Pairs
from jaxmps.pressure.equation import PoissonOperator
from jaxmps.pressure.linear import AbstractPreconditioner, Jacobi
from jaxmps.pressure.multigrid import cover, multigrid


class AbstractPreconditioning(eqx.Module):
    """A choice of preconditioner: it changes the cost of a solve, and its result by less than its tolerance."""

    @abc.abstractmethod
    def __call__(
        self,
        operator: PoissonOperator,
        unknown: Bool[Array, " n"],
        pairs: Pairs,
        position: Float[Array, "n d"],
        box: Box,
        spacing: float,
    ) -> AbstractPreconditioner:
        """The preconditioner of the matrix between particles at `position` [m]; `unknown` rows are solved for."""


class ByDiagonal(AbstractPreconditioning):
    """Jacobi. The number of iterations grows as that of particles along an axis: 75 at 2000 particles, 1000 at 10^5."""

    def __call__(self, operator, unknown, pairs, position, box, spacing):
        return Jacobi(operator.diagonal)


class ByMultigrid(AbstractPreconditioning):
    """Multigrid (see `Multigrid`) on elements of `cell` spacings: 11 to 16 iterations to 1e-6 for 2 to 3 spacings."""

    cell: float = eqx.field(static=True, default=3.0)

    def __call__(self, operator, unknown, pairs, position, box, spacing):
        half = 0.5 * operator.coupling.T
        tensor = [[jnp.sum(half * a * b, axis=-1) for b in pairs.r_ij] for a in pairs.r_ij]
        grid = cover(box, self.cell * spacing)
        return multigrid(box.wrap(position), tensor, operator.sink, operator.diagonal, unknown, grid)
