"""Keeps the frames of a run, in memory or in a file, and makes the `Run`."""

import time as clock
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Array

from jaxmps._compilation import jit
from jaxmps.description import describe, versions
from jaxmps.flow import Case, Kind, Outcome, Status, mechanical_energy
from jaxmps.io import Writer, read
from jaxmps.monitor import BITS
from jaxmps.results import Run
from jaxmps.running.log import Log
from jaxmps.scheme import Scheme
from jaxmps.stepping import State

_energy = jit(mechanical_energy)


def fields(state: State) -> dict[str, Array]:
    """What a frame keeps of the particles, by the names of a `Run`."""
    p = state.particles
    return {
        "position": p.position,
        "velocity": p.velocity,
        "pressure": p.pressure,
        "number_density": state.number_density,
        "surface": state.surface,
        "kind": p.kind,
    }


def unsolved(state: State) -> bool:
    """Whether no pressure has been solved for, or given."""
    return int(state.step) == 0 and not np.any(np.asarray(state.particles.pressure))


class Recorder:
    """Takes the state at the times of the frames; with `out` it writes each frame at once."""

    def __init__(
        self,
        case: Case,
        scheme: Scheme,
        settings: dict[str, Any],
        out: str | Path | None,
        overwrite: bool,
        kept: Mapping[str, Any] | None = None,
    ):
        """`kept` is what another recorder had in `keep`, whose file `out` this one carries on."""
        self._case, self._began = case, clock.perf_counter()
        position = case.particles.position
        self._fixed = {
            "phase": np.asarray(case.particles.phase),
            "density": np.asarray(case.density),
            "spacing": case.spacing,
        }
        self._metadata = {
            "case": {"name": case.name, **dict(case.parameters)},
            "scheme": {"name": scheme.name, **describe(scheme)},
            "run": {**settings, "precision": str(position.dtype)},
            "box": case.box.described(),
            "versions": versions(),
        }
        self._times: list[float] = []
        self._energies: list[float] = []
        self._frames: list[dict[str, Any]] = []
        self._writer = None
        if kept is not None and out is not None:
            self._began -= float(kept["seconds"])
            self._writer = Writer.restored(out, kept["image"])
            times, energies = self._writer.history()
            self._times, self._energies = times.tolist(), energies.sum(axis=1).tolist()
        elif out is not None:
            frames = round(settings["until"] / settings["save_every"]) + 1
            self._writer = Writer(
                out,
                **self._fixed,
                dim=case.dim,
                dtype=position.dtype,
                metadata=self._metadata,
                overwrite=overwrite,
                frames=frames,
            )

    def keep(self) -> dict[str, Any]:
        """What another recorder needs to carry on with the file: wall time so far [s], and the file's image."""
        if self._writer is None:
            raise ValueError("out must be given: only a run that is written to a file can be carried on")
        return {"seconds": clock.perf_counter() - self._began, "image": self._writer.image()}

    def save(self, state: State) -> None:
        """Adds the state as a frame, unless it is the last one already."""
        p, time = state.particles, float(state.time)
        if self._times and self._times[-1] == time:
            return
        energy = _energy(p, self._case.density, self._case.gravity)
        frame: dict[str, Any] = jax.device_get(fields(state))
        frame["time"] = time
        frame["energy"] = np.array([energy.kinetic, energy.potential], np.float64)
        if self._writer is None:
            self._frames.append(frame)
        else:
            self._writer.append(**frame)
        self._times.append(time)
        self._energies.append(float(frame["energy"].sum()))

    def complete(self, state: State, pressure: Callable[[], Array]) -> None:
        """Gives the first frame the `pressure` [Pa] of the first solve, if it has none yet: none was solved for before
        it. A case or a state that brings its own pressure keeps that.
        """
        if len(self._times) != 1 or not unsolved(state):
            return
        found = np.asarray(pressure())
        if self._writer is None:
            self._frames[0]["pressure"] = found
        else:
            self._writer.put_pressure(0, found)

    def finish(self, state: State, log: Log, outcome: Outcome) -> Run:
        """The run, with its summary."""
        seconds = clock.perf_counter() - self._began
        steps, kind = int(log.steps), np.asarray(state.particles.kind)
        # Mean number of pairs that the stabilizer kept apart; energies [J/kg] that it, the noise and moving walls gave
        # in all, and what of these and of the start is neither kinetic nor potential at the end.
        summary = {
            "case": self._case.name,
            "scheme": self._metadata["scheme"]["name"],
            "particles": len(kind),
            "fluid_particles": int(np.sum(kind == Kind.FLUID)),
            "escaped": int(log.count[BITS.index(Status.ESCAPED)]),
            "steps": steps,
            "time": float(state.time),
            "status": str(outcome),
            "completed": outcome.completed,
            "energy_start": self._energies[0],
            "energy_end": self._energies[-1],
            "max_speed": float(log.max_speed),
            "closest_pair": float(log.closest) if np.isfinite(log.closest) else None,
            "stabilized_pairs": float(log.stabilized) / max(steps, 1),
            "stabilizer_work": float(log.work),
            "noise_work": float(log.given),
            "wall_work": float(log.wall_work),
            "dissipated": float(log.lost + log.given + log.work),
            "mean_residual": float(log.residual) / max(steps, 1),
            "wall_seconds": seconds,
            "particle_steps_per_second": steps * len(kind) / seconds,
        }
        if self._writer is not None:
            self._writer.finish(outcome.to_dict(), summary)
            return read(self._writer.path, lazy=None)
        columns = {name: np.stack([f[name] for f in self._frames]) for name in self._frames[0]}
        return Run(**columns, **self._fixed, status=outcome, summary=summary, metadata=self._metadata)
