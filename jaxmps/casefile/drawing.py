"""A picture of a case before it runs: particles, domain and probes."""

from typing import TYPE_CHECKING

import numpy as np

from jaxmps.casefile.setup import Setup
from jaxmps.plotting import frame
from jaxmps.results import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw(setup: Setup) -> "Figure":
    """The start of the case: fluids by color, walls, probes, and in 2-D the domain."""
    figure = frame(_as_run(setup), color="phase")
    axes, box = figure.axes[0], setup.case.box
    if len(setup.case.fluids.density) == 1:
        bar = axes.child_axes[0] if setup.case.dim == 2 else figure.axes[1]
        bar.remove()
    if setup.case.dim == 3:
        return figure
    from matplotlib.patches import Rectangle

    axes.add_patch(Rectangle((box.lower[0], box.lower[1]), *box.lengths, fill=False, ls=":", ec="#5f6368"))
    # A small domain is shown whole, of a large one the part with the particles.
    margin = 2.0 * setup.case.spacing
    for set_limits, limits, low, high in (
        (axes.set_xlim, axes.get_xlim(), box.lower[0], box.upper[0]),
        (axes.set_ylim, axes.get_ylim(), box.lower[1], box.upper[1]),
    ):
        size = limits[1] - limits[0]
        set_limits(max(low - margin, limits[0] - 0.2 * size), min(high + margin, limits[1] + 0.2 * size))
    return figure


def _as_run(setup: Setup) -> Run:
    """The start as a run of one frame."""
    case, particles = setup.case, setup.case.particles
    kind = np.asarray(particles.kind)
    return Run(
        time=np.zeros(1),
        position=np.asarray(particles.position)[None],
        velocity=np.asarray(particles.velocity)[None],
        pressure=np.asarray(particles.pressure)[None],
        number_density=np.zeros((1, len(kind))),
        surface=np.zeros((1, len(kind)), bool),
        kind=kind[None],
        phase=np.asarray(particles.phase),
        density=np.asarray(case.density),
        spacing=case.spacing,
        energy=np.zeros((1, 2)),
        metadata={"case": {"name": case.name, **dict(case.parameters)}, "scheme": {"name": setup.scheme.name}},
    )
