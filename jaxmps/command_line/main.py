"""The command `jaxmps`; commands import JAX themselves, so that help comes at once."""

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from jaxmps.command_line.ensemble import ensemble, gather
from jaxmps.command_line.files import frames_of, open_run, prepare, refuse
from jaxmps.command_line.options import USUAL_TYPES, Color, Command, File, Force, Group, Types, named, real, whole
from jaxmps.command_line.output import FAILED, INTERRUPTED, WRONG_INPUT, catalog, fail, print_table, tell
from jaxmps.command_line.run import check, new, resume, run

app = typer.Typer(cls=Group, add_completion=False, help="A particle solver for free-surface flow: MPS in JAX.")


def main(argv: list[str] | None = None) -> int:
    """Runs a command line, by default that of the process, and gives its exit code."""
    # Loading a program from the cache makes XLA print pages about two processor flags that are none, unless it has been
    # told before JAX is imported.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    command = typer.main.get_command(app)
    arguments = list(sys.argv[1:] if argv is None else argv) or ["--help"]
    try:
        with command.make_context("jaxmps", arguments) as context:
            return command.invoke(context) or 0
    except typer.Exit as leave:
        return leave.exit_code
    except (KeyboardInterrupt, typer.Abort):
        return fail("interrupted", INTERRUPTED)
    except ValueError as error:
        return max(fail(fault, WRONG_INPUT) for fault in getattr(error, "faults", (str(error),)))
    except OSError as error:
        return fail(str(error), FAILED)
    except Exception as error:
        if hasattr(error, "format_message"):  # typer has brought its own click since 0.26
            return fail(error.format_message(), WRONG_INPUT)  # type: ignore[attr-defined]
        return fail(f"unexpected {type(error).__name__}: {error}", FAILED)


def _print_version(wanted: bool) -> bool:
    if wanted:
        from jaxmps import __version__

        typer.echo(f"jaxmps {__version__}")
        raise typer.Exit
    return wanted


@app.callback()
def _top(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True),
    ] = False,
) -> None:
    pass


app.command(cls=Command)(run)
app.command(cls=Command)(resume)
app.command(cls=Command)(check)
app.command(cls=Command)(new)
app.command(cls=Command)(ensemble)
app.command(cls=Command)(gather)


@app.command(cls=Command)
def cases(name: Annotated[str | None, typer.Argument(help="One case, in full.")] = None) -> None:
    """List the cases and their arguments."""
    from jaxmps.casefile.arguments import case_factories

    catalog("case", case_factories(), name)


@app.command(cls=Command)
def schemes(
    name: Annotated[str | None, typer.Argument(help="One scheme, in full.")] = None,
) -> None:
    """List the schemes and their arguments."""
    from jaxmps.casefile.arguments import scheme_factories, values_of

    known = scheme_factories()
    catalog("scheme", known, name)
    if name is not None:
        print_table("values for --set", values_of(known[name]()))


@app.command(cls=Command)
def show(
    file: File,
    frame: Annotated[int, whole("Which frame to draw; -1 is the last.")] = -1,
    color: Color = "pressure",
    out: Annotated[Path | None, named("FILE", "Picture; else next to the file.")] = None,
    force: Force = False,
) -> None:
    """Tell what is in a file, and draw a frame of it."""
    from jaxmps import plotting

    path, result = open_run(file)
    if not -len(result) <= frame < len(result):
        raise ValueError(f"frame must be between {-len(result)} and {len(result) - 1}, got {frame}")
    picture = out or path.with_name(f"{path.stem}_{color}_{frame % len(result):04d}.png")
    refuse(picture, force)
    prepare(picture.parent)
    drawn = plotting.frame(result, frame, color)
    tell(result)
    drawn.savefig(picture, dpi=150)
    typer.echo(picture)


@app.command(cls=Command)
def plot(
    what: Annotated[str, typer.Argument(help="energy or front.")],
    file: File,
    out: Annotated[Path | None, named("FILE", "Picture; else next to the file.")] = None,
    force: Force = False,
) -> None:
    """Plot energies, or the surge front of a dam break, against time."""
    if what not in ("energy", "front"):
        raise ValueError(f"what must be one of energy, front, got {what}")
    from jaxmps import plotting

    path, result = open_run(file)
    picture = out or path.with_name(f"{path.stem}_{what}.png")
    refuse(picture, force)
    prepare(picture.parent)
    drawn = plotting.energy(result) if what == "energy" else plotting.front(result)
    drawn.savefig(picture, dpi=150)
    typer.echo(picture)


@app.command(cls=Command)
def animate(
    file: File,
    out: Annotated[Path | None, named("FILE", "GIF or MP4; else next to the file.")] = None,
    color: Color = "pressure",
    fps: Annotated[float, real("Frames per second.")] = 25.0,
    force: Force = False,
) -> None:
    """Animate a run, as GIF or, where ffmpeg is installed, MP4."""
    from jaxmps import plotting

    path, result = open_run(file)
    picture = out or path.with_suffix(".gif")
    refuse(picture, force)
    prepare(picture.parent)
    plotting.animate(result, picture, color, fps=fps)
    typer.echo(picture)


@app.command(cls=Command)
def export(
    file: File,
    to: Annotated[str, named("FORMAT", "csv, prof, vtu or vtp.")],
    frame: Annotated[str, named("NUMBER|all", "Which frame; -1 is the last; or all, each to its file.")] = "-1",
    out: Annotated[Path | None, named("FILE", "File; else next to the run's. For all: numbers are added.")] = None,
    types: Types = USUAL_TYPES,
    force: Force = False,
) -> None:
    """Write particles for other programs."""
    from jaxmps import io
    from jaxmps.casefile.options import types_of
    from jaxmps.validation import one_of

    path, result = open_run(file)
    one_of("to", to, io.FORMATS)
    if out is not None and out.suffix != f".{to}":
        raise ValueError(f"out must end in .{to}, got {out}")
    frames, meaning = frames_of(frame, len(result)), types_of(types)
    numbered = frame == "all" or out is None
    base = out or path.with_suffix(f".{to}")
    files = {k: base.with_name(f"{base.stem}_{k:04d}.{to}") if numbered else base for k in frames}
    for made in files.values():
        refuse(made, force)
    prepare(base.parent)
    for k, made in files.items():
        typer.echo(io.export(result, made, k, types=meaning, overwrite=force))
