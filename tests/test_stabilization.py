"""Dynamic stabilization: pairs that are too close, against closed forms, and clouds, which keep their momentum."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arrangements import CLOUD, DIMENSIONS, SPACING, cloud, couple
from hasty import by_diagonal

import jaxmps
from jaxmps import cases, schemes
from jaxmps._vectors import components, joined
from jaxmps.kernels import lattice
from jaxmps.models import DynamicStabilization, NoStabilization
from jaxmps.models.stabilization import gap
from jaxmps.neighbors import Pairs
from jaxmps.operators import pair_weight

DT = 1e-3
ALPHA = 0.9
LIMIT = ALPHA * SPACING
AXIS = {2: np.array([0.6, 0.8]), 3: np.array([2.0, -1.0, 2.0]) / 3.0}
ACROSS = {2: np.array([-0.8, 0.6]), 3: np.array([1.0, 2.0, 0.0]) / np.sqrt(5.0)}
DENSITIES = pytest.mark.parametrize("density", [(1000.0, 1000.0), (1000.0, 2650.0), (600.0, 1000.0)])
WEIGHTINGS = pytest.mark.parametrize("weighting", ["kernel", "mean", "none"])


def push(near: Pairs, acceleration=None, density=None, moves=None, model=None):
    """What the stabilizer does to particles of one density, all moving and without acceleration unless told."""
    n, dim = near.j.shape[0], near.dim
    zero, ones = jnp.zeros((n, dim)), jnp.ones(n)
    return (model or DynamicStabilization(ALPHA))(
        zero if acceleration is None else jnp.asarray(acceleration),
        near,
        pair_weight(near, 2.1 * SPACING),
        ones if density is None else jnp.asarray(density),
        ones > 0 if moves is None else jnp.asarray(moves),
        SPACING,
        lattice(2.1, dim).n0,
        jnp.array(DT),
    )


def corrected(r: np.ndarray, **arguments) -> np.ndarray:
    """r_2 − r_1 after the correction, for particles r apart before it."""
    a = np.asarray(arguments.get("acceleration", np.zeros((2, len(r)))))
    shift = np.asarray(push(couple(r), **arguments).displacement)
    return r + DT**2 * (a[1] - a[0]) + shift[1] - shift[0]


@DIMENSIONS
@DENSITIES
@pytest.mark.parametrize("fraction", [0.1, 0.5, 0.85])
def test_overlapping_pair_is_pushed_apart_along_its_line_of_centers(dim, density, fraction):
    # With the sign of [T13] Eq. 7 taken literally both displacements would be the opposite.
    away = np.asarray(push(couple(fraction * SPACING * AXIS[dim]), density=density).displacement)
    assert away[0] @ AXIS[dim] < 0.0 < away[1] @ AXIS[dim]
    along = np.outer(away @ AXIS[dim], AXIS[dim])
    np.testing.assert_allclose(away, along, atol=1e-16)


def test_acceleration_of_an_overlapping_pair_has_its_known_size():
    # (w / n0) (α_DS l0 − r) / (2 Δt²) for l0 = 0.02 m, Δt = 1 ms, r = 0.85 l0, with w = 2.1 / 0.85 − 1 and n0 = 6.5397:
    # 112 m/s² away from each other.
    scale = 0.02 / SPACING
    a = np.asarray(push(couple(0.85 * SPACING * AXIS[2])).velocity) / DT * scale
    np.testing.assert_allclose(a @ AXIS[2], [-112.4, 112.4], atol=0.1)


@DIMENSIONS
@pytest.mark.parametrize(("fraction", "closed"), [(0.85, 0.225), (0.7, 0.306), (0.5, 0.489)])
def test_part_of_the_gap_that_a_step_closes_is_the_weight_over_that_of_the_lattice(dim, fraction, closed):
    r = fraction * SPACING * AXIS[dim]
    found = (np.linalg.norm(corrected(r)) - np.linalg.norm(r)) / (LIMIT - np.linalg.norm(r))
    assert found == pytest.approx((2.1 / fraction - 1.0) / lattice(2.1, dim).n0, rel=1e-12)
    if dim == 2:
        assert found == pytest.approx(closed, abs=5e-4)


@pytest.mark.parametrize(("weighting", "closed"), [("mean", 0.153), ("none", 1.0)])
@pytest.mark.parametrize("fraction", [0.85, 0.5])
def test_part_of_the_gap_closed_with_other_weightings_is_the_same_at_any_distance(weighting, closed, fraction):
    r = fraction * SPACING * AXIS[2]
    after = np.linalg.norm(corrected(r, model=DynamicStabilization(ALPHA, weighting=weighting)))
    found = (after - np.linalg.norm(r)) / (LIMIT - np.linalg.norm(r))
    assert found == pytest.approx(closed, abs=5e-4)


@WEIGHTINGS
def test_pair_at_the_limit_or_beyond_feels_nothing(weighting):
    # Powers of two, so that the pair stands exactly at α_DS l0.
    model = DynamicStabilization(0.875 * 0.125 / SPACING, weighting=weighting)
    limit = float(model.alpha_ds) * SPACING
    assert limit == 0.109375
    for distance in (limit, 1.001 * limit, 1.5 * limit, 0.2099):
        found = push(couple(np.array([distance, 0.0])), model=model)
        np.testing.assert_array_equal(found.displacement, 0.0)
        np.testing.assert_array_equal(found.velocity, 0.0)
    assert np.all(push(couple(np.array([0.999 * limit, 0.0])), model=model).displacement[:, 0] != 0.0)


@DIMENSIONS
@DENSITIES
@pytest.mark.parametrize("along", [0.95, 0.4, 0.0, -0.2, -0.7])
@pytest.mark.parametrize("across", [0.0, 0.3])
def test_pair_moved_by_the_pressure_ends_at_the_limit_on_its_own_sides(dim, density, along, across):
    # [T13] Eqs. 10 to 19 close the gap of a pair in one step, before the average of Eq. 7. A negative `along` is a pair
    # that has changed sides: with the magnitude of r*_∥, as Eq. 16 prints it, it would be left there.
    r = 0.95 * SPACING * AXIS[dim]
    target = SPACING * (along * AXIS[dim] + across * ACROSS[dim])
    u = (target - r) / DT**2
    acceleration = np.stack([-0.3 * u, 0.7 * u])
    model = DynamicStabilization(ALPHA, weighting="none")
    end = corrected(r, acceleration=acceleration, density=density, model=model)
    expected = max(along, np.sqrt(ALPHA**2 - across**2)) * SPACING
    np.testing.assert_allclose(end, expected * AXIS[dim] + across * SPACING * ACROSS[dim], atol=1e-14)


def test_pair_that_the_pressure_drives_apart_is_left_alone():
    r = 0.5 * SPACING * AXIS[2]
    apart = 0.41 * SPACING / DT**2 * AXIS[2]
    found = push(couple(r), acceleration=np.stack([-0.5 * apart, 0.5 * apart]))
    np.testing.assert_array_equal(found.displacement, 0.0)


@DIMENSIONS
@WEIGHTINGS
@DENSITIES
def test_forces_of_a_pair_are_opposite(dim, weighting, density):
    acceleration = 3e3 * np.random.default_rng(1).normal(size=(2, dim))
    model = DynamicStabilization(ALPHA, weighting=weighting)
    found = push(couple(0.8 * SPACING * AXIS[dim]), acceleration, density, model=model)
    force = np.array(density)[:, None] * np.asarray(found.displacement)
    assert np.abs(force).max() > 0.0
    np.testing.assert_allclose(force[0], -force[1], rtol=1e-14)


@WEIGHTINGS
def test_cloud_of_two_densities_keeps_its_momentum_and_angular_momentum(weighting):
    rng = np.random.default_rng(2)
    density = np.where(rng.random(150) < 0.5, 1000.0, 2650.0)
    acceleration = 1e3 * rng.normal(size=(150, 2))
    found = push(cloud()[0], acceleration, density, model=DynamicStabilization(ALPHA, weighting=weighting))
    force = density[:, None] * np.asarray(found.velocity)
    size = np.abs(force).sum()
    assert size > 0.0
    # Round-off of a sum of some thousand terms.
    assert np.abs(force.sum(axis=0)).max() < 1e-14 * size
    x, y = CLOUD.points.T
    assert abs(np.sum(x * force[:, 1] - y * force[:, 0])) < 1e-14 * size


@DENSITIES
def test_particle_takes_all_of_the_displacement_from_a_fixed_one(density):
    r = 0.5 * SPACING * AXIS[2]
    model = DynamicStabilization(ALPHA, weighting="none")
    shift = np.asarray(push(couple(r), density=density, moves=(True, False), model=model).displacement)
    np.testing.assert_array_equal(shift[1], 0.0)
    np.testing.assert_allclose(shift[0], -0.4 * SPACING * AXIS[2], rtol=1e-12)
    both = push(couple(r), density=density, moves=(False, False), model=model)
    np.testing.assert_array_equal(both.displacement, 0.0)
    np.testing.assert_array_equal(both.velocity, 0.0)


def test_kept_velocity_scales_the_velocity_and_not_the_displacement():
    near = cloud()[0]
    full = push(near)
    np.testing.assert_allclose(full.velocity, full.displacement / DT, rtol=1e-14)
    for kept in (0.0, 0.2):
        part = push(near, model=DynamicStabilization(ALPHA, kept))
        np.testing.assert_array_equal(part.displacement, full.displacement)
        np.testing.assert_allclose(part.velocity, kept * np.asarray(full.velocity), rtol=1e-14)


@DIMENSIONS
def test_cloud_is_spread_by_repeated_pushes(dim):
    # Pushes of several neighbors hinder each other, and a step closes a part of each gap: the closest pair of a random
    # cloud, with the density of the lattice, comes near the limit within some ten steps.
    size = 6 if dim == 2 else 4
    points = np.random.default_rng(5).uniform(0.0, size * SPACING, (size**dim, dim))
    before = float(jnp.min(all_pairs(points).distance))
    for _ in range(30):
        points = points + np.asarray(push(all_pairs(points)).displacement)
    assert before < 0.3 * SPACING
    assert float(jnp.min(all_pairs(points).distance)) > 0.85 * LIMIT


def all_pairs(points: np.ndarray) -> Pairs:
    """Every pair, however far: tables of one size."""
    n = len(points)
    j = np.array([[j for j in range(n) if j != i] for i in range(n)])
    r_ij = points[j] - points[:, None]
    distance = np.linalg.norm(r_ij, axis=-1)
    return Pairs(jnp.array(j), components(jnp.array(r_ij)), jnp.array(distance), jnp.ones(j.shape, bool))


def test_number_of_pairs_kept_apart_counts_each_pair_once_and_none_of_two_fixed_particles():
    near = cloud()[0]
    moves = np.random.default_rng(6).random(150) < 0.7
    distance = np.linalg.norm(CLOUD.points[:, None] - CLOUD.points[None], axis=-1)
    close = np.triu((distance < LIMIT) & (moves[:, None] | moves[None]), 1)
    assert int(push(near, moves=moves).pairs) == close.sum() > 100
    assert int(push(near, model=NoStabilization()).pairs) == 0


def test_derivative_in_alpha_is_the_closed_form_and_zero_without_an_overlap():
    # d/dα of (w / n0) (√(α² l0² − r_⊥²) − s) / 2, with r_⊥ = 0.3 l0.
    target = SPACING * (0.5 * AXIS[2] + 0.3 * ACROSS[2])
    near = couple(0.8 * SPACING * AXIS[2])
    u = (target - 0.8 * SPACING * AXIS[2]) / DT**2

    def slope(acceleration):
        moved = jax.jacfwd(lambda alpha: push(near, acceleration, model=DynamicStabilization(alpha)).displacement)
        return moved(jnp.array(ALPHA))

    expected = 0.5 * (2.1 / 0.8 - 1.0) / lattice(2.1, 2).n0 * SPACING * ALPHA / np.sqrt(ALPHA**2 - 0.3**2)
    np.testing.assert_allclose(slope(np.stack([0.0 * u, u])) @ AXIS[2], [-expected, expected], rtol=1e-12)
    np.testing.assert_array_equal(slope(np.stack([0.0 * u, -u])), 0.0)


@DIMENSIONS
def test_derivatives_are_finite_with_empty_slots_and_without_overlaps(dim):
    near = couple(0.95 * SPACING * AXIS[dim])

    def total(r_ij, acceleration, alpha, dt):
        distance = jnp.sqrt(jnp.where(near.present, jnp.sum(r_ij**2, axis=-1), SPACING**2))
        moved = Pairs(near.j, components(r_ij), distance, near.present)
        weights = jnp.arange(1.0, 5.0).reshape(2, 2)
        shift = push(moved, acceleration, model=DynamicStabilization(alpha)).displacement
        return jnp.sum(weights * gap(acceleration, moved, alpha * SPACING, dt)) + jnp.sum(shift[0])

    for alpha, some in ((0.9, False), (1.0, True)):
        arguments = joined(near.r_ij), jnp.zeros((2, dim)), jnp.array(alpha), jnp.array(DT)
        found = jax.grad(total, argnums=(0, 1, 2, 3))(*arguments)
        assert all(np.all(np.isfinite(x)) for x in found)
        assert bool(jnp.any(found[0] != 0.0)) == some


@pytest.mark.parametrize("make", [schemes.mps_hs_gc_ds, schemes.mps_cd_gc_ds])
@pytest.mark.parametrize("courant", [0.1, 0.25])
def test_alpha_is_one_less_the_courant_number_unless_given(make, courant):
    assert float(make(courant=courant).stabilizer.alpha_ds) == pytest.approx(1.0 - courant, rel=1e-15)
    assert float(make(courant=courant, alpha_ds=0.7).stabilizer.alpha_ds) == pytest.approx(0.7, rel=1e-15)
    assert float(make(courant=courant).time_step.courant) == pytest.approx(courant, rel=1e-15)


def test_no_stabilization_does_nothing():
    found = push(cloud()[0], model=NoStabilization())
    np.testing.assert_array_equal(found.velocity, 0.0)
    np.testing.assert_array_equal(found.displacement, 0.0)


def end_of_a_tank(scheme: jaxmps.Scheme) -> np.ndarray:
    """Position, velocity and pressure of a sloshing tank after some steps, side by side."""
    case = cases.hydrostatic(spacing=0.1, length=0.8, height=0.6, freeboard=0.2)
    x, y = np.asarray(case.particles.position).T
    swirl = 0.2 * np.stack([np.sin(np.pi * x / 0.8), np.cos(np.pi * x / 0.8) * y], axis=1)
    velocity = jnp.array(np.where(np.asarray(case.particles.fluid)[:, None], swirl, 0.0))
    case = eqx.tree_at(lambda c: c.particles.velocity, case, velocity)
    end = jaxmps.rollout(case, by_diagonal(scheme), jaxmps.start(case, scheme), steps=10, dt=2e-3)[0].particles
    return np.concatenate([end.position, end.velocity, end.pressure[:, None]], axis=1)


@pytest.mark.slow
def test_step_without_overlaps_is_that_of_the_scheme_without_stabilization():
    # The pressure force that decides on an overlap is that of the corrected gradient. Round-off: compilers order sums
    # differently. With a limit beyond the spacing of the particles the flow is another one.
    plain = end_of_a_tank(schemes.mps_hs_gc(tolerance=1e-12))
    scale = np.abs(plain).max(axis=0)
    assert np.all(scale > 0.01)
    np.testing.assert_allclose(end_of_a_tank(schemes.mps_hs_gc_ds(tolerance=1e-12)) / scale, plain / scale, atol=1e-9)
    other = end_of_a_tank(schemes.mps_hs_gc_ds(alpha_ds=1.1, tolerance=1e-12))
    assert np.abs(other - plain)[:, 2].max() > 1e-3
