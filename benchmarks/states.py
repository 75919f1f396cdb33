"""Flows to measure on, of any size: the collapse of a dam, and what is harder or easier to solve for."""

import dataclasses
from collections.abc import Callable, Iterator
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

import jaxmps as mps
from benchmarks.disorder import disordered
from benchmarks.splash import splash
from jaxmps.flow import Particles


class Flow(NamedTuple):
    """A state to measure on, and what it is called."""

    name: str
    case: mps.Case
    scheme: mps.Scheme
    state: mps.State


def begin(name: str, case: mps.Case, scheme: mps.Scheme | None = None) -> Flow:
    """The flow of a case at its start."""
    scheme = scheme or mps.schemes.mps(viscous=False)
    return Flow(name, case, scheme, mps.start(case, scheme))


def sized(make: Callable[..., mps.Case], particles: int, dim: int = 2) -> mps.Case:
    """The case with about so many particles, by its spacing."""
    case = make()
    for _ in range(6):
        ratio = len(case.particles.kind) / particles
        if abs(ratio - 1.0) < 0.02:
            break
        case = make(spacing=case.spacing * ratio ** (1.0 / dim))
    return case


def flows(particles: int) -> Iterator[Flow]:
    """The flows of about so many particles whose pressure is solved for, beside those of the dam break."""
    cases, own = mps.cases, mps.schemes.mps_cd_gc_ds()
    yield begin("splash", splash(particles))
    for make, scheme in ((cases.square_patch, own), (cases.hydrostatic, None), (cases.settling, own)):
        case = disordered(sized(make, particles), np.random.default_rng(0))
        yield begin(case.name, case, scheme)


def simulated(case: mps.Case, times: tuple[float, ...]) -> Iterator[Flow]:
    """The case as a run with the standard method finds it at some times [s]."""
    scheme, step = mps.schemes.mps(viscous=False), min(times)
    run = mps.simulate(case, scheme, until=max(times), save_every=step, progress=False)
    run.status.check()
    for time in times:
        frame = int(np.argmin(np.abs(run.time - time)))
        fields = (run.position, run.velocity, run.pressure, run.kind)
        position, velocity, pressure, kind = (jnp.asarray(values[frame]) for values in fields)
        particles = Particles(
            position, velocity, pressure, kind.astype(case.particles.kind.dtype), case.particles.phase
        )
        yield begin(f"{case.name} at {time:g} s", dataclasses.replace(case, particles=particles), scheme)
