"""The commands of ensembles: `jaxmps ensemble` and `jaxmps gather`."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from jaxmps.command_line.files import prepare, refuse
from jaxmps.command_line.options import Force, Settings, named, real, whole
from jaxmps.command_line.output import FAILED, fail, print_table
from jaxmps.command_line.sweeps import members_of, setups_of

if TYPE_CHECKING:
    pass


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

        setups = setups_of(case, scheme, spacing, settings or [], sweep or [], members, options | {"jitter": jitter})
        made, methods, keys = members_of(setups, members)
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


def _range(column: Any) -> str:
    import numpy as np

    found = np.unique(column)
    return f"{len(found)} values from {found[0]:g} to {found[-1]:g}"
