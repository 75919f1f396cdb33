"""What the host does between two chunks of compiled steps, for a single run and for runs side by side: how many steps
come next, which runs have failed, and whose neighbor tables have to grow.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy.spatial import KDTree

from jaxmps.flow import FATAL, Case, Event, Outcome, Status
from jaxmps.kernels import lattice
from jaxmps.models import NoCollision, NoStabilization
from jaxmps.neighbors import Neighbors, grow
from jaxmps.scheme import Scheme
from jaxmps.stepping import State

_FIRST = 16  # steps of the first chunk
_FEWEST = 4  # steps in a call: its temporaries, a gigabyte for 500 000 particles, are fresh memory in each call
_MOST = 4096
_CROWDED = 40  # times the neighbors on a lattice: particles have collapsed into clusters then


class Upkeep:
    """Upkeep of `count` runs that differ in values alone. `steps`: of the next chunk; `going`: which runs have not
    failed; `notes`: of each run the events that the compiled steps do not log.
    """

    def __init__(self, case: Case, scheme: Scheme, count: int = 1):
        self.steps, self.going = _FIRST, np.ones(count, bool)
        self.notes: list[tuple[Event, ...]] = [()] * count
        self._case = case
        has = {
            "stabilizer": not isinstance(scheme.stabilizer, NoStabilization),
            "collisions": not isinstance(scheme.collision, NoCollision),
            "double": case.particles.position.dtype == np.float64,
        }
        self._has = tuple(part for part, there in has.items() if there)
        self._most_slots = min(_CROWDED * lattice(scheme.ratio, case.dim).neighbors, len(case.particles.kind))

    def after(self, status: np.ndarray, state_of: Callable[[int], State]) -> list[Neighbors] | None:
        """Ends the runs whose `status`, of each the last step's, is fatal. If the table of one is full, larger lists
        for all; a table beyond any that a flow needs ends its run instead. `state_of` gives the state of a run.
        """
        self._end(self.going & _has(status, Status.TIME_STEP_COLLAPSED), Status.TIME_STEP_COLLAPSED, state_of)
        self.going &= ~_has(status, FATAL)
        full = self.going & _has(status, Status.TABLE_FULL)
        if not full.any():
            return None
        states = [state_of(run) for run in range(len(full))]
        grown = [grow(state.neighbors, state.particles.listed_position) for state in states]
        if grown[0].capacity <= self._most_slots:
            return grown
        self._end(full, Status.CLUSTERED, state_of)
        return None

    def outcome(self, run: int, logged: tuple[Event, ...]) -> Outcome:
        """How a run has gone so far, from what its steps have `logged`; advice leaves out what its scheme has."""
        return Outcome(tuple(dataclasses.replace(event, has=self._has) for event in logged + self.notes[run]))

    def note(self, run: int, event: Event) -> None:
        self.notes[run] = (*self.notes[run], event)

    def pace(self, seconds: float, wanted: float) -> None:
        """Chooses the next chunk, which is to take the time `wanted` [s], after one that took `seconds`."""
        self.steps = int(np.clip(self.steps * wanted / seconds, _FEWEST, min(2 * self.steps, _MOST)))

    def _end(self, runs: np.ndarray, bit: Status, state_of: Callable[[int], State]) -> None:
        for run in np.flatnonzero(runs).tolist():
            self.note(run, happened(self._case, state_of(run), bit))
        self.going &= ~runs


def happened(case: Case, state: State, bit: Status) -> Event:
    """The event that a run ended with at this state: of a collapsed time step with the fastest particle, of clusters
    with one of the closest.
    """
    event = Event(int(bit), float(state.time), int(state.step))
    if bit not in (Status.TIME_STEP_COLLAPSED, Status.CLUSTERED):
        return event
    fluid = np.flatnonzero(state.particles.fluid)
    position = np.asarray(state.particles.position)[fluid]
    if bit == Status.TIME_STEP_COLLAPSED:
        speed = np.linalg.norm(np.asarray(state.particles.velocity)[fluid], axis=1)
        found, value = int(np.argmax(speed)), float(speed.max())
    else:
        places, periods = case.box.torus(position)
        distance = KDTree(places, boxsize=periods).query(places, k=2)[0][:, 1]
        found, value = int(np.argmin(distance)), float(distance.min()) / case.spacing
    return dataclasses.replace(event, particle=int(fluid[found]), position=tuple(position[found].tolist()), value=value)


def _has(status: np.ndarray, bits: Status) -> np.ndarray:
    return (status & int(bits)) != 0
