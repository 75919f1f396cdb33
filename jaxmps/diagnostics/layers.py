"""A tank of one or two fluids: where each is, how deep, and how much room they take."""

import numpy as np
from jaxtyping import Bool, Float

from jaxmps.results import Run


def surface_height(run: Run, columns: float = 2.0) -> Float[np.ndarray, "m n"]:
    """Height [m] of the highest fluid particle within `columns` spacings to either side of each particle (2-D)."""
    height = np.empty(run.kind.shape)
    for k, (position, fluid) in enumerate(zip(run.position, run.fluid, strict=True)):
        order = np.flatnonzero(fluid)[np.argsort(position[fluid, 0])]
        x, y = position[order].T
        low = np.searchsorted(x, position[:, 0] - columns * run.spacing)
        high = np.searchsorted(x, position[:, 0] + columns * run.spacing, side="right")
        # Maxima over slices of an array, by numpy's reduceat over (start, end) pairs.
        edges = np.stack([low, np.maximum(high, low + 1)], axis=1).ravel()
        height[k] = np.maximum.reduceat(np.append(y, [0.0, 0.0]), edges)[::2]
    return height


def deep_surface(run: Run, fraction: float = 0.9) -> Bool[np.ndarray, "m n"]:
    """Which fluid particles pass for surface below `fraction` of the local depth, over a floor at y = 0 (2-D)."""
    return run.surface & run.fluid & (run.position[..., 1] < fraction * surface_height(run))


def mean_height(run: Run) -> Float[np.ndarray, " m"]:
    """Twice the mean elevation [m] of the fluid: the height of the water if it is level, whatever its phases."""
    weight = run.fluid / run.fluid.sum(axis=1, keepdims=True)
    return 2.0 * np.sum(weight * run.position[..., -1], axis=1)


def speed(run: Run, phase: int) -> Float[np.ndarray, " m"]:
    """Root-mean-square speed [m/s] of a phase in each frame."""
    counts = run.fluid & (run.phase == phase)
    squared = np.sum(run.velocity**2, axis=-1)
    return np.sqrt(np.sum(np.where(counts, squared, 0.0), axis=1) / np.maximum(counts.sum(axis=1), 1))
