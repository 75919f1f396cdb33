"""The commands about a case: `jaxmps run`, `jaxmps resume`, `jaxmps check` and `jaxmps new`."""

from pathlib import Path
from typing import Annotated

import typer

from jaxmps.command_line.files import prepare, refuse
from jaxmps.command_line.options import Force, Settings, named, real, whole
from jaxmps.command_line.output import print_table, say
from jaxmps.command_line.runs import begin, carry_on
from jaxmps.command_line.setup import prepare_case


def run(
    case: Annotated[str, typer.Argument(help="One of `jaxmps cases`, or a case file (.toml).")],
    scheme: Annotated[str | None, named("NAME", "One of `jaxmps schemes`; else the file's, or mps.")] = None,
    spacing: Annotated[float | None, real("Spacing of the particles in m; else the case's.")] = None,
    until: Annotated[float | None, real("Time in s at which the run ends; else the file's, or 2.")] = None,
    save_every: Annotated[float | None, real("Time in s from frame to frame; else the file's, or 0.02.")] = None,
    dt: Annotated[float | None, real("Fixed time step in s; else adaptive.")] = None,
    seed: Annotated[int | None, whole("Seed of noise and jitter; else the file's, or 0.")] = None,
    jitter: Annotated[float | None, real("Random displacement at the start, in spacings; else the file's.")] = None,
    precision: Annotated[str | None, named("NAME", "single or double; else the file's, or double.")] = None,
    on_blowup: Annotated[str, named("NAME", "stop, or halve-dt: go back a frame and take half the step.")] = "stop",
    out: Annotated[Path | None, named("DIR", "Directory; else named after the case.")] = None,
    checkpoint_every: Annotated[float | None, real("Time in s between checkpoints for resume; else none.")] = None,
    settings: Settings = None,
    force: Force = False,
) -> int:
    """Run a case: writes run.vtkhdf, summary.json and final.png; failure.png if it ends early, probes.csv of a file's
    probes.
    """
    folder = Path(Path(case).stem if case.endswith(".toml") else case) if out is None else out
    words = {"case": case, "scheme": scheme, "spacing": spacing, "settings": settings or []}
    options = {"until": until, "save_every": save_every, "dt": dt, "seed": seed, "jitter": jitter}
    return begin(words | {"options": options | {"precision": precision}}, folder, checkpoint_every, on_blowup, force)


def resume(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Directory of a run with --checkpoint-every.")],
) -> int:
    """Carry on a run that was killed or interrupted, from its last checkpoint to its end."""
    return carry_on(folder)


def check(
    case: Annotated[str, typer.Argument(help="A case file (.toml), or one of `jaxmps cases`.")],
    scheme: Annotated[str | None, named("NAME", "One of `jaxmps schemes`; else the file's, or mps.")] = None,
    spacing: Annotated[float | None, real("Spacing of the particles in m; else the case's.")] = None,
    settings: Settings = None,
    out: Annotated[Path | None, named("FILE", "Picture; else named after the case.")] = None,
    force: Force = False,
) -> None:
    """Check a case before it runs: draws it, counts particles, and estimates steps, memory and time."""
    picture = out or Path(f"{Path(case).stem}.png")
    refuse(picture, force)
    setup = prepare_case(case, scheme, spacing, settings, {})
    from jaxmps import casefile

    report = casefile.check(setup)
    prepare(picture.parent)
    casefile.draw(setup).savefig(picture, dpi=150)
    print_table(f"{setup.case.name}, {setup.scheme.name}", report.content)
    print_table("expected", report.expected)
    for warning in report.warnings:
        say("warning", warning)
    typer.echo(picture)


def new(
    case: Annotated[str, typer.Argument(help="tank, or one of `jaxmps cases`.")] = "tank",
) -> None:
    """Print a case file to start from, with comments: an own geometry, or a built-in case with all its arguments."""
    from jaxmps import casefile

    typer.echo(casefile.template(case), nl=False)
