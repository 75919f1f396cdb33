"""One time step, in the order of the papers."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from jaxmps._types import Scalar, positive_or_one
from jaxmps.flow import Case, Kind, Particles, energy_loss, kinetic_energy
from jaxmps.kernels import lattice
from jaxmps.models import Compression, beside_walls, wall_work
from jaxmps.monitor import StepInfo, Work, inspect
from jaxmps.neighbors import Neighbors, Pairs, pairs, update
from jaxmps.operators import density_rate, divergence, number_density, pair_weight
from jaxmps.pressure import Convergence, PressureEquation, poisson_operator, solve_pressure
from jaxmps.scheme import Scheme


class State(eqx.Module):
    """A flow at an instant: particles, their list, the number density and surface of the last prediction, time [s], and
    the `loss` of energy [J/kg] in the last step, not counting what walls did to it, which noise gives back.
    """

    particles: Particles
    neighbors: Neighbors
    number_density: Float[Array, " n"]
    surface: Bool[Array, " n"]
    time: Scalar
    step: Int[Array, ""]
    loss: Scalar


class Prediction(NamedTuple):
    """The flow after the explicit part of a step, without the pressure: u*, r*, and what belongs to them.

    `density` [kg/m³] is that by which pressures act, of one entry where there is one fluid; `given`: energy [J/kg] of
    the `noise` [m/s].
    """

    particles: Particles
    neighbors: Neighbors
    near: Pairs
    w: Float[Array, "n k"]
    number_density: Float[Array, " n"]
    surface: Bool[Array, " n"]
    source: Float[Array, " n"]
    density: Float[Array, " #n"]
    noise: Float[Array, "n d"]
    given: Scalar


def step(case: Case, scheme: Scheme, state: State, dt: Scalar, key: Key[Array, ""]) -> tuple[State, StepInfo]:
    """The flow after `dt` [s]: explicit prediction, pressure, correction ([N11] §2). Pure and differentiable."""
    prediction = predict(case, scheme, state, dt, key)
    equation = pressure_equation(case, scheme, prediction)
    p, convergence = solve_pressure(equation, scheme.tolerance, scheme.max_iterations)
    return correct(case, scheme, state, prediction, equation.unknown, p, convergence, dt)


def predict(case: Case, scheme: Scheme, state: State, dt: Scalar, key: Key[Array, ""]) -> Prediction:
    """Explicit: viscosity, gravity, noise and collisions give u*, r*, then walls move; these n*, surface and source."""
    old, spacing = state.particles, case.spacing
    radius = scheme.ratio * spacing
    n0, lam = lattice(scheme.ratio, case.dim)[:2]
    moving = old.fluid[:, None]
    neighbors = update(state.neighbors, old.listed_position)
    near = pairs(neighbors, old, spacing)
    w = pair_weight(near, radius)
    current = compression(old.velocity, near, w, radius, n0)
    viscosity, density = case.distinct_viscosity, case.distinct_density
    viscous = scheme.viscosity(old.velocity, viscosity, density, old.fluid, near, w, n0, lam * spacing**2)
    u = old.velocity + jnp.where(moving, dt * (viscous + case.gravity), 0.0)
    mass = jnp.where(old.fluid, case.density, 0.0)
    noise = scheme.noise(u, state.loss, mass, case.box.periodic, key)
    given = kinetic_energy(u + noise, mass) - kinetic_energy(u, mass)
    u = u + noise
    u = u + scheme.collision(u, near, case.distinct_density, old.fluid, spacing, dt)
    position, u = case.box.reflect(old.position + dt * u, u)
    predicted = eqx.tree_at(lambda p: (p.position, p.velocity), old, (position, u))
    predicted = case.motion.drive(predicted, case.particles.position, state.time + dt)

    neighbors = update(neighbors, predicted.listed_position)
    near = pairs(neighbors, predicted, spacing)
    w = pair_weight(near, radius)
    n, surface = density_and_surface(case, scheme, old, near, w)
    source = scheme.source(compression(predicted.velocity, near, w, radius, n0), current, n0, dt)
    density = density if len(density) == 1 else beside_walls(density, old.fluid, near, w)
    return Prediction(predicted, neighbors, near, w, n, surface, source, density, noise, given)


def pressure_equation(case: Case, scheme: Scheme, prediction: Prediction) -> PressureEquation:
    """Implicit: the PPE at r*, between particles that have a pressure."""
    particles, near, surface = prediction.particles, prediction.near, prediction.surface
    unknown = particles.has_pressure & ~surface
    coefficient = scheme.laplacian(near, _between_pressures(prediction), scheme.ratio, case.spacing)
    coefficient = scheme.surface_condition.coefficient(coefficient, surface, near)
    operator = poisson_operator(near, coefficient, prediction.density, unknown, case.box.open_axis)
    inside = case.box.wrap(particles.position)  # where a motion has its walls may be periods away
    preconditioner = scheme.preconditioning(operator, unknown, near, inside, case.box, case.spacing)
    return PressureEquation(operator, prediction.source, unknown, particles.pressure, preconditioner)


def correct(
    case: Case,
    scheme: Scheme,
    state: State,
    prediction: Prediction,
    unknown: Bool[Array, " n"],
    p: Float[Array, " n"],
    convergence: Convergence,
    dt: Scalar,
) -> tuple[State, StepInfo]:
    """The solved pressure and the stabilizer change u* and r*."""
    predicted, near, surface, moves = prediction.particles, prediction.near, prediction.surface, state.particles.fluid
    n0, density, spacing = lattice(scheme.ratio, case.dim).n0, prediction.density, case.spacing
    p = jnp.maximum(p, 0.0) if scheme.clip_pressure else p
    p = scheme.surface_condition.pressure(p, surface, unknown, near, prediction.w, spacing)
    a = -scheme.gradient(p, scheme.interface(density, near), near, _between_pressures(prediction), n0)
    a = jnp.where(moves[:, None], a, 0.0)
    push = scheme.stabilizer(a, near, prediction.w, density, moves, spacing, n0, dt)
    position = predicted.position + dt * dt * a + push.displacement
    velocity = predicted.velocity + dt * a + push.velocity
    position, velocity = case.box.reflect(position, velocity)
    new = Particles(position, velocity, p, predicted.kind, predicted.phase)
    by_walls = work_of_walls(case, scheme, state.particles, prediction, new, dt)
    loss = energy_loss(state.particles, new, case.density, case.gravity, dt) + by_walls
    full, work = prediction.neighbors.overflow, Work(prediction.given, by_walls, loss)
    new, info = inspect(case, state.particles, new, near, surface, push, work, dt, convergence, full)
    n = prediction.number_density
    return State(new, prediction.neighbors, n, surface, state.time + dt, state.step + 1, loss), info


def work_of_walls(
    case: Case, scheme: Scheme, old: Particles, prediction: Prediction, new: Particles, dt: Scalar
) -> Scalar:
    """Energy [J/kg] that moving walls give to the fluid in a step."""
    if not case.walls_move:
        return jnp.zeros_like(dt)
    fluid, n0 = old.fluid, lattice(scheme.ratio, case.dim).n0
    mass = jnp.where(fluid, case.density, 0.0)
    gained = mass[:, None] * (new.velocity - old.velocity - dt * case.gravity - prediction.noise)
    at, near, w = prediction.particles, prediction.near, prediction.w
    walls = 0.5 * (old.velocity + at.velocity)
    has_pressure = at.has_pressure
    work = wall_work(gained, new.pressure, fluid, has_pressure, at.position, walls, near, w, n0, dt, case.box)
    return work / positive_or_one(jnp.sum(mass))


def _between_pressures(prediction: Prediction) -> Float[Array, "n k"]:
    """The weights of pairs of which both particles have a pressure."""
    has_pressure = prediction.particles.has_pressure
    return jnp.where(has_pressure[:, None] & prediction.near.at_j(has_pressure), prediction.w, 0.0)


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


class Limits(NamedTuple):
    """Δt [s] that the Courant number, gravity and viscosity allow, infinite where they set no limit."""

    speed: Scalar
    gravity: Scalar
    viscosity: Scalar


def largest_step(case: Case, scheme: Scheme, particles: Particles) -> Scalar:
    """Δt [s] that the scheme allows: the least of `limits`."""
    speed, gravity, viscosity = limits(case, scheme, particles)
    return jnp.minimum(jnp.minimum(speed, gravity), viscosity)


def limits(case: Case, scheme: Scheme, particles: Particles) -> Limits:
    """What limits Δt at the present velocities, of walls too."""
    squared_speed = jnp.sum(particles.velocity**2, axis=-1)
    fastest = jnp.max(jnp.where(particles.kind != Kind.REMOVED, squared_speed, 0.0))
    rule, spacing = scheme.time_step, case.spacing
    courant = _over_root(rule.courant * spacing, fastest)
    falling = _over_root(rule.gravity_limit * spacing**0.5, jnp.sqrt(positive_or_one(jnp.sum(case.gravity**2))))
    falling = jnp.where(jnp.any(case.gravity != 0), falling, jnp.inf)
    return Limits(courant, falling, scheme.viscosity.largest_step(case.fluids.viscosity, spacing, case.dim))


def _over_root(a: Scalar, squared: Scalar) -> Scalar:
    """a / √squared, infinite for zero, with derivatives that stay finite there."""
    return jnp.where(squared > 0, a / jnp.sqrt(positive_or_one(squared)), jnp.inf)
