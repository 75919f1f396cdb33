"""Checks at the door: one error that names the argument, the rule, the unit and the value.

Numbers may be arrays; inside a transformation, where an argument has no value, there is nothing to check.
"""

import math
from collections.abc import Iterable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer


def number(name: str, value: Any, unit: str = "") -> Any:
    """`value` as a finite float, else `ValueError`."""
    if isinstance(value, Tracer):
        return value
    array = np.asarray(value)
    if array.dtype.kind not in "iuf" or array.ndim or not math.isfinite(array):
        raise ValueError(f"{name} must be a finite number{f' in {unit}' if unit else ''}, got {_show(value, unit)}")
    held = jnp.finfo(jnp.result_type(float))
    if array and not held.tiny <= abs(array) <= held.max:
        reach = f"from {held.tiny:.2g} to {held.max:.2g}, as far as {held.dtype} goes"
        raise ValueError(f"{name} must be zero or of a size {reach}, got {_show(value, unit)}")
    return float(array)


def fixed(name: str, value: Any) -> Any:
    """`value`, else `ValueError` if it is one under a transformation: what it decides is no array."""
    if isinstance(value, Tracer):
        raise ValueError(
            f"{name} must be a plain number, not one under jax.grad, vmap or jit: it is fixed before anything is "
            "compiled (a geometry decides how many particles there are), and has no derivative. Derivatives exist by "
            "gravity, densities, viscosities, the numbers of a motion, the values of a scheme, and by positions and "
            "velocities of a state or, with from_case=True in rollout, of a case"
        )
    return value


def whole(name: str, value: Any, *, least: int) -> int:
    """`value` as an int of `least` or more, else `ValueError`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueError(f"{name} must be a whole number of {least} or more, got {value!r}")
    return int(value)


def positive(name: str, value: Any, unit: str = "") -> Any:
    """`value` as a finite float above zero, else `ValueError`."""
    return _obey(name, value, unit, lambda x: x > 0.0, "greater than zero")


def not_negative(name: str, value: Any, unit: str = "") -> Any:
    """`value` as a finite float, zero or above, else `ValueError`."""
    return _obey(name, value, unit, lambda x: x >= 0.0, "zero or greater")


def not_zero(name: str, value: Any, unit: str = "") -> Any:
    """`value` as a finite float other than zero, else `ValueError`."""
    return _obey(name, value, unit, lambda x: x != 0.0, "other than zero")


def between(name: str, value: Any, low: float, high: float, unit: str = "") -> Any:
    """`value` as a float within `[low, high]`, else `ValueError`."""
    limits = f"between {low:g} and {high:g}{' ' + unit if unit else ''}"
    return _obey(name, value, unit, lambda x: low <= x <= high, limits)


def at_most(name: str, value: Any, limit_name: str, limit: float, unit: str) -> Any:
    """`value` as a float of at most `limit`, else `ValueError`."""
    return _obey(name, value, unit, lambda x: x <= limit, f"at most {limit_name} ({limit:g} {unit})")


def one_of(name: str, value: str, known: Iterable[str]) -> str:
    """`value` if it is among the `known` names, else `ValueError` that lists them."""
    known = tuple(known)
    if value not in known:
        raise ValueError(f"{name} must be one of {', '.join(known)}, got {value}")
    return value


def _obey(name: str, value: Any, unit: str, rule: Any, words: str) -> Any:
    checked = number(name, value, unit)
    if not isinstance(checked, Tracer) and not rule(checked):
        raise ValueError(f"{name} must be {words}, got {_show(value, unit)}")
    return checked


def _show(value: Any, unit: str) -> str:
    shown = f"{value:g}" if isinstance(value, float) else repr(value)
    return f"{shown} {unit}".rstrip()
