"""The differentiable solve of a symmetric positive definite system by preconditioned conjugate gradients."""

import abc
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.sparse.linalg import cg
from jaxtyping import Array, Float

from jaxmps._types import Scalar


class AbstractOperator(eqx.Module):
    """A symmetric positive definite matrix that is known by its product with a vector."""

    @abc.abstractmethod
    def __matmul__(self, x: Float[Array, " n"]) -> Float[Array, " n"]:
        """A x."""

    @abc.abstractmethod
    def precondition(self, residual: Float[Array, " n"]) -> Float[Array, " n"]:
        """A symmetric positive definite approximation of A⁻¹ times the residual."""


class Convergence(NamedTuple):
    """The true relative residual ‖b − A x‖ / ‖b‖ of a solve (zero for b = 0) and whether it met its tolerance."""

    residual: Scalar
    converged: Array


def solve(
    operator: AbstractOperator,
    b: Float[Array, " n"],
    guess: Float[Array, " n"],
    tolerance: float,
    max_iterations: int,
) -> tuple[Float[Array, " n"], Convergence]:
    """x with A x = b to ‖b − A x‖ ≤ tolerance ‖b‖, differentiable in A and b; nothing is propagated to `guess`.

    The derivative is that of the exact solution, A dx = db − dA x, from a solve of its own in both modes (symmetric A).
    Each solve stops relative to its own right-hand side: `jax.scipy`'s `cg` would use the starting vector and the
    absolute tolerance of the forward solve again for tangents and cotangents, which ruins them silently.
    """
    x = _solve(operator, b, jax.lax.stop_gradient(guess), tolerance, max_iterations)
    frozen, target = jax.lax.stop_gradient((operator, b))
    norm = jnp.linalg.norm(target)
    residual = jnp.linalg.norm(target - frozen @ jax.lax.stop_gradient(x))
    relative = jnp.where(norm > 0, residual / jnp.where(norm > 0, norm, 1.0), residual)
    # CG tests its recursive residual, from which round-off separates the true one: allow for twice the tolerance.
    return x, Convergence(relative, relative <= 2.0 * tolerance)


@partial(jax.custom_jvp, nondiff_argnums=(3, 4))
def _solve(operator, b, guess, tolerance, max_iterations):
    correction, _ = cg(
        operator.__matmul__,
        b - operator @ guess,
        tol=0.0,
        atol=tolerance * jnp.linalg.norm(b),
        maxiter=max_iterations,
        M=operator.precondition,
    )
    return guess + correction


@_solve.defjvp
def _solve_jvp(tolerance, max_iterations, primals, tangents):
    operator, b, guess = primals
    d_operator, d_b, _ = tangents
    x = _solve(operator, b, guess, tolerance, max_iterations)
    _, d_product = jax.jvp(lambda a: a @ x, (operator,), (d_operator,))

    def scaled_cg(matvec, rhs):
        # Scaled to order one: in single precision the squares inside cg underflow for tiny cotangents.
        scale = jnp.max(jnp.abs(rhs))
        scale = jnp.where(scale > 0, scale, 1.0)
        solution, _ = cg(matvec, rhs / scale, tol=tolerance, maxiter=max_iterations, M=operator.precondition)
        return scale * solution

    dx = jax.lax.custom_linear_solve(operator.__matmul__, d_b - d_product, scaled_cg, scaled_cg, symmetric=True)
    return x, dx
