"""An inverse problem: from where the particles are in the end, find how fast they moved at the start.

python examples/recover_initial_velocity.py [--spacing L] [--until T] [--updates N] [--out DIR]

A patch of water rotates freely; only its final positions are known. First its angular velocity is found by gradients,
from half the true value; then a smooth velocity field of nine numbers, from rest.
"""

import argparse
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from matplotlib.figure import Figure

import jaxmps as mps

OMEGA = 1.0  # 1/s
MODES = 3  # along each axis
DT = 0.05  # spacings over the speed of a corner


class Found(NamedTuple):
    """Of one problem: the relative error of the velocity after each step, and what was tuned."""

    error: np.ndarray
    history: mps.History


class Problem(NamedTuple):
    """A patch, how it is run, and a velocity field [m/s] from its parameters."""

    case: mps.Case
    scheme: mps.Scheme
    start: mps.State
    steps: int
    dt: float
    velocity: Any

    def end(self, parameters: Any) -> jax.Array:
        start = eqx.tree_at(lambda s: s.particles.velocity, self.start, self.velocity(self.case, parameters))
        return mps.rollout(self.case, self.scheme, start, steps=self.steps, dt=self.dt)[0].particles.position

    def recover(self, truth: Any, guess: Any, optimizer: optax.GradientTransformation, updates: int) -> Found:
        seen = self.end(truth)

        def loss(parameters: Any, _: Any) -> jax.Array:
            """The mean square distance of the final positions from those that were seen, in spacings."""
            return jnp.mean(jnp.sum((self.end(parameters) - seen) ** 2, axis=-1)) / self.case.spacing**2

        _, history = mps.tune(loss, guess, lambda parameters: [parameters], optimizer, steps=updates)
        true = self.velocity(self.case, truth)
        fields = (self.velocity(self.case, jnp.asarray(x)) for x in history.values[0])
        return Found(np.array([float(jnp.linalg.norm(u - true) / jnp.linalg.norm(true)) for u in fields]), history)


def rotation(case: mps.Case, omega: Any) -> jax.Array:
    """u = ω (y, −x)."""
    x, y = case.particles.position.T
    return omega * jnp.stack([y, -x], axis=-1)


def smooth(case: mps.Case, coefficients: Any) -> jax.Array:
    """u = (∂ψ/∂y, −∂ψ/∂x) of ψ = Σ a_mn cos(m π x / L) cos(n π y / L) L / (π (m + n)), m, n ≥ 1, free of divergence."""
    x, y = case.particles.position.T
    length = dict(case.parameters)["side"]
    u = jnp.zeros_like(case.particles.position)
    for m in range(1, MODES + 1):
        for n in range(1, MODES + 1):
            kx, ky = m * jnp.pi / length, n * jnp.pi / length
            mode = jnp.stack([-n * jnp.cos(kx * x) * jnp.sin(ky * y), m * jnp.sin(kx * x) * jnp.cos(ky * y)], axis=-1)
            u = u + coefficients[m - 1, n - 1] / (m + n) * mode
    return u


def figure(found: dict[str, Found], case: mps.Case, truth: Any) -> Figure:
    picture = Figure(figsize=(11, 4.2), layout="constrained")
    left, *fields = picture.subplots(1, 3, width_ratios=(1.25, 1.0, 1.0))
    for (name, one), color in zip(found.items(), ("#2f7fc1", "#d9822b"), strict=True):
        left.semilogy(100.0 * one.error, color=color, label=name)
    left.axhline(1.0, color="0.7", lw=0.8)
    left.set(xlabel="update", ylabel="error of the velocity [%]")
    left.legend()
    x, y = np.asarray(case.particles.position).T
    last = found["smooth field"].history
    for ax, (title, values) in zip(
        fields, (("true", truth), ("found", jnp.asarray(last.values[0][last.best]))), strict=True
    ):
        u, v = np.asarray(smooth(case, values)).T
        ax.quiver(x, y, u, v, np.hypot(u, v), cmap="viridis", scale=5.0)
        ax.set(title=title, xlabel="x [m]", aspect="equal")
    return picture


def main(
    spacing: float = 0.04, until: float = 0.2, updates: int = 200, out: str = "out/recover_initial_velocity"
) -> dict[str, Found]:
    """Solves both problems, prints the errors and draws them."""
    case = mps.cases.square_patch(spacing=spacing, angular_velocity=OMEGA)
    scheme = mps.schemes.mps_cd_gc_ds(restoring=0.0, tolerance=1e-8)
    steps = round(until / (DT * spacing / (0.7 * OMEGA)))
    start = mps.start(case, scheme)
    by_rotation, by_field = (Problem(case, scheme, start, steps, until / steps, u) for u in (rotation, smooth))
    truth = jnp.asarray(0.3 * np.random.default_rng(0).normal(size=(MODES, MODES)))
    decay = optax.cosine_decay_schedule(0.1, updates)
    found = {
        "angular velocity": by_rotation.recover(
            jnp.asarray(OMEGA), jnp.asarray(0.5 * OMEGA), optax.adam(decay), updates
        ),
        "smooth field": by_field.recover(truth, jnp.zeros_like(truth), optax.adam(decay), updates),
    }
    for name, one in found.items():
        reached = np.flatnonzero(one.error < 0.01)
        after = f"below 1 % after {reached[0]} updates" if len(reached) else "never below 1 %"
        print(f"{name}: error of the velocity {100 * one.error[0]:.0f} % -> {100 * one.error[-1]:.3f} %, {after}")
    Path(out).mkdir(parents=True, exist_ok=True)
    figure(found, case, truth).savefig(Path(out) / "recovered.png", dpi=140)
    return found


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spacing", type=float, default=0.04)
    parser.add_argument("--until", type=float, default=0.2)
    parser.add_argument("--updates", type=int, default=200)
    parser.add_argument("--out", default="out/recover_initial_velocity")
    main(**vars(parser.parse_args()))
