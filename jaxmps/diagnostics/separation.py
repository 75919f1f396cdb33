"""How far apart particles are, and when a run has broken up."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from jaxmps.results import Run, box_of


def nearest(run: Run) -> Float[np.ndarray, "m n"]:
    """Distance [spacings] of each fluid particle to its nearest particle of any kind, in each frame; else infinite.

    Periodic images count, if the run says of its box that it is periodic.
    """
    box = box_of(run)
    found = np.full(run.kind.shape, np.inf)
    for k, (position, fluid) in enumerate(zip(run.position, run.fluid, strict=True)):
        if fluid.any():
            places, periods = box.torus(position)
            found[k, fluid] = KDTree(places, boxsize=periods).query(places[fluid], k=2)[0][:, 1] / run.spacing
    return found


def breakup(run: Run, reference_speed: float, factor: float = 10.0, closest: float = 0.1) -> float:
    """The first time [s] of a frame in which a particle is faster than `factor` · `reference_speed` [m/s], or two are
    closer than `closest` spacings, or at which the run ended before its time; infinite if it holds together.

    A threshold on something chaotic: a time to be given over several seeds and steps, never alone.
    """
    speed = np.where(run.fluid, np.linalg.norm(run.velocity, axis=-1), 0.0).max(axis=1)
    broken = (speed > factor * reference_speed) | (nearest(run).min(axis=1) < closest)
    if broken.any():
        return float(run.time[np.argmax(broken)])
    return np.inf if run.status.completed else float(run.time[-1])
