"""The differentiable solve of a symmetric positive definite system by preconditioned conjugate gradients."""

import abc
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name
from jax.scipy.sparse.linalg import cg
from jaxtyping import Array, Float

from jaxmps._types import Scalar

SOLUTION = "solution"
"""The name of solutions, for policies of `jax.checkpoint`."""


class AbstractOperator(eqx.Module):
    """A symmetric positive definite matrix that is known by its product with a vector."""

    @abc.abstractmethod
    def __matmul__(self, x: Float[Array, " n"]) -> Float[Array, " n"]:
        """A x."""

    @abc.abstractmethod
    def magnitude(self, x: Float[Array, " n"]) -> Float[Array, " n"]:
        """About Σ_j |A_ij| |x_j|: the size of what is added up in A x, which sets its round-off."""


class AbstractPreconditioner(eqx.Module):
    """A symmetric positive definite approximation of A⁻¹."""

    @abc.abstractmethod
    def __call__(self, residual: Float[Array, " n"]) -> Float[Array, " n"]:
        """Its product with the residual."""


class Jacobi(AbstractPreconditioner):
    """The inverse of the diagonal."""

    diagonal: Float[Array, " n"]

    def __call__(self, residual):
        return residual / self.diagonal


class Convergence(NamedTuple):
    """The true relative residual ‖b − A x‖ / ‖b‖ of a solve (zero for b = 0), and whether it met its tolerance, as far
    as round-off allows.
    """

    residual: Scalar
    converged: Array


def solve(
    operator: AbstractOperator,
    b: Float[Array, " n"],
    guess: Float[Array, " n"],
    preconditioner: AbstractPreconditioner,
    tolerance: float,
    max_iterations: int,
) -> tuple[Float[Array, " n"], Convergence]:
    """x with A x = b to ‖b − A x‖ ≤ tolerance ‖b‖, differentiable in A and b; nothing is propagated to `guess` or to
    the preconditioner.

    The derivative is that of the exact solution, A dx = db − dA x, from a solve of its own in both modes (symmetric A).
    Each solve stops relative to its own right-hand side: `jax.scipy`'s `cg` would use the starting vector and the
    absolute tolerance of the forward solve again for tangents and cotangents, which ruins them silently.
    """
    guess, preconditioner = jax.lax.stop_gradient((guess, preconditioner))
    x = _solve(operator, b, guess, preconditioner, tolerance, max_iterations)
    frozen, target = jax.lax.stop_gradient((operator, b))
    norm = jnp.linalg.norm(target)
    found = jax.lax.stop_gradient(x)
    residual = jnp.linalg.norm(target - frozen @ found)
    relative = jnp.where(norm > 0, residual / jnp.where(norm > 0, norm, 1.0), residual)
    # CG tests its recursive residual, from which round-off separates the true one. No vector of this precision comes
    # closer than the round-off in A x: in a large smooth flow that is far above the tolerance in single precision.
    round_off = jnp.finfo(x.dtype).eps * jnp.linalg.norm(frozen.magnitude(found))
    return x, Convergence(relative, residual <= 2.0 * (tolerance * norm + round_off))


@partial(jax.custom_jvp, nondiff_argnums=(4, 5))
def _solve(operator, b, guess, preconditioner, tolerance, max_iterations):
    # The multiple of the guess that leaves the smallest residual: where the guess is bad, it does no harm.
    product = operator @ guess
    squared = jnp.vdot(product, product)
    part = jnp.where(squared > 0, jnp.vdot(product, b) / jnp.where(squared > 0, squared, 1.0), 0.0)
    correction, _ = cg(
        operator.__matmul__,
        b - part * product,
        tol=0.0,
        atol=tolerance * jnp.linalg.norm(b),
        maxiter=max_iterations,
        M=preconditioner,
    )
    return part * guess + correction


@_solve.defjvp
def _solve_jvp(tolerance, max_iterations, primals, tangents):
    operator, b, guess, preconditioner = primals
    d_operator, d_b, _, _ = tangents
    # Named: what is computed again in a step of the reverse mode need not be solved again.
    x = checkpoint_name(_solve(operator, b, guess, preconditioner, tolerance, max_iterations), SOLUTION)
    _, d_product = jax.jvp(lambda a: a @ x, (operator,), (d_operator,))

    def scaled_cg(matvec, rhs):
        # Scaled to order one: in single precision the squares inside cg underflow for tiny cotangents.
        scale = jnp.max(jnp.abs(rhs))
        scale = jnp.where(scale > 0, scale, 1.0)
        solution, _ = cg(matvec, rhs / scale, tol=tolerance, maxiter=max_iterations, M=preconditioner)
        return scale * solution

    dx = jax.lax.custom_linear_solve(operator.__matmul__, d_b - d_product, scaled_cg, scaled_cg, symmetric=True)
    return x, dx
