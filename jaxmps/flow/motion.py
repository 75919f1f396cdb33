"""How walls move: signals of the time, and rigid bodies that follow them."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from jaxmps._types import Scalar, as_array
from jaxmps.flow.particles import Kind, Particles


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
    """Values [m or rad] at increasing times [s], three at least, and between them the cubic with the slopes that
    parabolas through neighboring points have at these: continuous in velocity, exact for a parabola. Before the first
    time and after the last, it stays where it is there.
    """

    times: Float[Array, " k"] = eqx.field(converter=as_array)
    values: Float[Array, " k"] = eqx.field(converter=as_array)

    def __check_init__(self):
        if self.times.ndim != 1 or self.times.shape != self.values.shape or self.times.size < 3:
            raise ValueError(
                "times and values of a table must be two lists of one length, of three entries at least, got "
                f"{self.times.shape} and {self.values.shape}"
            )
        if not isinstance(self.times, Tracer) and not bool(jnp.all(jnp.diff(self.times) > 0)):
            raise ValueError(f"times of a table must increase, got {self.times} s")

    def __call__(self, time):
        t, x = self.times, self.values
        length = jnp.diff(t)
        rise = jnp.diff(x) / length
        inner = (length[1:] * rise[:-1] + length[:-1] * rise[1:]) / (length[1:] + length[:-1])
        slope = jnp.concatenate([2.0 * rise[:1] - inner[:1], inner, 2.0 * rise[-1:] - inner[-1:]])
        # Not `clip`, which would halve the velocity at the first time.
        now = jnp.where((time >= t[0]) & (time < t[-1]), time, jnp.where(time < t[0], t[0], t[-1]))
        k = jnp.clip(jnp.searchsorted(t, now, side="right") - 1, 0, t.size - 2)
        h = length[k]
        s = (now - t[k]) / h
        start = (1.0 + 2.0 * s) * x[k] + s * h * slope[k]
        return (1.0 - s) ** 2 * start + s**2 * ((3.0 - 2.0 * s) * x[k + 1] - (1.0 - s) * h * slope[k + 1])


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
    walls = ((particles.kind == Kind.WALL) | (particles.kind == Kind.DUMMY))[:, None]
    return eqx.tree_at(
        lambda p: (p.position, p.velocity),
        particles,
        (jnp.where(walls, position, particles.position), jnp.where(walls, velocity, particles.velocity)),
    )
