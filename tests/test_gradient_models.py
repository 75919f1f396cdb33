"""The antisymmetric and the corrected gradient: closed forms on lattices and in random clouds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arrangements import CLOUD, DIMENSIONS, SPACING, block, box_cloud, cloud, couple, strength, table

from jaxmps._vectors import components
from jaxmps.kernels import lattice
from jaxmps.models import OwnDensity, PairedDensity
from jaxmps.neighbors import Pairs
from jaxmps.operators import CMPS, Corrected, MinPressure, pair_weight
from jaxmps.operators.gradient import minimum, solve_small, weighted_gradient

RADIUS = 2.1 * SPACING
PRESSURE = np.random.default_rng(4).uniform(-1e4, 1e4, 150)
SLOPE = np.array([300.0, -700.0, 500.0])
MODELS = pytest.mark.parametrize("model", [MinPressure(), CMPS(), Corrected()])


def gradient(model, p, near: Pairs, n0: float, pair_density=None):
    w = pair_weight(near, RADIUS)
    return model(jnp.asarray(p), jnp.ones_like(w) if pair_density is None else pair_density, near, w, n0)


# CMPS


def test_forces_of_the_antisymmetric_gradient_sum_to_zero():
    near, w = cloud()
    found = CMPS()(jnp.array(PRESSURE), jnp.full_like(w, 1000.0), near, w, CLOUD.n0)
    # Round-off of a sum of some thousand terms.
    assert np.abs(found.sum(axis=0)).max() < 1e-14 * np.abs(found).sum()
    other = MinPressure()(jnp.array(PRESSURE), jnp.full_like(w, 1000.0), near, w, CLOUD.n0)
    assert np.abs(other.sum(axis=0)).max() > 1e-3 * np.abs(other).sum()


def test_antisymmetric_gradient_keeps_momentum_at_unequal_densities_with_the_own_density_only():
    near, w = cloud()
    density = jnp.array(np.where(np.random.default_rng(1).random(150) < 0.5, 1000.0, 2650.0))
    drift = {}
    for interface in (OwnDensity(), PairedDensity()):
        a = CMPS()(jnp.array(PRESSURE), interface(density, near), near, w, CLOUD.n0)
        force = np.asarray(density[:, None] * a)
        drift[type(interface)] = np.abs(force.sum(axis=0)).max() / np.abs(force).sum()
    assert drift[OwnDensity] < 1e-14
    assert drift[PairedDensity] > 1e-4


def test_every_pair_of_the_antisymmetric_gradient_repels():
    near, w = cloud()
    pushes = strength(CMPS(), jnp.array(PRESSURE), near, w, CLOUD.n0)[np.asarray(w) > 0]
    # Round-off, of pressures up to 1e4.
    assert pushes.min() > -1e-9
    assert np.mean(pushes > 1.0) > 0.9
    for pressures in ((5.0, 9.0), (-3.0, 2.0), (7.0, -7.0)):
        force = -np.asarray(gradient(CMPS(), pressures, couple(np.array([SPACING, 0.0])), CLOUD.n0))
        assert force[0, 0] < 0.0 < force[1, 0]


def test_repulsion_of_the_antisymmetric_gradient_is_not_always_the_larger_part():
    # [T13] Eq. 6, |(p_i − p̂_i) + (p_i − p̂_j)| ≥ |p_j − p_i|, holds for p_j ≤ p_i, since p̂_i ≤ p_j and p̂_j ≤ p_j. If i
    # has the lowest pressure of its own neighborhood and that of j, the left side is zero.
    near, w = cloud()
    p = jnp.array(PRESSURE)
    low = minimum(p, near, w > 0)
    difference = np.asarray(p[near.j] - p[:, None])
    left, right = np.abs(strength(CMPS(), p, near, w, CLOUD.n0) - difference), np.abs(difference)
    holds, counts = left >= right - 1e-9, np.asarray(w > 0)
    assert np.all(holds[counts & np.asarray(p[near.j] <= p[:, None])])
    assert not np.all(holds[counts])
    i = int(np.argmin(PRESSURE))
    lowest_of_both = counts[i] & np.asarray(low[near.j[i]] == p[i])
    assert np.any(lowest_of_both)
    np.testing.assert_allclose(left[i][lowest_of_both], 0.0, atol=1e-9)


@DIMENSIONS
def test_antisymmetric_gradient_of_a_linear_pressure_vanishes_inside_a_lattice(dim):
    # p_i − p̂_i is the same for all particles with a full neighborhood: every pair has the same difference.
    b = block(dim, size=12 if dim == 2 else 10)
    found = CMPS()(b.points @ SLOPE[:dim] + 1e4, jnp.ones_like(b.w), b.pairs, b.w, b.n0)
    # Neighbors, too, need full neighborhoods.
    np.testing.assert_allclose(found[b.edge >= 4], 0.0, atol=1e-13 * 1e4 / SPACING)
    assert np.abs(found[b.edge == 0]).max() > 300.0


# GC


@DIMENSIONS
def test_corrected_gradient_of_a_linear_field_is_exact_in_any_arrangement(dim):
    c = box_cloud(dim)
    found = gradient(Corrected(), c.points @ SLOPE[:dim] - 4e3, c.pairs, c.n0)
    exact = c.well_placed
    inside = np.all((c.points > RADIUS) & (c.points < c.points.max() - RADIUS), axis=1)
    assert np.sum(exact & ~inside) > 50 and np.sum(exact & inside) > 2
    # Round-off, magnified by the inverse of a matrix with a determinant above 0.05.
    np.testing.assert_allclose(found[exact], np.broadcast_to(SLOPE[:dim], (exact.sum(), dim)), atol=1e-8)
    plain = weighted_gradient(
        jnp.array(c.points @ SLOPE[:dim])[c.pairs.j] - (c.points @ SLOPE[:dim])[:, None], c.pairs, c.w, c.n0
    )
    assert np.abs(plain - SLOPE[:dim]).mean() > 100.0


@DIMENSIONS
def test_corrected_gradient_is_the_plain_one_inside_a_lattice(dim):
    b = block(dim)
    p = jnp.array(np.random.default_rng(2).uniform(-1e4, 1e4, len(b.points)))
    expected = weighted_gradient(p[b.pairs.j] - p[:, None], b.pairs, b.w, b.n0)
    found = gradient(Corrected(), p, b.pairs, b.n0)
    scale = float(jnp.abs(expected).max())
    np.testing.assert_allclose(found[b.interior], expected[b.interior], atol=1e-13 * scale)


@pytest.mark.parametrize(("model", "attracts"), [(Corrected(), True), (CMPS(), False), (MinPressure(), False)])
def test_corrected_gradient_alone_draws_a_particle_to_one_of_lower_pressure(model, attracts):
    force = -np.asarray(gradient(model, [-100.0, -300.0], couple(np.array([SPACING, 0.0])), CLOUD.n0))
    assert (force[0, 0] > 0.0) == attracts


@DIMENSIONS
@pytest.mark.parametrize("shape", ["one", "as many as dimensions", "flat"])
def test_corrected_gradient_falls_back_to_the_plain_one_with_too_few_or_aligned_neighbors(dim, shape):
    axes = SPACING * np.eye(dim)
    steps = {
        "one": axes[:1],
        "as many as dimensions": axes,
        # On a line in 2-D, in a plane in 3-D.
        "flat": np.concatenate([axes[:-1], -axes[:-1], 0.4 * axes[:-1], 1.7 * axes[:-1]]),
    }[shape]
    points = jnp.array(np.concatenate([np.zeros((1, dim)), steps]))
    near, n0 = table(np.asarray(points), RADIUS), lattice(2.1, dim).n0
    p = jnp.array(np.random.default_rng(7).uniform(-1e4, 1e4, len(points)))

    def first(points, p):
        r_ij = jnp.where(near.present[..., None], points[near.j] - points[:, None], 0.0)
        distance = jnp.sqrt(jnp.where(near.present, jnp.sum(r_ij**2, axis=-1), SPACING**2))
        return gradient(Corrected(), p, Pairs(near.j, components(r_ij), distance, near.present), n0)[0]

    length = np.linalg.norm(steps, axis=1)
    weight = np.where(length < RADIUS, RADIUS / length - 1.0, 0.0) / length**2
    plain = dim / n0 * np.sum((weight * np.asarray(p[1:] - p[0]))[:, None] * steps, axis=0)
    np.testing.assert_allclose(first(points, p), plain, rtol=1e-12, atol=1e-9)
    for derivative in jax.jit(jax.grad(lambda r, p: first(r, p) @ jnp.arange(1.0, dim + 1), argnums=(0, 1)))(points, p):
        assert np.all(np.isfinite(derivative))
        assert np.any(derivative != 0.0)


@MODELS
def test_constant_pressure_gives_no_force(model):
    near, _ = cloud()
    np.testing.assert_array_equal(gradient(model, np.full(150, -1234.5), near, CLOUD.n0), 0.0)


@MODELS
def test_density_of_the_pairs_divides_the_gradient(model):
    near, _ = cloud()
    plain = gradient(model, PRESSURE, near, CLOUD.n0)
    divided = gradient(model, PRESSURE, near, CLOUD.n0, jnp.full(near.j.shape, 800.0))
    scale = float(jnp.abs(plain).max())
    np.testing.assert_allclose(divided * 800.0, plain, atol=1e-12 * scale)


@DIMENSIONS
def test_small_systems_are_solved_as_by_elimination(dim):
    rng = np.random.default_rng(8)
    root = rng.normal(size=(50, dim, dim))
    matrix = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(dim)
    b = rng.normal(size=(50, dim))
    found = solve_small(jnp.array(matrix), jnp.array(b))
    # Condition numbers up to some hundreds.
    np.testing.assert_allclose(found, np.linalg.solve(matrix, b[..., None])[..., 0], rtol=1e-9, atol=1e-11)
