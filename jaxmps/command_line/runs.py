"""Runs that the command line starts and carries on.

All the words of a run, in `run.json`, make its case and scheme again when it is resumed.
"""

import json
import warnings
from pathlib import Path
from typing import Any

from jaxmps.command_line.files import prepare, refuse
from jaxmps.command_line.output import conclude, say
from jaxmps.command_line.setup import prepare_case, refuse_leaving

WORDS, PROBES, FAILURE = "run.json", "probes.csv", "failure.png"
_FORMAT = 1


def begin(words: dict[str, Any], folder: Path, checkpoint_every: float | None, on_blowup: str, force: bool) -> int:
    """Runs a case, and gives the exit code; `words` are the arguments of `prepare_case`."""
    paths = _paths(folder)
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"out must be a directory, got the file {folder}")
    for path in paths.values():
        refuse(path, force)
    setup = prepare_case(**words, checkpoint_every=checkpoint_every)
    refuse_leaving(setup)
    if setup.probes:
        paths[PROBES] = folder / PROBES
        refuse(paths[PROBES], force)
    import jax

    from jaxmps import SimulationWarning, io, running
    from jaxmps.validation import one_of

    one_of("on-blowup", on_blowup, running.ON_BLOWUP)
    file, stored = paths["run.vtkhdf"], folder / WORDS
    prepare(folder, [*(path for path in paths.values() if path != file), stored, io.checkpoint_of(file)])
    if checkpoint_every is not None:
        if words["case"].endswith(".toml"):
            words = words | {"case": str(Path(words["case"]).resolve())}
        io.replace_file(stored, json.dumps({"format": _FORMAT, "options": words}, indent=2).encode() + b"\n")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SimulationWarning)
        result = running.simulate(
            setup.case,
            setup.scheme,
            **setup.times,
            key=jax.random.key(setup.run.seed),
            out=file,
            overwrite=force,
            on_blowup=on_blowup,
            checkpoint_every=checkpoint_every,
        )
    return conclude(result, paths, setup.probes, setup.case.motion)


def carry_on(folder: Path) -> int:
    """Resumes the run in a directory, and gives the exit code."""
    if not folder.is_dir():
        raise ValueError(f"dir must be a directory of `jaxmps run`, got {folder}")
    from jaxmps import io

    paths, checkpoint = _paths(folder), io.checkpoint_of(folder / "run.vtkhdf")
    if not checkpoint.exists():
        return _without_checkpoint(folder, paths)
    words = _words(folder / WORDS)
    from jaxmps import SimulationWarning, running

    try:
        setup = prepare_case(**words)
    except TypeError as error:
        raise ValueError(f"{folder / WORDS} does not have the options of a run: {error}") from error
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", SimulationWarning)
        result = running.resume(paths["run.vtkhdf"], setup.case, setup.scheme)
    for warning in told:
        if not str(warning.message).startswith(str(result.status)):  # that one comes with the end
            say("warning", str(warning.message))
    if setup.probes:
        paths[PROBES] = folder / PROBES
    return conclude(result, paths, setup.probes, setup.case.motion)


def _without_checkpoint(folder: Path, paths: dict[str, Path]) -> int:
    from jaxmps.io import read

    try:
        result = read(paths["run.vtkhdf"], lazy=None)
    except (FileNotFoundError, ValueError):
        result = None
    if result is None or not result.status.completed:
        raise ValueError(f"{folder} has no checkpoint to resume from: `jaxmps run` with --checkpoint-every makes them")
    if not all(path.exists() for name, path in paths.items() if name != FAILURE):  # killed after the last step
        return conclude(result, paths)
    print(f"The run in {folder} has reached its end, t = {result.time[-1]:g} s: there is nothing to resume.")
    return 0


def _words(path: Path) -> dict[str, Any]:
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ValueError(f"{path} is missing: a run that Python started is carried on by jaxmps.resume") from None
    except ValueError as error:
        raise ValueError(f"{path} is damaged: {error}") from error
    found = stored.get("format") if isinstance(stored, dict) else None
    if found != _FORMAT:
        raise ValueError(f"{path} must have the format {_FORMAT}, got {found}")
    return stored["options"]


def _paths(folder: Path) -> dict[str, Path]:
    return {name: folder / name for name in ("run.vtkhdf", "summary.json", "final.png", FAILURE)}
