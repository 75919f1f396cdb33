"""Dynamic stabilization: repulsion that is just strong enough to keep particles apart."""

import abc
from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxmps._types import Scalar, as_array
from jaxmps._vectors import dot
from jaxmps.models.interface import share_of_displacement
from jaxmps.neighbors import Pairs


class Push(NamedTuple):
    """What a stabilizer does in a step: change of velocity [m/s], displacement [m], number of pairs kept apart."""

    velocity: Float[Array, "n d"]
    displacement: Float[Array, "n d"]
    pairs: Int[Array, ""]


class AbstractStabilizer(eqx.Module):
    """A model of the forces that keep particles apart."""

    @abc.abstractmethod
    def __call__(
        self,
        acceleration: Float[Array, "n d"],
        pairs: Pairs,
        w: Float[Array, "n k"],
        density: Float[Array, " #n"],
        moves: Bool[Array, " n"],
        spacing: float,
        n0: float,
        dt: Scalar,
    ) -> Push:
        """What happens beside the motion by the pressure, whose `acceleration` [m/s²] is given."""


class NoStabilization(AbstractStabilizer):
    """Pressure alone moves the particles."""

    def __call__(self, acceleration, pairs, w, density, moves, spacing, n0, dt):
        return Push(jnp.zeros_like(acceleration), jnp.zeros_like(acceleration), jnp.zeros((), int))


class DynamicStabilization(AbstractStabilizer):
    """a_i = (1 / (ρ_i n0)) Σ_j F_ij w_ij, F_ij = −ρ_i Π_ij e_ij for pairs that would end closer than d = α_DS l0
    ([T13] Eqs. 7–19), e_ij = r_ij / |r_ij| before the correction.

    The pressure gradient alone would take the pair to r* = r_ij + (a_j − a_i) Δt² (Eq. 11). With s = r*·e_ij and
    r_⊥² = |r*|² − s², the displacement √(d² − r_⊥²) − s along e_ij brings it to the distance d, and

        Π_ij = (ρ_j / (ρ_i + ρ_j)) (√(d² − r_⊥²) − s) / Δt²  (Eq. 19),  Π_ij = (...) / Δt² against fixed particles.

    F_ij = −F_ji: momentum is conserved at any densities. Read against the letter of the paper: its Eq. 7 adds F to the
    gradient, whose negative is the acceleration, so that particles would attract each other; Eq. 16 takes the magnitude
    of r*_∥, wrong for a pair that has changed sides, where s is negative here; and a wall has infinite inertia. The
    average with w_ij / n0 of Eq. 7 closes only a part of the gap within a step: 0.22 at 0.85 l0, 0.49 at 0.5 l0, for
    r_e = 2.1 l0. `weighting` "none" closes the gap of a lonely pair in one step, "mean" takes 1 / n0 for w_ij / n0.

    `alpha_ds` is 1 − C for the Courant number C of the time step (Eq. 9), 0.9 in the paper. Its derivative is zero
    until some pair comes closer than α_DS l0.

    `kept_velocity` is the part of the displacement's velocity a_i Δt that a particle keeps: 1 is published; with 0
    particles are only shifted apart. In a flow that strains its particles the velocities act like a yield stress and
    make the pressure noisy.
    """

    alpha_ds: Scalar = eqx.field(converter=as_array, default=0.9)
    kept_velocity: Scalar = eqx.field(converter=as_array, default=1.0)
    weighting: Literal["kernel", "mean", "none"] = eqx.field(static=True, default="kernel")

    def __call__(self, acceleration, pairs, w, density, moves, spacing, n0, dt):
        overlap = gap(acceleration, pairs, self.alpha_ds * spacing, dt)
        push = overlap * share_of_displacement(density, moves, pairs)
        push = push * {"kernel": w / n0, "mean": jnp.where(w > 0, 1.0 / n0, 0.0), "none": w > 0}[self.weighting]
        shift = jnp.where(moves[:, None], -pairs.along(push * pairs.inverse), 0.0)
        # A pair of two moving particles stands in the table twice.
        active = jnp.where(moves[:, None], jnp.where(pairs.at_j(moves), 0.5, 1.0), 0.0)
        count = jnp.round(jnp.sum(jnp.where(overlap > 0, active, 0.0))).astype(int)
        return Push(self.kept_velocity * shift / dt, shift, count)


def gap(
    acceleration: Float[Array, "n d"],
    pairs: Pairs,
    distance: Scalar,
    dt: Scalar,
) -> Float[Array, "n k"]:
    """√(d² − r_⊥²) − r*·e_ij [m] of each pair that would come closer than d, else zero ([T13] Eqs. 10, 11, 14, 18)."""
    e_ij, a_ij = pairs.e_ij, pairs.between(acceleration)
    r_star = tuple(r + dt**2 * a for r, a in zip(pairs.r_ij, a_ij, strict=True))
    along = dot(r_star, e_ij)
    sideways = tuple(r - along * e for r, e in zip(r_star, e_ij, strict=True))
    across = dot(sideways, sideways)
    overlaps = pairs.present & (along**2 + across < distance**2)
    # The root has a derivative wherever a pair overlaps; elsewhere it must not see a negative number.
    reach = jnp.sqrt(jnp.where(overlaps, distance**2 - across, 1.0))
    return jnp.where(overlaps, reach - along, 0.0)
