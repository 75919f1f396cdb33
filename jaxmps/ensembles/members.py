"""The members of an ensemble: what they share, and the leaves in which they differ."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from jaxmps.flow import Case
from jaxmps.scheme import Scheme

T = TypeVar("T")


class Member(NamedTuple):
    """One run of an ensemble."""

    number: int
    case: Case
    scheme: Scheme
    key: Key[Array, ""]
    values: dict[str, np.ndarray]


def members(
    case: Case | Sequence[Case], scheme: Scheme | Sequence[Scheme], keys: Key[Array, " members"]
) -> list[Member]:
    """A member for each key; `ValueError` unless there are as many cases and schemes, or one, and all of one kind."""
    count = len(keys)
    cases, schemes = _several("case", case, Case, count), _several("scheme", scheme, Scheme, count)
    values = {**_differing("case", cases), **_differing("scheme", schemes)}
    return [
        Member(k, cases[k], schemes[k], keys[k], {name: column[k] for name, column in values.items()})
        for k in range(count)
    ]


def split(trees: Sequence[T]) -> tuple[T, T]:
    """The leaves in which trees of one structure differ, stacked, and those that they share; None for the others.

    `eqx.combine` puts what a member has of both together again.
    """
    same = jax.tree.map(lambda *leaves: _equal(leaves), *trees)
    own = jax.tree.map(lambda alike, *leaves: None if alike else jnp.stack(leaves), same, *trees)
    return own, jax.tree.map(lambda alike, leaf: leaf if alike else None, same, trees[0])


def _several(name: str, given: Any, kind: type, count: int) -> list[Any]:
    if isinstance(given, kind):
        return [given] * count
    several = list(given)
    if len(several) != count or not all(isinstance(one, kind) for one in several):
        raise ValueError(f"{name} must be one, or one for each of {count} keys, got {len(several)}")
    bare = [one.undescribed() if isinstance(one, Case) else one for one in several]
    first = _kind_of(bare[0])
    for k, one in enumerate(bare):
        if _kind_of(one) != first:
            raise ValueError(
                f"every {name} must differ from the first in values alone, not in {', '.join(_fixed(bare[0], one))}, "
                f"got {name} {k}"
            )
    return several


def _kind_of(tree: Any) -> Any:
    return jax.tree.structure(tree), [(jnp.shape(leaf), jnp.result_type(leaf)) for leaf in jax.tree.leaves(tree)]


def _fixed(first: Any, other: Any, prefix: str = "") -> list[str]:
    """By dotted name what is fixed when a program is compiled, and differs."""
    if type(first) is not type(other):
        return [prefix.rstrip(".")]
    found = []
    for field in dataclasses.fields(first):
        name, a, b = prefix + field.name, getattr(first, field.name), getattr(other, field.name)
        if isinstance(a, eqx.Module):
            found += _fixed(a, b, name + ".")
        elif eqx.is_array(a) and eqx.is_array(b):
            found += [] if (a.shape, a.dtype) == (b.shape, b.dtype) else [f"the shape or precision of {name}"]
        elif a != b:
            found.append(name)
    return found


def _differing(what: str, several: Sequence[Any]) -> dict[str, np.ndarray]:
    """By dotted name the small values in which they differ; of a case's particles not every number."""
    if all(one is several[0] for one in several):
        return {}
    paths = [jax.tree_util.keystr(path).lstrip(".") for path, _ in jax.tree_util.tree_leaves_with_path(several[0])]
    columns = zip(*(jax.tree.leaves(one) for one in several), strict=True)
    return {
        path: np.stack([np.asarray(leaf) for leaf in leaves])
        for path, leaves in zip(paths, columns, strict=True)
        if not path.startswith("particles.") and not _equal(leaves)
    }


def _equal(leaves: Sequence[Any]) -> bool:
    first = leaves[0]
    return all(leaf is first or np.array_equal(leaf, first, equal_nan=True) for leaf in leaves)
