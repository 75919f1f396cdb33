"""A folder with a file for each member of an ensemble, and the HDF5 file of an ensemble."""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from jaxmps.flow import Outcome
from jaxmps.io.checkpoint import sync
from jaxmps.results import Ensemble

FORMAT = 1
_GROUPS = ("values", "series", "frames")
_ARRAYS = ("time", "member", "seed", "valid", "phase", "fluid_density")
_UNITS = {"time": "s", "kinetic": "J/kg", "potential": "J/kg", "front": "m", "top": "m", "height": "m"}
_UNITS |= {"position": "m", "velocity": "m/s", "pressure": "Pa", "fluid_density": "kg/m^3"}


class MemberFiles:
    """The folder of an ensemble. A file is there as a whole or not at all: a kill at any instant loses no member that
    had ended.

    `about` tells which ensemble it is. Raises `ValueError` for a folder of another one, unless `overwrite` is set,
    which removes its members; `OSError` if nothing can be written.
    """

    def __init__(self, folder: str | Path, about: dict[str, Any], overwrite: bool):
        self.folder = Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        head, about = self.folder / "ensemble.json", {"format": FORMAT, **about}
        if overwrite:
            for path in self.folder.glob("member-*.h5"):
                path.unlink(missing_ok=True)
        elif head.exists():
            old, new = load(head), json.loads(_dump(about))
            known, mine = old.get("members") or [], new["members"]
            alike = all(a == b for a, b in zip(known, mine, strict=False))  # more members make it larger
            if not alike or {**old, "members": 0} != {**new, "members": 0}:
                raise ValueError(
                    f"out must be a new folder or one of the same ensemble; {self.folder} has another: "
                    f"{_difference(old, new)}"
                )
            about["members"] = max(known, mine, key=len)
        _replace(head, _dump(about).encode())

    def __contains__(self, number: int) -> bool:
        return self._path(number).exists()

    def write(self, part: Ensemble) -> None:
        """Keeps the members of `part`."""
        for k, number in enumerate(part.member):
            write_ensemble(self._path(int(number)), part[k : k + 1], overwrite=True)

    def read(self, number: int) -> Ensemble:
        """A member."""
        return read_ensemble(self._path(number))

    def _path(self, number: int) -> Path:
        return self.folder / f"member-{number:06d}.h5"


def write_ensemble(path: str | Path, ensemble: Ensemble, overwrite: bool = False) -> None:
    """An HDF5 file with member and time as dimensions, seeds and values as coordinates. Whole or not there.

    Raises `FileExistsError` for a file that exists, unless `overwrite` is set.
    """
    path = Path(path)
    if path.exists() and not overwrite:
        raise FileExistsError(f"{path} exists already: choose another path, or allow it to be overwritten")
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with h5py.File(part, "w") as opened:
            file: Any = opened
            file.attrs["jaxmps"], file.attrs["format"] = "ensemble", FORMAT
            file.attrs["spacing"] = ensemble.spacing
            file.attrs["metadata"] = json.dumps(ensemble.metadata, default=str)
            file.attrs["status"] = json.dumps([outcome.to_dict() for outcome in ensemble.status])
            for name in _ARRAYS:
                _put(file, name, getattr(ensemble, name))
            for name in ("time", "member"):
                file[name].make_scale(name)
            for group in _GROUPS:
                made = file.create_group(group)
                for name, values in getattr(ensemble, group).items():
                    dataset = _put(made, name, values)
                    dataset.dims[0].attach_scale(file["member"])
                    if group != "values":
                        dataset.dims[1].attach_scale(file["time"])
        sync(part)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def read_ensemble(path: str | Path) -> Ensemble:
    """The ensemble in a file. Raises `FileNotFoundError` if there is none, `ValueError` if it is none or damaged."""
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"there is no ensemble at {path}")
    if not path.is_file() or not h5py.is_hdf5(path):
        raise ValueError(f"{path} is not an ensemble of jaxmps: it is no HDF5 file, or a damaged one")
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("jaxmps") != "ensemble" or file.attrs.get("format") != FORMAT:
                raise ValueError(f"it is no ensemble of format {FORMAT}")
            root: Any = file  # type checkers do not know what is in a file
            fields: dict[str, Any] = {name: root[name][()] for name in _ARRAYS}
            fields |= {group: {name: data[()] for name, data in root[group].items()} for group in _GROUPS}
            fields["status"] = tuple(Outcome.from_dict(entry) for entry in json.loads(root.attrs["status"]))
            fields |= {"metadata": json.loads(root.attrs["metadata"]), "spacing": float(root.attrs["spacing"])}
    except (OSError, RuntimeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is not an ensemble of jaxmps, or damaged: {error}") from error
    return Ensemble(**fields)


def _put(group: Any, name: str, values: np.ndarray) -> Any:
    large = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if np.size(values) > 4096 else {}
    dataset = group.create_dataset(name, data=values, **large)
    if name in _UNITS:
        dataset.attrs["units"] = _UNITS[name]
    return dataset


def _replace(path: Path, content: bytes) -> None:
    """As `replace_file`, but processes that start together may write the same file, each under a name of its own."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    part.write_bytes(content)
    part.replace(path)


def _dump(about: dict[str, Any]) -> str:
    return json.dumps(about, indent=2, sort_keys=True, default=str)


def load(head: Path) -> dict[str, Any]:
    """What `ensemble.json` tells of the ensemble in its folder; `ValueError` if it is damaged."""
    try:
        return dict(json.loads(head.read_text(encoding="utf-8")))
    except ValueError as error:
        raise ValueError(f"{head} is damaged, or of something else: {error}") from error


def _difference(old: dict[str, Any], new: dict[str, Any]) -> str:
    before, after = dict(_entries(old)), dict(_entries(new))
    name = next(name for name in [*after, *before] if before.get(name) != after.get(name))
    return f"its {name} is {_short(before.get(name))}, not {_short(after.get(name))}"


def _entries(about: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in about.items():
        if isinstance(value, dict):
            yield from ((f"{name}.{inner}", x) for inner, x in value.items())
        else:
            yield name, value


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) < 60 else text[:57] + "..."
