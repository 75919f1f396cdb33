"""What the step costs under transformations: its gradient, and an ensemble of runs."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

import jaxmps as mps
from benchmarks.states import Flow
from benchmarks.timing import compiled, medians

MEMBERS = 8


def gradient(flow: Flow, steps: int, turns: int) -> dict[str, Any]:
    """Time of the mean square velocity after so many steps with its gradient in the velocities, and without."""

    def energy(velocity: Float[Array, "n d"], case: mps.Case, scheme: mps.Scheme, state: mps.State) -> Array:
        return jnp.mean(_after(velocity, case, scheme, state, steps).particles.velocity ** 2)

    arguments = (flow.state.particles.velocity, *flow[1:])
    forward = compiled(energy, *arguments)
    both = compiled(jax.value_and_grad(energy), *arguments)
    value, slope = both(*arguments)
    if not (jnp.isfinite(value) and jnp.all(jnp.isfinite(slope))):
        raise RuntimeError("the gradient must be finite")
    plain, with_gradient = medians([lambda: forward(*arguments), lambda: both(*arguments)], turns)
    return {
        **_flow(flow),
        "steps": steps,
        "forward_ms_per_step": 1e3 * plain / steps,
        "value_and_grad_ms_per_step": 1e3 * with_gradient / steps,
        "relative": with_gradient / plain,
        "peak_bytes_per_particle": both.memory / len(flow.case.particles.kind),
        "compile_s": both.seconds,
    }


def ensemble(flow: Flow, steps: int, turns: int) -> dict[str, Any]:
    """Time of a member's step among eight under `vmap`, whose velocities differ by some thousandths, and of one run."""

    def run(velocity: Float[Array, "n d"], case: mps.Case, scheme: mps.Scheme, state: mps.State) -> mps.State:
        return _after(velocity, case, scheme, state, steps)

    velocity = flow.state.particles.velocity
    members = velocity * (1.0 + 1e-3 * jnp.arange(MEMBERS, dtype=velocity.dtype))[:, None, None]
    one = compiled(run, velocity, *flow[1:])
    many = compiled(jax.vmap(run, in_axes=(0, None, None, None)), members, *flow[1:])
    alone, together = medians([lambda: one(velocity, *flow[1:]), lambda: many(members, *flow[1:])], turns)
    return {
        **_flow(flow),
        "members": MEMBERS,
        "steps": steps,
        "single_ms_per_step": 1e3 * alone / steps,
        "ms_per_member_step": 1e3 * together / (MEMBERS * steps),
        "relative": together / (MEMBERS * alone),
        "compile_s": many.seconds,
    }


def _after(
    velocity: Float[Array, "n d"], case: mps.Case, scheme: mps.Scheme, state: mps.State, steps: int
) -> mps.State:
    start = eqx.tree_at(lambda s: s.particles.velocity, state, velocity)
    return mps.rollout(case, scheme, start, steps=steps)[0]


def _flow(flow: Flow) -> dict[str, Any]:
    precision = "double" if flow.state.particles.position.dtype.itemsize == 8 else "single"
    return {"case": flow.name, "particles": len(flow.case.particles.kind), "precision": precision}
