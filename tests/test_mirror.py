"""A mirror at the lower end of an axis: images of the particles take the place of a wall."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hasty import by_diagonal, quick

import jaxmps as mps
from jaxmps.flow import Kind, at_rest
from jaxmps.neighbors import allocate, pairs
from jaxmps.operators import laplacian, number_density, pair_weight
from jaxmps.pressure import poisson_operator

SPACING, RADIUS = 0.05, 0.105
G = 9.81


def cloud(dim, mirror, periodic, seed=0):
    """Disordered particles in a box, and their pairs."""
    rng = np.random.default_rng(seed)
    sides = [range(8)] * dim
    points = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, dim)
    position = SPACING * (points + 0.5 + rng.uniform(-0.3, 0.3, points.shape))
    box = mps.Box((0.0,) * dim, (8 * SPACING,) * dim, periodic, mirror)
    particles = at_rest(jnp.array(position), np.full(len(points), Kind.FLUID))
    neighbors = allocate(particles.position, box, RADIUS, 0.1 * SPACING, 60 if dim == 3 else 24)
    assert not bool(neighbors.overflow)
    return particles, neighbors, pairs(neighbors, particles, SPACING)


def reflected(x, mirror):
    """Vectors with their component along the axis of the mirror, which stands at zero, turned."""
    return x * np.where(np.arange(x.shape[-1]) == mirror, -1.0, 1.0)


@pytest.mark.parametrize("precision", ["single", "double"], indirect=True)
@pytest.mark.parametrize(
    ("dim", "mirror", "periodic"),
    [(2, 1, (True, False)), (2, 0, (False, False)), (2, 0, (False, True)), (3, 2, (True, True, False))],
)
def test_pairs_are_those_with_particles_and_with_images_in_a_box_twice_as_large(dim, mirror, periodic, precision):
    particles, _, near = cloud(dim, mirror, periodic)
    position = np.asarray(particles.position, float)
    whole = np.concatenate([position, reflected(position, mirror)])
    r = whole[None] - position[:, None]
    r -= np.where(periodic, 8 * SPACING * np.round(r / (8 * SPACING)), 0.0)
    distance = np.linalg.norm(r, axis=-1)
    expected = (distance < RADIUS) & (np.arange(len(whole)) != np.arange(len(position))[:, None])
    found = np.zeros_like(expected)
    i, k = np.nonzero(np.asarray(near.present))
    j = np.asarray(near.j)[i, k] + len(position) * np.asarray(near.image)[i, k]
    found[i, j] = True
    assert found.sum() == len(i)
    np.testing.assert_array_equal(found, expected)
    assert np.any(np.asarray(near.own_image))
    r_ij = np.stack([np.asarray(x) for x in near.r_ij], axis=-1)[i, k]
    np.testing.assert_allclose(r_ij, r[i, j], atol=1e-6)
    np.testing.assert_allclose(np.asarray(near.distance)[i, k], distance[i, j], rtol=2e-5)


def wave() -> mps.Case:
    return mps.cases.standing_wave(spacing=0.05, floor="mirror")


@quick
def fifty_steps(case, scheme, state):
    first = lambda s: (s.particles.position[0, 1], s.particles.velocity[0, 1])  # noqa: E731
    return mps.rollout(case, scheme, state, steps=50, dt=2e-3, record=first)


def rolled(case, scheme, times: int = 1):
    """The particles after that many fifty steps; height and upward speed of the first and the status, step by step."""
    state, told = mps.start(case, scheme), []
    for _ in range(times):
        state, info, (height, speed) = fifty_steps(case, scheme, state)
        told.append((height, speed, info.status))
    return state.particles, *(np.concatenate(one) for one in zip(*told, strict=True))


def test_number_density_on_a_lattice_is_complete_down_to_the_mirror():
    points = np.stack(np.meshgrid(range(8), range(6), indexing="ij"), axis=-1).reshape(-1, 2)
    position = jnp.array(SPACING * (points + 0.5))
    box = mps.Box((0.0, 0.0), (8 * SPACING, 1.0), (True, False), 1)
    particles = at_rest(position, np.full(len(points), Kind.FLUID))
    near = pairs(allocate(position, box, RADIUS, 0.1 * SPACING, 20), particles, SPACING)
    n = np.asarray(number_density(pair_weight(near, RADIUS)))
    np.testing.assert_allclose(n[points[:, 1] < 4], 6.5397, rtol=1e-5)


def test_vectors_of_images_are_mirrored_and_scalars_are_not():
    particles, _, near = cloud(2, 1, (True, False))
    rng = np.random.default_rng(1)
    u, p = rng.normal(size=particles.position.shape), rng.normal(size=len(particles.kind))
    image, j = np.asarray(near.image), np.asarray(near.j)
    at_j = np.where(image[..., None], reflected(u[j], 1), u[j])
    for axis, between in enumerate(near.between(jnp.array(u))):
        np.testing.assert_allclose(between, at_j[..., axis] - u[:, None, axis], atol=1e-15)
    np.testing.assert_array_equal(near.at_j(jnp.array(p)), p[j])
    # A flow along the mirror slips, and one against it is stopped: u_y = y has no Laplacian, u_x = |y| has one there.
    y = particles.position[:, 1]
    w = pair_weight(near, RADIUS)
    along = laplacian(jnp.stack([0.3 + 0.0 * y, y], axis=1), near, w, 6.5397, 1.0)
    np.testing.assert_allclose(along[:, 0], 0.0, atol=1e-12)
    by_y = np.sum(np.asarray(w) * np.asarray(near.r_ij[1]), axis=1)
    np.testing.assert_allclose(along[:, 1], 4.0 / 6.5397 * by_y, rtol=1e-10, atol=1e-12)


def test_pressure_matrix_is_symmetric_and_blind_to_own_images():
    particles, _, near = cloud(2, 1, (True, False))
    n = len(particles.kind)
    coefficient = pair_weight(near, RADIUS)
    unknown = jnp.asarray(np.asarray(particles.position[:, 1]) < 6 * SPACING)
    operator = poisson_operator(near, coefficient, jnp.ones(n), unknown)
    dense = np.asarray(jax.vmap(lambda x: operator @ x)(jnp.eye(n)))
    np.testing.assert_allclose(dense, dense.T, atol=1e-15)
    assert np.linalg.eigvalsh(dense).min() > 0.0
    # Without the coupling to the surface a constant pressure feels nothing: own images neither add nor take.
    constant = jnp.where(unknown, 1.0, 0.0)
    np.testing.assert_allclose((operator @ constant)[unknown], operator.sink[unknown], atol=1e-12)


@pytest.mark.slow
def test_a_particle_that_comes_through_is_reflected():
    box = mps.Box((0.0, -1.0), (2.0, 3.0), (False, False), 1)
    position = jnp.array([[0.5, -1.25], [0.5, -0.75], [1.0, -1.0]])
    velocity = jnp.array([[1.0, -2.0], [1.0, -2.0], [1.0, 0.0]])
    position, velocity = box.reflect(position, velocity)
    np.testing.assert_allclose(position, [[0.5, -0.75], [0.5, -0.75], [1.0, -1.0]])
    np.testing.assert_allclose(velocity, [[1.0, 2.0], [1.0, -2.0], [1.0, 0.0]])
    # As the drop that falls on it does: nothing is lost or stuck, and it never gets below.
    case, scheme = wave(), mps.schemes.mps(tolerance=1e-10)
    particles = case.particles
    kind = jnp.full_like(particles.kind, Kind.REMOVED).at[0].set(Kind.FLUID)
    alone = dataclasses.replace(particles, position=particles.position.at[0].set(jnp.array([0.5, 0.3])), kind=kind)
    case = dataclasses.replace(case, particles=alone)
    height, speed, status = rolled(case, scheme, times=5)[1:]
    assert not np.any(status)
    assert height.min() > 0.0
    assert np.any(speed > 0.1)


def test_water_at_rest_on_a_mirror_has_hydrostatic_pressure():
    case = mps.cases.standing_wave(spacing=0.025, depth=0.3, amplitude=0.0, floor="mirror")
    run = mps.simulate(case, by_diagonal(mps.schemes.mps()), until=0.5, save_every=0.1, progress=False)
    assert run.status.completed
    y, p = run.position[-1, :, 1], run.pressure[-1]
    weight = 1000.0 * G * (y.max() - y)
    deep = weight > 3.0 * 1000.0 * G * case.spacing
    # The standard method has 1.04 times the weight at a wall, whose particles stand in line with the water's.
    np.testing.assert_allclose(p[deep], weight[deep], rtol=0.1)
    assert np.polyfit(weight[deep], p[deep], 1)[0] == pytest.approx(1.0, abs=0.03)
    assert np.abs(run.velocity[-1]).max() < 0.02


@pytest.mark.slow
def test_antisymmetric_forces_keep_the_momentum_along_a_smooth_floor_to_round_off():
    # Disordered: a symmetric wave would keep its momentum with any scheme, and on any floor.
    drift = {}
    case = mps.cases.jitter(wave(), 0.05, jax.random.key(0))
    for scheme in (by_diagonal(mps.schemes.cmps_hs()), mps.schemes.mps(tolerance=1e-10)):
        end, _, _, status = rolled(case, scheme, times=3)
        assert not np.any(status)
        drift[scheme.name] = abs(float(jnp.mean(end.velocity[:, 0])))
    assert drift["cmps_hs"] < 1e-13
    assert drift["mps"] > 1e-6


def test_multigrid_and_jacobi_agree_with_a_mirror():
    multigrid = mps.schemes.mps(tolerance=1e-10)
    ends = [rolled(wave(), scheme)[0] for scheme in (multigrid, by_diagonal(multigrid))]
    np.testing.assert_allclose(ends[0].position, ends[1].position, atol=1e-9)


def test_derivative_with_a_mirror_is_that_of_differences():
    case = mps.cases.standing_wave(spacing=0.1, floor="mirror")
    scheme = by_diagonal(mps.schemes.mps_hs_gc_ds(tolerance=1e-13))

    @quick
    def speed(shift, begin):
        def loss(shift):
            low = jnp.argmin(begin.particles.position[:, 1])
            moved = eqx.tree_at(lambda s: s.particles.position, begin, begin.particles.position.at[low, 1].add(shift))
            end = mps.rollout(case, scheme, moved, steps=3, dt=2e-3)[0]
            return jnp.sum(end.particles.velocity[:, 1] ** 2), end

        return jax.value_and_grad(loss, has_aux=True)(shift)

    zero, h, begin = jnp.zeros(()), 1e-7, mps.start(case, scheme)
    for _ in range(2):
        (_, begin), _ = speed(zero, begin)
    derivative = float(speed(zero, begin)[1])
    difference = float(speed(zero + h, begin)[0][0] - speed(zero - h, begin)[0][0]) / (2.0 * h)
    assert abs(difference) > 1e-3
    assert derivative == pytest.approx(difference, rel=1e-4)


@pytest.mark.parametrize("mirror", [2, -1, 0])
def test_mirror_on_no_axis_or_on_a_periodic_one_is_refused(mirror):
    with pytest.raises(ValueError, match=f"box.mirror must be an axis that is not periodic, got {mirror}"):
        mps.Box((0.0, 0.0), (1.0, 1.0), (True, False), mirror)


def test_wave_on_a_mirror_is_834_particles_and_nothing_else(unchecked):
    case = mps.cases.standing_wave(floor="mirror")
    assert np.bincount(np.asarray(case.particles.kind)).tolist() == [834]
    assert case.box.lower[1] == 0.0
    assert case.box.mirror == 1
    with pytest.raises(ValueError, match="floor must be one of wall, mirror, got glass"):
        mps.cases.standing_wave(floor="glass")  # type: ignore[arg-type]
