"""Runs that the command line starts and carries on.

All the words of a run, in `run.json`, make its case and scheme again when it is resumed.
"""

import json
import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxmps._cli_output import conclude, prepare, refuse, say

if TYPE_CHECKING:
    from jaxmps.case import Case
    from jaxmps.scheme import Scheme

WORDS = "run.json"
_FORMAT = 1


def begin(words: dict[str, Any], folder: Path, checkpoint_every: float | None, force: bool) -> int:
    """Runs a case, and gives the exit code; `words` are the arguments of `_made` and times [s]."""
    paths = _paths(folder)
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"out must be a directory, got the file {folder}")
    for path in paths.values():
        refuse(path, force)
    if words["precision"] not in ("single", "double"):
        raise ValueError(f"precision must be single or double, got {words['precision']}")
    _quiet()
    _set_up(words)
    from jaxmps import io, simulation, status
    from jaxmps._cli_values import check_times

    times = check_times(words["until"], words["save_every"], words["dt"], checkpoint_every)
    case, scheme = _made(**words)
    file, stored = paths["run.vtkhdf"], folder / WORDS
    prepare(folder, [paths["summary.json"], paths["final.png"], stored, io.checkpoint_of(file)])
    if checkpoint_every is not None:
        io.replace_file(stored, json.dumps({"format": _FORMAT, "options": words}, indent=2).encode() + b"\n")
    import jax

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", status.SimulationWarning)
        key = jax.random.key(words["seed"])
        result = simulation.simulate(case, scheme, **times, key=key, out=file, overwrite=force)
    return conclude(result, paths)


def carry_on(folder: Path) -> int:
    """Resumes the run in a directory, and gives the exit code."""
    if not folder.is_dir():
        raise ValueError(f"dir must be a directory of `jaxmps run`, got {folder}")
    _quiet()
    from jaxmps import io

    paths, checkpoint = _paths(folder), io.checkpoint_of(folder / "run.vtkhdf")
    if not checkpoint.exists():
        return _without_checkpoint(folder, paths)
    words = _words(folder / WORDS)
    _set_up(words)
    from jaxmps import restart, status

    try:
        case, scheme = _made(**words)
    except TypeError as error:
        raise ValueError(f"{folder / WORDS} does not have the options of a run: {error}") from error
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", status.SimulationWarning)
        result = restart.resume(paths["run.vtkhdf"], case, scheme)
    for warning in told:
        if str(warning.message) != str(result.status):  # that one comes with the end
            say("warning", str(warning.message))
    return conclude(result, paths)


def _without_checkpoint(folder: Path, paths: dict[str, Path]) -> int:
    from jaxmps.io import read

    try:
        result = read(paths["run.vtkhdf"])
    except (FileNotFoundError, ValueError):
        result = None
    if result is None or not result.status.completed:
        raise ValueError(f"{folder} has no checkpoint to resume from: `jaxmps run` with --checkpoint-every makes them")
    if not all(path.exists() for path in paths.values()):  # killed after the last step
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
    return {name: folder / name for name in ("run.vtkhdf", "summary.json", "final.png")}


def _quiet() -> None:
    # Loading a program from the cache makes XLA print pages about two processor flags that are none, unless it has been
    # told before JAX is imported.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")


def _set_up(words: dict[str, Any]) -> None:
    import jax

    jax.config.update("jax_enable_x64", words["precision"] == "double")
    from jaxmps._compilation import keep_compiled

    keep_compiled()


def _made(
    case: str,
    scheme: str,
    spacing: float | None,
    settings: list[str],
    jitter: float,
    seed: int,
    **_: Any,
) -> "tuple[Case, Scheme]":
    from jaxmps._cli_values import build

    return build(case, scheme, spacing, settings, jitter, seed)
