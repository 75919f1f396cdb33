"""`start`: the state at t = 0 of a case, or that of a frame of a run."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxmps._compilation import jit
from jaxmps._types import as_array
from jaxmps.flow import Case, Particles
from jaxmps.neighbors import SKIN, Neighbors, allocate, pairs, usual_capacity
from jaxmps.operators import pair_weight
from jaxmps.results import Run, at_frame
from jaxmps.running.checks import check_particles, check_precision
from jaxmps.scheme import Scheme
from jaxmps.stepping import State, density_and_surface
from jaxmps.validation import positive


def start(
    case: Case,
    scheme: Scheme,
    *,
    run: Run | None = None,
    frame: int = -1,
    skin: float = SKIN,
    capacity: int | None = None,
) -> State:
    """The state at t = 0 with its neighbor list allocated. Not for use under jit.

    With a `run` it is that of the run's `frame`, by default the last, at its time: particles are where they were then,
    walls where the motion of `case` has them at that time. Scheme, materials, gravity and motion may be others than
    those of the run. Steps are counted from zero again, as the draws of a noise are, which has no energy to give back
    in the first of them. To carry on a run that was stopped, bit for bit, is what `resume` is for.

    The list reaches `skin` spacings beyond the cutoff and has `capacity` slots for each particle, by default a quarter
    more than particles have neighbors in a uniform cloud. Raises `ValueError` if the box is too short along a periodic
    axis, where a particle would meet two images of another, if case or scheme were made in another precision, and for a
    run of other particles than those of the case, `IndexError` for a frame that is not there.
    """
    positive("skin", skin, "spacings")
    check_precision(case=case, scheme=scheme)
    for periodic, axis, length in zip(case.box.periodic, "xyz", case.box.lengths, strict=False):
        if periodic and length < 2.0 * scheme.ratio * case.spacing:
            raise ValueError(
                f"the box must be at least two effective radii ({2.0 * scheme.ratio * case.spacing:g} m) long on its "
                f"periodic axis {axis}, got {length:g} m"
            )
    time = jnp.zeros_like(case.particles.pressure[0])
    particles = case.particles
    if run is not None:
        particles, time = _particles_of(run, frame, case), jnp.asarray(run.time[frame], time.dtype)
    particles = case.motion.drive(particles, case.particles.position, time)
    if run is not None:
        inside = case.box.wrap(particles.position)
        particles = dataclasses.replace(particles, position=inside)
        dataclasses.replace(case, particles=particles)  # which checks them
    if capacity is None:
        capacity = usual_capacity(scheme.ratio + skin, case.dim)
    radius = scheme.ratio * case.spacing
    neighbors = allocate(particles.listed_position, case.box, radius, skin * case.spacing, capacity)
    n, surface = _first_look(case.undescribed(), scheme, particles, neighbors)
    return State(
        particles=particles,
        neighbors=neighbors,
        number_density=n,
        surface=surface,
        time=time,
        step=jnp.zeros((), jnp.int32),
        loss=jnp.zeros_like(case.particles.pressure[0]),
    )


@jit
def _first_look(case: Case, scheme: Scheme, particles: Particles, neighbors: Neighbors) -> tuple[Array, Array]:
    near = pairs(neighbors, particles, case.spacing)
    w = pair_weight(near, scheme.ratio * case.spacing)
    return density_and_surface(case, scheme, particles, near, w)


def _particles_of(run: Run, frame: int, case: Case) -> Particles:
    """The particles of a frame, in the precision that JAX is set to; `ValueError` unless they are those of the case."""
    columns = at_frame(run, frame)
    if not math.isclose(run.spacing, case.spacing, rel_tol=1e-6):
        raise ValueError(f"run must have the spacing of the case, {case.spacing:g} m, got {run.spacing:g} m")
    own = case.particles
    particles = Particles(
        position=as_array(columns["position"]),
        velocity=as_array(columns["velocity"]),
        pressure=as_array(columns["pressure"]),
        kind=jnp.asarray(np.asarray(columns["kind"]), own.kind.dtype),
        phase=jnp.asarray(np.asarray(columns["phase"]), own.phase.dtype),
    )
    check_particles("run", case, particles)
    return particles
