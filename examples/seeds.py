"""Runs of one case with several seeds as one compiled batch, for `stochastic_dam_break.py` and `standing_wave.py`."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxmps as mps
from jaxmps.stepping import largest_step

NOT_TAKEN = int(mps.Status.TABLE_FULL)


def batch(
    case: mps.Case,
    scheme: mps.Scheme,
    seeds: Sequence[int],
    until: float,
    save_every: float,
    jitter: float = 1e-3,
) -> list[mps.Run]:
    """A run for each seed, which starts with particles displaced by up to `jitter` spacings: also without noise, runs
    then differ. All make the steps of their own Courant limits, in one program.

    A run that is not finite any more keeps its last frame; one whose table is full raises `RuntimeError`.
    """
    cases = [mps.cases.jitter(case, jitter, jax.random.key(seed)) for seed in seeds]
    states = [mps.start(one, scheme) for one in cases]
    state = jax.tree.map(lambda *leaves: jnp.stack(leaves), *states)
    keys = jnp.stack([jax.random.key(seed) for seed in seeds])
    given, bits = jnp.zeros(len(seeds)), jnp.zeros(len(seeds), int)
    frames = [_frame(case, state, given)]
    for k in range(1, round(until / save_every) + 1):
        state, given, bits = _advance(case, scheme, state, given, bits, keys, jnp.asarray(k * save_every))
        if np.any(np.asarray(bits) & NOT_TAKEN):
            raise RuntimeError("the neighbor table is full")
        frames.append(_frame(case, state, given))
    columns = {name: np.stack([frame[name] for frame in frames], axis=1) for name in frames[0]}
    return [_run(one, scheme, columns, member) for member, one in enumerate(cases)]


@eqx.filter_jit
def _advance(case: mps.Case, scheme: mps.Scheme, state: mps.State, given: Any, bits: Any, keys: Any, until: Any) -> Any:
    """All members up to the time `until` [s]."""

    def one(state: mps.State, given: Any, bits: Any, key: Any) -> Any:
        def going(carry: Any) -> Any:
            return (carry[0].time < until - 1e-9) & (carry[2] & int(mps.Status.NOT_FINITE) == 0)

        def body(carry: Any) -> Any:
            state, given, bits = carry
            remaining = until - state.time
            count = jnp.maximum(jnp.ceil(remaining / largest_step(case, scheme, state.particles) - 1e-6), 1.0)
            state, info = mps.step(case, scheme, state, remaining / count, jax.random.fold_in(key, state.step))
            return state, given + info.given, bits | info.status

        return jax.lax.while_loop(going, body, (state, given, bits))

    return jax.vmap(one)(state, given, bits, keys)


def _frame(case: mps.Case, state: mps.State, given: Any) -> dict[str, np.ndarray]:
    particles = state.particles
    energy = jax.vmap(lambda p: mps.diagnostics.mechanical_energy(p, case.density, case.gravity))(particles)
    frame = {
        "time": state.time,
        "position": particles.position,
        "velocity": particles.velocity,
        "pressure": particles.pressure,
        "number_density": state.number_density,
        "surface": state.surface,
        "kind": particles.kind,
        "energy": jnp.stack([energy.kinetic, energy.potential], axis=-1),
        "given": given,
    }
    host = {name: np.asarray(column) for name, column in frame.items()}
    light = ("position", "velocity", "pressure", "number_density")
    return host | {name: host[name].astype(np.float32) for name in light}


def _run(case: mps.Case, scheme: mps.Scheme, columns: dict[str, np.ndarray], member: int) -> mps.Run:
    fields = {name: column[member] for name, column in columns.items()}
    given = fields.pop("given")
    metadata = {"case": {"name": case.name, **dict(case.parameters)}, "scheme": {"name": scheme.name}}
    summary = {"noise_work": given.tolist()}
    density, phase = np.asarray(case.density), np.asarray(case.particles.phase)
    return mps.Run(**fields, phase=phase, density=density, spacing=case.spacing, metadata=metadata, summary=summary)


def kept(
    path: Path, case: mps.Case, scheme: mps.Scheme, seeds: Sequence[int], until: float, save_every: float, reuse: bool
) -> list[mps.Run]:
    """The runs of a `batch`, kept in a file. With `reuse` those that are there already are not run again: the first so
    many of `seeds`.
    """
    runs = load(path, case)[: len(seeds)] if reuse and path.exists() else []
    if missing := seeds[len(runs) :]:
        runs = runs + batch(case, scheme, missing, until, save_every)
        store(path, runs)
    return runs


def store(path: Path, runs: Sequence[mps.Run]) -> None:
    """Keeps what the figures need of the runs, for `--reuse`."""
    names = [
        field.name for field in dataclasses.fields(mps.Run) if isinstance(getattr(runs[0], field.name), np.ndarray)
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    columns = {name: np.stack([getattr(run, name) for run in runs]) for name in names}
    given = np.array([run.summary["noise_work"] for run in runs])
    np.savez_compressed(
        path, given=given, spacing=runs[0].spacing, scheme=runs[0].metadata["scheme"]["name"], **columns
    )


def load(path: Path, case: mps.Case) -> list[mps.Run]:
    """The runs that `store` kept."""
    with np.load(path) as file:
        columns = {name: file[name] for name in file.files}
    given, spacing, scheme = columns.pop("given"), float(columns.pop("spacing")), str(columns.pop("scheme"))
    metadata = {"case": {"name": case.name, **dict(case.parameters)}, "scheme": {"name": scheme}}
    return [
        mps.Run(
            **{name: column[k] for name, column in columns.items()},
            spacing=spacing,
            metadata=metadata,
            summary={"noise_work": given[k].tolist()},
        )
        for k in range(len(given))
    ]


def interval(values: Sequence[float] | np.ndarray) -> tuple[float, float]:
    """Mean over the seeds and half the width of its 95 % confidence interval (Student's t)."""
    from scipy.stats import t

    values = np.asarray(values, float)
    width = values.std(ddof=1) / np.sqrt(len(values)) * t.ppf(0.975, len(values) - 1) if len(values) > 1 else np.nan
    return float(values.mean()), float(width)
