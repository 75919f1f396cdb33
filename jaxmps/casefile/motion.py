"""The table `[motion]` made into the motion of a case."""

import math

from jaxmps.casefile.models import MotionTable, SignalTable
from jaxmps.flow.motion import AbstractMotion, AbstractSignal, Rigid, Sine, Still, Table


def motion(table: MotionTable | None, dim: int) -> AbstractMotion:
    """That of one rigid body, or none; `ValueError` for a table of values that is none."""
    if table is None:
        return Still()
    given = {name: getattr(table, name) for name in ("sway", "heave", "roll")}
    signals = {name: _signal(signal) for name, signal in given.items() if signal is not None}
    return Rigid(table.center or [0.0] * dim, **signals)


def _signal(table: SignalTable) -> AbstractSignal:
    if table.amplitude is None or table.period is None:
        return Table(table.times, table.values, table.interpolation or "pchip")
    return Sine(table.amplitude, 2.0 * math.pi / table.period, table.phase or 0.0)
