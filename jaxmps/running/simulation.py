"""`simulate`: the host's loop around compiled chunks of steps."""

import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from jaxmps._types import Scalar
from jaxmps.flow import FATAL, Case, SimulationWarning, Status
from jaxmps.io import checkpoint_of
from jaxmps.results import Run
from jaxmps.running.checkpoints import Checkpoints
from jaxmps.running.checks import check_start
from jaxmps.running.loop import Loop, frame_times
from jaxmps.running.progress import meter
from jaxmps.running.recorder import Recorder
from jaxmps.running.rescue import Rescue
from jaxmps.running.starting import start as _start  # `simulate` has an argument of that name
from jaxmps.scheme import Scheme
from jaxmps.stepping import State, limits
from jaxmps.validation import positive

_MOST_FRAMES = 1_000_000  # a mistyped time, not a plan


def simulate(
    case: Case,
    scheme: Scheme,
    *,
    until: float,
    save_every: float | None = None,
    dt: float | None = None,
    key: Key[Array, ""] | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    progress: bool | None = None,
    start: State | None = None,
    on_blowup: str = "stop",
    checkpoint_every: float | None = None,
) -> Run:
    """Runs a case up to the time `until` [s] and returns the frames saved at every `save_every` [s].

    Steps are as large as the scheme allows, or `dt` [s], shortened evenly to meet the times of the frames. A neighbor
    table that is too small is enlarged and the step repeated. The frame of the start has the pressure that the first
    step finds, unless case or state bring their own. With `out` the frames go to a VTKHDF file as they are
    made; an existing file is replaced only with `overwrite`. A run that fails keeps all frames and its last good
    state; `Run.status` says what happened, and `run.status.check()` raises `SimulationError`. Ctrl-C ends a run in the
    same way. `start` carries on from another state, which `mps.start` makes of a frame of a run, too. With
    `on_blowup="halve-dt"` a run that blows up goes back to its last frame and on from there with half the time step, at
    most ten times in a row; each is an event of the status. Unless `progress` is false, a bar shows how far the run is,
    or a line on stderr every ten seconds where there is neither terminal nor notebook.

    With `checkpoint_every` [s] all that the run goes on from is kept beside `out`, in a file with `.checkpoint` behind
    its name: at the start and then at the first pause of the compiled steps, some tenths of a second of wall time
    apart, at or after each multiple of that time. The steps are the same with and without. `resume` carries the run on
    after a kill or a failure of the machine; the checkpoint of a run that has reached its end is removed.

    Raises `ValueError` for times that are not positive, an unknown `on_blowup`, checkpoints with "halve-dt", a `start`
    of another case or for another radius, and what was made in another precision; `FileExistsError` for an existing
    file.
    """
    until = positive("until", until, "s")
    save_every = until if save_every is None else min(until, positive("save_every", save_every, "s"))
    if until / save_every > _MOST_FRAMES:
        raise ValueError(f"save_every must leave at most {_MOST_FRAMES} frames up to {until:g} s, got {save_every:g} s")
    fixed = None if dt is None else jnp.asarray(positive("dt", dt, "s"), float)
    key = jax.random.key(0) if key is None else key
    if start is not None:
        check_start(case, scheme, start)
    state = _start(case, scheme) if start is None else start
    begin = float(state.time)
    if begin >= until:
        raise ValueError(f"until must exceed the time of the start, {begin:g} s, got {until:g} s")
    _check_time_step(case, scheme, state, fixed)
    if checkpoint_every is not None:
        positive("checkpoint_every", checkpoint_every, "s")
        if out is None:
            raise ValueError("checkpoint_every needs out, the file beside which checkpoints are kept, got None")
        if on_blowup != "stop":  # a checkpoint does not know how often the time step was halved
            raise ValueError(f"checkpoint_every must go with on_blowup stop, got {on_blowup}")
    settings = {"begin": begin, "until": until, "save_every": save_every, "dt": dt, "on_blowup": on_blowup}
    settings["key"] = np.asarray(jax.random.key_data(key)).tolist()
    loop = Loop(case, scheme, state, fixed, key)
    rescue = Rescue(loop, on_blowup)
    recorder = Recorder(case, scheme, settings, out, overwrite)
    recorder.save(state)
    checkpoints = None
    if out is not None:
        checkpoint_of(Path(out)).unlink(missing_ok=True)  # of a run that was there before
    if checkpoint_every is not None and out is not None:
        checkpoints = Checkpoints(Path(out), loop, recorder, case, settings, checkpoint_every)
    return march(rescue, recorder, checkpoints, frame_times(begin, until, save_every), 1, progress)


def march(
    rescue: Rescue,
    recorder: Recorder,
    checkpoints: Checkpoints | None,
    times: Sequence[float],
    first: int,
    progress: bool | None,
) -> Run:
    """The rest of a run, from where its loop stands to the frame number `first` of those at `times` [s], and on."""
    loop = rescue.loop
    with meter(times[-1], progress, float(loop.state.time)) as bar:
        try:
            if first == 1:
                recorder.complete(loop.state, lambda: loop.first_pressure(times[1], bar))
            for frame in range(first, len(times)):
                look = (lambda: None) if checkpoints is None else partial(checkpoints.look, frame)
                rescue.reach(times[frame], bar, look)
                recorder.save(loop.state)
                if loop.outcome.flags & FATAL:
                    break
        except KeyboardInterrupt:
            recorder.save(loop.state)
            loop.note(Status.INTERRUPTED)
    outcome = loop.outcome
    if outcome.events:
        warnings.warn(f"{outcome}. Advice: {outcome.advice}", SimulationWarning, stacklevel=3)
    run = recorder.finish(loop.state, loop.log, outcome)
    if checkpoints is not None and outcome.completed:
        checkpoints.discard()
    return run


def _check_time_step(case: Case, scheme: Scheme, state: State, dt: Scalar | None) -> None:
    speed, gravity, _ = limits(case, scheme, state.particles)
    if dt is None and not np.isfinite(min(float(speed), float(gravity))):
        raise ValueError("dt must be given (in s) for a case at rest without gravity: the scheme sets no limit")
