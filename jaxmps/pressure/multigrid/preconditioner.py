"""The preconditioner: a Jacobi step on the particles and a V-cycle on the grid."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxmps._compilation import materialized
from jaxmps._types import total
from jaxmps._vectors import take
from jaxmps.pressure.linear import AbstractPreconditioner
from jaxmps.pressure.multigrid.elements import apply, coarsen, entries, row_sums, shape_functions, stencil
from jaxmps.pressure.multigrid.grid import Grid, closed, folded, prolong, restrict

_RELAXATION = 1.6  # of the smoother: it converges below 2, whatever the matrix
_SHIFT = 1e-4  # of the coarsest matrix, relative to its diagonal: makes parts without a free surface regular


class Level(eqx.Module):
    """The matrix on one grid, and what a smoothing step multiplies the residual by."""

    stencil: Float[Array, "offsets *haloed"]
    smoother: Float[Array, "*nodes"]
    grid: Grid = eqx.field(static=True)

    def residual(self, b: Float[Array, "*nodes"], x: Float[Array, "*nodes"]) -> Float[Array, "*nodes"]:
        return b - apply(self.stencil, x, self.grid)


class Multigrid(AbstractPreconditioner):
    """M = D⁻¹ + P V Pᵀ: a Jacobi step on the particles plus a V-cycle V on a grid, for the smooth part of the error.

    P interpolates linearly from the nodes around a particle. Both parts are symmetric, the first is positive and the
    second not negative: M is positive definite whatever the flow looks like, with droplets, and with enclosed parts
    that have no free surface. It does not apply the matrix of the particles, and with it the number of iterations does
    not depend on the number of particles.
    """

    inverse_diagonal: Float[Array, " n"]
    node: Int[Array, " n"]
    shape: Float[Array, "corners n"]
    levels: tuple[Level, ...]
    coarsest: Float[Array, "nodes nodes"]
    grid: Grid = eqx.field(static=True)

    def __call__(self, residual):
        return self.inverse_diagonal * residual + self._interpolate(_cycle(self, 0, self._gather(residual)))

    def _gather(self, x: Float[Array, " n"]) -> Float[Array, "*nodes"]:
        """Pᵀ x."""
        total = jnp.zeros(math.prod(self.grid.closed), x.dtype)
        for weight, step in zip(self.shape, _steps(self.grid), strict=True):
            total = total.at[self.node + step].add(weight * x, mode="promise_in_bounds")
        return folded(total.reshape(self.grid.closed), self.grid)

    def _interpolate(self, x: Float[Array, "*nodes"]) -> Float[Array, " n"]:
        """P x."""
        values = materialized(closed(x, self.grid).ravel())
        corners = zip(self.shape, _steps(self.grid), strict=True)
        return total(weight * take(values, self.node + step) for weight, step in corners)


def multigrid(
    position: Float[Array, "n d"],
    tensor: list[list[Float[Array, " n"]]],
    sink: Float[Array, " n"],
    diagonal: Float[Array, " n"],
    unknown: Bool[Array, " n"],
    grid: Grid,
) -> Multigrid:
    """The preconditioner of (A p)_i = Σ_j c_ij (p_i − p_j) + s_i p_i with zero p_i where not `unknown`.

    A smooth p has the energy Σ_i (∇p·T_i ∇p + s_i p²) / 2 with the components T_i = ½ Σ_j c_ij r_ij ⊗ r_ij of a
    `tensor` and the `sink` s_i, the coupling to known p_j. This makes a matrix of bilinear finite elements on the grid,
    with the particles as points of quadrature. It stands for Pᵀ A P, whose stencils would be wider, and costs no pass
    over the pairs. Each coarser matrix is Pᵀ K P of the finer one.
    """
    size, dtype = jnp.array(grid.size, position.dtype), position.dtype
    place = jnp.nan_to_num((position - jnp.array(grid.lower, dtype)) / size)
    corner = jnp.clip(jnp.floor(place), 0, jnp.array(grid.elements, dtype) - 1)
    node = jnp.sum(corner.astype(jnp.int32) * jnp.array(_strides(grid)), axis=-1)
    shape, gradient = shape_functions(jnp.clip(place - corner, 0.0, 1.0), grid)
    flux = [[sum(t * g for t, g in zip(row, slope, strict=True)) for row in tensor] for slope in gradient]
    energy = [
        sum(f * g for f, g in zip(flux[a], gradient[b], strict=True)) + sink * shape[a] * shape[b]
        for a, b in entries(grid.dim)
    ]
    energy = jnp.where(unknown, jnp.stack(energy), 0.0)
    matrices = jnp.zeros((len(energy), math.prod(grid.closed)), dtype)
    matrices = matrices.at[:, node].add(energy, mode="promise_in_bounds").reshape(-1, *grid.closed)
    matrices = matrices[(slice(None), *(slice(0, m) for m in grid.elements))]
    levels, coarsest = _hierarchy(matrices, grid)
    shape = jnp.where(unknown, jnp.stack(shape), 0.0)
    return Multigrid(1.0 / diagonal, node, shape, levels, coarsest, grid)


def _hierarchy(matrices, grid):
    """The levels down to the last but one, and the inverse of the coarsest matrix."""
    levels = []
    while any(grid.split):
        sums = row_sums(matrices, grid)
        smoother = jnp.where(sums > 0, _RELAXATION / jnp.where(sums > 0, sums, 1.0), 0.0)
        levels.append(Level(stencil(matrices, grid), smoother, grid))
        matrices, grid = coarsen(matrices, grid), grid.coarser
    half, unit = stencil(matrices, grid), jnp.eye(math.prod(grid.nodes), dtype=matrices.dtype)
    whole = jax.vmap(lambda x: apply(half, x.reshape(grid.nodes), grid).ravel())(unit)
    diagonal = jnp.diagonal(whole)
    # Scaled to a unit diagonal. A node without particles stands for itself.
    scale = jnp.where(diagonal > 0, 1.0 / jnp.sqrt(jnp.where(diagonal > 0, diagonal, 1.0)), 0.0)
    scaled = scale[:, None] * whole * scale + jnp.diag(jnp.where(diagonal > 0, _SHIFT, 1.0))
    return tuple(levels), scale[:, None] * _inverse(scaled) * scale


def _inverse(matrix: Float[Array, "m m"]) -> Float[Array, "m m"]:
    """The inverse of a small symmetric positive definite matrix, by sweeps: Gauss-Jordan steps that keep the symmetry.

    Not LAPACK's: on CPUs its threads wait for the next call at full speed, and one core does nothing else in a run.
    """
    places = jnp.arange(matrix.shape[0])

    def sweep(k, a):
        row, pivot, itself = a[k], a[k, k], places == k
        scaled = jnp.where(itself, -1.0, row) / pivot
        rest = a - row[:, None] * row / pivot
        return jnp.where(itself[:, None], scaled, jnp.where(itself, scaled[:, None], rest))

    return -jax.lax.fori_loop(0, matrix.shape[0], sweep, matrix)


def _cycle(m: Multigrid, number: int, b: Float[Array, "*nodes"]) -> Float[Array, "*nodes"]:
    """A V-cycle with one smoothing step before and one after."""
    if number == len(m.levels):
        return (m.coarsest @ b.ravel()).reshape(b.shape)
    level = m.levels[number]
    x = level.smoother * b
    x = x + prolong(_cycle(m, number + 1, restrict(level.residual(b, x), level.grid)), level.grid)
    return x + level.smoother * level.residual(b, x)


def _strides(grid: Grid) -> list[int]:
    """How far apart neighboring nodes of the closed grid lie in memory along each axis."""
    return [math.prod(grid.closed[axis + 1 :]) for axis in range(grid.dim)]


def _steps(grid: Grid) -> list[int]:
    """How far each corner of an element lies from the first in memory."""
    return [sum(c * stride for c, stride in zip(corner, _strides(grid), strict=True)) for corner in grid.corners]
