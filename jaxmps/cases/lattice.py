"""Particles on a lattice: fluid blocks in tanks with a wall layer and dummy layers."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from jaxmps.flow import Box, Case, Fluid, Kind, at_rest
from jaxmps.validation import between, fixed, not_negative, positive

WATER = {"density": 1000.0, "viscosity": 1e-6}
"""kg/m³ and m²/s."""


_MOST_POINTS = 50_000_000  # more than any single device runs: a mistyped spacing, not a plan


def dummy_layers(ratio: float) -> int:
    """Layers of dummies behind the wall that complete the neighborhood of a wall particle, ⌈r_e / l0⌉ − 1."""
    return max(1, math.ceil(ratio) - 1)


def cells(length: float, spacing: float) -> int:
    """Whole number of spacings that comes closest to a length; `ValueError` for more than can be."""
    few(length / spacing)
    return round(length / spacing)


def lattice_points(*ranges: range) -> np.ndarray:
    """Integer points `(n, d)` of a lattice with these ranges along its axes, the last axis first to vary."""
    few(math.prod(float(max(r.stop - r.start, 0)) for r in ranges))  # a range of enormous length has no len
    return np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, len(ranges))


def few(points: float) -> None:
    """`ValueError` for more lattice points than can be; before there is memory for them."""
    if points > _MOST_POINTS:
        raise ValueError(f"spacing must leave at most {_MOST_POINTS:.0e} lattice points, got {points:.1e}")


def materials(density: Mapping[str, float], viscosity: Mapping[str, float]) -> Fluid:
    """One phase for each density [kg/m³] and kinematic viscosity [m²/s], checked under the names of their arguments."""
    return Fluid(
        [positive(name, value, "kg/m^3") for name, value in density.items()],
        [not_negative(name, value, "m^2/s") for name, value in viscosity.items()],
    )


def block_in_tank(
    block: tuple[int, ...],
    inside: tuple[int, ...],
    wall_height: int,
    layers: int,
    periodic: tuple[bool, ...],
) -> tuple[np.ndarray, np.ndarray]:
    """Integer lattice points and `Kind` of a block of fluid in the lower corner of a tank that is open at the top.

    `block` and `inside` count fluid particles and inner lattice points along each axis (the last is vertical), walls
    stand on `wall_height` rows and are 1 + `layers` particles thick, on all sides that are not periodic.
    """
    thick = 1 + layers
    ranges = [
        range(0, size) if wraps else range(-thick, size + thick)
        for size, wraps in zip(inside[:-1], periodic[:-1], strict=True)
    ]
    ranges.append(range(-thick, max(wall_height, block[-1])))
    points = lattice_points(*ranges)
    limits = np.array([*(size - 1 for size in inside[:-1]), np.iinfo(int).max])
    depth = np.maximum(np.maximum(-points, points - limits), 0).max(axis=1)
    fluid = np.all((points >= 0) & (points < np.array(block)), axis=1)
    wall = (depth > 0) & (points[:, -1] < wall_height)
    kind = np.where(fluid, Kind.FLUID, np.where(depth == 1, Kind.WALL, Kind.DUMMY))
    order = np.concatenate([np.flatnonzero(fluid), np.flatnonzero(wall & ~fluid)])
    return points[order], kind[order]


def tank_case(
    *,
    name: str,
    parameters: Mapping[str, Any],
    block: tuple[int, ...],
    inside: tuple[int, ...],
    wall_height: int,
    headroom: float,
    spacing: float,
    ratio: float,
    gravity: float,
    fluids: Fluid,
    phase: Callable[[np.ndarray], np.ndarray] | None = None,
    periodic: tuple[bool, ...] | None = None,
    mirror: int | None = None,
    first: tuple[float, ...] | None = None,
) -> Case:
    """A block of fluid at rest in a tank whose inner lower corner is the origin. `headroom`: top of the domain [m].

    Each particle stands in the middle of its cell, the first at l0 / 2 from floor and walls, unless `first` has another
    place for it [spacings]. `phase` finds the phases of the block's particles from their positions `(n, d)` [m], or −1
    where the block has no particle; walls, and all particles if there is no `phase`, are of phase 0. At the lower end
    of the axis `mirror` a mirror takes the place of the wall.
    """
    not_negative("gravity", gravity, "m/s^2")
    positive("ratio", fixed("ratio", ratio), "spacings")
    dim = len(block)
    periodic = periodic or (False,) * dim
    layers = dummy_layers(ratio)
    points, kind = block_in_tank(block, inside, wall_height, layers, periodic)
    position = (points + np.array(first or (0.5,) * dim)) * spacing
    phases = np.zeros(len(kind), int)
    if phase is not None:
        phases[kind == Kind.FLUID] = phase(position[kind == Kind.FLUID])
    there = phases >= 0
    if mirror is not None:
        there &= points[:, mirror] >= 0
    margin = (1 + layers) * spacing
    lower = [0.0 if p or axis == mirror else -margin for axis, p in enumerate(periodic)]
    upper = [size * spacing + (0.0 if p else margin) for size, p in zip(inside, periodic, strict=True)]
    upper[-1] = headroom
    return Case(
        particles=at_rest(position[there], kind[there], phases[there]),
        fluids=fluids,
        gravity=[0.0] * (dim - 1) + [-gravity],
        spacing=spacing,
        box=Box(tuple(lower), tuple(upper), periodic, mirror),
        name=name,
        parameters=tuple(parameters.items()),
    )


def jitter(case: Case, amplitude: float, key: Key[Array, ""]) -> Case:
    """The case with its fluid particles displaced by up to `amplitude` spacings (0 to 0.3) along each axis.

    The displacements are independent and uniform; use it to see how much of a result hangs on the lattice.
    """
    between("amplitude", amplitude, 0.0, 0.3, "spacings")
    particles = case.particles
    # Drawn in single precision, so that a key means the same case in both precisions.
    shift = jax.random.uniform(key, particles.position.shape, jnp.float32, -1.0, 1.0)
    shift = amplitude * case.spacing * shift.astype(particles.position.dtype)
    position = jnp.where(particles.fluid[:, None], particles.position + shift, particles.position)
    particles = eqx.tree_at(lambda p: p.position, particles, case.box.wrap(position))
    parameters = dict(case.parameters, jitter=amplitude)
    return dataclasses.replace(case, particles=particles, parameters=tuple(parameters.items()))
