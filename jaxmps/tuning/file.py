"""The file of a tuning: a line of JSON that says whose it is and how far it has come, and the arrays."""

import json
import os
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np


class Progressed(NamedTuple):
    """How far a tuning has come: free variables and the optimiser's memory, and what each step has shown."""

    free: Any
    memory: Any
    loss: list[float]
    values: list[list[np.ndarray]]
    norm: list[float]

    def then(self, free: Any, memory: Any, loss: float, values: list[np.ndarray], norm: float) -> "Progressed":
        """One step further."""
        return Progressed(free, memory, [*self.loss, loss], [*self.values, values], [*self.norm, norm])


def write(file: str | Path | None, about: dict[str, Any], progressed: Progressed) -> None:
    """Replaces the file in one go, so that it is whole at any instant."""
    if file is None:
        return
    path = Path(file)
    part = path.with_name(path.name + ".part")
    head = {"jaxmps": "tuning", "steps": len(progressed.loss), **about}
    with part.open("wb") as stream:
        stream.write((json.dumps(head) + "\n").encode())
        eqx.tree_serialise_leaves(stream, progressed)
        stream.flush()
        os.fsync(stream.fileno())
    part.replace(path)


def read(file: str | Path | None, about: dict[str, Any], begin: Progressed) -> Progressed:
    """What the file holds, or `begin` if there is none yet; `ValueError` if it is of another tuning."""
    if file is None or not Path(file).exists():
        return begin
    with Path(file).open("rb") as stream:
        try:
            head = json.loads(stream.readline())
            steps = head.pop("steps")
            mine = head.pop("jaxmps") == "tuning"
        except (ValueError, KeyError, AttributeError, UnicodeDecodeError):
            mine, steps, head = False, 0, {}
        if not mine:
            raise ValueError(f"file must be one that a tuning has written, got {file}")
        for name, value in about.items():
            if head.get(name) != value:
                raise ValueError(f"file must be of the same tuning: {file} has {name} {head.get(name)}, not {value}")
        row = [np.asarray(x) for x in begin.free]
        like = Progressed(begin.free, begin.memory, [0.0] * steps, [row] * steps, [0.0] * steps)
        try:
            return eqx.tree_deserialise_leaves(stream, like)
        except Exception as error:  # of whatever type: shapes, types and ends of files
            raise ValueError(f"file must be of the same tuning, with the same optimiser; {file}: {error}") from error
