"""What can be known of a run before it runs: particles, mass, steps, memory and time, and what looks wrong."""

import dataclasses
import math

import numpy as np
from scipy.spatial import KDTree

from jaxmps.casefile.leaving import leaving
from jaxmps.casefile.memory import file_size, memory
from jaxmps.casefile.plane import CLOSE
from jaxmps.casefile.setup import Setup
from jaxmps.flow import Kind
from jaxmps.stepping import limits

# README, "Speed": µs per particle and step on two cores of a server.
_MICROSECONDS = {(2, "single"): 1.2, (2, "double"): 1.8, (3, "single"): 2.6, (3, "double"): 4.5}
_STARTING = 6.0  # s of wall time in which Python and JAX start and pictures are drawn
_COMPILING = {2: 10.0, 3: 20.0}  # s on such cores, however many particles there are


@dataclasses.dataclass(frozen=True)
class Report:
    """Tables of names and values, and a warning for each thing that looks wrong."""

    content: dict[str, str]
    expected: dict[str, str]
    warnings: tuple[str, ...]


def check(setup: Setup) -> Report:
    """Counts what there is, estimates what the run will take, and looks for particles that stand too close."""
    case, run = setup.case, setup.run
    kind, phase = np.asarray(case.particles.kind), np.asarray(case.particles.phase)
    content = {k.name.lower(): str(int(np.sum(kind == k))) for k in (Kind.FLUID, Kind.WALL, Kind.DUMMY)}
    density = np.asarray(case.fluids.density)
    unit = "kg per m" if case.dim == 2 else "kg"
    for i, rho in enumerate(density):
        count = int(np.sum((kind == Kind.FLUID) & (phase == i)))
        name = setup.fluids[i] if setup.fluids else f"phase {i}"
        content[name] = f"{count} particles, {rho:g} kg/m^3, {count * rho * case.spacing**case.dim:.5g} {unit}"
    content["domain"] = f"{_corner(case.box.lower)} to {_corner(case.box.upper)} m"
    steps, (later, at_start) = _steps(setup)
    seconds = steps[1] * len(kind) * _MICROSECONDS[case.dim, run.precision] * 1e-6 + _STARTING
    first, again = memory(setup)
    two_cores = "on two cores of a server"
    expected = {
        "time step": f"{run.until / steps[1]:.2g} s in fast flow{later}, {run.until / steps[0]:.2g} s at the start"
        f"{at_start}",
        "steps": f"{steps[0]} to {steps[1]}",
        "memory": f"{_megabytes(first)} in the first run, {_megabytes(again)} in later ones, which need not compile",
        "file": f"{file_size(setup):.3g} MB",
        "wall time": f"up to {_duration(seconds)} without compiling, {two_cores}; a GPU is faster",
        "compiling": f"about {_duration(_COMPILING[case.dim])} before the first step, {two_cores}; later runs of this "
        "case find it done",
    }
    gone = leaving(setup)
    left = [] if gone is None else [str(gone)]
    return Report(
        content, expected, (*left, *_close(setup), *_behind(setup), *_thin(setup), *_misfits(setup), *_dry(setup))
    )


def _corner(point: tuple[float, ...]) -> str:
    return f"({', '.join(f'{x:.4g}' for x in point)})"


def _steps(setup: Setup) -> tuple[tuple[int, int], tuple[str, str]]:
    """Fewest and most steps: as large as at the start, and at the speed of a fall through the whole of the fluid; of
    most and fewest what limits them.
    """
    case, run = setup.case, setup.run
    if run.dt is not None:
        count = math.ceil(run.until / run.dt)
        return (count, count), (" (fixed)", " (fixed)")
    position, kind = np.asarray(case.particles.position), np.asarray(case.particles.kind)
    gravity = np.asarray(case.gravity)
    allowed = {cause: float(x) for cause, x in limits(case, setup.scheme, case.particles)._asdict().items()}
    first = min(allowed, key=lambda cause: allowed[cause])
    start = allowed[first]
    size = float(np.linalg.norm(gravity))
    speed = float(np.max(np.linalg.norm(np.asarray(case.particles.velocity)[kind == Kind.FLUID], axis=1)))
    if size > 0.0:
        depth = position @ gravity / size
        fall = max(float(depth.max() - depth[kind == Kind.FLUID].min()), 0.0)
        speed = math.sqrt(speed**2 + 2.0 * size * fall)
    if not math.isfinite(min(allowed["speed"], allowed["gravity"])) and speed == 0.0:
        raise ValueError("dt must be given (in s) for a case at rest without gravity: the scheme sets no limit")
    fast = float(setup.scheme.time_step.courant) * case.spacing / speed if speed > 0.0 else math.inf
    last, fast = ("speed", fast) if fast < start else (first, start)
    counts = math.ceil(run.until / start), max(math.ceil(run.until / fast), math.ceil(run.until / run.save_every))
    return counts, (f" (limited by {last})", f" (limited by {first})")


def _megabytes(size: float) -> str:
    return f"{size:.0f} MB" if size < 1e4 else f"{size / 1e3:.1f} GB"


def _duration(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"


def _close(setup: Setup) -> list[str]:
    case = setup.case
    position, kind = np.asarray(case.particles.position, float), np.asarray(case.particles.kind)
    inside, periods = case.box.torus(position)
    pairs = KDTree(inside, boxsize=periods).query_pairs(CLOSE * case.spacing * (1.0 - 1e-6), output_type="ndarray")
    fluid = kind[pairs] == Kind.FLUID
    found = []
    for what, chosen in (("one another", fluid.all(axis=1)), ("a wall", fluid.sum(axis=1) == 1)):
        if chosen.any():
            i, j = pairs[chosen][0]
            place = _corner(tuple(position[i if kind[i] == Kind.FLUID else j]))
            found.append(f"{chosen.sum()} times fluid is nearer than {CLOSE} spacings to {what}, first at {place} m")
    return found


def _behind(setup: Setup) -> list[str]:
    """Fluid at the back of a wall, where nothing holds it."""
    position, kind = np.asarray(setup.case.particles.position), np.asarray(setup.case.particles.kind)
    fluid, fixed = position[kind == Kind.FLUID], np.flatnonzero(kind != Kind.FLUID)
    if not len(fixed):
        return []
    box = setup.case.box
    tree = KDTree(box.torus(position[fixed])[0], boxsize=box.torus(position)[1])
    away, nearest = tree.query(box.torus(fluid)[0])
    back = (away < 1.2 * setup.case.spacing) & (kind[fixed[nearest]] == Kind.DUMMY)
    if not back.any():
        return []
    place = _corner(tuple(fluid[back][0]))
    return [f"{back.sum()} fluid particles touch a wall from behind, where it has no pressure, first at {place} m"]


def _thin(setup: Setup) -> list[str]:
    """Obstacles so thin that fluid on one side has neighbors on the other, or flows through a part of them."""
    if setup.layout is None:
        return []
    spacing, ratio = setup.case.spacing, setup.scheme.ratio
    open_ = [
        f"wall {index} has no particles at {_corner(place)} m, where it is thinner than a spacing: fluid flows through"
        for index, place in setup.layout.gaps
    ]
    return open_ + [
        f"wall {index} is {thick:.3g} m thick: fluid on one side feels that on the other; as a plate it would be thick "
        "enough"
        for index, thick in enumerate(setup.layout.thickness, 1)
        if thick + spacing < ratio * spacing * (1.0 - 1e-6)
    ]


def _misfits(setup: Setup) -> list[str]:
    """Bodies whose particles have not the mass of the shape, by more than 1 %."""
    if setup.layout is None:
        return []
    cell = setup.case.spacing**setup.case.dim
    found = []
    for index, (points, asked) in enumerate(zip(setup.layout.bodies, setup.layout.asked, strict=True), 1):
        if asked > 0.0 and abs(off := len(points) * cell / asked - 1.0) > 0.01:
            found.append(
                f"body {index} has the mass of its shape to {100 * off:+.1f} % only: its sides are no whole numbers of "
                "spacings, or walls are in its way"
            )
    return found


def _dry(setup: Setup) -> list[str]:
    """Probes that lie outside of the domain."""
    box = setup.case.box
    found = []
    for probe in setup.probes:
        for point in probe.place:
            axes = zip(point, box.lower, box.upper, strict=False)
            if any(not low <= x <= high for x, low, high in axes):
                found.append(f"probe {probe.name} lies outside of the domain, at {_corner(point)} m")
    return found
