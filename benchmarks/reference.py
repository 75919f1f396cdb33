"""The step of `schemes.mps(viscous=False)` as one would write it in Python with NumPy and SciPy: what to compare with.

The same formulas, walls, surface test, collisions, matrix, tolerance and warm start. Each pair is stored once, i < j,
found by a k-d tree with a skin and evaluated twice in a step; sums over pairs are `np.bincount`; the equation holds the
unknown particles only, in compressed rows. Double precision, one fluid, open boxes. SciPy does all this on one core.
"""

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal, NamedTuple

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import LinearOperator, cg, spilu, splu

from benchmarks.reference_list import List, Pairs
from jaxmps import Case, Scheme
from jaxmps.flow import Kind
from jaxmps.kernels import lattice
from jaxmps.models import DensityDeviation, DensityThreshold, Inviscid, PairCollision

Solver = Literal["jacobi", "ilu", "lu"]
SOLVERS: tuple[Solver, ...] = ("jacobi", "ilu", "lu")
"""Conjugate gradients with the diagonal or with incomplete factors for a preconditioner, and the direct solution.

Factors are SuperLU's, made anew in each step, for the surface changes the unknowns. With a larger tolerance for what
is dropped, incomplete factors are no longer symmetric enough for conjugate gradients.
"""
_FACTORS = {"diag_pivot_thresh": 0.0, "permc_spec": "MMD_AT_PLUS_A", "options": {"SymmetricMode": True}}
_INCOMPLETE = {"drop_tol": 1e-3, "fill_factor": 10.0, **_FACTORS}


class Flow(NamedTuple):
    """Position [m], velocity [m/s] and pressure [Pa] of all particles, and their `Kind`."""

    position: np.ndarray
    velocity: np.ndarray
    pressure: np.ndarray
    kind: np.ndarray


def without_mean(x: np.ndarray, part: np.ndarray) -> np.ndarray:
    """x less its mean over each part with a number of zero or more."""
    number = part + 1
    mean = np.bincount(number, x) / np.maximum(np.bincount(number), 1)
    return np.where(number > 0, x - mean[number], x)


class Reference:
    """The stepper of a case: `skin` in spacings; `seconds` are those spent so far in each part, `applications` the
    products with the matrix. Raises `ValueError` for schemes and cases other than those described above.
    """

    def __init__(self, case: Case, scheme: Scheme, solver: Solver = "jacobi", skin: float = 0.6):
        surface, source, collision = scheme.free_surface, scheme.source, scheme.collision
        known = (DensityThreshold, DensityDeviation, PairCollision)
        inviscid = isinstance(scheme.viscosity, Inviscid)
        alike = all(map(isinstance, (surface, source, collision), known)) and scheme.name == "mps" and inviscid
        if not alike or len(case.fluids.density) != 1 or any(case.box.periodic):
            raise ValueError("the reference is the standard method for one inviscid fluid in an open box")
        self.spacing, self.dim = case.spacing, case.dim
        self.radius = scheme.ratio * case.spacing
        self.n0, lam = lattice(scheme.ratio, case.dim)[:2]
        self.density = float(case.fluids.density[0])
        self.laplacian = 2.0 * self.dim / (lam * self.spacing**2 * self.n0 * self.density)
        self.gravity = np.asarray(case.gravity, float)
        self.lower, self.upper = np.array(case.box.lower), np.array(case.box.upper)
        self.beta, self.relaxation = float(surface.beta), float(source.relaxation)
        self.closest, self.restitution = float(collision.distance) * self.spacing, float(collision.restitution)
        self.courant, self.gravity_limit = float(scheme.time_step.courant), float(scheme.time_step.gravity_limit)
        self.tolerance, self.max_iterations, self.clip = scheme.tolerance, scheme.max_iterations, scheme.clip_pressure
        self.solver: Solver = solver
        self.list = List(self.radius, skin * self.spacing, 1e-3 * self.spacing)
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self.applications = 0

    def largest_step(self, flow: Flow) -> float:
        """Δt [s]."""
        fastest = np.sqrt(np.max(np.sum(flow.velocity[flow.kind == Kind.FLUID] ** 2, axis=1)))
        falling = self.gravity_limit * np.sqrt(self.spacing / np.linalg.norm(self.gravity))
        return float(min(self.courant * self.spacing / fastest if fastest > 0 else np.inf, falling))

    def step(self, flow: Flow) -> Flow:
        """The flow after one time step."""
        position, velocity, pressure, kind = flow
        moves = kind == Kind.FLUID
        has_pressure = moves | (kind == Kind.WALL)
        dt = self.largest_step(flow)

        with self._timed("list"):
            near = self.list.pairs(position, kind)
        with self._timed("operators"):
            u = velocity + np.where(moves[:, None], dt * self.gravity, 0.0)
            u = u + self._collide(u, near, moves, dt)
            position = position + dt * u
        with self._timed("list"):
            near = self.list.pairs(position, kind)
        with self._timed("operators"):
            n = len(kind)
            w = self.radius / near.distance - 1.0
            number = np.bincount(near.i, w, n) + np.bincount(near.j, w, n)
            unknown = has_pressure & (number >= self.beta * self.n0)
            b = (self.relaxation / dt**2) * (number - self.n0) / self.n0
            wet = np.flatnonzero(has_pressure[near.i] & has_pressure[near.j])
            near, w = Pairs(near.i[wet], near.j[wet], np.take(near.r, wet, axis=0), near.distance[wet]), w[wet]
        with self._timed("matrix"):
            matrix, diagonal, loose = self._matrix(near, w, unknown)
        p = np.zeros(n)
        solved = self._solve(matrix, diagonal, without_mean(b[unknown], loose), pressure[unknown])
        p[unknown] = without_mean(solved, loose)
        with self._timed("operators"):
            p = np.maximum(p, 0.0) if self.clip else p
            a = np.where(moves[:, None], self._acceleration(p, near, w), 0.0)
            position, u = position + dt**2 * a, u + dt * a
            gone = moves & ~np.all((position >= self.lower) & (position < self.upper), axis=1)
            u, p = np.where(gone[:, None], 0.0, u), np.where(gone, 0.0, p)
            kind = np.where(gone, Kind.REMOVED, kind)
        return Flow(position, u, p, kind)

    def _collide(self, u: np.ndarray, near: Pairs, moves: np.ndarray, dt: float) -> np.ndarray:
        u_ij = np.take(u, near.j, axis=0) - np.take(u, near.i, axis=0)
        approach = np.einsum("pd,pd->p", near.r, u_ij)
        # Approaching pairs that could meet at all; few are left, for which the rest is cheap.
        reach = self.closest + dt * np.sqrt(np.einsum("pd,pd->p", u_ij, u_ij))
        few = np.flatnonzero((approach < 0) & (near.distance < reach))
        i, j, r, distance = near.i[few], near.j[few], near.r[few], near.distance[few]
        travel = dt * u_ij[few]
        length = np.sum(travel**2, axis=1)
        nearest = np.clip(-dt * approach[few] / length, 0.0, 1.0)
        hits = np.sum((r + nearest[:, None] * travel) ** 2, axis=1) < self.closest**2
        impulse = (1.0 + self.restitution) * np.where(hits, approach[few] / distance**2, 0.0)[:, None] * r
        change = np.zeros_like(u)
        np.add.at(change, i, np.where(moves[j], 0.5, 1.0)[:, None] * impulse)
        np.add.at(change, j, -np.where(moves[i], 0.5, 1.0)[:, None] * impulse)
        return np.where(moves[:, None], change, 0.0)

    def _matrix(
        self, near: Pairs, w: np.ndarray, unknown: np.ndarray
    ) -> tuple[sparse.csr_array, np.ndarray, np.ndarray]:
        """The matrix, its diagonal, and of each row the part without a known pressure that it is in, −1 for none."""
        n, c = len(unknown), self.laplacian * w
        i, j = near.i, near.j
        both = np.flatnonzero(unknown[i] & unknown[j])
        row = np.cumsum(unknown, dtype=np.int32) - 1
        size = int(np.sum(unknown))
        upper = sparse.csr_array((-c[both], (row[i[both]], row[j[both]])), shape=(size, size))
        diagonal = np.bincount(i, c, n) + np.bincount(j, c, n)
        partners = np.bincount(i, minlength=n) + np.bincount(j, minlength=n)
        inside = np.bincount(i[both], minlength=n) + np.bincount(j[both], minlength=n)
        parts, part = connected_components(upper, directed=False)
        loose = np.bincount(part, (partners - inside)[unknown], parts) == 0
        diagonal = np.where(diagonal > 0, diagonal, 1.0)[unknown]
        # One row of each loose part is tied to zero: with a right-hand side of the mean zero that decides its constant.
        first = np.unique(part, return_index=True)[1][loose]
        diagonal[first] *= 2.0
        matrix = upper + upper.T.tocsr() + sparse.diags_array(diagonal, format="csr")
        return matrix, diagonal, np.where(loose[part], part, -1)

    def _solve(self, matrix: sparse.csr_array, diagonal: np.ndarray, b: np.ndarray, guess: np.ndarray) -> np.ndarray:
        with self._timed("preconditioner"):
            if self.solver == "jacobi":
                inverse = 1.0 / diagonal
                approximation = LinearOperator(matrix.shape, lambda r: inverse * r, dtype=float)
            elif self.solver == "ilu":
                approximation = LinearOperator(matrix.shape, spilu(matrix.tocsc(), **_INCOMPLETE).solve, dtype=float)
            else:
                factors = splu(matrix.tocsc(), **_FACTORS)
        with self._timed("solve"):
            if self.solver == "lu":
                return factors.solve(b)
            # The multiple of the last pressure that leaves the smallest residual.
            product = matrix @ guess
            squared = product @ product
            guess = (product @ b / squared if squared > 0 else 0.0) * guess
            self.applications += 2
            options = {"rtol": self.tolerance, "atol": 0.0, "maxiter": self.max_iterations}
            return cg(matrix, b, guess, M=approximation, callback=self._count, **options)[0]

    def _count(self, _: np.ndarray) -> None:
        self.applications += 1

    def _acceleration(self, p: np.ndarray, near: Pairs, w: np.ndarray) -> np.ndarray:
        at_i, at_j = p[near.i], p[near.j]
        smallest = p.copy()
        np.minimum.at(smallest, near.i, at_j)
        np.minimum.at(smallest, near.j, at_i)
        factor = (self.dim / (self.n0 * self.density)) * w / near.distance**2
        to_i, to_j = factor * (at_j - smallest[near.i]), factor * (at_i - smallest[near.j])
        n, columns = len(p), near.r.T
        return np.stack([np.bincount(near.j, to_j * r, n) - np.bincount(near.i, to_i * r, n) for r in columns], axis=1)

    @contextmanager
    def _timed(self, part: str) -> Iterator[None]:
        began = time.perf_counter()
        yield
        self.seconds[part] += time.perf_counter() - began
