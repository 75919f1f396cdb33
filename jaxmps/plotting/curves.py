"""Curves over the time of a run."""

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxmps.plotting.flow import heading, new_figure
from jaxmps.results import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BLUE, _ORANGE, _DARK = "#2f7fc1", "#d9822b", "#1b2a3a"


def energy(run: Run, ax: Any = None) -> "Figure":
    """Kinetic, potential and total energy against time, per unit mass [J/kg] and per volume [J/m³] of the fluid.

    Particles have equal volumes, so one is the other times the mean density.
    """
    ax = _axes(run, 0.76) if ax is None else ax
    kinetic, potential = run.energy.T
    for values, name, color in (
        (kinetic + potential, "total", _DARK),
        (potential, "potential", _BLUE),
        (kinetic, "kinetic", _ORANGE),
    ):
        ax.plot(run.time, values, label=name, color=color, lw=1.8)
    ax.set(xlabel="t [s]", ylabel="energy per unit mass [J/kg]")
    ax.margins(x=0.0, y=0.08)
    density = float(np.mean(run.density[run.fluid[0]]))
    volume = ax.secondary_yaxis("right", functions=(lambda e: density * e, lambda e: e / density))
    volume.set_ylabel("energy per volume [J/m³]")
    _finish(ax)
    return ax.figure


def front(run: Run, ax: Any = None) -> "Figure":
    """Surge front Z = x / a of a dam break against T = t √(2g / a), with what others found.

    a is the width of the column. Raises `ValueError` if the run is no dam break.
    """
    from jaxmps.cases.dam_break import KOSHIZUKA_OKA_EXPERIMENT, KOSHIZUKA_OKA_MPS, MARTIN_MOYCE_EXPERIMENT
    from jaxmps.diagnostics import surge_front

    case = run.metadata.get("case")
    case = case if isinstance(case, dict) else {}
    name = str(case.get("name", "custom"))
    if not name.startswith("dam_break") or not {"width", "gravity", "tank_length"} <= case.keys():
        raise ValueError(f"run must be a dam break to have a surge front, got the case {name}")
    width, scheme = case["width"], "".join(heading(run)[1:]) or "this run"
    time = run.time * np.sqrt(2.0 * case["gravity"] / width)
    place = surge_front(run.position, run.fluid, run.spacing) / width
    wall = case["tank_length"] / width
    # What the front does once it has met the far wall is no surge.
    end = int(np.argmax(place > wall - 0.02)) + 1 if np.any(place > wall - 0.02) else len(place)
    ax = _axes(run) if ax is None else ax
    ax.plot(time[:end], place[:end], color=_BLUE, lw=2.0, label=f"{scheme} (this run)", zorder=3)
    marks = {"ls": "none", "mfc": "white", "mew": 1.3, "ms": 6.0}
    for values, label, marker, color in (
        (KOSHIZUKA_OKA_EXPERIMENT, "experiment, Koshizuka & Oka 1996", "o", _DARK),
        (MARTIN_MOYCE_EXPERIMENT, "experiment, Martin & Moyce 1952", "s", "#7a6f9b"),
        (KOSHIZUKA_OKA_MPS, "MPS, Koshizuka & Oka 1996", "^", _ORANGE),
    ):
        ax.plot(*values, marker=marker, color=color, label=label, **marks)
    ax.set(xlabel=r"$T = t\,\sqrt{2g/a}$", ylabel=r"$Z = x_{\mathrm{front}}/a$")
    ax.set(xlim=(0.0, None), ylim=(0.8, None))
    _finish(ax)
    return ax.figure


def _axes(run: Run, width: float = 0.85) -> Any:
    figure = new_figure(6.6, 4.2)
    ax = figure.add_axes((0.11, 0.14, width, 0.76))
    ax.set_title(" · ".join(heading(run)), loc="left", fontsize=11)
    return ax


def _finish(ax: Any) -> None:
    ax.grid(color="#e3e6ea", lw=0.8)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.legend(frameon=False)
