"""Files and folders that commands are given: what is there, and what may be written."""

import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxmps.results import Run


def refuse(path: Path, force: bool) -> None:
    """`ValueError` if there is something at `path` that must not be replaced."""
    if path.is_dir():
        raise ValueError(f"out must be a file, got the directory {path}")
    if path.exists() and not force:
        raise ValueError(f"{path} exists already: choose another --out, or replace it with --force")


def prepare(folder: Path, stale: Iterable[Path] = ()) -> None:
    """Makes the directory and removes `stale` files; `OSError` if nothing can be written there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        # Else a run that is killed would leave them next to a file that they are not about.
        for path in stale:
            path.unlink(missing_ok=True)
    except OSError as error:
        raise OSError(f"out must lie in a directory that can be written, got {folder} ({error.strerror})") from error


def open_run(file: Path) -> tuple[Path, "Run"]:
    """The run in a file or in the directory of `jaxmps run`; `ValueError` if there is none."""
    from jaxmps.io import read

    path = file / "run.vtkhdf" if file.is_dir() else file
    try:
        result = read(path, lazy=None)
    except FileNotFoundError as error:
        raise ValueError(f"file must exist, got {path}") from error
    if not len(result):
        raise ValueError(f"file must hold frames, got {path} with none")
    return path, result


def frames_of(text: str, count: int) -> list[int]:
    """The frame of that number, or all."""
    if text == "all":
        return list(range(count))
    try:
        frame = int(text)
    except ValueError:
        raise ValueError(f"frame must be a whole number or all, got {text}") from None
    if not -count <= frame < count:
        raise ValueError(f"frame must be between {-count} and {count - 1}, got {frame}")
    return [frame % count]
