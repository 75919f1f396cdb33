"""`ensemble`: many runs that differ in keys and values, on all cores or devices of this process."""

import functools
import hashlib
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from jaxmps.description import describe, versions
from jaxmps.diagnostics import observation
from jaxmps.ensembles.batch import Batch
from jaxmps.ensembles.batch_size import sizes
from jaxmps.ensembles.lanes import Look
from jaxmps.ensembles.members import Member, members
from jaxmps.flow import Case
from jaxmps.io.member_files import MemberFiles
from jaxmps.results import Ensemble
from jaxmps.running import Log, check_precision, counter, fields, frame_times
from jaxmps.scheme import Scheme
from jaxmps.stepping import State
from jaxmps.validation import positive, whole


def ensemble(
    case: Case | Sequence[Case],
    scheme: Scheme | Sequence[Scheme],
    *,
    keys: Key[Array, " members"] | int,
    until: float,
    save_every: float | None = None,
    dt: float | None = None,
    observe: Callable[[Case, State], dict[str, Array]] = observation,
    keep_frames: bool = True,
    batch: int | None = None,
    memory: float | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    progress: bool | None = None,
) -> Ensemble:
    """Runs a case once for each of `keys`, up to the time `until` [s], with frames at every `save_every` [s].

    `keys` is an array of keys, or the number of members, whose keys are then `fold_in(key(0), k)`. `case` and `scheme`
    may be one for each member; they may differ in every array, not in what fixes the program. A member makes the steps
    that `simulate` makes with its case, scheme and key: bit for bit where it runs by itself, else within round-off.

    Of each member are kept: what `observe` makes of a state (see `observation`), the number of `steps` and the energies
    [J/kg] that noise and stabilizer have given so far, `noise_work` and `stabilizer_work`, and the particles unless
    `keep_frames` is false. A member that fails stays as it was, with the cause in its status, and disturbs no other.

    `batch` members at a time run as one program on each of the local devices. On processors it is one by default, and
    as many run at a time as there are cores, each by itself: it waits for no other, neither in the pressure solve nor
    in the time step. Elsewhere it is what fits into `memory` [bytes], by default most of what is free; a bound on
    memory bounds the members at a time on processors, too.

    With `out`, a folder, each member is written there as soon as it has ended, in one go, and members that are there
    already are not run again: the same call carries on after any interruption, and more keys make a larger ensemble.
    Under `jax.distributed` each process runs the members whose number modulo the number of processes is its own, and
    returns these; `gather` reads all from the folder. With `overwrite` the members there are removed first. Raises
    `ValueError` for members of several kinds, for what was made in another precision than JAX is set to now, and for a
    folder of another ensemble.
    """
    until = positive("until", until, "s")
    save_every = until if save_every is None else min(until, positive("save_every", save_every, "s"))
    fixed = None if dt is None else jnp.asarray(positive("dt", dt, "s"), float)
    every = members(case, scheme, _keys(keys))
    for member in every[:1] if isinstance(case, Case) and isinstance(scheme, Scheme) else every:
        check_precision(case=member.case, scheme=member.scheme)
    metadata = _metadata(every[0], {"until": until, "save_every": save_every, "dt": dt})
    kept = None if out is None else MemberFiles(out, _fingerprint(every, metadata, keep_frames), overwrite)
    mine = every[jax.process_index() :: jax.process_count()]
    waiting = mine if kept is None else [member for member in mine if member.number not in kept]
    if kept is not None and not mine:
        raise ValueError(f"keys must give every process a member, got {len(every)} for {jax.process_count()} processes")
    times, look = frame_times(0.0, until, save_every), _look_of(observe, keep_frames)

    def make(some: Sequence[Member], devices: Sequence[Any]) -> Batch:
        return Batch(some, devices, times, fixed, look, metadata)

    done = []
    with counter(len(mine), progress, "members") as count:
        count(len(mine) - len(waiting))
        for part in _run(waiting, make, batch, memory):
            count(len(part))
            if kept is None:
                done.append(part)
            else:
                kept.write(part)
    return Ensemble.join(done if kept is None else [kept.read(member.number) for member in mine])


def _run(
    waiting: Sequence[Member], make: Callable[..., Batch], most: int | None, memory: float | None
) -> Iterator[Any]:
    """The ensembles of batches, as they end."""
    if not waiting:
        return
    devices = jax.local_devices()
    size, workers = sizes(waiting[0], len(waiting), devices, most, memory)
    batches = [waiting[k : k + size] for k in range(0, len(waiting), size)]
    # The first steps compile what all others use: they are taken before the others begin.
    first = make(batches[0], devices)
    first.next_frame()
    stop = threading.Event()
    with ThreadPoolExecutor(workers) as pool:
        jobs = [pool.submit(first.finish, stop)]
        jobs += [pool.submit(lambda one: make(one, devices).finish(stop), one) for one in batches[1:]]
        try:
            while jobs:
                done, _ = wait(jobs, return_when=FIRST_COMPLETED)
                jobs = [job for job in jobs if job not in done]
                yield from (job.result() for job in done)
        finally:
            stop.set()
            pool.shutdown(cancel_futures=True)


@functools.cache
def _look_of(observe: Callable[[Case, State], dict[str, Array]], keep_frames: bool) -> Look:
    """One function for each: it is part of what is compiled."""

    def look(case: Case, state: State, log: Log) -> dict[str, Any]:
        work = {"noise_work": log.given, "stabilizer_work": log.work, "wall_work": log.wall_work}
        counted = {"steps": log.steps, **work}
        return {"series": observe(case, state) | counted, "frames": fields(state) if keep_frames else {}}

    return look


def _keys(keys: Any) -> Key[Array, " members"]:
    if isinstance(keys, int):
        numbers = jnp.arange(whole("keys", keys, least=1))
        return jax.vmap(lambda k: jax.random.fold_in(jax.random.key(0), k))(numbers)
    if not (isinstance(keys, jax.Array) and jnp.issubdtype(keys.dtype, jax.dtypes.prng_key) and keys.ndim == 1):
        raise ValueError(f"keys must be a whole number of 1 or more, or an array of keys, got {keys!r}")
    return keys


def _metadata(first: Member, run: dict[str, Any]) -> dict[str, Any]:
    case, scheme = first.case, first.scheme
    return {
        "case": {"name": case.name, **dict(case.parameters)},
        "scheme": {"name": scheme.name, **describe(scheme)},
        "run": {**run, "precision": str(case.particles.position.dtype)},
        "box": case.box.described(),
        "versions": versions(),
    }


def _fingerprint(every: Sequence[Member], metadata: dict[str, Any], keep_frames: bool) -> dict[str, Any]:
    """What makes an ensemble this one, as values for JSON; of each member a digest of all its numbers."""
    about = {name: metadata[name] for name in ("case", "scheme", "run")}
    for name in {name for member in every for name in member.values}:
        about["scheme"] = {key: value for key, value in about["scheme"].items() if key != name}
    return {**about, "frames": keep_frames, "members": [_digest(member) for member in every]}


def _digest(member: Member) -> str:
    digest = hashlib.sha256()
    for leaf in jax.tree.leaves((member.case, member.scheme, jax.random.key_data(member.key))):
        digest.update(np.asarray(leaf).tobytes())
    return digest.hexdigest()[:16]
