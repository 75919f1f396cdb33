"""The command `jaxmps`; commands import JAX themselves, so that help comes at once."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from jaxmps._cli_options import Color, File, Force, Settings, real, whole
from jaxmps._cli_output import (
    FAILED,
    INTERRUPTED,
    WRONG_INPUT,
    catalog,
    fail,
    open_run,
    prepare,
    print_table,
    refuse,
    tell,
)
from jaxmps._cli_runs import begin, carry_on

app = typer.Typer(add_completion=False, help="A particle solver for free-surface flow: MPS in JAX.")


def main(argv: list[str] | None = None) -> int:
    """Runs a command line, by default that of the process, and gives its exit code."""
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
        return fail(str(error), WRONG_INPUT)
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


@app.command()
def run(
    case: Annotated[str, typer.Argument(help="One of `jaxmps cases`.")],
    scheme: Annotated[str, typer.Option(help="One of `jaxmps schemes`.")] = "mps",
    spacing: Annotated[float | None, real("Spacing of the particles in m; else the case's.")] = None,
    until: Annotated[float, real("Time in s at which the run ends.")] = 2.0,
    save_every: Annotated[float, real("Time in s from frame to frame.")] = 0.02,
    dt: Annotated[float | None, real("Fixed time step in s; else adaptive.")] = None,
    seed: Annotated[int, whole("Seed of noise and jitter.")] = 0,
    jitter: Annotated[float, real("Random displacement at the start, in spacings.")] = 0.0,
    precision: Annotated[str, typer.Option(help="single or double.")] = "double",
    out: Annotated[Path | None, typer.Option(help="Directory; else named after the case.")] = None,
    checkpoint_every: Annotated[float | None, real("Time in s between checkpoints for resume; else none.")] = None,
    settings: Settings = None,
    force: Force = False,
) -> int:
    """Run a case: writes run.vtkhdf, summary.json and final.png."""
    words = {"case": case, "scheme": scheme, "spacing": spacing, "until": until, "save_every": save_every, "dt": dt}
    words |= {"seed": seed, "jitter": jitter, "precision": precision, "settings": settings or []}
    return begin(words, Path(case) if out is None else out, checkpoint_every, force)


@app.command()
def resume(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Directory of a run with --checkpoint-every.")],
) -> int:
    """Carry on a run that was killed or interrupted, from its last checkpoint to its end."""
    return carry_on(folder)


@app.command()
def cases(name: Annotated[str | None, typer.Argument(help="One case, in full.")] = None) -> None:
    """List the cases and their arguments."""
    from jaxmps._cli_values import case_factories

    catalog("case", case_factories(), name)


@app.command()
def schemes(
    name: Annotated[str | None, typer.Argument(help="One scheme, in full.")] = None,
) -> None:
    """List the schemes and their arguments."""
    from jaxmps._cli_values import scheme_factories, values_of

    known = scheme_factories()
    catalog("scheme", known, name)
    if name is not None:
        print_table("values for --set", values_of(known[name]()))


@app.command()
def show(
    file: File,
    frame: Annotated[int, whole("Which frame to draw; -1 is the last.")] = -1,
    color: Color = "pressure",
    out: Annotated[Path | None, typer.Option(help="Picture; else next to the file.")] = None,
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


@app.command()
def plot(
    what: Annotated[str, typer.Argument(help="energy or front.")],
    file: File,
    out: Annotated[Path | None, typer.Option(help="Picture; else next to the file.")] = None,
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


@app.command()
def animate(
    file: File,
    out: Annotated[Path | None, typer.Option(help="GIF or MP4; else next to the file.")] = None,
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
