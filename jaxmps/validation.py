"""Checks at the door: one error that names the argument, the rule, the unit and the value."""

import math
import numbers


def number(name: str, value: object, unit: str = "") -> float:
    """`value` as a finite float, else `ValueError`."""
    is_number = isinstance(value, numbers.Real) and not isinstance(value, bool)
    if not is_number or not math.isfinite(value):
        raise ValueError(f"{name} must be a finite number{_in(unit)}, got {_show(value, unit)}")
    return float(value)


def positive(name: str, value: object, unit: str = "") -> float:
    """`value` as a finite float above zero, else `ValueError`."""
    if number(name, value, unit) <= 0.0:
        raise ValueError(f"{name} must be greater than zero, got {_show(value, unit)}")
    return float(value)  # type: ignore[arg-type]


def not_negative(name: str, value: object, unit: str = "") -> float:
    """`value` as a finite float, zero or above, else `ValueError`."""
    if number(name, value, unit) < 0.0:
        raise ValueError(f"{name} must not be negative, got {_show(value, unit)}")
    return float(value)  # type: ignore[arg-type]


def between(name: str, value: object, low: float, high: float, unit: str = "") -> float:
    """`value` as a float within `[low, high]`, else `ValueError`."""
    if not low <= number(name, value, unit) <= high:
        limits = f"between {low:g} and {high:g}{' ' + unit if unit else ''}"
        raise ValueError(f"{name} must be {limits}, got {_show(value, unit)}")
    return float(value)  # type: ignore[arg-type]


def at_most(name: str, value: float, limit_name: str, limit: float, unit: str) -> None:
    """`ValueError` unless `value` is at most `limit`."""
    if value > limit:
        raise ValueError(
            f"{name} must be at most {limit_name} ({limit:g} {unit}), got {_show(value, unit)}"
        )


def _in(unit: str) -> str:
    return f" in {unit}" if unit else ""


def _show(value: object, unit: str) -> str:
    shown = f"{value:g}" if isinstance(value, float) else repr(value)
    return f"{shown} {unit}".rstrip()
