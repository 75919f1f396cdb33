"""The leaves of a tree that are to be tuned, and the free variables that stand for them within their bounds."""

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmps._types import ArrayLike

Bounds: TypeAlias = tuple[ArrayLike | None, ArrayLike | None] | None
"""The open range of a value; None where it has no end."""


class Selection:
    """The leaves that `where` selects in a tree, their names, and their bounds. Raises `ValueError` for leaves that are
    not float arrays, and where bounds are not one for each leaf.
    """

    def __init__(self, tree: Any, where: Callable[[Any], Any], bounds: Sequence[Bounds] | None):
        self._tree, self._where, self._several = tree, where, isinstance(where(tree), (list, tuple))
        paths = jax.tree_util.tree_map_with_path(lambda path, _: _name(path), tree)
        self.leaves, self.names = self._chosen(tree), self._chosen(paths)
        for name, leaf in zip(self.names, self.leaves, strict=True):
            if not eqx.is_inexact_array(leaf):
                raise ValueError(f"where must select float arrays, got {leaf!r} for {name}")
        self.bounds = [None] * len(self.leaves) if bounds is None else list(bounds)
        if len(self.bounds) != len(self.leaves):
            raise ValueError(
                f"bounds must have one entry for each of {len(self.leaves)} leaves, got {len(self.bounds)}"
            )

    def free(self) -> list[Array]:
        """The free variables of the leaves as they are; `ValueError` for one that is not strictly within its bounds."""
        return [_freed(*each) for each in zip(self.names, self.leaves, self.bounds, strict=True)]

    def values(self, free: Sequence[Array]) -> list[Array]:
        """What the free variables stand for."""
        return [_bounded(z, bounds) for z, bounds in zip(free, self.bounds, strict=True)]

    def put(self, values: Sequence[Any]) -> Any:
        """The tree with these values for its leaves."""
        arrays = [jnp.asarray(x, leaf.dtype) for x, leaf in zip(values, self.leaves, strict=True)]
        return eqx.tree_at(self._where, self._tree, arrays if self._several else arrays[0])

    def show(self, values: Sequence[Any]) -> str:
        return ", ".join(f"{name} = {value}" for name, value in zip(self.names, values, strict=True))

    def _chosen(self, tree: Any) -> list[Any]:
        chosen = self._where(tree)
        return list(chosen) if self._several else [chosen]


def _name(path: tuple[Any, ...]) -> str:
    """The way to a leaf; a tree that is a leaf itself goes by the name of its argument."""
    return jax.tree_util.keystr(path).lstrip(".") or "start"


def _bounded(free: Array, bounds: Bounds) -> Array:
    """low + (high − low) / (1 + e^−z) between two bounds, low + log(1 + e^z) or high − log(1 + e^z) with one."""
    low, high = bounds or (None, None)
    if low is not None and high is not None:
        return jnp.asarray(low) + (jnp.asarray(high) - low) * jax.nn.sigmoid(free)
    if low is not None:
        return jnp.asarray(low) + jax.nn.softplus(free)
    return free if high is None else jnp.asarray(high) - jax.nn.softplus(free)


def _freed(name: str, value: Array, bounds: Bounds) -> Array:
    """The inverse of that."""
    low, high = bounds or (None, None)
    above = low is None or np.all(np.asarray(value > low))
    below = high is None or np.all(np.asarray(value < high))
    if not (above and below):
        raise ValueError(f"{name} must start strictly between its bounds {low} and {high}, got {value}")
    if low is not None and high is not None:
        part = (value - low) / (jnp.asarray(high) - low)
        return jnp.log(part) - jnp.log1p(-part)
    if low is None and high is None:
        return value
    distance = jnp.abs(value - jnp.asarray(high if low is None else low))
    return distance + jnp.log(-jnp.expm1(-distance))  # log(e^x − 1) without overflow
