"""Where the water is: the surge front and the height of the water."""

import numpy as np
from jaxtyping import Bool, Float


def surge_front(
    position: Float[np.ndarray, "m n d"],
    fluid: Bool[np.ndarray, "m n"],
    spacing: float,
    company: float = 1.5,
) -> Float[np.ndarray, " m"]:
    """Position [m] of the surge front along x in each frame: the outer edge, l0 / 2 ahead of its center, of the
    foremost fluid particle that is not alone, that is, has another one within `company` spacings.

    Single drops that fly ahead of the water are no front. With `company` infinite they count.
    """
    fronts = []
    for frame, wet in zip(position, fluid, strict=True):
        points = frame[wet]
        points = points[np.argsort(-points[:, 0])]
        near = (company * spacing) ** 2
        leader = next((p for p in points if np.sum(np.sum((points - p) ** 2, axis=1) <= near) > 1), [np.nan])
        fronts.append(leader[0] + 0.5 * spacing)
    return np.array(fronts)
