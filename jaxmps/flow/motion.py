"""How walls move: signals of the time, and rigid bodies that follow them."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from jaxmps._types import Scalar, as_array
from jaxmps.flow.particles import Particles
from jaxmps.validation import one_of

INTERPOLATIONS = ("pchip", "linear")
"""What `Table` knows."""


class AbstractSignal(eqx.Module):
    """A number as a function of the time, with a derivative."""

    @abc.abstractmethod
    def __call__(self, time: Scalar) -> Scalar:
        """Its value at a time [s]."""


class Constant(AbstractSignal):
    """No motion."""

    value: Scalar = eqx.field(converter=as_array, default=0.0)

    def __call__(self, time):
        return self.value


class Sine(AbstractSignal):
    """A sin(ωt + φ): `amplitude` A [m or rad], angular `frequency` ω [rad/s], `phase` φ [rad]. With φ = −π/2 a motion
    begins at rest, with φ = 0 at its full speed, which is an impulse.
    """

    amplitude: Scalar = eqx.field(converter=as_array)
    frequency: Scalar = eqx.field(converter=as_array)
    phase: Scalar = eqx.field(converter=as_array, default=0.0)

    def __call__(self, time):
        return self.amplitude * jnp.sin(self.frequency * time + self.phase)


class Table(AbstractSignal):
    """Values [m or rad] at increasing times [s], two at least, and in between what `interpolation` says.

    With "pchip" these are cubics with the slopes of `pchip_slopes`: continuous in velocity, monotone wherever the
    values are, so that nothing overshoots and what rests in the table rests. With "linear" they are straight lines:
    each entry is an impulse. Before the first time and after the last, it stays where it is there.
    """

    times: Float[Array, " k"] = eqx.field(converter=as_array)
    values: Float[Array, " k"] = eqx.field(converter=as_array)
    interpolation: str = eqx.field(static=True, default="pchip")

    def __check_init__(self):
        one_of("interpolation", self.interpolation, INTERPOLATIONS)
        if self.times.ndim != 1 or self.times.shape != self.values.shape or self.times.size < 2:
            raise ValueError(
                "times and values of a table must be two lists of one length, of two entries at least, got "
                f"{self.times.shape} and {self.values.shape}"
            )
        for name, x in (("times", self.times), ("values", self.values)):
            if not isinstance(x, Tracer) and not bool(jnp.all(jnp.isfinite(x))):
                raise ValueError(f"{name} of a table must be finite, got {x}")
        if not isinstance(self.times, Tracer) and not bool(jnp.all(jnp.diff(self.times) > 0)):
            raise ValueError(f"times of a table must increase, got {self.times} s")

    def __call__(self, time):
        t, x = self.times, self.values
        # Not `clip`, which would halve the velocity at the first time.
        now = jnp.where((time >= t[0]) & (time < t[-1]), time, jnp.where(time < t[0], t[0], t[-1]))
        k = jnp.clip(jnp.searchsorted(t, now, side="right") - 1, 0, t.size - 2)
        h = t[k + 1] - t[k]
        s = (now - t[k]) / h
        if self.interpolation == "linear":
            return (1.0 - s) * x[k] + s * x[k + 1]
        slope = pchip_slopes(t, x)
        start = (1.0 + 2.0 * s) * x[k] + s * h * slope[k]
        return (1.0 - s) ** 2 * start + s**2 * ((3.0 - 2.0 * s) * x[k + 1] - (1.0 - s) * h * slope[k + 1])


def pchip_slopes(t: Float[Array, " k"], x: Float[Array, " k"]) -> Float[Array, " k"]:
    """Slopes at the entries of a table with which cubics are monotone where the table is (Fritsch & Carlson 1980, SIAM
    J. Numer. Anal. 17, 238; in the form of Fritsch & Butland 1984, SIAM J. Sci. Stat. Comput. 5, 300).

    Between rises of one sign their weighted harmonic mean, (w₀ + w₁) / (w₀/m₀ + w₁/m₁) with w₀ = 2h₁ + h₀,
    w₁ = h₁ + 2h₀, and zero elsewhere; at the ends that of the parabola through three entries, zero if its sign is not
    that of the rise beside it, and at most three times that if the next rise has another sign.
    """
    h = jnp.diff(t)
    m = jnp.diff(x) / h
    if m.size == 1:
        return jnp.concatenate([m, m])
    h0, h1, m0, m1 = h[:-1], h[1:], m[:-1], m[1:]
    w0, w1 = 2.0 * h1 + h0, h1 + 2.0 * h0
    same = m0 * m1 > 0
    # Without the quotients w/m, and so with finite derivatives where rises are zero.
    inner = jnp.where(same, (w0 + w1) * m0 * m1 / jnp.where(same, w0 * m1 + w1 * m0, 1.0), 0.0)
    return jnp.concatenate([_end(h[0], h[1], m[0], m[1]), inner, _end(h[-1], h[-2], m[-1], m[-2])])


def _end(h0: Scalar, h1: Scalar, m0: Scalar, m1: Scalar) -> Float[Array, " one"]:
    slope = ((2.0 * h0 + h1) * m0 - h0 * m1) / (h0 + h1)
    slope = jnp.where((m0 * m1 <= 0) & (jnp.abs(slope) > 3.0 * jnp.abs(m0)), 3.0 * m0, slope)
    return jnp.where(slope * m0 > 0, slope, 0.0)[None]


class AbstractMotion(eqx.Module):
    """How walls and dummies move. It is a function of the time alone: nothing drifts, and a state needs no memory."""

    @abc.abstractmethod
    def place(self, position: Float[Array, "n d"], time: Scalar) -> Float[Array, "n d"]:
        """Where [m] what is at `position` [m] at t = 0 is at a `time` [s]; the walls' own places at t = 0.

        Raises `ValueError` for positions that the motion is not made for.
        """

    @abc.abstractmethod
    def drive(self, particles: Particles, reference: Float[Array, "n d"], time: Scalar) -> Particles:
        """The particles with the walls, at t = 0 at `reference` [m], at their places and velocities at `time` [s]."""


class Still(AbstractMotion):
    """Walls stay where they are."""

    def place(self, position, time):
        return position

    def drive(self, particles, reference, time):
        return particles


class Rigid(AbstractMotion):
    """All walls move as one rigid body: r(t) = c + s(t) + R(θ(t)) (r(0) − c).

    s has the signal `sway` [m] along the first axis and `heave` [m] along the last; `roll` is the angle θ [rad] about
    `center` c [m], which moves along with s, in the plane of these two axes, from the first to the last. Of each signal
    the change since t = 0 counts: walls begin where the case has them.
    """

    center: Float[Array, " d"] = eqx.field(converter=as_array)
    sway: AbstractSignal = eqx.field(default_factory=Constant)
    heave: AbstractSignal = eqx.field(default_factory=Constant)
    roll: AbstractSignal = eqx.field(default_factory=Constant)

    def pose(self, time: Scalar) -> tuple[Float[Array, "d d"], Float[Array, " d"]]:
        """The rotation matrix R and the displacement s [m] of the center at a time [s]."""
        sway, heave, roll = (f(time) - f(jnp.zeros_like(time)) for f in (self.sway, self.heave, self.roll))
        sine, cosine = jnp.sin(roll), jnp.cos(roll)
        turn = jnp.eye(self.center.size).at[0, 0].set(cosine).at[-1, -1].set(cosine)
        turn = turn.at[0, -1].set(-sine).at[-1, 0].set(sine)
        return turn, jnp.zeros(self.center.shape).at[0].set(sway).at[-1].set(heave)

    def place(self, position, time):
        if position.shape[-1:] != self.center.shape:
            raise ValueError(f"center of the motion must have {position.shape[-1]} components, got {self.center.size}")
        turn, shift = self.pose(jnp.asarray(time, position.dtype))
        # Differences and not R itself: walls that do not turn keep every bit of their shape.
        return position + shift + (position - self.center) @ (turn - jnp.eye(self.center.size)).T

    def drive(self, particles, reference, time):
        return _driven(self, particles, reference, time)


class Bodies(AbstractMotion):
    """Several bodies: walls with the number k in `body` follow `motions[k]`, those with −1 stand still. `body` has an
    entry for each particle; those of the fluid mean nothing.
    """

    motions: tuple[AbstractMotion, ...]
    body: Int[Array, " n"] = eqx.field(converter=jnp.asarray)

    def place(self, position, time):
        if self.body.shape != position.shape[:1]:
            raise ValueError(f"body must have one number for each particle, {len(position)}, got {self.body.shape}")
        placed = position
        for k, motion in enumerate(self.motions):
            placed = jnp.where((self.body == k)[:, None], motion.place(position, time), placed)
        return placed

    def drive(self, particles, reference, time):
        return _driven(self, particles, reference, time)


def _driven(motion: AbstractMotion, particles: Particles, reference: Float[Array, "n d"], time: Scalar) -> Particles:
    """Walls at their places, with the time derivative of these as their velocity."""
    place = lambda t: motion.place(reference, t)  # noqa: E731
    position, velocity = jax.jvp(place, (time,), (jnp.ones_like(time),))
    walls = particles.fixed[:, None]
    return eqx.tree_at(
        lambda p: (p.position, p.velocity),
        particles,
        (jnp.where(walls, position, particles.position), jnp.where(walls, velocity, particles.velocity)),
    )
