"""What a run looked like where it failed."""

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from jaxmps.flow import MESSAGES, Kind, Status
from jaxmps.plotting.flow import Scene
from jaxmps.results import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_REACH = {2: 15.0, 3: 6.0}  # of the surroundings, in spacings
_MARK = "#d1422b"


def failure(run: Run, color: str = "speed") -> "Figure":
    """The last good frame around the particle at which a run failed, which is marked.

    `color` is one of `COLORS`. Raises `ValueError` for a run that did not fail.
    """
    event = run.status.fatal
    if event is None or event.particle is None or not len(run):
        raise ValueError(f"run must have failed at a particle, got: {run.status}")
    last = {name: getattr(run, name)[-1:].copy() for name in _OF_FRAMES}
    place = last["position"][0, event.particle]
    reach = _REACH[run.position.shape[2]] * run.spacing
    far = np.any(np.abs(last["position"][0] - place) > reach, axis=1)
    last["kind"][0, far] = Kind.REMOVED
    scene = Scene(dataclasses.replace(run, **last), color, None, range(1), probes=False)
    scene.show(0)
    scene.mark(place, _MARK)
    cause = MESSAGES[Status(event.status)].split(":")[0]
    scene.title.set(text=f"{cause}: particle {event.particle}, t = {event.time:.6g} s", color=_MARK)
    return scene.figure


_OF_FRAMES = ("time", "position", "velocity", "pressure", "number_density", "surface", "kind", "energy")
