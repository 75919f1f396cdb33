"""The commands of ensembles: `jaxmps ensemble` and `jaxmps gather`."""

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from jaxmps.command_line.options import Force, Settings, named, real, whole
from jaxmps.command_line.output import FAILED, fail, prepare, print_table, refuse
from jaxmps.command_line.setup import prepare_case

if TYPE_CHECKING:
    from jaxmps.casefile import Setup

_MOST_POINTS = 10_000


def ensemble(
    case: Annotated[str, typer.Argument(help="One of `jaxmps cases`, or a case file (.toml).")],
    members: Annotated[int, whole("Runs with different seeds, for each combination of swept values.")] = 16,
    sweep: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=LOW:HIGH:COUNT",
            help="Values of what --set can set, evenly spaced or NAME=A,B,C; several sweeps are combined.",
        ),
    ] = None,
    scheme: Annotated[str | None, named("NAME", "One of `jaxmps schemes`; else the file's, or mps.")] = None,
    spacing: Annotated[float | None, real("Spacing of the particles in m; else the case's.")] = None,
    until: Annotated[float | None, real("Time in s at which the runs end; else the file's, or 2.")] = None,
    save_every: Annotated[float | None, real("Time in s from frame to frame; else the file's, or 0.02.")] = None,
    dt: Annotated[float | None, real("Fixed time step in s; else adaptive.")] = None,
    seed: Annotated[int | None, whole("Seed of all members' keys and jitters; else the file's, or 0.")] = None,
    jitter: Annotated[float | None, real("Random displacement of each member's start, in spacings.")] = None,
    precision: Annotated[str | None, named("NAME", "single or double; else the file's, or double.")] = None,
    frames: Annotated[bool, typer.Option("--frames", help="Keep all particles at every frame, too.")] = False,
    batch: Annotated[int | None, whole("Members in one program on each device; else chosen.")] = None,
    memory: Annotated[float | None, real("Bound on the memory of members at a time, in bytes.")] = None,
    out: Annotated[Path | None, named("DIR", "Folder; else named after the case.")] = None,
    hosts: Annotated[
        str | None,
        named("ADDRESS:PORT", "ADDRESS:PORT of process 0, or auto under Slurm, MPI or a cloud that JAX knows."),
    ] = None,
    processes: Annotated[int | None, whole("Number of processes, with --hosts ADDRESS:PORT.")] = None,
    process: Annotated[int | None, whole("Number of this process, from 0.")] = None,
    settings: Settings = None,
    force: Force = False,
) -> int:
    """Run a case many times: a file for each member in a folder; what is there already is not run again."""
    folder = out or Path(f"{Path(case).stem if case.endswith('.toml') else case}_ensemble")
    options = {"until": until, "save_every": save_every, "dt": dt, "seed": seed, "precision": precision}
    with _hosts(hosts, processes, process) as together:
        import jax

        from jaxmps import ensembles

        setups = _setups(case, scheme, spacing, settings or [], sweep or [], members, options | {"jitter": jitter})
        made, methods, keys = _members(setups, members)
        prepare(folder)
        if jax.process_index() == 0:
            print(f"{len(methods)} members on {jax.process_count()} processes")
        result = ensembles.ensemble(
            made,
            methods,
            keys=keys,
            **setups[0].times,
            keep_frames=frames,
            batch=batch,
            memory=memory,
            out=folder,
            overwrite=force,
        )
    if together:
        print(f"{len(result)} members are in {folder}; when all processes have ended: jaxmps gather {folder}")
        return 0
    return gather(folder, force=True)


def gather(
    folder: Annotated[Path, typer.Argument(help="A folder that `jaxmps ensemble` wrote.")],
    out: Annotated[Path | None, named("FILE", "File; else ensemble.h5 in the folder.")] = None,
    force: Force = False,
) -> int:
    """Join the members in a folder into one HDF5 file, with member, seed and values as coordinates, and draw bands.

    A file that has them all already is left alone, as after `jaxmps ensemble` by one process.
    """
    from jaxmps import plotting
    from jaxmps.io import gather, gathered, write_ensemble

    path = out or folder / "ensemble.h5"
    picture = path.with_suffix(".png")
    found = gathered(path, folder) if path.is_file() and not force else None
    if found is None:
        refuse(path, force)
        refuse(picture, force)
    elif found.kept == found.members and picture.is_file():
        print(f"All {found.members} members in {folder} are in {path} already: there is nothing to gather.")
        return 0
    else:  # nothing is lost with it: what it has is in the folder, too
        print(f"{path} has {found.kept} of the {found.members} members in {folder}: file and picture are made anew.")
    result = gather(folder)
    prepare(path.parent)
    write_ensemble(path, result, overwrite=force or found is not None)
    plotting.bands(result).savefig(picture, dpi=150)
    last = {
        name: f"{result.mean(name)[-1]:.6g} ± {result.variance(name)[-1] ** 0.5:.2g}" for name in ("energy", "front")
    }
    rows = {"members": len(result), **{f"{name} at the end": text for name, text in last.items()}}
    print_table("ensemble", rows | {name: _range(column) for name, column in result.values.items()})
    print(path)
    print(picture)
    lost = [(k, outcome) for k, outcome in zip(result.member, result.status, strict=True) if not outcome.completed]
    if lost:
        return fail(f"{len(lost)} of {len(result)} members failed, member {lost[0][0]} first: {lost[0][1]}", FAILED)
    return 0


@contextmanager
def _hosts(hosts: str | None, processes: int | None, process: int | None) -> Iterator[bool]:
    """Meets the other processes, if there are any; at the end it waits for them, for none may leave before the rest."""
    if hosts is None:
        if processes is not None or process is not None:
            raise ValueError("hosts must be given with --processes and --process: ADDRESS:PORT of process 0")
        yield False
        return
    arguments: dict[str, Any] = {}
    if hosts != "auto":
        if ":" not in hosts or processes is None or process is None:
            raise ValueError(f"hosts must be auto, or ADDRESS:PORT with --processes and --process, got {hosts}")
        if not 0 <= process < processes:
            raise ValueError(f"process must be between 0 and {processes - 1}, got {process}")
        arguments = {"coordinator_address": hosts, "num_processes": processes, "process_id": process}
    import jax

    week = 7 * 86_400
    try:
        jax.distributed.initialize(**arguments, shutdown_timeout_seconds=week)
    except (RuntimeError, ValueError) as error:
        raise ValueError(f"hosts must be reachable, or known to JAX, got {hosts}: {error}") from error
    yield True
    jax.distributed.shutdown()


def _setups(
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
    return [prepare_case(case, scheme, spacing, [*settings, *point], options, jittered=False) for point in grid]


def _members(setups: "list[Setup]", count: int) -> tuple[list[Any], list[Any], Any]:
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


def _range(column: Any) -> str:
    import numpy as np

    found = np.unique(column)
    return f"{len(found)} values from {found[0]:g} to {found[-1]:g}"
