"""How derivatives through long runs grow, and what helps: windows, and evolution strategies.

python examples/gradient_growth.py [--out DIR]

The norm of the derivative of the mean square velocity by the initial velocities, against the number of steps, on the
rotating patch and on the standing wave: whole, and in windows of 25 steps. Small disturbances grow in these flows, and
the derivative tells so faithfully; where it has grown by orders, a step of an optimiser along it leads nowhere.
"""

import argparse
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import jaxmps as mps

WINDOW = 25


def growth(case: mps.Case, scheme: mps.Scheme, steps: tuple[int, ...], dt: float) -> dict[str, np.ndarray]:
    """Norms of the derivative for each number of steps: whole, and in windows."""
    start = mps.start(case, scheme)

    def squared(state: mps.State) -> jax.Array:
        return jnp.mean(jnp.sum(state.particles.velocity**2, axis=-1))

    def norms(window: int | None) -> np.ndarray:
        def loss(velocity: jax.Array, count: jax.Array) -> jax.Array:
            """The mean over the first `count` steps: of the end alone, only the last window would count."""
            moving = eqx.tree_at(lambda s: s.particles.velocity, start, velocity)
            options = {"steps": max(steps), "dt": dt, "window": window, "record": squared}
            every = mps.rollout(case, scheme, moving, **options)[2]
            return jnp.sum(jnp.where(jnp.arange(max(steps)) < count, every, 0.0)) / count

        slope = jax.jit(jax.grad(loss))
        return np.array([float(jnp.linalg.norm(slope(start.particles.velocity, jnp.asarray(n)))) for n in steps])

    return {"whole": norms(None), "windows": norms(WINDOW)}


def main(
    spacing: float = 0.04,
    steps: tuple[int, ...] = (25, 50, 100, 200, 400, 800),
    names: tuple[str, ...] | None = None,
    out: str = "out/gradient_growth",
) -> dict[str, dict[str, np.ndarray]]:
    """Prints and draws the norms."""
    patch = mps.cases.square_patch(spacing=spacing)
    wave = mps.cases.jitter(mps.cases.standing_wave(spacing=spacing, floor="mirror"), 0.01, jax.random.key(0))
    flows = {
        "patch, mps_hs_gc_ds": (patch, mps.schemes.mps_hs_gc_ds(), 0.1 * spacing),
        "patch, mps_cd_gc_ds": (patch, mps.schemes.mps_cd_gc_ds(restoring=0.0), 0.1 * spacing),
        "wave, mps": (wave, mps.schemes.mps(), 0.1 * spacing),
        "wave, mps_cd_gc_ds": (wave, mps.schemes.mps_cd_gc_ds(), 0.1 * spacing),
    }
    found = {}
    print(f"{'norm of the derivative after':32}" + "".join(f"{n:>10}" for n in steps) + " steps")
    for name, (case, scheme, dt) in flows.items():
        if names is not None and name not in names:
            continue
        found[name] = growth(case, scheme, steps, dt)
        for kind, norms in found[name].items():
            print(f"{name + ', ' + kind:32}" + "".join(f"{x:10.2g}" for x in norms), flush=True)
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    ax = figure.subplots()
    for (name, norms), color in zip(found.items(), ("#1b2a3a", "#2f7fc1", "#d9822b", "#3a9a5b"), strict=False):
        ax.loglog(steps, norms["whole"], "o-", color=color, label=name)
        ax.loglog(steps, norms["windows"], "o:", color=color, ms=3)
    ax.set(
        xlabel="steps", ylabel="norm of the derivative [s/m]", title=f"whole, and (dotted) in windows of {WINDOW} steps"
    )
    ax.legend(fontsize=8)
    Path(out).mkdir(parents=True, exist_ok=True)
    figure.savefig(Path(out) / "growth.png", dpi=140)
    return found


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", default="out/gradient_growth")
    main(out=parser.parse_args().out)
