"""The reference's list of pairs, from SciPy's k-d tree."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from jaxmps.flow import Kind


class Pairs(NamedTuple):
    """Pairs within the effective radius, i < j: r = r_j − r_i [m] and its length, not below 1e-3 l0."""

    i: np.ndarray
    j: np.ndarray
    r: np.ndarray
    distance: np.ndarray


class List:
    """All pairs within radius + skin [m], found again when a particle has moved by more than half the skin."""

    def __init__(self, radius: float, skin: float, floor: float):
        self.radius, self.skin, self.floor, self.builds = radius, skin, floor, 0
        self._there = self._i = self._j = np.empty(0, np.intp)
        self._position = np.empty((0, 0))

    def pairs(self, position: np.ndarray, kind: np.ndarray) -> Pairs:
        there = np.flatnonzero(kind != Kind.REMOVED)
        if self._moved(position, there):
            self._build(position, there, kind)
        r = np.take(position, self._j, axis=0)
        r -= np.take(position, self._i, axis=0)
        squared = np.einsum("pd,pd->p", r, r)
        near = np.flatnonzero(squared < self.radius**2)
        distance = np.sqrt(np.maximum(squared[near], self.floor**2))
        return Pairs(self._i[near], self._j[near], np.take(r, near, axis=0), distance)

    def _moved(self, position: np.ndarray, there: np.ndarray) -> bool:
        if len(there) != len(self._there):
            return True
        travel = (position - self._position)[there]
        return bool(np.max(np.einsum("nd,nd->n", travel, travel)) > (0.5 * self.skin) ** 2)

    def _build(self, position: np.ndarray, there: np.ndarray, kind: np.ndarray) -> None:
        # Neither balanced nor compact: the tree is used once, and this one is ready in a third of the time.
        tree = cKDTree(position[there], balanced_tree=False, compact_nodes=False)
        i, j = there[tree.query_pairs(self.radius + self.skin, output_type="ndarray")].T
        used = (kind[i] != Kind.DUMMY) | (kind[j] != Kind.DUMMY)
        self._i, self._j = i[used], j[used]
        self._there, self._position = there, position.copy()
        self.builds += 1
