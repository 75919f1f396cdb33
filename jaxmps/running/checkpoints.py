"""What a run goes on from, kept in a file while it runs, and taken up again.

A checkpoint has the loop's whole carry: state with its neighbor list, the clock of the frame under way, the log. It is
taken between two chunks of steps, wherever these happen to end: chunks leave no trace in the results, and so neither
does a checkpoint. Of case and scheme it has fingerprints only; whoever resumes makes them again.
"""

import math
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxmps.description import differences, fingerprint, versions
from jaxmps.flow import Case
from jaxmps.io import checkpoint_of, read_checkpoint, sync, write_checkpoint
from jaxmps.neighbors import allocate
from jaxmps.running.log import empty_log
from jaxmps.running.loop import Clock, Loop, Snapshot
from jaxmps.running.recorder import Recorder
from jaxmps.scheme import Scheme
from jaxmps.stepping import State


class Checkpoints:
    """Keeps a checkpoint of a run beside its file, a new one every so many seconds of simulated time.

    `settings` are until, save_every and dt of `simulate`, for whoever resumes.
    """

    def __init__(
        self,
        out: Path,
        loop: Loop,
        recorder: Recorder,
        case: Case,
        settings: dict[str, Any],
        every: float,
        due: float = -math.inf,
    ):
        self._out, self._path, self._loop, self._recorder = out, checkpoint_of(out), loop, recorder
        self._every, self._due = every, due
        self._header = {
            **fingerprints(case, loop.scheme),
            "versions": versions(),
            "run": {**settings, "checkpoint_every": every, "key_type": str(jax.random.key_impl(loop.key))},
        }

    def look(self, frame: int) -> None:
        """Writes a checkpoint if one is due; `frame` is the number of the frame that the loop is on its way to."""
        time = float(self._loop.state.time)
        if time < self._due:
            return
        kept, here = self._recorder.keep(), self._loop.snapshot
        list_now = here.state.neighbors
        shape = {"capacity": list_now.capacity, "cutoff": list_now.cutoff, "skin": list_now.skin}
        header = {**self._header, "frame": frame, "seconds": kept["seconds"], "list": shape}
        image = {f"image.{name}": array for name, array in kept["image"].items()}
        write_checkpoint(self._path, header, {**_named(here.carry), **image})
        self._due = next_multiple(self._every, time)

    def discard(self) -> None:
        """Removes the checkpoint: the file is complete and, first of all, on disk."""
        sync(self._out)
        self._path.unlink(missing_ok=True)


class Checkpoint:
    """The checkpoint beside the file `out` of a run. Raises what `read_checkpoint` does."""

    def __init__(self, out: Path):
        self.path = checkpoint_of(out)
        header, self._arrays = read_checkpoint(self.path)
        self.run, self.frame, self.versions = header["run"], int(header["frame"]), header["versions"]
        self._prints, self._seconds, self._list = header, header["seconds"], header["list"]

    @property
    def kept(self) -> dict[str, Any]:
        """What `Recorder.keep` gave."""
        mark = "image."
        image = {name.removeprefix(mark): x for name, x in self._arrays.items() if name.startswith(mark)}
        return {"seconds": self._seconds, "image": image}

    def check(self, case: Case, scheme: Scheme) -> None:
        """`ValueError` that says in what case or scheme are not those of the checkpoint."""
        for part, now in fingerprints(case, scheme).items():
            if found := differences(self._prints[part], now):
                more = f", and {len(found) - 3} more" if len(found) > 3 else ""
                raise ValueError(f"{part} must be that of {self.path}: {'; '.join(found[:3])}{more}")

    def loop(self, case: Case, scheme: Scheme) -> Loop:
        """The loop as it stood then, on this process's device."""
        box, particles, shape = case.box, case.particles, self._list
        neighbors = allocate(particles.listed_position, box, shape["cutoff"], shape["skin"], shape["capacity"])
        scalar = jnp.zeros_like(particles.pressure[0])
        flags, step = jnp.zeros(particles.pressure.shape, bool), jnp.zeros((), jnp.int32)
        state = State(particles, neighbors, particles.pressure, flags, scalar, step, scalar)
        alike = (state, Clock(scalar, scalar, scalar, scalar), empty_log(case, particles))
        empty = _named(alike)
        carry = [jnp.asarray(_extended(self._arrays.get(name, like), like)) for name, like in empty.items()]
        state, timer, log = jax.tree.unflatten(jax.tree.structure(alike), carry)
        key = jnp.asarray(self.run["key"], jnp.uint32)
        dt = None if self.run["dt"] is None else jnp.asarray(self.run["dt"], float)
        loop = Loop(case, scheme, state, dt, jax.random.wrap_key_data(key, impl=self.run["key_type"]))
        loop.put_back(Snapshot(state, timer, log))
        return loop


def fingerprints(case: Case, scheme: Scheme) -> dict[str, dict[str, str]]:
    """Of all that decides on the results; how a case is called does not."""
    return {"case": fingerprint(case.undescribed()), "scheme": fingerprint(scheme)}


def next_multiple(every: float, time: float) -> float:
    """The first multiple of `every` [s] after `time` [s], with some room for round-off."""
    return (math.floor(time / every + 1e-6) + 1 - 1e-6) * every


def _extended(array: np.ndarray, like: np.ndarray) -> np.ndarray:
    """A part of the log with the entries that it lacks, empty: of what no step of an older version could tell."""
    return np.concatenate([array, like[len(array) :]]) if np.ndim(array) and len(array) < len(like) else array


def _named(tree: Any) -> dict[str, np.ndarray]:
    """The arrays of a tree by the way to each."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(tree)
    return {"carry" + jax.tree_util.keystr(path): np.asarray(leaf) for path, leaf in leaves}
