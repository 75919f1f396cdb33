"""How derivatives through long runs grow, and what helps: windows, and evolution strategies.

python examples/gradient_growth.py [--out DIR]

Of the mean square velocity over the first n steps, against n, on the rotating patch and on the standing wave: the norm
of the derivative by all initial velocities, and the derivative by a number of the scheme that acts in each step, whole
and in windows of 25 steps. Small disturbances grow in these flows, and the derivative tells so faithfully; where it has
grown by orders, a step of an optimiser along it leads nowhere.
"""

import argparse
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import jaxmps as mps

WINDOW = 25


def growth(case: mps.Case, scheme: mps.Scheme, where: Any, steps: tuple[int, ...], dt: float) -> dict[str, np.ndarray]:
    """Sizes of the derivatives for each number of steps."""
    start = mps.start(case, scheme)

    def means(scheme: mps.Scheme, velocity: jax.Array, window: int | None) -> jax.Array:
        """Of the first 1, 2, 3, … steps: of the end alone, only the last window would count."""
        moving = eqx.tree_at(lambda s: s.particles.velocity, start, velocity)
        record = lambda state: jnp.mean(jnp.sum(state.particles.velocity**2, axis=-1))  # noqa: E731
        every = mps.rollout(case, scheme, moving, steps=max(steps), dt=dt, window=window, record=record)[2]
        return jnp.cumsum(every) / jnp.arange(1, max(steps) + 1)

    velocity, value = start.particles.velocity, where(scheme)
    by_velocity = jax.jit(jax.grad(lambda u, n: means(scheme, u, None)[n - 1]))

    def by_value(window: int | None) -> np.ndarray:
        changed = lambda x: means(eqx.tree_at(where, scheme, x), velocity, window)  # noqa: E731
        slopes = jax.jit(lambda x: jax.jvp(changed, (x,), (jnp.ones_like(x),))[1])(value)
        return np.abs(np.asarray(slopes))[np.array(steps) - 1]

    norms = [float(jnp.linalg.norm(by_velocity(velocity, jnp.asarray(n)))) for n in steps]
    return {"velocities": np.array(norms), "whole": by_value(None), "windows": by_value(WINDOW)}


def main(
    spacing: float = 0.04,
    steps: tuple[int, ...] = (25, 50, 100, 200, 400, 800),
    names: tuple[str, ...] | None = None,
    out: str = "out/gradient_growth",
) -> dict[str, dict[str, np.ndarray]]:
    """Prints and draws the norms."""
    patch = mps.cases.square_patch(spacing=spacing)
    wave = mps.cases.jitter(mps.cases.standing_wave(spacing=spacing, floor="mirror"), 0.01, jax.random.key(0))
    alpha_ds, relaxation = (lambda s: s.stabilizer.alpha_ds), (lambda s: s.source.relaxation)
    flows = {
        "patch, mps_hs_gc_ds": (patch, mps.schemes.mps_hs_gc_ds(), alpha_ds, 0.1 * spacing),
        "patch, mps_cd_gc_ds": (patch, mps.schemes.mps_cd_gc_ds(restoring=0.0), alpha_ds, 0.1 * spacing),
        "wave, mps": (wave, mps.schemes.mps(), relaxation, 0.1 * spacing),
        "wave, mps_cd_gc_ds": (wave, mps.schemes.mps_cd_gc_ds(), alpha_ds, 0.1 * spacing),
    }
    found = {}
    print(f"{'size of the derivative after':32}" + "".join(f"{n:>10}" for n in steps) + " steps")
    for name, (case, scheme, where, dt) in flows.items():
        if names is not None and name not in names:
            continue
        found[name] = growth(case, scheme, where, steps, dt)
        for kind, norms in found[name].items():
            print(f"{name + ', ' + kind:32}" + "".join(f"{x:10.2g}" for x in norms), flush=True)
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    ax = figure.subplots()
    for (name, norms), color in zip(found.items(), ("#1b2a3a", "#2f7fc1", "#d9822b", "#3a9a5b"), strict=False):
        ax.loglog(steps, norms["velocities"], "o-", color=color, label=name)
        ax.loglog(steps, norms["whole"], "o--", color=color, ms=3)
        ax.loglog(steps, norms["windows"], "o:", color=color, ms=3)
    title = f"by the initial velocities (full lines); by one number: whole (dashed), windows of {WINDOW} (dotted)"
    ax.set(xlabel="steps", ylabel="size of the derivative")
    ax.set_title(title, fontsize=8)
    ax.legend(fontsize=8)
    Path(out).mkdir(parents=True, exist_ok=True)
    figure.savefig(Path(out) / "growth.png", dpi=140)
    return found


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", default="out/gradient_growth")
    main(out=parser.parse_args().out)
