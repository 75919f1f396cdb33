"""What a run does when it blows up: stop, or go back to its last frame and take half the time step from there."""

import dataclasses
from collections.abc import Callable

from jaxmps.flow import Status
from jaxmps.running.loop import Loop
from jaxmps.running.progress import Meter
from jaxmps.validation import one_of

ON_BLOWUP = ("stop", "halve-dt")
_MOST = 10  # halvings in a row


class Rescue:
    """The loop of a run, frame by frame.

    With "halve-dt" a frame in which the run blows up is computed again, from its start and with half the time step,
    which then stays. Each halving is an `Event` at the time [s] of the failure. After ten of them without a frame that
    needed none, the run ends as with "stop".
    """

    def __init__(self, loop: Loop, on_blowup: str):
        self.loop, self._halves = loop, one_of("on_blowup", on_blowup, ON_BLOWUP) == "halve-dt"
        self._halvings = self._in_a_row = 0

    def reach(self, target: float, bar: Meter, look: Callable[[], None] = lambda: None) -> None:
        """As `Loop.reach`: up to the time `target` [s], or to the last good state before a failure for good."""
        loop, before = self.loop, self._halvings
        last_frame = loop.snapshot
        loop.reach(target, bar, look)
        while self._halves and self._in_a_row < _MOST and (failure := loop.outcome.fatal) is not None:
            self._halvings, self._in_a_row = self._halvings + 1, self._in_a_row + 1
            loop.put_back(last_frame)
            loop.halve(dataclasses.replace(failure, status=int(Status.HALVED), value=0.5**self._halvings, count=1))
            last_frame = loop.snapshot
            loop.reach(target, bar, look)
        if self._halvings == before:
            self._in_a_row = 0
