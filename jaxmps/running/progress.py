"""What is told of runs on their way (time, Δt, speed, simulated seconds per wall second), ensembles and tuning."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from jaxmps.running.display import Told, shown


class Meter(Told):
    """How far a run has come, from the time `begin` to `until` [s]; one that is not shown costs nothing."""

    def __init__(self, refresh: Callable[[], None] | None, until: float, begin: float = 0.0):
        super().__init__(refresh, until, begin)
        self._dt = self._speed = 0.0

    def update(self, time: float, dt: float, max_speed: float) -> None:
        """Time [s], the last Δt [s], the largest speed [m/s]."""
        self._dt, self._speed = dt, max_speed
        self.reach(time)

    def words(self, wall: str) -> list[str]:
        told = [f"t {_as_precise(self.done, self.total)} s of {self.total:.4g}", wall, f"Δt {self._dt:.2e} s"]
        pace = [f"{self.pace:.3g} s/s"] if self.pace > 0.0 else []
        return [*told, f"u {self._speed:.3g} m/s", *pace]


class Tally(Told):
    """How many steps of tuning were taken, with the loss and the norm of its gradient."""

    def __init__(self, refresh: Callable[[], None] | None, steps: int):
        super().__init__(refresh, float(steps))
        self._loss = self._norm = math.nan

    def update(self, taken: int, loss: float, norm: float) -> None:
        self._loss, self._norm = loss, norm
        self.reach(float(taken))

    def words(self, wall: str) -> list[str]:
        told = [f"step {self.done:.0f} of {self.total:.0f}", wall]
        return [*told, f"loss {self._loss:.4g}", f"|gradient| {self._norm:.3g}"]


class Counter(Told):
    """How many of a number of things are done. What is added first was there before, and says nothing of the pace."""

    def __init__(self, refresh: Callable[[], None] | None, total: int, what: str):
        super().__init__(refresh, float(total))
        self._what, self.compiling = what, False  # nobody tells when the first things have begun to run

    def add(self, more: int) -> None:
        self.reach(self.done + more)

    def words(self, wall: str) -> list[str]:
        return [f"{self.done:.0f} of {self.total:.0f} {self._what}", wall]


@contextmanager
def meter(until: float, visible: bool | None, begin: float = 0.0) -> Iterator[Meter]:
    """A `Meter` from the time `begin` to `until` [s]: by default a bar on a terminal and in notebooks, else a line on
    stderr every ten seconds.
    """
    with shown(visible) as screen:
        told = Meter(screen.refresh, until, begin)
        screen.start(told)
        yield told


@contextmanager
def tally(steps: int, visible: bool | None) -> Iterator[Callable[[int, float, float], None]]:
    """A function of the number of steps taken, the loss and the norm of its gradient, which shows them in a bar."""
    with shown(visible, lines=False) as screen:
        told = Tally(screen.refresh, steps)
        screen.start(told)
        yield told.update


@contextmanager
def counter(total: int, visible: bool | None, what: str) -> Iterator[Callable[[int], None]]:
    """A function that counts so many more of `total` as done, and shows it as `meter` does."""
    with shown(visible) as screen:
        told = Counter(screen.refresh, total, what)
        screen.start(told)
        yield told.add


def _as_precise(number: float, total: float) -> str:
    """A number on its way to `total`, with as many decimals as show four digits of that: it keeps its width."""
    if not 1e-3 <= total < 1e6:
        return f"{number:.3e}"
    return f"{number:.{max(0, 3 - math.floor(math.log10(total)))}f}"
