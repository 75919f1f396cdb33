"""Estimates of the gradient of an objective: through the run, or, where chaos makes that useless, around it."""

import abc
from collections.abc import Callable
from typing import Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Key

from jaxmps._types import Scalar
from jaxmps.validation import positive, whole

Objective: TypeAlias = Callable[[Any], Scalar]


class AbstractEstimator(eqx.Module):
    """A way to estimate the gradient of an objective."""

    @abc.abstractmethod
    def __call__(self, objective: Objective, values: Any, key: Key[Array, ""]) -> tuple[Scalar, Any]:
        """The objective and its gradient at `values`, a pytree of float arrays; draws, if any, come from `key`."""


class Pathwise(AbstractEstimator):
    """The derivative of the computation itself, in reverse mode: exact, for as long as the flow is not chaotic."""

    def __call__(self, objective, values, key):
        return jax.value_and_grad(objective)(values)


class Forward(AbstractEstimator):
    """The same derivative in forward mode: for a few numbers cheaper than reverse mode, and no step is kept."""

    def __call__(self, objective, values, key):
        flat, restore = ravel_pytree(values)
        value, slope = jax.linearize(lambda x: objective(restore(x)), flat)
        return value, restore(jax.lax.map(slope, jnp.eye(len(flat), dtype=flat.dtype)))


class Evolution(AbstractEstimator):
    """An evolution strategy with antithetic pairs: g = 1/(2 σ m) Σ_k (L(x + σ ε_k) − L(x − σ ε_k)) ε_k, ε_k ~ N(0, 1).

    The unbiased gradient of L smoothed by a Gaussian of width σ (Salimans et al. 2017, arXiv:1703.03864, §2.1), of
    whose noise the even part of L has no share. It needs no derivative, and so does not mind chaos or kinks. All runs
    of one estimate share their keys. `sigma` is measured in the variables that are tuned, after the transformation of
    bounds; `pairs` m runs twice as many objectives, side by side.
    """

    sigma: float = eqx.field(static=True, default=0.1)
    pairs: int = eqx.field(static=True, default=8)

    def __check_init__(self):
        positive("sigma", self.sigma)
        whole("pairs", self.pairs, least=1)

    def __call__(self, objective, values, key):
        flat, restore = ravel_pytree(values)
        draws = jax.random.normal(key, (self.pairs, len(flat)), flat.dtype)
        steps = self.sigma * jnp.concatenate([draws, -draws])
        plus, minus = jax.vmap(lambda x: objective(restore(x)))(flat + steps).reshape(2, self.pairs)
        gradient = jnp.mean((plus - minus)[:, None] * draws, axis=0) / (2.0 * self.sigma)
        return jnp.mean(jnp.concatenate([plus, minus])), restore(gradient)
