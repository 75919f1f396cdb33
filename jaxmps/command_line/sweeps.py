"""Sweeps of an ensemble: the values of each point, and case, scheme and key of each member."""

import itertools
from typing import TYPE_CHECKING, Any

from jaxmps.command_line.setup import prepare_case, refuse_leaving

if TYPE_CHECKING:
    from jaxmps.casefile import Setup

_MOST_POINTS = 10_000


def setups_of(
    case: str,
    scheme: str | None,
    spacing: float | None,
    settings: list[str],
    sweep: list[str],
    count: int,
    options: dict[str, Any],
) -> "list[Setup]":
    """Case and scheme at each point of the grid that the sweeps span, not jittered yet."""
    from jaxmps.validation import whole

    whole("members", count, least=1)
    grid = list(itertools.product(*(_values(text) for text in sweep)))
    if len(grid) * count > _MOST_POINTS:
        raise ValueError(f"members must be at most {_MOST_POINTS} in all, got {len(grid) * count}")
    made = [prepare_case(case, scheme, spacing, [*settings, *point], options, jittered=False) for point in grid]
    for setup in made:
        refuse_leaving(setup)
    return made


def members_of(setups: "list[Setup]", count: int) -> tuple[list[Any], list[Any], Any]:
    """Case, scheme and key of each member: the points in the order of the sweeps, and of each all seeds.

    Seed j is the same key and the same jitter at all points, so that these can be compared.
    """
    import jax
    import jax.numpy as jnp

    from jaxmps import cases

    run = setups[0].run
    keys = jax.vmap(lambda k: jax.random.fold_in(jax.random.key(run.seed), k))(jnp.arange(count))
    made = [cases.jitter(s.case, run.jitter, key) if run.jitter else s.case for s in setups for key in keys]
    return made, [s.scheme for s in setups for _ in keys], jnp.tile(keys, len(setups))


def _values(text: str) -> list[str]:
    """The settings NAME=VALUE of a sweep."""
    name, sign, rest = (part.strip() for part in text.partition("="))
    name = name.removeprefix("stochastic.")
    rule = f"sweep must have the form NAME=LOW:HIGH:COUNT or NAME=A,B,C, got {text!r}"
    try:
        if ":" not in rest:
            return [f"{name}={float(part)!r}" for part in rest.split(",")]
        low, high, count = rest.split(":")
        start, end, points = float(low), float(high), int(count)
    except ValueError:
        raise ValueError(rule) from None
    if not (name and sign) or not 2 <= points <= _MOST_POINTS:
        raise ValueError(rule)
    return [f"{name}={start + (end - start) * (k / (points - 1))!r}" for k in range(points)]
