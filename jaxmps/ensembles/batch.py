"""A batch of an ensemble's members, run frame by frame."""

import threading
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from jaxmps._types import Scalar
from jaxmps.ensembles.lanes import Alone, Lanes, Look
from jaxmps.ensembles.members import Member
from jaxmps.results import Ensemble


class Batch:
    """Members that run together, and what is seen of them at each frame."""

    def __init__(
        self,
        members: Sequence[Member],
        devices: Sequence[Any],
        times: Sequence[float],
        dt: Scalar | None,
        look: Look,
        metadata: dict[str, Any],
    ):
        alone = len(members) == 1 and len(devices) == 1
        self._lanes = Alone(members[0], dt, look) if alone else Lanes(members, dt, look, devices)
        self._members, self._times, self._metadata = members, times, metadata
        self._seen, self._alive = [self._lanes.look(times[1])], [self._lanes.alive.copy()]

    def next_frame(self) -> None:
        """Runs up to the next frame. Members that have all failed cost nothing."""
        if self._alive[-1].any():
            self._lanes.reach(self._times[len(self._seen)])
        self._seen.append(self._lanes.look())
        self._alive.append(self._lanes.alive.copy())

    def finish(self, stop: threading.Event) -> Ensemble:
        """Runs to the end; `KeyboardInterrupt` if told to stop."""
        while len(self._seen) < len(self._times):
            if stop.is_set():
                raise KeyboardInterrupt
            self.next_frame()
        columns = jax.tree.map(lambda *frames: np.stack(frames, axis=1), *self._seen)
        members, case = self._members, self._members[0].case
        return Ensemble(
            time=np.array(self._times),
            member=np.array([member.number for member in members]),
            seed=np.stack([np.asarray(jax.random.key_data(member.key)) for member in members]),
            values={name: np.stack([member.values[name] for member in members]) for name in members[0].values},
            series=columns["series"],
            valid=np.stack(self._alive, axis=1),
            status=tuple(self._lanes.outcomes),
            frames=columns["frames"],
            phase=np.asarray(case.particles.phase),
            fluid_density=np.stack([np.asarray(member.case.fluids.density) for member in members]),
            spacing=case.spacing,
            metadata=self._metadata,
        )
