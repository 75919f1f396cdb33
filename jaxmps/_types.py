"""Array types and conversions that every module shares."""

import functools
import operator
from collections.abc import Iterable
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float
from jaxtyping import ArrayLike as ArrayLike

Scalar = Float[Array, ""]


def as_array(value: Any) -> Array:
    """`value`, a number, sequence or array, as an array of JAX's default float.

    A bare Python float in a module is static: every value of it would be compiled anew.
    """
    return jnp.asarray(value, dtype=float)


def positive_or_one(x: Array) -> Array:
    """x where it is positive, else one: for quotients and roots that are not used there, nor their derivatives."""
    return jnp.where(x > 0, x, 1.0)


def root(x: Array) -> Array:
    """√x, zero for x of zero or below, where its derivative is zero, too: a root has none there."""
    return jnp.where(x > 0, jnp.sqrt(positive_or_one(x)), 0.0)


def total(parts: Iterable[Array]) -> Array:
    """The sum of arrays, of which there is at least one."""
    return functools.reduce(operator.add, parts)
