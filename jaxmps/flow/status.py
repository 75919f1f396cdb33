"""What can go wrong in a run: status bits that are valid under jit, vmap and scan, and their telling to a person."""

import enum
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any


class Status(enum.IntFlag):
    """Bits of a step's status; zero is well. Those in `FATAL` end a run."""

    NOT_FINITE = 1
    TIME_STEP_TOO_LARGE = 2
    TABLE_FULL = 4
    NOT_CONVERGED = 8
    ESCAPED = 16
    INTERRUPTED = 32
    CLUSTERED = 64
    TIME_STEP_COLLAPSED = 128
    HALVED = 256
    WALL_OUTSIDE = 512
    SOLVE_FAILED = 1024
    RUNAWAY = 2048


FATAL = (
    Status.NOT_FINITE
    | Status.TIME_STEP_TOO_LARGE
    | Status.CLUSTERED
    | Status.TIME_STEP_COLLAPSED
    | Status.WALL_OUTSIDE
    | Status.SOLVE_FAILED
    | Status.RUNAWAY
)

MESSAGES = {
    Status.NOT_FINITE: "position, velocity or pressure is no longer finite",
    Status.TIME_STEP_TOO_LARGE: "time step too large: a particle moved by more than one spacing in a single step",
    Status.TABLE_FULL: "the neighbor table is too small",
    Status.NOT_CONVERGED: "the pressure solve missed its tolerance",
    Status.ESCAPED: "a particle left the domain and was taken out of the flow",
    Status.INTERRUPTED: "interrupted before its end",
    Status.TIME_STEP_COLLAPSED: "the time step has collapsed: a particle is so fast that the run would never end",
    Status.CLUSTERED: "particles have collapsed into clusters: the neighbor table would have to grow without bound",
    Status.HALVED: "the run blew up and went on from its last frame with half the time step",
    Status.WALL_OUTSIDE: "a moving wall has left the domain",
    Status.SOLVE_FAILED: "the pressure solve failed: a tenth of its right-hand side or more is left over",
    Status.RUNAWAY: "the flow blows up: it has more energy than it began with and was given",
}

ADVICE = {
    Status.NOT_FINITE: "look for overlapping particles and values of the scheme far from its defaults, then try a "
    "smaller time_step.courant or dt",
    Status.TIME_STEP_TOO_LARGE: "try a smaller dt or time_step.courant, or on_blowup halve-dt; at t = 0, look for "
    "particles that overlap",
    Status.TABLE_FULL: "start with a larger capacity",
    Status.NOT_CONVERGED: "try a larger max_iterations or tolerance; a domain that is full, closed and without a free "
    "surface leaves the pressure undetermined",
    Status.ESCAPED: "look at where it left: a wall needs a layer of WALL and ceil(ratio) - 1 layers of DUMMY without "
    "gaps, one spacing apart; spray over the rim needs a higher box; else try a smaller time step",
    Status.INTERRUPTED: "where it has a checkpoint, `jaxmps resume` or mps.resume carries it on; else run it again, "
    "from the start or, by mps.start(case, scheme, run=run), from the last frame",
    Status.TIME_STEP_COLLAPSED: "the flow had blown up before: try {scheme}a smaller time_step.courant; a fixed dt "
    "lets the run go on",
    Status.CLUSTERED: "try {scheme}a smaller time step; look for particles that overlap at t = 0",
    Status.HALVED: "a smaller dt or time_step.courant from the start would not lose these frames' time",
    Status.WALL_OUTSIDE: "give the case a larger box, or its walls a smaller motion",
    Status.SOLVE_FAILED: "try a larger max_iterations{precision}",
    Status.RUNAWAY: "try {scheme}a smaller time_step.courant or dt",
}
"""What to try, for each cause; `advice_on` fills in what depends on the scheme."""


def advice_on(bit: Status, has: tuple[str, ...] = ()) -> str:
    """What to try, but for what the scheme `has` already: "stabilizer", "collisions", "double" precision."""
    lacks = [part for part in ("stabilizer", "collisions") if part not in has]
    scheme = f"a scheme with {'a ' if lacks[0] == 'stabilizer' else ''}{' or '.join(lacks)}, or " if lacks else ""
    return ADVICE[bit].format(scheme=scheme, precision="" if "double" in has else ", or double precision")


class SimulationError(RuntimeError):
    """A run that did not reach its end, raised by `Outcome.check`."""


class SimulationWarning(UserWarning):
    """Something in a run that its user should know of."""


@dataclass(frozen=True)
class Event:
    """The first time [s] at which a status bit was raised: step, particle and place [m], and how often since.

    `has`: of `advice_on`.
    """

    status: int
    time: float
    step: int
    particle: int | None = None
    position: tuple[float, ...] | None = None
    value: float | None = None
    count: int = 1
    has: tuple[str, ...] = ()

    def __str__(self) -> str:
        text = f"{MESSAGES[Status(self.status)]}, at t = {self.time:.6g} s (step {self.step}"
        if self.particle is not None and self.position is not None:
            place = ", ".join(f"{x:.4g}" for x in self.position)
            text += f", particle {self.particle} at ({place}) m"
        if self.value is not None:
            text += f", {_VALUE_NAMES.get(Status(self.status), 'value')} {self.value:.3g}"
        return text + (f", {self.count} times in all)" if self.count > 1 else ")")

    @property
    def advice(self) -> str:
        """What to try."""
        return advice_on(Status(self.status), self.has)


_VALUE_NAMES = {
    Status.TIME_STEP_TOO_LARGE: "displacement in spacings",
    Status.NOT_CONVERGED: "relative residual",
    Status.SOLVE_FAILED: "relative residual",
    Status.RUNAWAY: "energy beyond that in J/kg",
    Status.TIME_STEP_COLLAPSED: "speed in m/s",
    Status.CLUSTERED: "closest distance in spacings",
    Status.HALVED: "part of the first time step",
}


@dataclass(frozen=True)
class Outcome:
    """How a run ended: one `Event` for each kind of trouble and each halving, none if all went well."""

    events: tuple[Event, ...] = field(default=())

    @property
    def flags(self) -> Status:
        """The bits of all events."""
        flags = Status(0)
        for event in self.events:
            flags |= Status(event.status)
        return flags

    @property
    def completed(self) -> bool:
        """Whether the run reached its end; warnings such as a missed tolerance do not count against it."""
        return not self.flags & (FATAL | Status.INTERRUPTED)

    @property
    def fatal(self) -> Event | None:
        """What ended the run early, if it failed."""
        return next((event for event in self.events if event.status & FATAL), None)

    @property
    def advice(self) -> str:
        """What to try: against what ended the run, or else against what it warns of; empty if all went well."""
        ends = FATAL | Status.INTERRUPTED
        told = self.events if self.completed else tuple(event for event in self.events if event.status & ends)
        return "; ".join(dict.fromkeys(event.advice for event in told))

    def check(self) -> None:
        """Raises `SimulationError`, with what to try, if the run did not reach its end."""
        if not self.completed:
            raise SimulationError(f"{self}. Advice: {self.advice}")

    def __str__(self) -> str:
        return "; ".join(str(event) for event in self.events) or "completed"

    def to_dict(self) -> dict[str, Any]:
        """Values for JSON; `from_dict` reads them."""
        return {
            "completed": self.completed,
            "message": str(self),
            "events": [asdict(event) for event in self.events],
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "Outcome":
        """What `to_dict` made. Raises `KeyError` for other data."""
        events = []
        for entry in data["events"]:
            place = entry["position"]
            values = {"position": None if place is None else tuple(place), "has": tuple(entry.get("has", ()))}
            events.append(Event(**{**entry, **values}))
        return cls(tuple(events))
