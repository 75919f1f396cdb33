"""Grains of a heavier fluid that settle in water: Tsuruta, Khayyer & Gotoh 2013, §3.2.1 (Fig. 4).

python examples/settling.py [--out DIR] [--reuse]

Runs CMPS-HS, MPS-HS-GC, MPS-HS-GC-DS and MPS-CD-GC-DS with the paper's 7000 particles, prints how each did, and draws
both fluids with their velocities. With --reuse the runs are read from the files of an earlier call.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import grains
import jax

import jaxmps as mps

TIMES = (0.0, 0.1, 0.2, 0.4, 1.0)


def main(
    spacing: float = 0.0025,
    until: float = 1.0,
    save_every: float = 0.01,
    out: str = "out/settling",
    schemes: Sequence[str] = grains.SCHEMES,
    reuse: bool = False,
) -> list[mps.Run]:
    """The runs; tables are printed, and the figure goes to the folder `out`."""
    case = mps.cases.settling(spacing=spacing)
    return grains.compare(case, until, save_every, TIMES, False, Path(out), schemes, reuse)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", default="out/settling")
    parser.add_argument("--reuse", action="store_true")
    arguments = parser.parse_args()
    main(out=arguments.out, reuse=arguments.reuse)
