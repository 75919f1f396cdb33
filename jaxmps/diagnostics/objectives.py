"""Quantities of a flow that have useful derivatives, to build losses from.

Where others take a maximum or a minimum, which hangs on one particle and jumps to the next, these take means over the
particles that come close to it. All work on the state of a rollout, in jit, grad and vmap.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmps._types import ArrayLike, Scalar, positive_or_one, root
from jaxmps.flow import Case
from jaxmps.monitor import StepInfo
from jaxmps.neighbors import pairs, update
from jaxmps.operators import pair_weight
from jaxmps.stepping import State


def smooth_maximum(values: Float[Array, " n"], width: ArrayLike, where: Array | None = None) -> Scalar:
    """Σ v_i e^{v_i/w} / Σ e^{v_i/w}: the mean of the largest values, where `width` w tells what counts as close to the
    largest. It is below the maximum, and tends to it with w → 0. `where` picks the values that count; zero if none do.
    """
    counts = jnp.ones(values.shape, bool) if where is None else where
    counts = counts | ~jnp.any(counts)
    weight = jax.nn.softmax(jnp.where(counts, values / width, -jnp.inf))
    found = jnp.sum(jnp.where(weight > 0, weight * values, 0.0))
    return found if where is None else jnp.where(jnp.any(where), found, 0.0)


def energy_error(info: StepInfo, reference: ArrayLike | None = None) -> Scalar:
    """The root of the mean square over the steps of a rollout of (E − E_ref) / E_k.

    E is the mechanical energy [J/kg], E_ref the `reference` at each step, by default that of the first step, and E_k
    the mean kinetic energy, through which no derivative passes: a large potential does not hide an error.
    """
    total = info.energy.total
    expected = jax.lax.stop_gradient(total[0]) if reference is None else jnp.asarray(reference)
    scale = jax.lax.stop_gradient(jnp.mean(info.energy.kinetic))
    return root(jnp.mean((total - expected) ** 2)) / positive_or_one(scale)


def elevation(case: Case, state: State, x: ArrayLike, width: float = 3.0) -> Float[Array, "*places"]:
    """The height of the water [m] over the floor's y = 0 at the places `x` [m] of a two-dimensional flow:
    h(x) = Σ_i l0² K(x − x_i), with the cubic B-spline K of a knot distance of `width` spacings.

    That is the volume of the particles over each place. Whole numbers of spacings count each column of a lattice once.
    Within two knots of a side wall, part of the kernel lies outside the water.
    """
    particles, knot = state.particles, width * case.spacing
    places = jnp.asarray(x, particles.position.dtype)
    apart = case.box.nearest(0, places[..., None] - particles.position[:, 0])
    s = jnp.abs(apart) / knot
    near, far = jnp.maximum(1.0 - s, 0.0), jnp.maximum(2.0 - s, 0.0)
    kernel = (far**3 / 6.0 - near**3 * (4.0 / 6.0)) / knot
    return case.spacing**2 * jnp.sum(jnp.where(particles.fluid, kernel, 0.0), axis=-1)


def wave_height_error(
    time: Float[Array, " steps"],
    height: Float[Array, " steps"],
    reference_time: ArrayLike,
    reference: ArrayLike,
) -> Scalar:
    """The root of the mean square of η − η_ref over that of η_ref, at the times [s] of the reference that lie within
    the run. Both are elevations [m] over the still water; that of the run is interpolated.
    """
    at, expected = jnp.asarray(reference_time), jnp.asarray(reference)
    inside = (at >= time[0]) & (at <= time[-1])
    found = jnp.interp(at, time, height)
    squared = jnp.sum(jnp.where(inside, (found - expected) ** 2, 0.0))
    return root(squared / positive_or_one(jnp.sum(jnp.where(inside, expected**2, 0.0))))


def tip_radius(case: Case, state: State, center: ArrayLike | None = None, width: float = 0.25) -> Scalar:
    """The distance [m] of the outermost fluid from `center` [m], by default the center of mass: a `smooth_maximum` over
    `width` spacings.
    """
    particles, fluid = state.particles, state.particles.fluid
    if center is None:
        mass = jnp.where(fluid, case.density, 0.0)
        center = mass @ particles.position / positive_or_one(jnp.sum(mass))
    squared = jnp.sum(case.box.displacement(particles.position - jnp.asarray(center)) ** 2, axis=-1)
    return smooth_maximum(root(squared), width * case.spacing, fluid)


def front_position(case: Case, state: State, width: float = 0.25) -> Scalar:
    """The foremost fluid along x [m], l0 / 2 ahead of its centers as in `surge_front`: a `smooth_maximum` over `width`
    spacings. Single drops that fly ahead count.
    """
    particles = state.particles
    return smooth_maximum(particles.position[:, 0], width * case.spacing, particles.fluid) + 0.5 * case.spacing


def smallest_distance(case: Case, state: State, width: float = 0.02) -> Scalar:
    """The distance of the closest pairs in spacings: a smooth minimum over `width` spacings.

    A spacing where no two particles are within the effective radius.
    """
    particles = state.particles
    near = pairs(update(state.neighbors, particles.position), particles, case.spacing)
    moving = near.present & (particles.fluid[:, None] | near.at_j(particles.fluid))
    distance = (near.distance / case.spacing).ravel()
    return jnp.where(jnp.any(moving), -smooth_maximum(-distance, width, moving.ravel()), 1.0)


def pressure_roughness(case: Case, state: State) -> Scalar:
    """The root of the mean square of p_i − Σ_j w_ij p_j / Σ_j w_ij over the fluid inside, relative to that of p.

    Zero for a pressure that is linear among neighbors that lie symmetrically; noise from particle to particle counts
    in full.
    """
    particles = state.particles
    neighbors = update(state.neighbors, particles.position)
    near = pairs(neighbors, particles, case.spacing)
    pressed = particles.has_pressure
    w = jnp.where(near.at_j(pressed), pair_weight(near, neighbors.cutoff), 0.0)
    total = jnp.sum(w, axis=-1)
    mean = jnp.sum(w * near.at_j(particles.pressure), axis=-1) / positive_or_one(total)
    inside = particles.fluid & ~state.surface & (total > 0)
    noise = jnp.sum(jnp.where(inside, (particles.pressure - mean) ** 2, 0.0))
    whole = jnp.sum(jnp.where(inside, particles.pressure**2, 0.0))
    return root(noise / positive_or_one(whole))
