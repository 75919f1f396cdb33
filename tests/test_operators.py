"""The operators on lattices, where closed forms are exact, and at a size at which compilers have failed."""

import itertools
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.linalg
from arrangements import CLOUD, DIMENSIONS, SPACING, block, cloud, table
from scipy.spatial import cKDTree

import jaxmps
from jaxmps import Kind, cases, schemes
from jaxmps._compilation import jit
from jaxmps._vectors import joined
from jaxmps.kernels import lattice
from jaxmps.neighbors import pairs
from jaxmps.operators import KernelLaplacian, MinPressure, laplacian, number_density, pair_weight
from jaxmps.operators.gradient import minimum
from jaxmps.pressure import poisson_operator
from jaxmps.stepping import step
from jaxmps.viscosity import Inviscid, Viscous

PRESSURE = np.random.default_rng(4).uniform(0, 1e4, 150)

# Tolerances of 1e-11 and 1e-12: round-off of sums of some ten terms, magnified by l0^2 in second derivatives.


@DIMENSIONS
@pytest.mark.parametrize("ratio", [2.1, 3.1])
def test_laplacian_of_a_paraboloid_is_twice_the_dimension(dim, ratio):
    b = block(dim, ratio)
    phi = jnp.sum((b.points - 0.37) ** 2, axis=1)
    found = laplacian(phi, b.pairs, b.w, b.n0, b.lam)[b.interior]
    assert b.interior.sum() > 0
    np.testing.assert_allclose(found, 2.0 * dim, rtol=1e-11)


@DIMENSIONS
def test_laplacian_of_a_squared_coordinate_is_two_along_each_axis(dim):
    b = block(dim)
    found = laplacian(b.points**2, b.pairs, b.w, b.n0, b.lam)[b.interior]
    np.testing.assert_allclose(found, 2.0, rtol=1e-11)


@DIMENSIONS
def test_laplacian_of_a_constant_is_zero_everywhere(dim):
    b = block(dim)
    phi = jnp.full(len(b.points), 7.3)
    np.testing.assert_array_equal(laplacian(phi, b.pairs, b.w, b.n0, b.lam), 0.0)


@DIMENSIONS
def test_laplacian_of_linear_fields_is_zero_in_the_interior(dim):
    b = block(dim)
    matrix = np.random.default_rng(0).normal(size=(dim, 5))
    found = laplacian(b.points @ matrix, b.pairs, b.w, b.n0, b.lam)[b.interior]
    np.testing.assert_allclose(found, 0.0, atol=1e-11)


def test_laplacian_of_a_vector_field_is_that_of_its_components():
    near, w = cloud()
    u = jnp.array(np.random.default_rng(1).normal(size=(150, 2, 3)))
    whole = laplacian(u, near, w, 6.5, 0.01)
    for a, b in itertools.product(range(2), range(3)):
        part = laplacian(u[:, a, b], near, w, 6.5, 0.01)
        np.testing.assert_allclose(whole[:, a, b], part, rtol=1e-13, atol=1e-11)


def test_laplacian_exchanges_without_loss():
    # Antisymmetric fluxes: the sum over all particles vanishes, in any arrangement.
    near, w = cloud()
    found = laplacian(jnp.array(PRESSURE), near, w, 6.5, 0.01)
    assert abs(float(found.sum())) < 1e-12 * float(jnp.abs(found).sum())


@DIMENSIONS
def test_viscous_acceleration_of_a_parabolic_flow_is_viscosity_times_its_curvature(dim):
    b = block(dim)
    u = jnp.sum(b.points**2, axis=-1)[:, None] * jnp.arange(1.0, dim + 1)
    nu = jnp.full(len(b.points), 0.3)
    found = Viscous()(u, nu, b.pairs, b.w, b.n0, b.lam)[b.interior]
    np.testing.assert_allclose(found, np.broadcast_to(0.3 * 2 * dim * np.arange(1.0, dim + 1), found.shape), rtol=1e-9)
    np.testing.assert_array_equal(Inviscid()(u, nu, b.pairs, b.w, b.n0, b.lam), 0.0)


def test_phases_of_different_viscosity_exchange_momentum_without_loss():
    near, w = cloud()
    rng = np.random.default_rng(7)
    u, nu = jnp.array(rng.normal(size=(150, near.dim))), jnp.array(rng.uniform(0.1, 2.0, 150))
    found = Viscous()(u, nu, near, w, 6.5, 0.01)
    assert np.abs(found.sum(axis=0)).max() < 1e-12 * float(jnp.abs(found).sum())
    assert float(jnp.sum(u * found)) < 0.0  # and take energy out of the flow


@DIMENSIONS
@pytest.mark.parametrize("ratio", [2.1, 3.1])
def test_gradient_of_a_linear_field_is_exact_in_the_interior(dim, ratio):
    b = block(dim, ratio)
    slope = np.array([300.0, -700.0, 500.0])[:dim]
    found = MinPressure()(b.points @ slope + 40.0, jnp.ones_like(b.w), b.pairs, b.w, b.n0)[b.interior]
    np.testing.assert_allclose(found, np.broadcast_to(slope, found.shape), rtol=1e-11)


@DIMENSIONS
def test_gradient_with_the_minimum_is_the_plain_one_in_symmetric_neighborhoods(dim):
    b = block(dim)
    rng = np.random.default_rng(2)
    p = jnp.array(rng.uniform(0, 1e4, len(b.points)))
    near = b.pairs
    plain = (p[near.j] - p[:, None])[..., None] * joined(near.r_ij) * (b.w / near.distance**2)[..., None]
    plain = dim / b.n0 * plain.sum(axis=1)
    found = MinPressure()(p, jnp.ones_like(b.w), near, b.w, b.n0)
    scale = float(jnp.abs(plain).max())
    np.testing.assert_allclose(found[b.interior], plain[b.interior], atol=1e-12 * scale)
    assert np.abs(found - plain)[b.edge == 0].max() > 1e-3 * scale


@DIMENSIONS
def test_constant_pressure_gives_no_force_anywhere(dim):
    b = block(dim)
    p = jnp.full(len(b.points), 1234.5)
    np.testing.assert_array_equal(MinPressure()(p, jnp.ones_like(b.w), b.pairs, b.w, b.n0), 0.0)


def test_pressure_force_of_every_pair_repels():
    # The part of j in the acceleration of i points away from j: p_j is nowhere below the minimum.
    near, w = cloud()
    p = jnp.array(PRESSURE)
    strength = (p[near.j] - minimum(p, near, w > 0)[:, None]) * w
    assert np.all(np.asarray(strength) >= 0)
    assert np.any(np.asarray(strength) > 0)


@pytest.mark.parametrize("pressures", [(5.0, 5.0, 9.0), (0.0, 0.0, 3.0), (4.0, 1.0, 1.0), (1.0, 4.0, 2.0)])
def test_particle_between_two_others_is_pushed_from_the_one_of_higher_pressure(pressures):
    points = np.array([[0.1, 0.0], [0.0, 0.0], [0.23, 0.0]])  # i, left, right
    near = table(points, 2.1 * SPACING)
    w = pair_weight(near, 2.1 * SPACING)
    force = -MinPressure()(jnp.array(pressures), jnp.ones_like(w), near, w, 6.5)[0, 0]
    own, left, right = pressures
    low = min(pressures)
    push = {side: (p - low) * (0.21 / r - 1.0) / r for side, p, r in (("left", left, 0.1), ("right", right, 0.13))}
    assert own >= low
    assert float(force) == pytest.approx(2 / 6.5 * (push["left"] - push["right"]), rel=1e-12)


def test_minimum_includes_the_particle_itself():
    near, w = cloud()
    p = jnp.array(PRESSURE)
    lowest = int(np.argmin(PRESSURE))
    found = np.asarray(minimum(p, near, w > 0))
    assert np.all(found <= PRESSURE)
    assert found[lowest] == PRESSURE[lowest]
    alone = table(np.array([[0.0, 0.0], [1.0, 0.0], [1.1, 0.0]]), 2.1 * SPACING)
    weights = pair_weight(alone, 2.1 * SPACING)
    np.testing.assert_array_equal(minimum(jnp.array([9.0, 3.0, 5.0]), alone, weights > 0), [9.0, 3.0, 3.0])


def test_minimum_counts_only_pairs_of_nonzero_weight():
    near, w = cloud()
    near_radius = 1.3 * SPACING
    short = pair_weight(near, near_radius)
    found = minimum(jnp.array(PRESSURE), near, short > 0)
    distance = np.linalg.norm(CLOUD.points[:, None] - CLOUD.points[None], axis=-1)
    expected = np.where(distance < near_radius, PRESSURE[None], np.inf).min(axis=1)
    np.testing.assert_array_equal(found, expected)
    wide = np.where(distance < 2.1 * SPACING, PRESSURE[None], np.inf).min(axis=1)
    assert np.any(expected != wide)
    np.testing.assert_array_equal(minimum(jnp.array(PRESSURE), near, w > 0), wide)


def test_absent_pairs_have_no_weight():
    near, w = cloud()
    np.testing.assert_array_equal(np.asarray(w)[~np.asarray(near.present)], 0.0)
    assert np.all(np.asarray(w)[np.asarray(near.present)] > 0)


@pytest.mark.parametrize(
    ("ratio", "rows", "corner"),
    [
        (2.1, (0.676, 0.992, 1.0), 0.426),
        (2.4, (0.664, 0.9645, 1.0), 0.414),
        (3.1, (0.641, 0.918, 0.998), 0.391),
        (4.0, (0.622, 0.868, 0.9696), 0.372),
    ],
)
def test_number_density_of_rows_below_a_surface_and_of_a_corner_is_the_tabulated_one(ratio, rows, corner):
    b = block(2, ratio)
    fraction = np.asarray(number_density(b.w)) / b.n0
    side = b.index.shape[0] ** 0.5
    middle = b.index[:, 0] == side // 2
    for row, expected in enumerate(rows):
        here = fraction[middle & (b.index[:, 1] == row)]
        # Half a unit of the last tabulated digit, three or four of them.
        assert here == pytest.approx(expected, abs=5e-4 if round(expected, 3) == expected else 5e-5)
    assert fraction[0] == pytest.approx(corner, abs=5e-4)
    assert fraction[b.interior] == pytest.approx(1.0, rel=1e-13)


# At this size a release of jax compiled gather-heavy sums wrongly, from 16 384 or 32 768 particles on.


def large_tank(dim: int) -> jaxmps.Case:
    """A column in a tank, 40 000 particles, off their lattice so that no sum is trivial."""
    if dim == 2:
        case = cases.dam_break(spacing=0.01, width=4.0, height=0.96, tank_length=4.5, tank_height=1.0)
    else:
        case = cases.dam_break_3d(spacing=0.1, width=3.3, depth=2.8, height=2.7, tank_length=3.4, tank_height=2.8)
    assert 40_000 <= len(case.particles.kind) < 46_000
    return cases.jitter(case, 0.1, jax.random.key(5))


@pytest.fixture(scope="module", params=[2, 3])
def large(request):
    dim = request.param
    jax.config.update("jax_enable_x64", True)  # module fixtures come before the one that sets it for each test
    case = large_tank(dim)
    scheme = schemes.mps(tolerance=1e-10)
    return SimpleNamespace(case=case, scheme=scheme, dim=dim, state=jaxmps.start(case, scheme))


def all_operators(neighbors, particles, case, p, dim):
    radius = 2.1 * case.spacing
    n0, lam = lattice(2.1, dim)[:2]
    near = pairs(neighbors, particles, case.spacing)
    w = pair_weight(near, radius)
    has_pressure = particles.has_pressure
    coefficient = KernelLaplacian()(near, w, 2.1, case.spacing)
    operator = poisson_operator(near, coefficient, case.density, has_pressure)
    return {
        "weight sums": number_density(w),
        "laplacian": laplacian(p, near, w, n0, lam * case.spacing**2),
        "vector laplacian": laplacian(particles.position**2, near, w, n0, lam * case.spacing**2),
        "gradient": MinPressure()(p, jnp.ones_like(w), near, w, n0),
        "pressure matrix": operator @ p,
    }


def test_compiled_operators_agree_with_uncompiled_ones_at_40_000_particles(large):
    case, particles = large.case, large.case.particles
    p = jnp.array(np.random.default_rng(6).uniform(0, 1e4, len(particles.kind)))
    arguments = (large.state.neighbors, particles, case, p, large.dim)
    plain = all_operators(*arguments)
    compiled = jit(all_operators, static_argnums=4)(*arguments)
    for name, expected in plain.items():
        scale = float(jnp.abs(expected).max())
        # Round-off of sums in another order.
        np.testing.assert_allclose(compiled[name], expected, atol=1e-13 * scale, err_msg=name)


def one_step(case: jaxmps.Case, dt: float, relaxation: float, beta: float) -> SimpleNamespace:
    """A step of the standard method for one inviscid fluid at rest, with matrices: [N11] Eqs. 5 to 12."""
    spacing, dim, kind = case.spacing, case.dim, np.asarray(case.particles.kind)
    radius, gravity = 2.1 * spacing, np.asarray(case.gravity)
    n0, lam = lattice(2.1, dim)[:2]
    density = float(case.fluids.density[0])
    moving = (kind == Kind.FLUID)[:, None]
    u = np.where(moving, dt * gravity, 0.0)
    r = np.asarray(case.particles.position) + dt * u
    i, j = cKDTree(r).query_pairs(radius, output_type="ndarray").T
    i, j = np.concatenate([i, j]), np.concatenate([j, i])
    distance = np.linalg.norm(r[j] - r[i], axis=1)
    w = radius / distance - 1.0
    n = np.bincount(i, w, len(r))
    pressed = kind <= Kind.WALL
    surface = pressed & (n < beta * n0)
    unknown = pressed & ~surface
    both = pressed[i] & pressed[j]
    i, j, w, distance = i[both], j[both], w[both], distance[both]
    c = 2 * dim / (lam * spacing**2 * n0) / density * w
    shape = (len(r), len(r))
    matrix = scipy.sparse.diags(np.bincount(i, c, len(r))) - scipy.sparse.csr_matrix((c, (i, j)), shape)
    keep = np.flatnonzero(unknown)
    matrix = matrix.tocsr()[keep][:, keep]
    b = (relaxation / dt**2 * (n - n0) / n0)[keep]
    inverse = scipy.sparse.diags(1 / matrix.diagonal())
    solution, failed = scipy.sparse.linalg.cg(matrix, b, rtol=1e-11, M=inverse)
    assert failed == 0
    p = np.zeros(len(r))
    p[keep] = np.maximum(solution, 0.0)
    low = p.copy()
    np.minimum.at(low, i, p[j])
    factor = dim / n0 * (p[j] - low[i]) * w / distance**2
    gradient = [np.bincount(i, factor * (r[j] - r[i])[:, axis], len(r)) for axis in range(dim)]
    du = np.where(moving, -dt / density * np.stack(gradient, axis=1), 0.0)
    return SimpleNamespace(n=n, surface=surface, p=p, velocity=u + du, position=r + dt * du)


def test_compiled_step_agrees_with_matrices_at_40_000_particles(large):
    case = large.case
    dt = 1e-3 * (case.spacing / 0.01) ** 0.5
    state, info = jit(step)(case, large.scheme, large.state, jnp.array(dt), jax.random.key(0))
    expected = one_step(case, dt, relaxation=0.2, beta=0.97)
    assert int(info.status) == 0
    assert int(info.surface_count) == expected.surface.sum()
    np.testing.assert_array_equal(state.surface, expected.surface)
    np.testing.assert_allclose(state.number_density, expected.n, rtol=1e-12)
    # Both solves stop at a residual of 1e-10 or below; the condition number of the matrix is some 1e4.
    scale = expected.p.max()
    assert scale > 0
    np.testing.assert_allclose(state.particles.pressure, expected.p, atol=1e-6 * scale)
    speed = np.abs(expected.velocity).max()
    np.testing.assert_allclose(state.particles.velocity, expected.velocity, atol=1e-6 * speed)
    np.testing.assert_allclose(state.particles.position, expected.position, atol=1e-6 * speed * dt)


def test_list_at_40_000_particles_has_all_pairs(large):
    case = large.case
    near = pairs(large.state.neighbors, case.particles, case.spacing)
    tree = cKDTree(np.asarray(case.particles.position))
    count = 2 * len(tree.query_pairs(2.1 * case.spacing, output_type="ndarray"))
    assert int(near.present.sum()) == count
    assert not large.state.neighbors.overflow
