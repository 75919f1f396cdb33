"""The energy that moving walls give to the fluid.

Nothing in the equations of a step is the force of a wall: differences of pressure move the particles. What the walls
have done is found from what happened to the fluid.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxmps._types import Scalar, positive_or_one
from jaxmps.flow import Box
from jaxmps.neighbors import Pairs


def wall_work(
    gained: Float[Array, "n d"],
    pressure: Float[Array, " n"],
    fluid: Bool[Array, " n"],
    has_pressure: Bool[Array, " n"],
    position: Float[Array, "n d"],
    wall_velocity: Float[Array, "n d"],
    pairs: Pairs,
    w: Float[Array, "n k"],
    n0: float,
    dt: Scalar,
    box: Box,
) -> Scalar:
    """Σ_j I_j · u_j over walls and dummies j at the velocities u_j [m/s], the impulses I_j being those on the fluid.

    `gained`: momentum per volume [kg/(m² s)] that each particle has gained in the step, but for gravity and noise. The
    impulses are first (D Δt / n0) Σ_i (p_i + p_j) w_ij r_ji / r_ij² over the fluid i, the force of pairs in the
    antisymmetric form of the gradient. To these the least correction is added, weighted by
    Σ_i w_ij, with which their sum and their moment are those of all that the fluid has gained: the work is exact for
    walls that move together as a rigid body, and with several bodies their shares are those of the pressure before
    them. Sums along a mirror's axis, and moments beside mirrors and periodic axes, do not belong to walls alone.
    """
    wall = ~fluid
    partner = jnp.where(wall[:, None] & pairs.at_j(fluid), w, 0.0)
    there = pairs.at_j(pressure)
    both = there + jnp.where(has_pressure[:, None], pressure[:, None], there)
    impulse = dt * pairs.dim / n0 * pairs.along(both * partner * pairs.inverse**2)
    weight = jnp.sum(partner, axis=-1)
    motions = _rigid_motions(position, weight, box)
    missing = jnp.sum(motions * (jnp.where(fluid[:, None], gained, 0.0) - impulse), axis=(1, 2))
    metric = jnp.einsum("kid,lid,i->kl", motions, motions, weight)
    ridge = 100.0 * jnp.finfo(metric.dtype).eps * positive_or_one(jnp.trace(metric))
    share = jnp.linalg.solve(metric + ridge * jnp.eye(len(motions)), missing)
    impulse = impulse + weight[:, None] * jnp.einsum("k,kid->id", share, motions)
    return jnp.sum(jnp.where(wall[:, None], impulse * wall_velocity, 0.0))


def _rigid_motions(position: Float[Array, "n d"], weight: Float[Array, " n"], box: Box) -> Float[Array, "k n d"]:
    """The velocities of translations and rotations about the wetted walls' center, in units of their extent."""
    dim = position.shape[1]
    center = weight @ position / positive_or_one(jnp.sum(weight))
    arm = position - center
    extent = jnp.sqrt(positive_or_one(weight @ jnp.sum(arm**2, axis=-1) / positive_or_one(jnp.sum(weight))))
    motions = [jnp.zeros_like(arm).at[:, axis].set(1.0) for axis in range(dim) if axis != box.mirror]
    if box.mirror is None and not any(box.periodic):
        for a in range(dim):
            for b in range(a + 1, dim):
                motions.append(jnp.zeros_like(arm).at[:, a].set(-arm[:, b]).at[:, b].set(arm[:, a]) / extent)
    return jnp.stack(motions)
