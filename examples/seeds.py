"""Runs of one case with several seeds, for `stochastic_dam_break.py` and `standing_wave.py`."""

from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxmps as mps


def runs(
    folder: Path,
    case: mps.Case,
    scheme: mps.Scheme,
    seeds: Sequence[int],
    until: float,
    save_every: float,
    reuse: bool,
    jitter: float = 1e-3,
) -> list[mps.Run]:
    """A run for each seed, which starts with particles displaced by up to `jitter` spacings: also without noise, runs
    then differ. They are kept in a folder; with `reuse` those that are there already are not run again.
    """
    keys = jnp.stack([jax.random.key(seed) for seed in seeds])
    cases = [mps.cases.jitter(case, jitter, key) for key in keys]
    many = mps.ensemble(
        cases, scheme, keys=keys, until=until, save_every=save_every, out=folder, overwrite=not reuse, progress=False
    )
    return [many[k] for k in range(len(many))]


def interval(values: Sequence[float] | np.ndarray) -> tuple[float, float]:
    """Mean over the seeds and half the width of its 95 % confidence interval (Student's t)."""
    from scipy.stats import t

    values = np.asarray(values, float)
    width = values.std(ddof=1) / np.sqrt(len(values)) * t.ppf(0.975, len(values) - 1) if len(values) > 1 else np.nan
    return float(values.mean()), float(width)
