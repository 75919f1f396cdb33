"""What commands about a case are given, made into objects."""

import dataclasses
from typing import TYPE_CHECKING, Any

from jaxmps.command_line.options import prepare_jax

if TYPE_CHECKING:
    from jaxmps.casefile import Setup


def prepare_case(
    case: str,
    scheme: str | None,
    spacing: float | None,
    settings: list[str] | None,
    options: dict[str, Any],
    jittered: bool = True,
    checkpoint_every: float | None = None,
) -> "Setup":
    """Case, scheme and times of a command; JAX is set to the precision that was asked for. Particles lie at random, as
    far as they should, only if they are to be `jittered` here.
    """
    from jaxmps.casefile import CaseFile, RunTable, Setup
    from jaxmps.casefile.arguments import build
    from jaxmps.casefile.options import check_options

    check_options({"checkpoint_every": checkpoint_every})
    given = check_options(options)
    file = CaseFile(case) if case.endswith(".toml") else None
    table = RunTable(**given) if file is None else file.run.model_copy(update=given)
    prepare_jax(table.precision)
    displaced = table.jitter if jittered else 0.0
    if file is not None:
        setup = file.build(scheme, spacing, settings or [], given | {"jitter": displaced})
        return dataclasses.replace(setup, run=table)
    made, method = build(case, scheme or "mps", spacing, settings or [], displaced, table.seed)
    return Setup(made, method, (), table)


def refuse_leaving(setup: "Setup") -> None:
    """`ValueError` for a run that would fail at a time which is known: when a wall leaves the domain."""
    from jaxmps.casefile import leaving

    gone = leaving(setup)
    if gone is not None:
        raise ValueError(str(gone))
