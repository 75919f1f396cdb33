"""What the command line prints and writes."""

import csv
import inspect
import io
import json
import math
import re
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    import numpy as np

    from jaxmps.diagnostics import Probe
    from jaxmps.flow.motion import AbstractMotion
    from jaxmps.results import Run

WRONG_INPUT, FAILED, INTERRUPTED = 2, 1, 130
_SHOWN = {"time": "s", "energy_start": "J/kg", "energy_end": "J/kg", "max_speed": "m/s"}
_SHOWN |= dict.fromkeys(("stabilizer_work", "noise_work", "wall_work", "dissipated"), "J/kg")
_SHOWN |= {"wall_seconds": "s", "particle_steps_per_second": "1/s"}


def say(kind: str, message: str) -> None:
    """One line on stderr, however long."""
    print(f"{kind}: {' '.join(message.split())}", file=sys.stderr)


def fail(message: str, code: int) -> int:
    """Prints an error and gives the exit code back."""
    say("error", message)
    return code


def conclude(
    result: "Run",
    paths: Mapping[str, Path],
    instruments: "Sequence[Probe]" = (),
    motion: "AbstractMotion | None" = None,
) -> int:
    """Writes summary, picture and readings of a run, prints how it went, and gives the exit code.

    Instruments go with the walls if these have a `motion`.
    """
    from jaxmps import plotting
    from jaxmps.io import replace_file

    summary = {key: _plain(value) for key, value in result.summary.items()}
    text = json.dumps(summary, indent=2, allow_nan=False, ensure_ascii=False)
    picture = io.BytesIO()
    plotting.frame(result).savefig(picture, format="png", dpi=150)
    # Whole or not there at all: what a kill leaves out is made by `jaxmps resume`.
    replace_file(paths["summary.json"], f"{text}\n".encode())
    replace_file(paths["final.png"], picture.getbuffer())
    if instruments:
        from jaxmps.diagnostics import probes, relative

        seen = result if motion is None else relative(result, motion)
        _write_columns(paths["probes.csv"], probes(seen, instruments))
    print_table("result", {key: _with_unit(key, value) for key, value in summary.items()})
    for name, path in paths.items():
        if name != "failure.png":
            print(path)
    kept = f"{len(result)} frames are in {paths['run.vtkhdf']}"
    if result.status.fatal is not None:
        plotting.failure(result).savefig(paths["failure.png"], dpi=150)
        kept += f", and a picture of the place is {paths['failure.png']}"
    return _verdict(result, kept)


def _write_columns(path: Path, columns: "Mapping[str, np.ndarray]") -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows([f"{x:.9g}" for x in row] for row in zip(*columns.values(), strict=True))


def _verdict(result: "Run", kept: str) -> int:
    """One line for what ended the run, or else one for each thing that its user should know."""
    from jaxmps.flow import FATAL, Outcome, Status
    from jaxmps.io import checkpoint_of

    events, ends = result.status.events, FATAL | Status.INTERRUPTED
    if result.status.completed:
        for event in events:
            say("warning", f"{event}. Advice: {event.advice}")
        return 0
    cause = Outcome(tuple(event for event in events if event.status & ends))
    failed, advice = bool(cause.flags & FATAL), cause.advice
    if not failed and result.path is not None and checkpoint_of(result.path).exists():
        advice = f"jaxmps resume {shlex.quote(str(result.path.parent))} carries it on from its checkpoint"
    return fail(f"{cause}; {kept}. Advice: {advice}", FAILED if failed else INTERRUPTED)


def tell(result: "Run") -> None:
    """Prints everything about a run but its arrays."""
    for key, title in (
        ("case", "case"),
        ("scheme", "scheme"),
        ("run", "run"),
        ("versions", "versions"),
    ):
        if isinstance(result.metadata.get(key), dict):
            print_table(title, result.metadata[key])
    from jaxmps.flow import Kind

    counts = {kind.name.lower(): int((result.kind[-1] == kind).sum()) for kind in Kind}
    first, last = result.time[0], result.time[-1]
    content = {
        "particles": ", ".join(f"{count} {name}" for name, count in counts.items()),
        "dimensions": result.position.shape[2],
        "frames": f"{len(result)}, t = {first:.6g} to {last:.6g} s",
        "status": str(result.status),
    }
    print_table("content", content)
    if result.summary:
        print_table("summary", {key: _with_unit(key, v) for key, v in result.summary.items()})


def catalog(what: str, factories: Mapping[str, Callable[..., Any]], name: str | None) -> None:
    """Prints a table of functions and their arguments, or all about one of them."""
    if name is None:
        table = Table("name", "description", "arguments and defaults, in SI units", title=f"{what}s")
        for known, factory in factories.items():
            table.add_row(known, _first_sentence(factory), _defaults(factory))
        Console().print(table)
        return
    from jaxmps.validation import one_of

    factory = factories[one_of(what, name, factories)]
    print(inspect.getdoc(factory))
    signature = inspect.signature(factory)
    print_table("arguments", {k: p.default for k, p in signature.parameters.items()})


def print_table(title: str, rows: Mapping[str, Any]) -> None:
    table = Table(title=title, show_header=False, title_justify="left")
    table.add_column(style="bold")
    table.add_column(overflow="fold")
    for name, value in rows.items():
        table.add_row(name, _text(value))
    Console().print(table, markup=False)


def _defaults(factory: Callable[..., Any]) -> str:
    parameters = inspect.signature(factory).parameters.values()
    return ", ".join(f"{p.name}={_text(p.default)}" for p in parameters)


def _first_sentence(factory: Callable[..., Any]) -> str:
    text = " ".join((inspect.getdoc(factory) or "").split())
    return re.split(r"(?<=\.) ", text, maxsplit=1)[0]


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _with_unit(name: str, value: Any) -> str:
    unit = _SHOWN.get(name, "") if isinstance(value, float) else ""
    return f"{_text(value)} {unit}".rstrip()


def _plain(value: Any) -> Any:
    """Strict JSON has no infinity."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
