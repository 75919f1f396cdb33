"""Walls in three dimensions as a surface: the squares between particles of their lattice, and its edges."""

import itertools
from typing import NamedTuple

import numpy as np

from jaxmps.flow import Kind
from jaxmps.results import Run

_OFF = 0.2  # [spacings] a particle farther than that from the lattice of the others belongs to no square


class Shell(NamedTuple):
    """Indices of particles: corners of squares `(q, 4)`, ends of edges `(e, 2)`, and wall particles in no square.

    The corners are particles, and so a shell goes wherever its walls go.
    """

    squares: np.ndarray
    edges: np.ndarray
    loose: np.ndarray


def shell(run: Run, frame: int) -> Shell:
    """The surface through the wall particles that have a pressure; they stand on a lattice along the axes in `frame`.

    Those with walls all around, as in the foot of an obstacle, are no part of it. Edges: where it ends or turns.
    """
    fixed = np.flatnonzero(np.isin(run.kind[frame], (Kind.WALL, Kind.DUMMY)))
    place = run.position[frame][fixed] / run.spacing
    place = place - place[0] if len(place) else place
    cell = np.round(place).astype(np.int64)
    regular = np.abs(place - cell).max(axis=1, initial=0.0) < _OFF
    cell, members = cell[regular], fixed[regular]
    walls = fixed[run.kind[frame][fixed] == Kind.WALL]
    if not len(members):
        return Shell(np.zeros((0, 4), int), np.zeros((0, 2), int), walls)
    cell -= cell.min(axis=0)
    sizes = cell.max(axis=0) + 3
    strides = np.array([sizes[1] * sizes[2], sizes[2], 1])
    keys, first = np.unique(cell @ strides, return_index=True)
    members = members[first]
    around = np.array(list(itertools.product((-1, 0, 1), repeat=3))) @ strides
    inner = np.all([_member(keys, keys + step) >= 0 for step in around], axis=0)
    outer = (run.kind[frame][members] == Kind.WALL) & ~inner
    walls = np.setdiff1d(walls, members[inner])
    keys, members = keys[outer], members[outer]
    squares, normals = [], []
    for normal in range(3):
        a, b = (strides[axis] for axis in range(3) if axis != normal)
        corners = [_member(keys, keys + step) for step in (0, a, a + b, b)]
        whole = np.all([corner >= 0 for corner in corners], axis=0)
        squares.append(members[np.stack(corners, axis=1)[whole]])
        normals.append(np.full(whole.sum(), normal))
    found = np.concatenate(squares)
    return Shell(found, _edges(found, np.concatenate(normals)), np.setdiff1d(walls, found))


def _member(keys: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    place = np.minimum(np.searchsorted(keys, wanted), max(len(keys) - 1, 0))
    if not len(keys):
        return place - 1
    return np.where(keys[place] == wanted, place, -1)


def _edges(squares: np.ndarray, normals: np.ndarray) -> np.ndarray:
    ends = np.sort(np.stack([squares, np.roll(squares, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edges, index = np.unique(ends, axis=0, return_inverse=True)
    counts = np.zeros((len(edges), 3), int)
    np.add.at(counts, (index.ravel(), np.repeat(normals, 4)), 1)
    return edges[(counts.sum(axis=1) == 1) | ((counts > 0).sum(axis=1) > 1)]


def carried(run: Run, points: np.ndarray, frame: int) -> np.ndarray:
    """Points `(k, d)` [m] fixed to the walls, which stood by them in the first frame, at another one.

    By the rigid motion that comes closest to that of all walls: a case file moves them as one body.
    """
    walls = np.isin(run.kind[0], (Kind.WALL, Kind.DUMMY))
    before, now = run.position[0][walls].astype(float), run.position[frame][walls].astype(float)
    if not walls.any() or np.array_equal(before, now):
        return points
    middle, there = before.mean(axis=0), now.mean(axis=0)
    u, _, v = np.linalg.svd((before - middle).T @ (now - there))
    flip = np.ones(len(middle))
    flip[-1] = np.sign(np.linalg.det(u @ v))
    return there + (points - middle) @ (u * flip) @ v
