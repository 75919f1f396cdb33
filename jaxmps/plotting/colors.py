"""What colors can show: quantities, their color maps, and the values at the ends of a scale."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxmps.results import Run
from jaxmps.validation import number, one_of

if TYPE_CHECKING:
    from matplotlib.colors import Colormap

WALL, DUMMY, INK = "#7d828a", "#ced1d6", "#c0392b"  # INK: of probes
_WATER, _CREST, _AMBER, _GREEN, _PURPLE = "#2f7fc1", "#f2a541", "#e0a030", "#3c9d6b", "#8a63b0"
_MOST_FRAMES = 40  # percentiles of more frames take long, and say the same
_SIGNED = 0.01  # of the largest pressure: less tension than that is noise, and no reason for another scale


class Quantity(NamedTuple):
    """Something that colors show: a number with a unit, or one of a few `classes`."""

    label: str
    values: Callable[[Run, int], np.ndarray]
    colormap: Callable[[], "Colormap"]
    classes: Callable[[Run], list[str]] | None = None
    signed: bool = False


def quantity(color: str) -> Quantity:
    """The quantity of that name; `ValueError` if there is none."""
    return _QUANTITIES[one_of("color", color, _QUANTITIES)]


def scale(run: Run, shown: Quantity, limits: tuple[float, float] | None, frames: range) -> Any:
    """The color map, the norm, and at which ends values lie outside: arguments of a color bar.

    `limits`: values at the ends; by default 1st and 99th percentile in the fluid, over `frames`. A quantity with a sign
    that has both of them in that range gets colors that part at zero, and ends that are equally far from it.
    """
    from matplotlib import colormaps
    from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize, TwoSlopeNorm

    colormap = shown.colormap()
    if shown.classes is not None:
        count = len(shown.classes(run))
        listed = ListedColormap([colormap(i % colormap.N) for i in range(count)])
        return listed, BoundaryNorm(np.arange(count + 1) - 0.5, count), "neither"
    sample = frames[:: -(-len(frames) // _MOST_FRAMES)]
    values = np.concatenate([shown.values(run, k)[run.fluid[k]] for k in sample])
    values = values[np.isfinite(values)]
    values = values if len(values) else np.zeros(1)
    if limits is None:
        low, high = (float(x) for x in np.percentile(values, [1.0, 99.0]))
        low = min(low, 0.0) if shown.label.startswith(("pressure", "speed")) else low
        high = high if high > low else low + 1.0
        signed = shown.signed and low < -_SIGNED * abs(high)
        low, high = (-max(-low, high), max(-low, high)) if signed else (low, high)
    else:
        low, high = (number("limits", x) for x in limits)
        if low >= high:
            raise ValueError(f"limits must be two rising numbers, got {low:g} and {high:g}")
        signed = shown.signed and low < 0.0 < high
    below, above = bool(values.min() < low), bool(values.max() > high)
    extend = {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}[below, above]
    if signed:  # both halves in full, also between limits that are not equally far from zero
        return colormaps["coolwarm"], TwoSlopeNorm(0.0, low, high), extend
    return colormap, Normalize(low, high), extend


def water() -> "Colormap":
    """From pale cyan to deep blue, in equal steps of lightness in the OKLab color space."""
    from matplotlib.colors import ListedColormap

    t = np.linspace(0.0, 1.0, 256)
    hue = np.radians(222.0 + 42.0 * t)
    chroma = 0.045 + 0.09 * np.sin(np.pi * (0.05 + 0.8 * t))
    return ListedColormap(_srgb(0.88 - 0.58 * t, chroma, hue), name="water")


def _srgb(lightness: np.ndarray, chroma: np.ndarray, hue: np.ndarray) -> np.ndarray:
    lab = np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], axis=-1)
    to_cone = [
        [1, 0.39633778, 0.21580376],
        [1, -0.10556135, -0.06385417],
        [1, -0.08948418, -1.29148555],
    ]
    to_rgb = [
        [4.07674166, -3.30771159, 0.23096993],
        [-1.26843800, 2.60975740, -0.34131940],
        [-0.00419609, -0.70341861, 1.70761470],
    ]
    linear = np.clip((lab @ np.transpose(to_cone)) ** 3 @ np.transpose(to_rgb), 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def _named(name: str) -> Callable[[], "Colormap"]:
    def colormap() -> "Colormap":
        from matplotlib import colormaps

        return colormaps[name]

    return colormap


def _listed(*colors: str) -> Callable[[], "Colormap"]:
    def colormap() -> "Colormap":
        from matplotlib.colors import ListedColormap

        return ListedColormap(colors)

    return colormap


_QUANTITIES = {
    "pressure": Quantity("pressure [Pa]", lambda run, k: run.pressure[k], water, signed=True),
    # Fast water is pale, as foam is.
    "speed": Quantity(
        "speed [m/s]",
        lambda run, k: np.linalg.norm(run.velocity[k], axis=-1),
        lambda: water().reversed(),
    ),
    "phase": Quantity(
        "phase",
        lambda run, k: run.phase,
        _listed(_WATER, _AMBER, _GREEN, _PURPLE),
        lambda run: run.phase_names,
    ),
    "number_density": Quantity("number density [–]", lambda run, k: run.number_density[k], _named("viridis")),
    "kind": Quantity(
        "kind",
        lambda run, k: run.kind[k],
        _listed(_WATER, WALL, DUMMY),
        lambda run: ["fluid", "wall", "dummy"],
    ),
    "surface": Quantity(
        "surface",
        lambda run, k: run.surface[k],
        _listed(_WATER, _CREST),
        lambda run: ["inside", "surface"],
    ),
}
COLORS = tuple(_QUANTITIES)
"""What `color` can be."""
