"""What the members of an ensemble have in common, and how far they differ."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxmps.plotting.flow import new_figure
from jaxmps.results import Ensemble

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LABELS = {
    "energy": "total energy per unit mass [J/kg]",
    "kinetic": "kinetic energy per unit mass [J/kg]",
    "potential": "potential energy per unit mass [J/kg]",
    "front": "front along x [m]",
    "top": "highest water [m]",
    "height": "height of the water [m]",
}
_BLUE, _GREY = "#2f7fc1", "#8a939c"


def bands(
    ensemble: Ensemble, names: Sequence[str] = ("energy", "front"), by: str | None = None, ax: Any = None
) -> "Figure":
    """Median against time of each of `names`, one below the other, with bands that hold the middle half and the middle
    95 % of the members.

    With `by`, the name of a value that differs, a median and its 95 % for each of its values instead. `ax` are as many
    axes as there are names. Raises `ValueError` for names that there are not, and for series with more than a number
    for each frame.
    """
    if by is not None and by not in ensemble.values:
        raise ValueError(f"by must be one of {', '.join(ensemble.values) or 'no values'}, got {by}")
    for name in names:
        if ensemble.of(name).ndim != 2:
            raise ValueError(f"names must be of series with one number at each frame, got {name}")
    given: Any = new_figure(7.0, 2.9 * len(names)).subplots(len(names), 1, sharex=True) if ax is None else ax
    axes = np.ravel(given)
    for one, name in zip(axes, names, strict=True):
        if by is None:
            _band(one, ensemble, name, _BLUE, "median", whole=True)
        else:
            values = np.unique(ensemble.values[by])
            for value, color in zip(values, _shades(len(values)), strict=True):
                _band(one, ensemble.where(by, value), name, color, f"{by} = {value:.4g}", whole=False)
        one.set_ylabel(_LABELS.get(name, name))
        one.grid(color="#e3e6ea", lw=0.8)
        one.set_axisbelow(True)
        one.spines[["top", "right"]].set_visible(False)
        one.margins(x=0.0)
    axes[0].legend(frameon=False, fontsize=8, ncols=3)
    axes[-1].set_xlabel("t [s]")
    figure = axes[0].figure
    if ax is None:
        figure.set_layout_engine("constrained")
        case = ensemble.metadata.get("case", {}).get("name", "")
        axes[0].set_title(f"{case} · {len(ensemble)} members", loc="left", fontsize=11)
    return figure


def wet(ensemble: Ensemble, frame: int = -1, ax: Any = None) -> "Figure":
    """The probability of being wet, at a frame, in the cells of a two-dimensional case.

    Raises `ValueError` in three dimensions, or if `wet` was not observed, and `IndexError` for a frame that is not
    there.
    """
    probability = ensemble.mean("wet")[frame]
    if probability.ndim != 2:
        raise ValueError(f"wet must be of a case in two dimensions, got {probability.ndim}")
    ax = new_figure(7.0, 3.4).subplots() if ax is None else ax
    box = ensemble.metadata["box"]
    corners = [x for ends in zip(box["lower"], box["upper"], strict=True) for x in ends]
    image = ax.imshow(probability.T, origin="lower", extent=corners, cmap="Blues", vmin=0.0, vmax=1.0, aspect="equal")
    ax.figure.colorbar(image, ax=ax, label="probability of being wet", fraction=0.03, pad=0.02)
    highest = int(np.flatnonzero(np.any(ensemble.mean("wet") > 0.0, axis=(0, 1)))[-1:].sum()) + 2
    height = (box["upper"][1] - box["lower"][1]) / probability.shape[1]
    top = min(box["lower"][1] + highest * height, box["upper"][1])  # where it was ever wet
    ax.set(xlabel="x [m]", ylabel="y [m]", ylim=(box["lower"][1], top))
    ax.set_title(f"t = {ensemble.time[frame]:.3g} s, {len(ensemble)} members", loc="left", fontsize=11)
    return ax.figure


def _band(ax: Any, ensemble: Ensemble, name: str, color: Any, label: str, whole: bool) -> None:
    low, lower, middle, upper, high = ensemble.quantile(name, [0.025, 0.25, 0.5, 0.75, 0.975])
    ax.fill_between(ensemble.time, low, high, color=color, alpha=0.18, lw=0, label="95 %" if whole else None)
    if whole:
        ax.fill_between(ensemble.time, lower, upper, color=color, alpha=0.35, lw=0, label="50 %")
    ax.plot(ensemble.time, middle, color=color, lw=1.6, label=label)


def _shades(count: int) -> list[Any]:
    import matplotlib

    return [matplotlib.colormaps["viridis"](0.9 * k / max(count - 1, 1)) for k in range(count)]
