"""Random velocities that are added in the explicit step."""

import abc

import equinox as eqx
from jaxtyping import Array, Float, Key


class AbstractVelocityNoise(eqx.Module):
    """A model of the random velocity."""

    @abc.abstractmethod
    def __call__(self, velocity: Float[Array, "n d"], key: Key[Array, ""]) -> Float[Array, "n d"]:
        """The velocity [m/s] with the random part added."""


class NoNoise(AbstractVelocityNoise):
    """Deterministic flow: the key is not used."""

    def __call__(self, velocity, key):
        return velocity
