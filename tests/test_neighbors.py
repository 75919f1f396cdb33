"""The neighbor table against a k-d tree."""

import functools
import itertools
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

from jaxmps import Box, Kind
from jaxmps._vectors import dot
from jaxmps.flow import at_rest
from jaxmps.kernels import lattice
from jaxmps.neighbors import Neighbors, Pairs, allocate, grow, pairs, update, usual_capacity

SPACING = 0.1
CUTOFF = 2.1 * SPACING
SKIN = 0.3 * SPACING
BOTH = pytest.mark.parametrize("precision", ["single", "double"], indirect=True)
# Few geometries and shapes, shared by the tests, for each is compiled anew.
OPEN = Box((-0.3, 0.7), (0.9, 1.7))
PERIODIC = Box((-0.3, 0.7), (0.9, 1.7), (True, True))
CHANNEL = Box((-0.3, 0.7), (0.9, 1.7), (True, False))
CHANNEL_3D = Box((-0.3, 0.7, 0.0), (0.6, 1.5, 0.8), (False, True, False))
PERIODIC_3D = Box((-0.3, 0.7, 0.0), (0.6, 1.5, 0.8), (True, True, True))
CAPACITY = {2: 48, 3: 128}


@eqx.filter_jit
def look_up(neighbors, position):
    neighbors = update(neighbors, position)
    return neighbors, pairs(neighbors, at_rest(position, fluid(position)), SPACING)


def fluid(position) -> np.ndarray:
    return np.full(position.shape[0], Kind.FLUID)


def cloud(box: Box, seed: int) -> np.ndarray:
    """Random particles, about as dense as a lattice, with one on each corner and in the middle of each face."""
    lower, upper = np.array(box.lower), np.array(box.upper)
    n = round(np.prod(box.lengths) / SPACING**box.dim)
    inside = np.random.default_rng(seed).uniform(lower, upper, (n, box.dim))
    ends = zip(box.lower, box.upper, strict=True)
    corners = np.array(list(itertools.product(*ends)))
    middle = 0.5 * (lower + upper)
    faces = np.tile(middle, (2 * box.dim, 1))
    for axis in range(box.dim):
        faces[2 * axis, axis], faces[2 * axis + 1, axis] = lower[axis], upper[axis]
    return np.concatenate([inside, corners, faces])


def make_list(position, box: Box) -> Neighbors:
    neighbors, _ = look_up(empty_list(box, jax.config.jax_enable_x64), jnp.asarray(position, float))
    return neighbors


@functools.cache
def empty_list(box: Box, double: bool) -> Neighbors:
    """A list with room for all clouds, so that each geometry is compiled once."""
    position = cloud(box, seed=0)
    position[:15] = 0.5 * (np.array(box.lower) + np.array(box.upper))
    return allocate(jnp.array(position), box, CUTOFF, SKIN, CAPACITY[box.dim])


def image(box: Box, r_ij: np.ndarray) -> np.ndarray:
    lengths = np.where(box.periodic, box.lengths, np.inf)
    return r_ij - np.where(box.periodic, np.round(r_ij / lengths) * np.array(box.lengths), 0.0)


def true_pairs(box: Box, position: np.ndarray, reach: float) -> set[tuple[int, int]]:
    """All (i, j) closer than `reach`, from a k-d tree; its axes of length zero are not periodic."""
    lengths = np.array(box.lengths)
    shifted = position - np.array(box.lower)
    shifted = np.where(box.periodic, np.mod(shifted, lengths), shifted)
    shifted = np.where(box.periodic & (shifted >= lengths), 0.0, shifted)
    tree = cKDTree(shifted, boxsize=np.where(box.periodic, lengths, 0.0))
    found = tree.query_pairs(reach, output_type="ndarray")
    return {(int(i), int(j)) for i, j in np.concatenate([found, found[:, ::-1]])}


def assert_complete(box: Box, position, near: Pairs) -> None:
    """No pair is missed or doubled and each has its r_ij; absent slots hold i, l0 and zero."""
    position, near = np.asarray(position, np.float64), jax.device_get(near)
    present, j, found = near.present, near.j, np.stack(near.r_ij, axis=-1)
    rows = np.broadcast_to(np.arange(len(j))[:, None], j.shape)
    listed = list(zip(rows[present].tolist(), j[present].tolist(), strict=True))
    assert len(listed) == len(set(listed))
    # Pairs at the cutoff to within round-off may count or not.
    epsilon = 1e-5 if found.dtype == np.float32 else 1e-12
    assert true_pairs(box, position, CUTOFF * (1 - epsilon)) <= set(listed)
    assert set(listed) <= true_pairs(box, position, CUTOFF * (1 + epsilon))
    r_ij = image(box, position[j] - position[rows])
    distance = np.linalg.norm(r_ij, axis=-1)
    np.testing.assert_allclose(found[present], r_ij[present], atol=5 * epsilon * SPACING)
    # Coinciding particles get a thousandth of the spacing.
    distance = np.maximum(distance[present], 1e-3 * SPACING)
    np.testing.assert_allclose(near.distance[present], distance, atol=5 * epsilon * SPACING)
    np.testing.assert_array_equal(j[~present], rows[~present])
    np.testing.assert_array_equal(found[~present], 0.0)
    np.testing.assert_allclose(near.distance[~present], SPACING, rtol=1e-6)


@pytest.mark.parametrize(
    ("precision", "box"),
    [
        ("double", OPEN),
        ("double", PERIODIC),
        ("single", CHANNEL),
        ("double", CHANNEL_3D),
        pytest.param("single", PERIODIC_3D, marks=pytest.mark.slow),
    ],
    indirect=["precision"],
)
def test_no_pair_is_missed_or_doubled(precision, box):
    neighbors = make_list(cloud(box, seed=0), box)
    for seed in range(6):
        position = jnp.array(cloud(box, seed))
        neighbors, near = look_up(neighbors, position)
        assert not neighbors.overflow
        assert_complete(box, position, near)


@pytest.mark.parametrize("box", [OPEN, PERIODIC], ids=["open", "periodic"])
@pytest.mark.parametrize("travel", [0.3, 0.9, 20.0])
def test_no_pair_is_missed_after_small_and_large_motion(box, travel):
    # In units of half the skin, the largest travel that needs no new list: never, at every other step, and always.
    rng = np.random.default_rng(2)
    position = cloud(box, seed=3)
    neighbors = make_list(position, box)
    for _ in range(3):
        angle = rng.uniform(0, 2 * np.pi, len(position))
        step = 0.5 * SKIN * travel * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        position = np.asarray(box.wrap(jnp.array(position + step)))
        neighbors, near = look_up(neighbors, jnp.array(position))
        assert not neighbors.overflow
        assert_complete(box, position, near)


def test_list_is_kept_below_half_the_skin_and_rebuilt_above():
    box = OPEN
    position = jnp.array(cloud(box, seed=4))
    neighbors = make_list(position, box)
    still = position.at[5, 0].add(0.49 * SKIN)
    moved = position.at[5, 0].add(0.51 * SKIN)
    old = neighbors.table.reference_position
    np.testing.assert_array_equal(look_up(neighbors, still)[0].table.reference_position, old)
    assert np.any(np.asarray(look_up(neighbors, moved)[0].table.reference_position != old))


def test_particle_that_crosses_the_seam_keeps_its_pairs():
    box = CHANNEL
    position = cloud(box, seed=13)
    neighbors = make_list(position, box)
    for x in (0.899, 0.9, -0.299, -0.295):
        position[0] = [x, 1.2]
        position[1:4] = [[-0.25, 1.2], [0.8, 1.2], [0.4, 1.2]]
        neighbors, near = look_up(neighbors, jnp.array(position))
        found = set(np.asarray(near.j[0])[np.asarray(near.present[0])].tolist())
        assert {1, 2} <= found
        assert 3 not in found
        assert_complete(box, position, near)


@pytest.mark.parametrize(
    ("lengths", "periodic"),
    [
        ((0.3, 0.2), (False, False)),
        ((0.6, 0.7), (True, False)),
        ((0.25, 0.6, 0.9), (False, True, False)),
    ],
)
def test_box_of_fewer_than_three_cells_misses_no_pair(lengths, periodic):
    box = Box((0.2,) * len(lengths), tuple(0.2 + x for x in lengths), periodic)
    position = jnp.array(cloud(box, seed=5))
    neighbors, near = look_up(make_list(position, box), position)
    assert not neighbors.overflow
    assert_complete(box, position, near)


def test_particles_outside_of_an_open_box_keep_their_pairs():
    box = OPEN
    position = cloud(box, seed=6)
    position[:20] += [0.3, -0.2]
    position[20:40] -= [1.0, 0.8]
    neighbors = make_list(position, box)
    assert_complete(box, position, look_up(neighbors, jnp.array(position))[1])


def test_vmap_and_scan_give_the_pairs_of_single_calls():
    box = CHANNEL
    clouds = jnp.array([cloud(box, seed) for seed in range(3)])
    neighbors = make_list(clouds[0], box)

    def body(neighbors, position):
        neighbors, near = look_up(neighbors, position)
        return neighbors, (near, neighbors.overflow)

    _, (scanned, scan_overflow) = jax.lax.scan(body, neighbors, clouds)
    _, (mapped, map_overflow) = eqx.filter_vmap(body, in_axes=(None, 0))(neighbors, clouds)
    assert not np.any(scan_overflow)
    assert not np.any(map_overflow)
    for k, position in enumerate(clouds):
        assert_complete(box, position, jax.tree.map(lambda x, k=k: x[k], scanned))
        assert_complete(box, position, jax.tree.map(lambda x, k=k: x[k], mapped))


def test_members_have_the_lists_that_they_would_have_alone():
    position = jnp.array([cloud(OPEN, seed) for seed in range(3)])
    # Below half the skin, beyond it for one member, and beyond it for all: lists are kept or built, each as alone.
    travels = jnp.array([[0.1, 0.1, 0.1], [0.0, 0.6, 0.1], [0.7, 0.7, 0.7]]) * SKIN
    start = make_list(position[0], OPEN)
    together = jax.jit(jax.vmap(update))
    members, alone = jax.tree.map(lambda x: jnp.stack([x] * 3), start), [start] * 3
    built = []
    for travel in (jnp.zeros(3), *travels):
        position = position + travel[:, None, None]
        members = together(members, position)
        alone = [update(neighbors, x) for neighbors, x in zip(alone, position, strict=True)]
        for k, single in enumerate(alone):
            jax.tree.map(np.testing.assert_array_equal, jax.tree.map(lambda x, k=k: x[k], members.table), single.table)
        built.append(
            [
                bool(jnp.all(n.table.reference_position == OPEN.wrap(x) - jnp.array(OPEN.lower)))
                for n, x in zip(alone, position, strict=True)
            ]
        )
    assert built == [[True] * 3, [False] * 3, [False, True, False], [True] * 3]


def test_overflow_of_the_table_is_told_and_repaired():
    box = OPEN
    position = jnp.array(cloud(box, seed=7))
    neighbors = allocate(position, box, CUTOFF, SKIN, capacity=8)
    assert neighbors.capacity == 8
    assert neighbors.overflow
    rounds = 0
    while neighbors.overflow:
        before = neighbors.capacity
        neighbors = grow(neighbors, position)
        # Geometric growth, so that few sizes are compiled.
        assert neighbors.capacity >= 1.5 * before - 1
        rounds += 1
    assert rounds <= 6
    assert_complete(box, position, look_up(neighbors, position)[1])


def test_overflow_in_a_later_update_is_told_and_repaired():
    box = OPEN
    position = cloud(box, seed=8)
    neighbors = make_list(position, box)
    assert not neighbors.overflow
    crowd = jnp.array(np.array([0.3, 1.2]) + 0.3 * (position - np.array([0.3, 1.2])))
    neighbors, _ = look_up(neighbors, crowd)
    assert neighbors.overflow
    # Told until it is repaired, even where the particles are apart again.
    neighbors, _ = look_up(neighbors, jnp.array(position))
    assert neighbors.overflow
    for _ in range(6):
        if neighbors.overflow:
            neighbors = grow(neighbors, crowd)
    assert not neighbors.overflow
    assert_complete(box, crowd, look_up(neighbors, crowd)[1])


def test_lists_of_the_same_geometry_do_not_compile_anything_anew():
    position = jnp.array(cloud(OPEN, seed=0))
    first, second = (allocate(position, OPEN, CUTOFF, SKIN, CAPACITY[2]) for _ in range(2))
    assert jax.tree.structure(first) == jax.tree.structure(second)


@pytest.mark.parametrize("dim", [2, 3])
def test_usual_capacity_holds_a_full_lattice(dim):
    for reach in np.linspace(1.5, 4.5, 301):
        assert usual_capacity(reach, dim) >= lattice(reach, dim).neighbors


def test_particles_that_were_removed_have_no_pairs():
    box = OPEN
    position = jnp.array(cloud(box, seed=9))
    neighbors = make_list(position, box)
    removed = np.arange(position.shape[0]) % 3 == 0
    kind = np.where(removed, Kind.REMOVED, np.arange(position.shape[0]) % 3)
    near = pairs(neighbors, at_rest(position, kind), SPACING)
    present, j = np.asarray(near.present), np.asarray(near.j)
    assert not present[removed].any()
    assert not removed[j[present]].any()
    every = true_pairs(box, np.asarray(position), CUTOFF)
    assert present.sum() == sum(not removed[i] and not removed[j] for i, j in every)


@BOTH
def test_derivative_of_a_sum_over_pairs_is_the_closed_form(precision):
    # The sum of (r_e^2 - r^2)^2 over all pairs has the derivative -8 sum_j (r_e^2 - r_ij^2) (r_i - r_j) at r_i.
    box = CHANNEL
    position = cloud(box, seed=10)
    # No coinciding images of corners: their distance is not the true one.
    position[-8:] = np.random.default_rng(10).uniform(box.lower, box.upper, (8, 2))
    neighbors = make_list(position, box)

    def total(position):
        near = pairs(neighbors, at_rest(position, fluid(position)), SPACING)
        return jnp.sum(jnp.where(near.present, (CUTOFF**2 - near.distance**2) ** 2, 0.0))

    r_ij = image(box, position[None] - position[:, None])
    gap = np.maximum(CUTOFF**2 - np.sum(r_ij**2, axis=-1), 0.0)
    expected = 8 * np.sum(gap[..., None] * r_ij, axis=1)
    found = jax.grad(total)(jnp.array(position))
    tolerance = 1e-5 if precision == "single" else 1e-12
    np.testing.assert_allclose(found, expected, atol=tolerance * np.abs(expected).max())


@BOTH
def test_derivative_is_finite_for_particles_that_coincide(precision):
    box = OPEN
    position = cloud(box, seed=11)
    position[1] = position[0]
    position[2] = position[0] + 1e-12
    position = jnp.array(position)
    neighbors = make_list(position, box)

    def total(position):
        near = pairs(neighbors, at_rest(position, fluid(position)), SPACING)
        return jnp.sum(near.distance + 1 / near.distance + dot(near.r_ij, near.r_ij))

    assert np.isfinite(total(position))
    assert np.all(np.isfinite(jax.grad(total)(position)))
    tangent = jnp.ones_like(position).at[0].set(-1.0)
    assert np.isfinite(jax.jvp(total, (position,), (tangent,))[1])


def test_list_of_one_precision_does_not_disturb_the_other():
    box = OPEN
    for double in (True, False, True):
        jax.config.update("jax_enable_x64", double)
        position = jnp.array(cloud(box, seed=12))
        _, near = look_up(make_list(position, box), position)
        assert near.distance.dtype == position.dtype == (jnp.float64 if double else jnp.float32)
        assert_complete(box, position, near)


@pytest.mark.parametrize(
    ("init", "partition"),
    [
        ("from jax_md import partition, energy", ""),
        ("from jax_md import energy\nconstant = 3\nfrom jax_md import partition", "from jax_md import constant"),
    ],
    ids=["without its package", "with its package"],
)
def test_lists_of_jax_md_come_without_the_rest_where_they_can(tmp_path, init, partition):
    package = tmp_path / "jax_md"
    package.mkdir()
    for name, text in {"__init__": init, "partition": partition, "energy": ""}.items():
        (package / f"{name}.py").write_text(text)
    code = f"""
import sys
sys.path.insert(0, sys.argv[1])
from jaxmps.neighbors.jax_md import partition
lists = partition()
assert ("jax_md.energy" in sys.modules) == {bool(partition)}
import jax_md
assert jax_md.partition is lists is partition() is sys.modules["jax_md.partition"] and jax_md.energy
"""
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=True)


def test_a_list_is_made_without_the_rest_of_jax_md():
    code = """
import sys
from jaxmps.neighbors.jax_md import partition
assert partition().NeighborList and not {"jax_md", "jax_md.energy", "flax", "e3nn_jax", "sympy"} & set(sys.modules)
"""
    subprocess.run([sys.executable, "-c", code], check=True)
