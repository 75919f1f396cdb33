"""Options of a run, and the meaning of numbers in other programs' files, checked; `ValueError` says what is wrong."""

from collections.abc import Mapping
from typing import Any

from jaxmps.flow import Kind
from jaxmps.validation import between, one_of, positive


def check_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Those options of a run that are given, not None; `ValueError` unless they follow the rules for them."""
    given = {name: value for name, value in options.items() if value is not None}
    for name in ("until", "save_every", "dt", "checkpoint_every"):
        if name in given:
            positive(name.replace("_", "-"), given[name], "s")
    if "jitter" in given:
        between("jitter", given["jitter"], 0.0, 0.3, "spacings")
    if not 0 <= given.get("seed", 0) < 2**32:
        raise ValueError(f"seed must be between 0 and {2**32 - 1}, got {given['seed']}")
    if "precision" in given:
        one_of("precision", given["precision"], ("single", "double"))
    return given


def types_of(text: str) -> dict[int, tuple[Kind, int]]:
    """The meaning of a .prof's types from text such as `0=fluid,1=fluid:1,2=wall`."""
    found = {}
    for entry in text.split(","):
        number, _, meaning = entry.partition("=")
        kind, _, phase = meaning.strip().partition(":")
        try:
            found[int(number)] = (Kind[kind.upper()], int(phase or 0))
        except (KeyError, ValueError):
            kinds = ", ".join(kind.name.lower() for kind in Kind)
            raise ValueError(
                f"--types must be NUMBER=KIND or NUMBER=KIND:PHASE, with KIND one of {kinds}, got {entry}"
            ) from None
    return found
