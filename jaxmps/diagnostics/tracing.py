"""The free surface as a line of particles, traced from left to right."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from jaxmps.flow import Kind
from jaxmps.kernels import lattice
from jaxmps.results import Run
from jaxmps.validation import not_negative, positive

_SAME_PLACE = 1e-3  # [spacings] particles closer than this have no direction from one to the other
_TIE = 1e-9  # [rad] far above rounding


class Surface(NamedTuple):
    """A traced surface: `particles`, the indices of its particles from left to right, each once, and whether it is
    `complete`; if not, they are those left of where it is broken, and `reason` says where that is.
    """

    particles: Int[np.ndarray, " s"]
    complete: bool
    reason: str = ""


def trace_surface(
    position: Float[np.ndarray, "n 2"],
    fluid: Bool[np.ndarray, " n"],
    number_density: Float[np.ndarray, " n"],
    n0: float,
    spacing: float,
    ratio: float = 2.1,
    period: float | None = None,
    sparsest: float = 0.4,
) -> Surface:
    """The surface particles of a fluid in 2-D, walked from the upper left one to the upper right one ([N11] §4).

    The next particle is one within r_e = `ratio` · `spacing` [m]: the first that a disk of the diameter r_e meets when
    it rolls over the particle from the side of the air. The paper takes the one at the smallest angle from the way
    back; that leaves out particles of a hollow, and then may take one of these for the next and turn round. The disk
    leaves out none unless it is bridged, does not turn round, and follows a surface that overturns. On a lattice cut
    along a slope of up to one, it meets the top particle of each column, but not the ground of a notch one column wide.

    Particles of a number density below `sparsest` · `n0` jump off and do not count. n0 and the densities must be of
    one radius, and 2.1 spacings is the one to take: at 3.1 and more, 0.4 n0 leaves out the corners of a square. At 2.1
    it leaves out sharper corners, and a sheet that is one particle thick.

    The first and the last particle are those that the disk meets when it is lowered at the sides, half a spacing
    outside the fluid. With a `period` [m] in x it is lowered at the least x, and the surface is complete if the walk
    goes round once. A surface with a gap that lets the disk through is broken: the walk comes back on itself. It
    always ends, for there are finitely many steps from one particle to another and each fixes the next.

    Positions in m; those that are not finite do not count. `ValueError` unless `ratio` exceeds √2, below which the
    disk falls through a lattice, and `period` 2 r_e.
    """
    radius = positive("ratio", ratio) * positive("spacing", spacing, "m")
    if ratio <= 2.0**0.5:
        raise ValueError(f"ratio must exceed the square root of 2, got {ratio:g}")
    if period is not None and positive("period", period, "m") <= 2.0 * radius:
        raise ValueError(f"period must exceed twice the search radius ({2.0 * radius:g} m), got {period:g} m")
    least = not_negative("sparsest", sparsest) * positive("n0", n0)
    chosen = np.flatnonzero(fluid & (number_density >= least) & np.isfinite(position).all(axis=1))
    if not len(chosen):
        return Surface(chosen, False, f"no fluid particle has a number density of {least:.3g} or more")
    points = position[chosen].astype(float)
    points[:, 0] -= points[:, 0].min()
    if period is not None:
        points[:, 0] %= period
    walk = _Walk(points, spacing, radius, period)
    if walk.go():
        return Surface(chosen[walk.until(len(walk.path))], True)
    furthest = int(np.argmax(walk.advance))
    last = chosen[walk.path[furthest]]
    x, y = position[last]
    reason = (
        f"the surface is broken: from the left it leads no further than particle {last} at ({x:.4g}, {y:.4g}) m, "
        f"with nothing beyond within {radius:.3g} m"
    )
    return Surface(chosen[walk.until(furthest + 1)], False, reason)


def trace(run: Run, ratio: float = 2.1, period: float | None = None, sparsest: float = 0.4) -> list[Surface]:
    """The surface of each frame of a 2-D run by `trace_surface`, with n0 that of a lattice and r_e = `ratio` · l0.

    `period` [m] is the length of a domain that is periodic in x. The number densities are summed anew, over all
    particles within r_e, since those of the run belong to the radius of its scheme. `ValueError` if the run is 3-D.
    """
    if run.position.shape[-1] != 2:
        raise ValueError(f"a surface is traced in 2-D, got a run in {run.position.shape[-1]}-D")
    n0, surfaces = lattice(positive("ratio", ratio), 2).n0, []
    for position, kind in zip(run.position.astype(float), run.kind, strict=True):
        present = (kind != Kind.REMOVED) & np.isfinite(position).all(axis=1)
        density = np.zeros(len(kind))
        density[present] = _number_density(position[present], run.spacing, ratio, period)
        fluid = kind == Kind.FLUID
        surfaces.append(trace_surface(position, fluid, density, n0, run.spacing, ratio, period, sparsest))
    return surfaces


def _number_density(points: np.ndarray, spacing: float, ratio: float, period: float | None) -> np.ndarray:
    """Σ w(r), w = r_e / r − 1 ([N11] Eqs. 5, 6), of each of the points."""
    i, j = _tree(points, period).query_pairs(ratio * spacing, output_type="ndarray").T
    distance = np.linalg.norm(_across_seam(points[j] - points[i], period), axis=1)
    weight = ratio / np.maximum(distance / spacing, _SAME_PLACE) - 1.0
    return np.bincount(np.concatenate([i, j]), np.tile(weight, 2), minlength=len(points))


def _tree(points: np.ndarray, period: float | None) -> KDTree:
    if period is None:
        return KDTree(points)
    return KDTree(np.stack([points[:, 0] % period % period, points[:, 1]], axis=1), boxsize=[period, 0.0])


def _across_seam(offset: np.ndarray, period: float | None) -> np.ndarray:
    if period is not None:
        offset[:, 0] -= period * np.round(offset[:, 0] / period)
    return offset


class _Walk:
    """The steps of a trace: `path`, the particles in turn, and how far right of the first each is [m]."""

    def __init__(self, points: np.ndarray, spacing: float, radius: float, period: float | None):
        self.points, self.spacing, self.radius, self.period = points, spacing, radius, period
        self.tree = _tree(points, period)
        self.path: list[int] = []
        self.advance: list[float] = []

    def go(self) -> bool:
        """Walk to the last particle, or round the period, and whether it is possible."""
        x = self.points[:, 0]
        outside = 0.0 if self.period is not None else 0.5 * self.spacing
        first, center = self._lower(x.min() - outside)
        last, _ = self._lower(x.max() + outside)
        self.path, self.advance, back = [first], [0.0], np.zeros(2)
        taken: dict[tuple[int, int], float] = {}
        while self.period is not None or self.path[-1] != last:
            found = self._next(self.path[-1], center, back)
            if found is None:
                return False
            (after, way), here = found, self.advance[-1]
            step = (self.path[-1], after)
            if step in taken:
                # Once round leads on; round a piece of a broken surface leads nowhere.
                around = self.period is not None and here - taken[step] > 0.5 * self.period
                if around:
                    self._from_seam()
                return around
            taken[step] = here
            self.path.append(after)
            self.advance.append(here + float(way[0]))
            center, back = self._rest(way) - way, -way
        return True

    def until(self, end: int) -> list[int]:
        """The first particles of the path, each once."""
        return list(dict.fromkeys(self.path[:end]))

    def _from_seam(self) -> None:
        """Begin the closed path on the right side of the seam; the disk may have met a particle on the left."""
        turn = int(np.argmax(self.points[self.path, 0] < 0.5 * self.points[:, 0].max()))
        self.path = self.path[turn:-1] + self.path[:turn]

    def _lower(self, x: float) -> tuple[int, np.ndarray]:
        """The particle that the disk meets when it is lowered at x, and the way from there to its center [m]."""
        offset = _across_seam(np.stack([x - self.points[:, 0], self.points[:, 1]], axis=1), self.period)[:, 0]
        under = np.abs(offset) < 0.5 * self.radius
        rise = np.sqrt(np.where(under, 0.25 * self.radius**2 - offset**2, 0.0))
        met = int(np.argmax(np.where(under, self.points[:, 1] + rise, -np.inf)))
        return met, np.array([offset[met], rise[met]])

    def _rest(self, way: np.ndarray) -> np.ndarray:
        """The way to the center of the disk [m] when it rests on a particle and, to the right, one at `way`."""
        distance = np.linalg.norm(way)
        height = 0.5 * np.sqrt(max(self.radius**2 - distance**2, 0.0))
        return 0.5 * way + height / distance * np.array([-way[1], way[0]])

    def _next(self, here: int, center: np.ndarray, back: np.ndarray) -> tuple[int, np.ndarray] | None:
        """The next particle and the way to it; `center` and `back` are those to the disk and the one before [m]."""
        near = np.array(self.tree.query_ball_point(self.tree.data[here], self.radius, return_sorted=True))
        way = _across_seam(self.points[near] - self.points[here], self.period)
        distance = np.linalg.norm(way, axis=1)
        apart = distance > _SAME_PLACE * self.spacing  # leaves out the particle itself
        if not apart.any():
            return None
        near, way, distance = near[apart], way[apart], distance[apart]
        # Clockwise from the center as it is to the particle, less from the center as it will be to the particle.
        clockwise = np.arctan2(way @ np.array([center[1], -center[0]]), way @ center)
        roll = clockwise - np.arccos(np.minimum(distance / self.radius, 1.0))
        roll = (roll + _TIE) % (2.0 * np.pi) - _TIE
        # The way back is the last resort: a full turn, not none. At the tip of a single file there is no other.
        roll[np.linalg.norm(way - back, axis=1) <= _SAME_PLACE * self.spacing] = 2.0 * np.pi
        pick = int(np.argmin(np.where(roll <= roll.min() + _TIE, distance, np.inf)))
        return int(near[pick]), way[pick]
