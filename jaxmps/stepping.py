"""One time step, in the order of the papers."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from jaxmps._types import Scalar
from jaxmps.case import Case
from jaxmps.kernels import lattice
from jaxmps.monitor import StepInfo, inspect
from jaxmps.neighbors import Neighbors, Pairs, pairs, update
from jaxmps.operators import density_rate, divergence, number_density, pair_weight
from jaxmps.particles import Particles
from jaxmps.pressure import Compression, poisson_operator, solve_pressure
from jaxmps.scheme import Scheme


class State(eqx.Module):
    """A flow at an instant: particles, their list, the number density and surface of the last prediction, time [s]."""

    particles: Particles
    neighbors: Neighbors
    number_density: Float[Array, " n"]
    surface: Bool[Array, " n"]
    time: Scalar
    step: Int[Array, ""]


def step(case: Case, scheme: Scheme, state: State, dt: Scalar, key: Key[Array, ""]) -> tuple[State, StepInfo]:
    """The flow after `dt` [s]: explicit prediction, pressure, correction ([N11] §2). Pure and differentiable."""
    old, density, spacing = state.particles, case.density, case.spacing
    radius = scheme.ratio * spacing
    n0, lam = lattice(scheme.ratio, case.dim)[:2]
    lam = lam * spacing**2
    moves = old.fluid
    moving = moves[:, None]

    # Explicit: viscosity, gravity, noise and collisions give u* and r*.
    neighbors = update(state.neighbors, old.position)
    near = pairs(neighbors, old, spacing)
    w = pair_weight(near, radius)
    current = compression(old.velocity, near, w, radius, n0)
    viscosity = case.fluids.viscosity[old.phase]
    viscous = scheme.viscosity(old.velocity, viscosity, near, w, n0, lam)
    u = old.velocity + jnp.where(moving, dt * (viscous + case.gravity), 0.0)
    u = jnp.where(moving, scheme.noise(u, key), u)
    u = u + scheme.collision(u, near, density, moves, spacing, dt)
    predicted = eqx.tree_at(lambda p: (p.position, p.velocity), old, (old.position + dt * u, u))

    # Implicit: the predicted state gives surface and source, the PPE the pressure.
    neighbors = update(neighbors, predicted.position)
    near = pairs(neighbors, predicted, spacing)
    w = pair_weight(near, radius)
    n, surface = density_and_surface(case, scheme, old, near, w)
    source = scheme.source(compression(u, near, w, radius, n0), current, n0, dt)
    unknown = old.has_pressure & ~surface
    all_w = w
    w = jnp.where(old.has_pressure[:, None] & old.has_pressure[near.j], w, 0.0)
    coefficient = scheme.laplacian(near, w, scheme.ratio, spacing)
    coefficient = scheme.surface_condition.coefficient(coefficient, surface, near)
    operator = poisson_operator(near, coefficient, density, unknown)
    preconditioner = scheme.preconditioning(operator, unknown, near, predicted.position, case.box, spacing)
    p, convergence = solve_pressure(
        operator, source, unknown, old.pressure, preconditioner, scheme.tolerance, scheme.max_iterations
    )
    p = jnp.maximum(p, 0.0) if scheme.clip_pressure else p
    p = scheme.surface_condition.pressure(p, surface, unknown, near, all_w, spacing)

    # Correction: pressure and stabilization change u* and r*.
    a = -scheme.gradient(p, scheme.interface(density, near), near, w, n0)
    a = jnp.where(moving, a, 0.0)
    push = scheme.stabilizer(a, near, all_w, density, moves, spacing, n0, dt)
    position = predicted.position + dt * dt * a + push.displacement
    new = Particles(position, u + dt * a + push.velocity, p, old.kind, old.phase)
    new, info = inspect(case, old, new, near, surface, push, dt, convergence, neighbors.overflow)
    return State(new, neighbors, n, surface, state.time + dt, state.step + 1), info


def density_and_surface(
    case: Case, scheme: Scheme, particles: Particles, near: Pairs, w: Float[Array, "n k"]
) -> tuple[Float[Array, " n"], Bool[Array, " n"]]:
    """The number density and which particles lie on the free surface; dummies never do."""
    n = number_density(w)
    surface = scheme.free_surface(n, near, w, lattice(scheme.ratio, case.dim).n0)
    return n, surface & particles.has_pressure


def compression(
    velocity: Float[Array, "n d"], near: Pairs, w: Float[Array, "n k"], radius: float, n0: float
) -> Compression:
    """All that a source may ask for; what it does not use, the compiler leaves out."""
    return Compression(number_density(w), density_rate(velocity, near, radius), divergence(velocity, near, w, n0))


def largest_step(case: Case, scheme: Scheme, particles: Particles) -> Scalar:
    """Δt [s] that the scheme allows at the present velocities; infinite at rest without gravity."""
    squared_speed = jnp.sum(particles.velocity**2, axis=-1)
    fastest = jnp.max(jnp.where(particles.fluid, squared_speed, 0.0))
    rule, spacing = scheme.time_step, case.spacing
    courant = _over_root(rule.courant * spacing, fastest)
    falling = _over_root(rule.gravity_limit * spacing**0.5, jnp.sqrt(_positive(jnp.sum(case.gravity**2))))
    falling = jnp.where(jnp.any(case.gravity != 0), falling, jnp.inf)
    return jnp.minimum(courant, falling)


def _over_root(a: Scalar, squared: Scalar) -> Scalar:
    """a / √squared, infinite for zero, with derivatives that stay finite there."""
    return jnp.where(squared > 0, a / jnp.sqrt(_positive(squared)), jnp.inf)


def _positive(x: Scalar) -> Scalar:
    return jnp.where(x > 0, x, 1.0)
