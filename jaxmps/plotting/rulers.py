"""Edges of a box in space with places and units, drawn where a picture shows them."""

from collections.abc import Callable
from typing import Any

import numpy as np

_GREY = "#5f6368"
_OUTWARD = ((0.0, -1.0), (1.0, -0.6), (-1.0, 0.0))  # of each edge, in the picture
_ALIGNED = (("center", "top"), ("left", "top"), ("right", "center"))


def rulers(axes: Any, seen: Callable[[np.ndarray], np.ndarray], corners: tuple[Any, Any], tick: float) -> None:
    """Three edges of the box between two `corners` [m]; `seen` tells where in the picture points are, and marks are
    `tick` long there.
    """
    from matplotlib.ticker import MaxNLocator

    low, high = corners
    for axis, (outward, (ha, va)) in enumerate(zip(_OUTWARD, _ALIGNED, strict=True)):
        start = np.array([high[0] if axis == 1 else low[0], low[1], low[2]], float)
        line, text = {"color": _GREY, "lw": 0.8}, {"color": _GREY, "fontsize": 9, "ha": ha, "va": va}

        def at(value: float, axis: int = axis, start: np.ndarray = start) -> np.ndarray:
            return seen(np.where(np.arange(3) == axis, value, start))

        way = tick * np.array(outward)
        axes.plot(*np.stack([at(low[axis]), at(high[axis])]).T, **line)
        most = max(2, round(6 * (high[axis] - low[axis]) / max(high - low)))
        for value in MaxNLocator(most).tick_values(low[axis], high[axis]):
            if low[axis] <= value <= high[axis]:
                axes.plot(*np.stack([at(value), at(value) + way]).T, **line)
                axes.text(*(at(value) + 1.5 * way), f"{value:g}", **text)
        middle = at(0.5 * (low[axis] + high[axis]))
        axes.text(*(middle + (6.0 if axis == 2 else 4.5) * way), f"{'xyz'[axis]} [m]", **text)
