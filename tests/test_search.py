"""The search for neighbors against jax-md's own list, all pairs by brute force, and a k-d tree."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

from jaxmps import Box
from jaxmps.neighbors import allocate, grow, jax_md, update
from jaxmps.neighbors.cells import window_size
from jaxmps.neighbors.search import search

REACH = 0.25
N = 120
SQUARE = ((1.0, 1.0), (False, False), REACH)  # for `brute_force`

# Open and periodic axes, in several orders; lengths, in reaches, that hold one cell, two, and more.
GEOMETRIES = [
    ((5.3, 4.2), (False, False)),
    ((1.8, 6.1), (True, False)),
    ((3.3, 1.8), (False, True)),
    ((5.2, 3.1), (True, True)),
    ((2.3, 1.8), (True, True)),
    ((3.1, 2.2, 1.4), (False, False, False)),
    ((2.1, 1.5, 2.4), (True, False, False)),
    ((1.8, 0.9, 2.0), (False, False, True)),
    ((2.6, 2.2, 1.3), (True, True, False)),
    ((2.4, 1.9, 3.4), (False, True, True)),
    ((3.7, 1.8, 2.2), (True, True, True)),
]


def clouds(lengths: np.ndarray, seed: int) -> list[np.ndarray]:
    """A random cloud, a lattice and clusters, all of N particles, some of them not finite, on a face or coinciding."""
    rng = np.random.default_rng(seed)
    dim = len(lengths)
    per_axis = np.ceil(N ** (1 / dim)) + 1
    lattice = np.stack(np.meshgrid(*[np.arange(per_axis)] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    lattice = rng.permutation(lattice)[:N] / per_axis * lengths
    centers = rng.uniform(0, lengths, (8, dim))
    clusters = centers[rng.integers(0, 8, N)] + rng.normal(0, 0.2 * REACH, (N, dim))
    random = rng.uniform(0, lengths, (N, dim))
    random[:5] = np.nan
    random[5, 0], random[6, 1] = np.inf, -np.inf
    random[7], random[8] = 0.0, lengths * (1 - 1e-12)
    random[10] = random[9]
    return [random, lattice, clusters]


def brute_force(position: np.ndarray, lengths, periodic, reach: float) -> np.ndarray:
    """All pairs (i, j) closer than `reach`, as sorted numbers i n + j."""
    with np.errstate(invalid="ignore"):
        r_ij = position[None] - position[:, None]
        r_ij = r_ij - np.where(periodic, np.round(r_ij / np.array(lengths)) * lengths, 0.0)
        near = np.sum(r_ij**2, axis=-1) < reach**2
    np.fill_diagonal(near, False)
    return np.flatnonzero(near)


def listed(idx) -> np.ndarray:
    """The pairs (i, j) of a table as sorted numbers i n + j; empty slots stand behind all others and hold n."""
    idx = np.asarray(idx)
    present = idx < len(idx)
    assert np.all(idx[~present] == len(idx))
    assert np.all(present[:, :-1] >= present[:, 1:])
    return np.sort((np.arange(len(idx))[:, None] * len(idx) + idx)[present])


@pytest.mark.parametrize(("lengths", "periodic"), GEOMETRIES)
def test_pairs_are_those_of_brute_force(lengths, periodic):
    lengths = tuple(REACH * x for x in lengths)
    slots = N - 1
    window = window_size(lengths, periodic, REACH, N, slots)
    find = jax.jit(lambda position: search(position, lengths, periodic, REACH, slots, window))
    for position in [cloud for seed in range(3) for cloud in clouds(np.array(lengths), seed)]:
        with np.errstate(invalid="ignore"):
            position = np.where(periodic, np.mod(position, lengths), position)
        idx, *full = find(jnp.array(position))
        assert not any(full)
        np.testing.assert_array_equal(listed(idx), brute_force(position, lengths, periodic, REACH))


@pytest.mark.parametrize(
    ("lengths", "periodic"),
    [((1.3, 1.0), (False, False)), ((1.1, 0.9), (True, False)), ((1.0, 0.9, 0.8), (False, True, True))],
)
def test_list_is_that_of_jax_md(lengths, periodic):
    partition = jax_md.partition()
    box = Box((0.2,) * len(lengths), tuple(0.2 + x for x in lengths), periodic)
    rng = np.random.default_rng(1)
    position = jnp.array(rng.uniform(box.lower, box.upper, (N, box.dim)))
    cutoff, skin = 0.8 * REACH, 0.2 * REACH
    theirs = partition.neighbor_list(
        lambda a, b, **_: box.displacement(a - b), jnp.array(lengths), cutoff, skin, format=partition.Dense
    ).allocate(position - 0.2)
    ours = allocate(position, box, cutoff, skin, capacity=64)
    assert not ours.overflow
    np.testing.assert_array_equal(listed(ours.table.idx), listed(jnp.sort(theirs.idx, axis=1)))
    assert jax.tree.structure(theirs).num_leaves == jax.tree.structure(ours.table).num_leaves


@pytest.mark.parametrize(
    ("precision", "dim"), [("single", 2), pytest.param("double", 3, marks=pytest.mark.slow)], indirect=["precision"]
)
def test_forty_thousand_particles_have_the_neighbors_of_a_k_d_tree(precision, dim):
    # Compiled wrongly by some releases of XLA above 16 384 and 32 768 particles.
    size = round(40_000 ** (1 / dim)) + 1
    lattice = np.stack(np.meshgrid(*[np.arange(size)] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    position = jnp.array(0.1 * (lattice + np.random.default_rng(0).uniform(0.2, 0.8, lattice.shape)))
    box = Box((0.0,) * dim, (0.1 * size,) * dim)
    neighbors = allocate(position, box, 0.2, 0.03, capacity=24 if dim == 2 else 64)
    assert not neighbors.overflow
    tree = cKDTree(np.asarray(position, np.float64))
    epsilon = 1e-5 if precision == "single" else 1e-12
    sure, possible = (
        np.concatenate([i * len(position) + j, j * len(position) + i])
        for i, j in (tree.query_pairs(0.23 * x, output_type="ndarray").T for x in (1 - epsilon, 1 + epsilon))
    )
    found = listed(neighbors.table.idx)
    assert np.all(np.diff(found) > 0)
    assert np.all(np.isin(sure, found))
    assert np.all(np.isin(found, possible))


def test_a_window_that_is_too_small_is_told_and_repaired():
    # Two clusters, out of reach of each other, share a window: no particle needs more slots, but the windows overflow.
    box = Box((0.0, 0.0), (2.0, 1.0))
    rng = np.random.default_rng(0)
    ends = np.repeat([[0.30, 0.5], [0.30 + 1.15 * REACH, 0.5]], 10, axis=0)
    position = jnp.array(np.concatenate([ends + rng.uniform(0, 0.01, (20, 2)), rng.uniform(1, 2, (40, 2))]))
    neighbors = allocate(position, box, REACH, 0.001, capacity=10)
    assert neighbors.table.error.code == 2
    rounds = 0
    while neighbors.overflow:
        neighbors = grow(neighbors, position)
        rounds += 1
    assert 1 <= rounds <= 3
    expected = brute_force(np.asarray(position), box.lengths, box.periodic, REACH + 0.001)
    np.testing.assert_array_equal(listed(neighbors.table.idx), expected)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_lists_of_one_two_and_three_particles(n):
    position = jnp.array([[0.1, 0.1], [0.2, 0.1], [0.9, 0.9]])[:n]
    neighbors = allocate(position, Box((0.0, 0.0), (1.0, 1.0)), REACH, 0.01, capacity=8)
    assert neighbors.capacity == n - 1
    assert not neighbors.overflow
    np.testing.assert_array_equal(listed(neighbors.table.idx), [] if n == 1 else [1, n])


def test_a_particle_whose_position_becomes_finite_gets_its_neighbors():
    position = jnp.array(np.random.default_rng(0).uniform(0, 1, (50, 2)))
    lost = position.at[3].set(jnp.nan)
    neighbors = allocate(lost, Box((0.0, 0.0), (1.0, 1.0)), REACH - 0.01, 0.01, capacity=30)
    np.testing.assert_array_equal(listed(neighbors.table.idx), brute_force(np.asarray(lost), *SQUARE))
    # One that is found again has the list rebuilt, one that is lost leaves it as it is.
    found = update(neighbors, position)
    np.testing.assert_array_equal(listed(found.table.idx), brute_force(np.asarray(position), *SQUARE))
    np.testing.assert_array_equal(update(found, lost).table.idx, found.table.idx)


def temporary_bytes(compiled) -> int:
    return compiled.memory_analysis().temp_size_in_bytes


def test_a_box_that_is_nearly_empty_takes_no_more_cells_than_particles_can_fill():
    lengths = (1e4 * REACH, 1e4 * REACH)
    rng = np.random.default_rng(0)
    position = 1e3 * REACH + rng.uniform(0, 4 * REACH, (N, 2))
    sizes = 64, window_size(lengths, (False, False), REACH, N, 64)
    compiled = jax.jit(lambda x: search(x, lengths, (False, False), REACH, *sizes)).lower(position).compile()
    assert temporary_bytes(compiled) < 1e6
    idx, *full = compiled(jnp.array(position))
    assert not any(full)
    np.testing.assert_array_equal(listed(idx), brute_force(position, lengths, (False, False), REACH))


def test_the_rebuild_takes_a_hundred_bytes_for_each_particle():
    n = 20_000
    position = jnp.array(np.random.default_rng(0).uniform(0, 141, (n, 2)), jnp.float32)
    box = Box((0.0, 0.0), (141.0, 141.0))
    neighbors = allocate(position, box, 2.1, 0.1, capacity=24)
    assert temporary_bytes(jax.jit(update).lower(neighbors, position).compile()) < 100 * n
