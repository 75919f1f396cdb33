"""Prescribed motion of walls: sway, heave and roll of a rigid body, for sloshing tanks and wave makers."""

from jaxmps.flow.motion import AbstractMotion, AbstractSignal, Bodies, Constant, Rigid, Sine, Still, Table

__all__ = ["AbstractMotion", "AbstractSignal", "Bodies", "Constant", "Rigid", "Sine", "Still", "Table"]
