"""Ensembles of the standing wave of [N11] against the same runs one after the other.

python -m benchmarks.members [--members 16,64,256] [--steps 500] [--spacing 0.02] [--json FILE]

834 fluid particles on a wall, α = 0.04, single and double precision, a fixed time step. One after the other are
compiled rollouts; the ensemble is `jaxmps.ensemble` without frames, and, for comparison, all members under one `vmap`.
Both are compiled before, and take turns. Memory is what the process has grown by at its largest.
"""

import argparse
import json
import resource
import time
from collections.abc import Callable, Sequence
from math import nan
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

import jaxmps as mps
from benchmarks import machine
from jaxmps._compilation import compiler_options
from jaxmps.ensembles.batch_size import bytes_of

_MOST_IN_TURN = 64  # members that are also run one after the other, and under vmap
DT = 1e-3  # s, below the Courant limit of the wave's 0.7 m/s at the default spacing


def measure(case: mps.Case, members: int, steps: int, turns: int, vmapped: bool) -> dict[str, Any]:
    """Seconds of all members, each way, and the memory [bytes] that the ensemble took."""
    scheme = mps.schemes.stochastic(mps.schemes.mps(), alpha=0.04)
    keys = jax.vmap(jax.random.key)(jnp.arange(members))
    begin = mps.start(case, scheme)

    def roll(key: jax.Array) -> mps.State:
        return mps.rollout(case, scheme, begin, steps=steps, dt=DT, key=key)[0]

    single = jax.jit(roll, compiler_options=compiler_options())
    together = jax.jit(jax.vmap(roll), compiler_options=compiler_options())

    def in_turn() -> None:
        for key in keys:
            jax.block_until_ready(single(key))

    def ensemble() -> None:
        many = mps.ensemble(
            case, scheme, keys=keys, until=steps * DT, dt=DT, keep_frames=False, progress=False, observe=_energy
        )
        assert all(outcome.completed for outcome in many.status)

    ways: dict[str, Callable[[], Any]] = {"ensemble": ensemble}
    if members <= _MOST_IN_TURN:
        ways["in turn"] = in_turn
    if vmapped:
        ways["vmap"] = lambda: jax.block_until_ready(together(keys))
    jax.block_until_ready(single(keys[0]))
    mps.ensemble(case, scheme, keys=1, until=2 * DT, dt=DT, keep_frames=False, progress=False, observe=_energy)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    ensemble()
    grown = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    if vmapped:
        ways["vmap"]()
    best = dict.fromkeys(ways, float("inf"))
    for _ in range(turns):
        for name, way in ways.items():
            began = time.perf_counter()
            way()
            best[name] = min(best[name], time.perf_counter() - began)
    return {"seconds": best, "grown": grown, "reckoned": bytes_of(case, scheme)}


def _energy(case: mps.Case, state: mps.State) -> dict[str, jax.Array]:
    energy = mps.diagnostics.mechanical_energy(state.particles, case.density, case.gravity)
    return {"kinetic": energy.kinetic, "potential": energy.potential}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--members", default="16,64,256")
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--spacing", type=float, default=0.02)
    parser.add_argument("--turns", type=int, default=2)
    parser.add_argument("--no-vmap", action="store_true")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(arguments)
    print(", ".join(f"{key} {value}" for key, value in machine.describe().items()))
    print("precision  members  in turn [s]  ensemble [s]  faster  ms per member and step   vmap [s]  memory [MB]")
    rows = []
    for precision in ("single", "double"):
        jax.config.update("jax_enable_x64", precision == "double")
        case = mps.cases.standing_wave(spacing=options.spacing)
        for members in map(int, options.members.split(",")):
            found = measure(
                case, members, options.steps, options.turns, not options.no_vmap and members <= _MOST_IN_TURN
            )
            seconds = found["seconds"]
            each = 1e3 * seconds["ensemble"] / members / options.steps
            print(
                f"{precision:9}{members:9}{seconds.get('in turn', nan):13.1f}{seconds['ensemble']:14.1f}"
                f"{seconds.get('in turn', nan) / seconds['ensemble']:8.2f}{each:24.3f}"
                f"{seconds.get('vmap', nan):11.1f}{found['grown'] / 1e6:13.0f}",
                flush=True,
            )
            rows.append({"precision": precision, "members": members, "steps": options.steps, **found})
            if options.json:
                options.json.write_text(json.dumps(rows, indent=2))


if __name__ == "__main__":
    main()
