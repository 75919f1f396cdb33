"""What an ensemble keeps of each member at each frame instead of its particles."""

import math
from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxmps._types import Scalar, positive_or_one
from jaxmps.diagnostics.objectives import elevation
from jaxmps.flow import Case, mechanical_energy
from jaxmps.neighbors import pairs, update
from jaxmps.stepping import State

_COMPANY = 1.5  # spacings, as in `surge_front`


def observation(case: Case, state: State, *, gauges: Sequence[float] = (), cell: float = 2.0) -> dict[str, Array]:
    """The usual quantities of a flow at an instant, by name. Pure, for jit and vmap.

    - `kinetic`, `potential` [J/kg]: energies per unit mass
    - `front` [m]: the foremost fluid along x, l0 / 2 ahead of its center, as `surge_front` has it
    - `top` [m]: the highest fluid against gravity, measured likewise
    - `height` (gauges,) [m]: the `elevation` at the places `gauges` [m] of a two-dimensional flow, if there are any
    - `wet` (cells along each axis): whether a cell of about `cell` spacings is filled at least half, see
      `volume_fraction`; its mean over the members of an ensemble is the probability of being wet

    Single drops, without company within 1.5 l0, are neither front nor top.
    """
    particles = state.particles
    energy = mechanical_energy(particles, case.density, case.gravity)
    near = pairs(update(state.neighbors, particles.position), particles, case.spacing)
    beside = near.at_j(particles.fluid) & near.present & (near.distance <= _COMPANY * case.spacing)
    water = particles.fluid & jnp.any(beside, axis=-1)
    up = -case.gravity / jnp.sqrt(positive_or_one(jnp.sum(case.gravity**2)))
    found = {
        "kinetic": energy.kinetic,
        "potential": energy.potential,
        "front": _edge(particles.position[:, 0], water, case.spacing),
        "top": _edge(particles.position @ up, water, case.spacing),
        "wet": volume_fraction(case, state, cell) >= 0.5,
    }
    if len(gauges):
        found["height"] = elevation(case, state, jnp.asarray(gauges, particles.position.dtype))
    return found


def _edge(along: Float[Array, " n"], water: Bool[Array, " n"], spacing: float) -> Scalar:
    most = jnp.max(jnp.where(water, along, -jnp.inf))
    return jnp.where(jnp.any(water), most + 0.5 * spacing, jnp.nan)


def cells(case: Case, cell: float = 2.0) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Number of cells of about `cell` spacings along each axis of the box, and their lengths [m]."""
    shape = tuple(max(1, math.ceil(length / (cell * case.spacing) - 1e-9)) for length in case.box.lengths)
    return shape, tuple(length / count for length, count in zip(case.box.lengths, shape, strict=True))


def volume_fraction(case: Case, state: State, cell: float = 2.0) -> Float[Array, "*cells"]:
    """The part of each cell of the box that fluid fills: each particle gives its volume l0^d to the cells whose centers
    surround it, with linear weights. Cells have about `cell` spacings.
    """
    shape, width = cells(case, cell)
    fluid, position = state.particles.fluid, state.particles.position
    volume = jnp.where(fluid, case.spacing**case.dim / math.prod(width), 0.0)
    low, high = [], []
    for axis, (count, size) in enumerate(zip(shape, width, strict=True)):
        place = jnp.where(fluid, (position[:, axis] - case.box.lower[axis]) / size, 0.5) - 0.5
        first = jnp.floor(place).astype(jnp.int32)
        weight = place - first
        ends = [(first, 1.0 - weight), (first + 1, weight)]
        if case.box.periodic[axis]:
            ends = [(number % count, w) for number, w in ends]
        else:  # at a wall all of a particle's volume stays in the cell next to it
            ends = [(jnp.clip(number, 0, count - 1), w) for number, w in ends]
        low.append(ends[0])
        high.append(ends[1])
    total = jnp.zeros(shape, position.dtype)
    for corner in range(2**case.dim):
        chosen = [(high if corner >> axis & 1 else low)[axis] for axis in range(case.dim)]
        share = volume
        for _, weight in chosen:
            share = share * weight
        total = total.at[tuple(number for number, _ in chosen)].add(share)
    return total
