"""When walls that move leave the domain, known before anything runs."""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.spatial import ConvexHull, QhullError

from jaxmps._compilation import jit
from jaxmps.casefile.setup import Setup
from jaxmps.flow import Box
from jaxmps.flow.motion import AbstractMotion, AbstractSignal, Bodies, Rigid, Sine, Table

_FEWEST, _MOST = 500, 50_000  # instants that are looked at
_FINE = 32  # of them in a period, or between two times of a table


class Leaving(NamedTuple):
    """The first time [s] at which a wall is outside of the domain, which one, and where it gets out [m]."""

    time: float
    body: str
    place: tuple[float, ...]

    def __str__(self) -> str:
        place = ", ".join(f"{x:.4g}" for x in self.place)
        return (
            f"{self.body} leaves the domain at t = {self.time:.4g} s, at ({place}) m, where a run ends: the domain "
            "(lower and upper of [case]) must have room for the motion, or the run must end before"
        )


def leaving(setup: Setup) -> Leaving | None:
    """Of the walls the first that is outside of the domain at some time of the run; None if all stay inside."""
    case = setup.case
    if not case.walls_move:
        return None
    walls = np.asarray(case.particles.fixed)
    reference, body = np.asarray(case.particles.position, float), _bodies(setup, walls)
    some = _outermost(case.motion, reference, body, walls)
    if not walls.any():
        return None
    motion = _of(case.motion, some)
    where = (case.box, motion, jnp.asarray(reference[some]), jnp.asarray(walls[some]))
    times = np.linspace(0.0, setup.run.until, _instants(case.motion, setup.run.until) + 1)
    ever = np.asarray(_ever(*where, jnp.asarray(times)))
    if not ever.any():
        return None
    first = int(np.argmax(ever))
    before, after = times[max(first - 1, 0)], times[first]
    for _ in range(40):
        middle = 0.5 * (before + after)
        before, after = (before, middle) if np.any(_outside(*where, jnp.asarray(middle))) else (middle, after)
    out = int(np.argmax(np.asarray(_outside(*where, jnp.asarray(after)))))
    place = np.asarray(motion.place(where[2], jnp.asarray(after)))[out]
    return Leaving(float(after), _name(setup, int(body[some[out]])), tuple(place.tolist()))


def _outside_at(box: Box, motion: AbstractMotion, points: Array, counts: Array, time: Array) -> Array:
    return counts & ~box.contains(motion.place(points, time))


def _ever_outside(box: Box, motion: AbstractMotion, points: Array, counts: Array, times: Array) -> Array:
    return jax.lax.map(lambda time: jnp.any(_outside_at(box, motion, points, counts, time)), times)


_outside, _ever = jit(_outside_at), jit(_ever_outside)


def _bodies(setup: Setup, walls: np.ndarray) -> np.ndarray:
    """A number for each particle: of its `[[wall]]`, else of its body in the motion."""
    body = np.full(len(walls), -1)
    if setup.layout is not None:
        body[walls] = setup.layout.owner
    elif isinstance(setup.case.motion, Bodies):
        body = np.where(walls, np.asarray(setup.case.motion.body), -1)
    return body


def _name(setup: Setup, body: int) -> str:
    if setup.layout is not None:
        return f"[[wall]] {body + 1}"
    return f"body {body} of the motion" if body >= 0 else "a wall"


def _outermost(motion: AbstractMotion, reference: np.ndarray, body: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """Particles that tell of all others: of each rigid body the corners of its convex hull. Of another motion all, for
    it may move each in its own way.
    """
    if not isinstance(motion, Rigid | Bodies):
        return np.arange(len(walls))
    found = []
    for number in np.unique(body[walls]):
        here = np.flatnonzero(walls & (body == number))
        try:
            found.append(here[ConvexHull(reference[here]).vertices])
        except QhullError:  # too few, or all in one line or plane
            found.append(here)
    return np.concatenate([np.zeros(0, int), *found])


def _of(motion: AbstractMotion, some: np.ndarray) -> AbstractMotion:
    """The motion of some particles only."""
    return eqx.tree_at(lambda m: m.body, motion, motion.body[some]) if isinstance(motion, Bodies) else motion


def _instants(motion: AbstractMotion, until: float) -> int:
    """So many that no signal turns unseen."""
    step = until / _FEWEST
    signals = jax.tree.leaves(motion, is_leaf=lambda x: isinstance(x, AbstractSignal))
    for signal in signals:
        if isinstance(signal, Sine) and float(signal.frequency) != 0.0:
            step = min(step, 2.0 * math.pi / abs(float(signal.frequency)) / _FINE)
        elif isinstance(signal, Table):
            step = min(step, float(np.min(np.diff(np.asarray(signal.times)))) / _FINE)
    return min(math.ceil(until / step), _MOST)
