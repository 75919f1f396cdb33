"""Arrangements of particles for the tests of operators and models, with their tables of pairs."""

import itertools
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

from jaxmps._vectors import components, joined
from jaxmps.kernels import lattice
from jaxmps.neighbors import Pairs
from jaxmps.operators import pair_weight

SPACING = 0.1
DIMENSIONS = pytest.mark.parametrize("dim", [2, 3])


def table(points: np.ndarray, reach: float) -> Pairs:
    """The pairs closer than `reach`, from a k-d tree."""
    found = cKDTree(points).query_pairs(reach, output_type="ndarray")
    ends = np.concatenate([found, found[:, ::-1]])
    i, j = ends[np.lexsort((ends[:, 1], ends[:, 0]))].T
    n = len(points)
    count = np.bincount(i, minlength=n)
    slot = np.arange(len(i)) - np.repeat(np.cumsum(count) - count, count)
    slots = np.tile(np.arange(n)[:, None], (1, int(count.max()) + 2))
    slots[i, slot] = j
    r_ij = points[slots] - points[:, None]
    distance = np.linalg.norm(r_ij, axis=-1)
    present = distance > 0
    distance = np.where(present, distance, SPACING)
    return Pairs(jnp.array(slots), components(jnp.array(r_ij)), jnp.array(distance), jnp.array(present))


def block(dim: int, ratio: float = 2.1, size: int | None = None) -> SimpleNamespace:
    """A block of the lattice; `interior` marks particles with a full neighborhood."""
    size = size or (12 if dim == 2 else 7 if ratio < 3 else 10)
    index = np.array(list(itertools.product(range(size), repeat=dim)))
    points = (index + 0.5) * SPACING
    edge = np.minimum(index, size - 1 - index).min(axis=1)
    near = table(points, ratio * SPACING)
    n0, lam = lattice(ratio, dim)[:2]
    return SimpleNamespace(
        points=jnp.array(points),
        index=index,
        edge=edge,
        interior=edge >= np.ceil(ratio) - 1,
        pairs=near,
        w=pair_weight(near, ratio * SPACING),
        n0=n0,
        lam=lam * SPACING**2,
    )


CLOUD = SimpleNamespace(points=np.random.default_rng(3).uniform(0, 1.2, (150, 2)), n0=lattice(2.1, 2).n0)


def cloud() -> tuple[Pairs, jax.Array]:
    near = table(CLOUD.points, 2.1 * SPACING)
    return near, pair_weight(near, 2.1 * SPACING)


def strength(model: Any, p: jax.Array, near: Pairs, w: jax.Array, n0: float) -> np.ndarray:
    """What stands for p_j − p_i in the part that each pair has in this gradient: D/n0 (p_j − p_i) w r_ij / r²."""
    ones = jnp.ones_like(w)
    parts = [jax.grad(lambda w, a=a: jnp.sum(model(p, ones, near, w, n0)[:, a]))(w) for a in range(near.dim)]
    return np.asarray(n0 / near.dim * sum(part * r for part, r in zip(parts, near.r_ij, strict=True)))


def couple(r: np.ndarray) -> Pairs:
    """Two particles at a distance `r` (d,) from the first to the second, and an empty slot for each."""
    length, zero = float(np.linalg.norm(r)), np.zeros(len(r))
    return Pairs(
        j=jnp.array([[1, 0], [0, 1]]),
        r_ij=components(jnp.array([[r, zero], [-r, zero]])),
        distance=jnp.array([[length, SPACING]] * 2),
        present=jnp.array([[True, False]] * 2),
    )


def box_cloud(dim: int) -> SimpleNamespace:
    """Random points in a square or cube, as dense as the lattice, and their pairs within 2.1 spacings.

    `well_placed`: more than `dim` neighbors, which do not nearly stand in a line or a plane.
    """
    size = 12 if dim == 2 else 6
    points = np.random.default_rng(dim).uniform(0.0, size * SPACING, (size**dim, dim))
    near, n0 = table(points, 2.1 * SPACING), lattice(2.1, dim).n0
    w = pair_weight(near, 2.1 * SPACING)
    e_ij = np.asarray(joined(near.e_ij))
    matrix = dim / n0 * np.einsum("nk,nkd,nke->nde", np.asarray(w), e_ij, e_ij)
    well_placed = (np.linalg.det(matrix) > 0.05) & (np.sum(np.asarray(w) > 0, axis=1) > dim)
    return SimpleNamespace(points=points, pairs=near, w=w, n0=n0, well_placed=well_placed)
