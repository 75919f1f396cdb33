"""The members in a folder, joined to one ensemble, and whether a file has them already."""

from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

from jaxmps.io.member_files import load, read_ensemble
from jaxmps.results import Ensemble


class Gathered(NamedTuple):
    """How many of the `members` in a folder a file has."""

    kept: int
    members: int


def gather(folder: str | Path) -> Ensemble:
    """All members in a folder that `ensemble` has written, by whatever processes. Raises `ValueError` if there are none
    or if some are missing, with their numbers: the same command as before computes these.
    """
    return Ensemble.join([read_ensemble(path) for path in _members(Path(folder))])


def gathered(path: str | Path, folder: str | Path) -> Gathered | None:
    """How many of the members in a folder the file at `path` has, by number, seed and values, of those that were not
    written again since then. None if it has anything else, which would be lost with it.

    Raises `ValueError` as `gather` does.
    """
    members, path = _members(Path(folder)), Path(path)
    written = path.stat().st_mtime_ns
    labels: dict[int, Any] = {}
    try:
        about, kept = _labels(path)
        if about != _labels(members[0])[0]:
            return None
        for member in members:
            _, label = _labels(member)
            labels |= {number: (seen, member.stat().st_mtime_ns) for number, seen in label.items()}
    except (OSError, KeyError):
        return None
    if any(number not in labels or labels[number][0] != label for number, label in kept.items()):
        return None
    return Gathered(sum(number in kept and time <= written for number, (_, time) in labels.items()), len(members))


def _members(folder: Path) -> list[Path]:
    paths = sorted(folder.glob("member-*.h5"))
    head = folder / "ensemble.json"
    if not (head.exists() and paths):
        raise ValueError(f"folder must be one that an ensemble was written to, got {folder} without members")
    expected = set(range(len(load(head)["members"])))
    missing = sorted(expected - {int(path.stem.split("-")[1]) for path in paths})
    if missing:
        raise ValueError(
            f"folder must hold all {len(expected)} members, got {folder} without {len(missing)} of them, the first "
            f"{missing[0]}: run the same command again"
        )
    return paths


def _labels(path: Path) -> tuple[Any, dict[int, Any]]:
    """What a file is about, and by their numbers what its members are."""
    with h5py.File(path, "r") as file:
        root: Any = file  # type checkers do not know what is in a file
        about = (root.attrs["metadata"], root["time"][()].tobytes(), sorted(root["frames"]))
        columns = [root["seed"][()], *(root["values"][name][()] for name in sorted(root["values"]))]
        return about, {
            int(number): tuple(np.asarray(column[k]).tobytes() for column in columns)
            for k, number in enumerate(root["member"][()])
        }
