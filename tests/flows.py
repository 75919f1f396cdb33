"""Flows in units of their spacing, in a few shapes that they share, for each shape is compiled anew."""

import dataclasses
import functools
from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from hasty import quick
from jaxtyping import Array, Bool, Float, Int
from scipy.spatial import cKDTree

from jaxmps import Box, Case, Kind, cases, schemes
from jaxmps.flow import Fluid, at_rest
from jaxmps.models import OneSided
from jaxmps.neighbors import Neighbors, pairs
from jaxmps.operators import pair_weight
from jaxmps.pressure import AbstractOperator, PressureEquation
from jaxmps.stepping import Prediction, density_and_surface, pressure_equation

RATIO = 2.1


def per_precision(function: Callable[..., Any]) -> Callable[..., Any]:
    """`functools.cache` for what depends on the precision."""
    cached = functools.cache(lambda _, *arguments: function(*arguments))
    return lambda *arguments: cached(jax.config.jax_enable_x64, *arguments)


class Shape(NamedTuple):
    box: Box
    particles: int
    slots: int


PLANE = Shape(Box((0.0, 0.0), (48.0, 48.0)), 1500, 20)
CHANNEL = Shape(Box((0.0, 0.0), (48.0, 32.0), (True, False)), 950, 20)
SPACE = Shape(Box((0.0, 0.0, 0.0), (18.0, 18.0, 18.0)), 3060, 44)
TORUS = Shape(Box((0.0, 0.0), (32.0, 32.0), (True, True)), 1024, 20)


class Fault(NamedTuple):
    code: Int[Array, ""]


class Table(eqx.Module):
    """A list in jax-md's form that stays as it is, for particles that hardly move."""

    idx: Int[Array, "n slots"]
    error: Fault

    def update(self, position):
        return self


class Flow(eqx.Module):
    """A case with the list of its pairs."""

    case: Case
    neighbors: Neighbors

    def at(self, position: Float[Array, "n d"]) -> "Flow":
        """With its particles a little displaced: the list stays."""
        return eqx.tree_at(lambda flow: flow.case.particles.position, self, position)

    @property
    def taken(self) -> np.ndarray:
        """Which particles have not been removed."""
        return np.asarray(self.case.particles.kind) != Kind.REMOVED


def made(shape: Shape, points: np.ndarray, kind: np.ndarray, phase: np.ndarray, density: np.ndarray) -> Flow:
    """The flow of these particles, jittered by a tenth of the spacing, and removed ones where there is room."""
    corner = np.where(shape.box.periodic, 0.0, points.min(axis=0) - 0.5)
    room = np.stack(np.meshgrid(*(np.arange(0.5, x) for x in shape.box.lengths), indexing="ij"), axis=-1)
    room = room.reshape(-1, shape.box.dim)
    farthest_first = np.argsort(-cKDTree(points - corner).query(room)[0], kind="stable")
    removed = room[farthest_first[: shape.particles - len(points)]]
    kind, phase = (np.concatenate([x, np.full(len(removed), y)]) for x, y in ((kind, Kind.REMOVED), (phase, 0)))
    case = jittered(np.concatenate([points - corner, removed]), kind, phase, np.resize(density, 2), shape.box)
    return Flow(case, listed(np.asarray(case.particles.position, float), shape))


@quick
def jittered(points, kind, phase, density, box) -> Case:
    particles, fluids = at_rest(points, kind, phase), Fluid(density, [0.0, 0.0])
    case = Case(particles=particles, fluids=fluids, gravity=[0.0] * box.dim, spacing=1.0, box=box)
    return cases.jitter(case, 0.1, jax.random.key(1))


def listed(points: np.ndarray, shape: Shape) -> Neighbors:
    period = np.where(shape.box.periodic, shape.box.lengths, 0.0)
    ends = cKDTree(points, boxsize=period).query_pairs(RATIO + 0.02, output_type="ndarray")
    i, j = np.concatenate([ends, ends[:, ::-1]]).T
    order = np.argsort(i, kind="stable")
    i, j, n = i[order], j[order], len(points)
    count = np.bincount(i, minlength=n)
    idx = np.full((n, shape.slots), n, np.int32)
    idx[i, np.arange(len(i)) - np.repeat(np.cumsum(count) - count, count)] = j
    return Neighbors(Table(jnp.array(idx), Fault(jnp.zeros((), int))), shape.box, RATIO, 0.0)


class Named(NamedTuple):
    """A case of the library at a scale, and the shape that holds it at the scales one and two.

    A wave that is half as long stands twice in its channel.
    """

    shape: Shape
    case: Callable[[int], Case]


NAMED = {
    "dam_break": Named(
        PLANE,
        lambda k: cases.dam_break(
            spacing=1.0, width=10.0 * k, height=15.0 * k, tank_length=20.0 * k, tank_height=15.0 * k
        ),
    ),
    "square_patch": Named(PLANE, lambda k: cases.square_patch(spacing=1.0, side=18.0 * k)),
    "hydrostatic": Named(
        PLANE, lambda k: cases.hydrostatic(spacing=1.0, length=16.0 * k, height=16.0 * k, freeboard=2.0)
    ),
    "settling": Named(PLANE, lambda k: cases.settling(spacing=0.0125 / k)),
    "two_layer": Named(
        PLANE,
        lambda k: cases.two_layer(
            spacing=1.0,
            length=14.0 * k,
            lower_height=8.0 * k,
            upper_height=8.0 * k,
            freeboard=2.0,
            lower_density=1000.0,
            upper_density=1.0,
        ),
    ),
    "standing_wave": Named(CHANNEL, lambda k: cases.standing_wave(spacing=1 / 24 / k)),
    "dam_break_3d": Named(
        SPACE,
        lambda k: cases.dam_break_3d(
            spacing=1.0, width=4.0 * k, depth=4.0 * k, height=6.0 * k, tank_length=4.0 * k, tank_height=6.0 * k
        ),
    ),
}


@per_precision
def particles_of(name: str, scale: int) -> tuple[np.ndarray, ...]:
    """Points in spacings, kinds, phases and densities."""
    shape, make = NAMED[name]

    @quick
    def arrays():
        case = make(scale)
        particles, box = case.particles, case.box
        # Not the whole case: pressures are left out of what is compiled.
        return particles.position, particles.kind, particles.phase, case.fluids.density, case.spacing, box

    *found, spacing, box = arrays()
    points, kind, phase, density = (np.asarray(x) for x in found)
    length = round(box.lengths[0] / spacing)
    copies = round(shape.box.lengths[0]) // length if box.periodic[0] else 1
    along = np.eye(box.dim)[0]
    points = np.concatenate([points / spacing + k * length * along for k in range(copies)])
    return points, np.tile(kind, copies), np.tile(phase, copies), density


@per_precision
def flow(name: str, scale: int) -> Flow:
    return made(NAMED[name].shape, *particles_of(name, scale))


def with_more(name: str, points: np.ndarray) -> Flow:
    """The small flow of that name with more fluid at these points, beside the origin of its particles."""
    first, kind, phase, density = particles_of(name, 1)
    more = np.full(len(points), Kind.FLUID)
    return made(
        NAMED[name].shape,
        np.concatenate([first, points]),
        np.concatenate([kind, more]),
        np.concatenate([phase, 0 * more]),
        density,
    )


def spray() -> tuple[Flow, np.ndarray]:
    """The dam break with droplets of 1, 2, 3 and 10 particles in the air, and which are theirs."""
    droplets = [[15.0, 30.0], [20.0, 30.0], [20.8, 30.2], [26.0, 32.0], [26.5, 32.7], [27.0, 32.0]]
    droplets = droplets + [[10.0 + 0.8 * (i % 4), 36.0 + 0.8 * (i // 4)] for i in range(10)]
    together = with_more("dam_break", np.array(droplets))
    theirs = np.zeros(len(together.taken), bool)
    theirs[np.flatnonzero(together.taken)[-len(droplets) :]] = True
    return together, theirs


def look(flow: Flow) -> tuple[Float[Array, " n"], Bool[Array, " n"]]:
    """Number density and which particles lie on the free surface."""
    case = flow.case
    scheme = dataclasses.replace(schemes.mps(), free_surface=OneSided())
    near = pairs(flow.neighbors, case.particles, case.spacing)
    return density_and_surface(case, scheme, case.particles, near, pair_weight(near, RATIO))


def equation(flow: Flow, surface: Bool[Array, " n"], source: Float[Array, " n"]) -> PressureEquation:
    """The pressure equation, preconditioned by multigrid, with a cold start."""
    near = pairs(flow.neighbors, flow.case.particles, flow.case.spacing)
    zero, w, density = jnp.zeros_like(source), pair_weight(near, RATIO), flow.case.density
    predicted = Prediction(
        flow.case.particles, flow.neighbors, near, w, zero, surface, source, density, zero, jnp.zeros(())
    )
    return pressure_equation(flow.case, schemes.mps(), predicted)


def right_hand_side(flow: Flow) -> Float[Array, " n"]:
    """Noise, and a mean that takes Jacobi many iterations."""
    return jnp.array(1.0 + np.random.default_rng(0).normal(size=len(flow.taken)), float)


look_up, set_up = quick(look), quick(equation)


def set_up_as_found(flow: Flow) -> PressureEquation:
    """The pressure equation with the surface that is there."""
    return set_up(flow, look_up(flow)[1], right_hand_side(flow))


PRODUCTS = Counter()


class Counted(AbstractOperator):
    """Counts its products with a vector in `PRODUCTS`, to be read behind `jax.effects_barrier`."""

    operator: AbstractOperator

    def __matmul__(self, x):
        jax.debug.callback(lambda: PRODUCTS.update(["all"]))
        return self.operator @ x

    def magnitude(self, x):
        return self.operator.magnitude(x)
