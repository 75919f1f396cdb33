"""How much memory a run takes, before it runs.

Measured as the peak of the resident memory of `jaxmps run` on two cores, about 20 steps of the dam breaks in two and
three dimensions with `mps_hs_gc_ds`, in an empty cache of compiled programs and then in the filled one (Linux, jax
0.10.1, November 2026). The numbers below are fitted to these runs; `mps` takes up to a tenth less. MB:

| particles | frames | precision | first run: said | taken | later: said | taken |
|---|---|---|---|---|---|---|
| 2171, 2-D | 3 | double | 941 | 927 | 581 | 578 |
| 23 621, 2-D | 3 | double | 1051 | 1071 | 691 | 653 |
| 80 862, 2-D | 3 | double | 1344 | 1363 | 984 | 910 |
| 80 862, 2-D | 3 | single | 1169 | 1208 | 809 | 770 |
| 2669, 3-D | 3 | double | 1208 | 1211 | 708 | 710 |
| 76 694, 3-D | 3 | double | 2269 | 2177 | 1769 | 1622 |
| 76 694, 3-D | 3 | single | 1806 | 1800 | 1306 | 1281 |
| 121 548, 3-D | 3 | double | 2913 | 2665 | 2413 | 2150 |
| 80 862, 2-D, 361 steps | 101 | double | 1685 | 1815 | 1325 | 1286 |

A table that flow has filled is made half as large again, which is not foreseen here.
"""

import math
from typing import NamedTuple

from jaxmps.casefile.setup import Setup
from jaxmps.neighbors import SKIN, usual_capacity

_PACKAGES = 310.0  # MB of Python with JAX, jax-md, h5py and matplotlib
_PROGRAMS = {2: 260.0, 3: 360.0}  # MB of the step, the search for neighbors, energies, and what runs them
_COMPILER = {2: 360.0, 3: 500.0}  # MB that compiling them takes, which the process keeps
_NUMBERS, _INDICES = 27, 10  # for each slot of the neighbor table in a step: pairs, matrices, and copies of them
_READ = 1.4  # all frames, and those of one field once more while it is read


class Memory(NamedTuple):
    """Memory [MB] of a run that compiles its programs, and of later ones, which find them compiled."""

    first: float
    later: float


def memory(setup: Setup) -> Memory:
    """What Python, its packages and programs take, and the larger of what a step and the end of the run take besides:
    so much for each slot of the neighbor table, and all frames, which are read then.
    """
    case = setup.case
    number = 4 if setup.run.precision == "single" else 8
    slots = len(case.particles.kind) * usual_capacity(setup.scheme.ratio + SKIN, case.dim)
    step = slots * (_NUMBERS * number + 4 * _INDICES) / 1e6
    later = _PACKAGES + _PROGRAMS[case.dim] + max(step, _READ * file_size(setup))
    return Memory(later + _COMPILER[case.dim], later)


def file_size(setup: Setup) -> float:
    """Size [MB] of the file with all frames of a run."""
    number = 4 if setup.run.precision == "single" else 8
    frames = math.ceil(setup.run.until / setup.run.save_every) + 1
    return frames * len(setup.case.particles.kind) * (8 * number + 2) / 1e6
