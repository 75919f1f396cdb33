"""Carrying on a run that was killed."""

import warnings
from pathlib import Path

from jaxmps.description import differences, versions
from jaxmps.flow import Case, SimulationWarning
from jaxmps.io import checkpoint_of, read
from jaxmps.results import Run
from jaxmps.running.checkpoints import Checkpoint, Checkpoints, next_multiple
from jaxmps.running.checks import check_precision
from jaxmps.running.loop import frame_times
from jaxmps.running.recorder import Recorder
from jaxmps.running.rescue import Rescue
from jaxmps.running.simulation import march
from jaxmps.scheme import Scheme


def resume(path: str | Path, case: Case, scheme: Scheme, *, progress: bool | None = None) -> Run:
    """Carries on the run in the file `path` from its last checkpoint, to the end it was meant to have.

    Case and scheme are made again by the caller, as for `simulate`; all else is in the checkpoint. Steps and frames
    after it are taken again: the run becomes bit for bit the one that nobody stopped, on the same machine with the same
    versions of all packages, and in the same file. A run that has reached its end is only read.

    Raises `FileNotFoundError` if there is no such run; `ValueError` if it has no checkpoint, if that is damaged, of a
    newer version or of another file, or if case or scheme are others, and says which of their values.
    """
    path = Path(path)
    if not checkpoint_of(path).exists():
        run = read(path, lazy=None)
        if run.status.completed:
            return run
        raise ValueError(f"{path} has no checkpoint to resume from: checkpoint_every of simulate makes them")
    checkpoint = Checkpoint(path)
    checkpoint.check(case, scheme)
    check_precision(case=case, scheme=scheme)
    if changed := differences(checkpoint.versions, versions()):
        told = f"the run may differ in round-off from one that was not stopped: {'; '.join(changed)}"
        warnings.warn(told, SimulationWarning, stacklevel=2)
    run = checkpoint.run
    settings = {name: run[name] for name in ("begin", "until", "save_every", "dt", "key")}
    loop = checkpoint.loop(case, scheme)
    recorder = Recorder(case, scheme, settings, path, overwrite=False, kept=checkpoint.kept)
    due = next_multiple(run["checkpoint_every"], float(loop.state.time))
    checkpoints = Checkpoints(path, loop, recorder, case, settings, run["checkpoint_every"], due)
    times = frame_times(run["begin"], run["until"], run["save_every"])
    return march(Rescue(loop, "stop"), recorder, checkpoints, times, checkpoint.frame, progress)
