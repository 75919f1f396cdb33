"""The command `jaxmps`; commands import JAX themselves, so that help comes at once."""

import os
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from jaxmps._cli_options import Color, File, Force, Settings, real, whole
from jaxmps._cli_output import (
    FAILED,
    INTERRUPTED,
    WRONG_INPUT,
    catalog,
    conclude,
    fail,
    open_run,
    prepare,
    print_table,
    refuse,
    tell,
)

if TYPE_CHECKING:
    from jaxmps.casefile import Setup

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


@app.command()
def run(
    case: Annotated[str, typer.Argument(help="One of `jaxmps cases`, or a case file (.toml).")],
    scheme: Annotated[str | None, typer.Option(help="One of `jaxmps schemes`; else the file's, or mps.")] = None,
    spacing: Annotated[float | None, real("Spacing of the particles in m; else the case's.")] = None,
    until: Annotated[float | None, real("Time in s at which the run ends; else the file's, or 2.")] = None,
    save_every: Annotated[float | None, real("Time in s from frame to frame; else the file's, or 0.02.")] = None,
    dt: Annotated[float | None, real("Fixed time step in s; else adaptive.")] = None,
    seed: Annotated[int | None, whole("Seed of noise and jitter; else the file's, or 0.")] = None,
    jitter: Annotated[float | None, real("Random displacement at the start, in spacings; else the file's.")] = None,
    precision: Annotated[str | None, typer.Option(help="single or double; else the file's, or double.")] = None,
    out: Annotated[Path | None, typer.Option(help="Directory; else named after the case.")] = None,
    settings: Settings = None,
    force: Force = False,
) -> int:
    """Run a case: writes run.vtkhdf, summary.json and final.png, and probes.csv if its file has probes."""
    folder = Path(Path(case).stem if case.endswith(".toml") else case) if out is None else out
    paths = {name: folder / name for name in ("run.vtkhdf", "summary.json", "final.png")}
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"out must be a directory, got the file {folder}")
    for path in paths.values():
        refuse(path, force)
    options = {"until": until, "save_every": save_every, "dt": dt, "seed": seed, "jitter": jitter}
    setup = _prepare(case, scheme, spacing, settings, {**options, "precision": precision})
    if setup.probes:
        paths["probes.csv"] = folder / "probes.csv"
        refuse(paths["probes.csv"], force)
    from jaxmps import simulation, status
    from jaxmps._compilation import keep_compiled

    keep_compiled()
    prepare(folder, [path for name, path in paths.items() if name != "run.vtkhdf"])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", status.SimulationWarning)
        import jax

        key = jax.random.key(setup.run.seed)
        file = paths["run.vtkhdf"]
        result = simulation.simulate(setup.case, setup.scheme, **setup.times, key=key, out=file, overwrite=force)
    return conclude(result, paths, setup.probes)


def _prepare(
    case: str,
    scheme: str | None,
    spacing: float | None,
    settings: list[str] | None,
    options: dict[str, Any],
) -> "Setup":
    """Case, scheme and times of a command; JAX is set to the precision that was asked for."""
    # Loading a program from the cache makes XLA print pages about two processor flags that are none.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    import jax

    from jaxmps._cli_values import build, check_options
    from jaxmps.casefile import CaseFile, RunTable, Setup

    given = check_options(options)
    file = CaseFile(case) if case.endswith(".toml") else None
    table = RunTable(**given) if file is None else file.run.model_copy(update=given)
    jax.config.update("jax_enable_x64", table.precision == "double")
    if file is not None:
        return file.build(scheme, spacing, settings or [], given)
    made, method = build(case, scheme or "mps", spacing, settings or [], table.jitter, table.seed)
    return Setup(made, method, (), table)


@app.command()
def check(
    case: Annotated[str, typer.Argument(help="A case file (.toml), or one of `jaxmps cases`.")],
    scheme: Annotated[str | None, typer.Option(help="One of `jaxmps schemes`; else the file's, or mps.")] = None,
    spacing: Annotated[float | None, real("Spacing of the particles in m; else the case's.")] = None,
    settings: Settings = None,
    out: Annotated[Path | None, typer.Option(help="Picture; else named after the case.")] = None,
    force: Force = False,
) -> None:
    """Check a case before it runs: draws it, counts particles, and estimates steps, memory and time."""
    picture = out or Path(f"{Path(case).stem}.png")
    refuse(picture, force)
    setup = _prepare(case, scheme, spacing, settings, {})
    from jaxmps import casefile
    from jaxmps._cli_output import say

    report = casefile.check(setup)
    prepare(picture.parent)
    casefile.draw(setup).savefig(picture, dpi=150)
    print_table(f"{setup.case.name}, {setup.scheme.name}", report.content)
    print_table("expected", report.expected)
    for warning in report.warnings:
        say("warning", warning)
    typer.echo(picture)


@app.command()
def new(
    case: Annotated[str, typer.Argument(help="tank, or one of `jaxmps cases`.")] = "tank",
) -> None:
    """Print a case file to start from, with comments: an own geometry, or a built-in case with all its arguments."""
    from jaxmps import casefile

    typer.echo(casefile.template(case), nl=False)


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
