"""At 40 000 particles compiled code agrees with uncompiled code and with matrices; it is compiled as users get it.

A release of jax compiled gather-heavy sums wrongly, from 16 384 or 32 768 particles on.
"""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.linalg
from hasty import with_care
from scipy.spatial import cKDTree

import jaxmps
from jaxmps import Kind, cases, schemes
from jaxmps._compilation import jit
from jaxmps.kernels import lattice
from jaxmps.neighbors import pairs
from jaxmps.operators import KernelLaplacian, MinPressure, laplacian, number_density, pair_weight
from jaxmps.pressure import poisson_operator
from jaxmps.stepping import step


@pytest.fixture(autouse=True, scope="module")
def as_users_compile():
    with with_care():
        yield


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


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize("large", [2, 3], indirect=True)
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
