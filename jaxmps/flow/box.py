"""The domain: an axis-parallel box, each axis open or periodic."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmps._vectors import components, joined
from jaxmps.validation import fixed, number


class Box(eqx.Module):
    """Lower and upper corner [m], which axes are periodic, and at the lower end of which one stands a mirror; static,
    for it fixes the grid of the neighbor search.

    On an open axis a particle outside `[lower, upper)` has left the domain and is taken out of the flow. A mirror is a
    smooth wall without particles: each particle near it has an image behind it, with the same pressure and the mirrored
    velocity, and one that comes through is reflected. One axis at most may have a mirror.
    """

    lower: tuple[float, ...] = eqx.field(static=True)
    upper: tuple[float, ...] = eqx.field(static=True)
    periodic: tuple[bool, ...] = eqx.field(static=True)
    mirror: int | None = eqx.field(static=True)

    def __init__(
        self,
        lower: tuple[float, ...],
        upper: tuple[float, ...],
        periodic: tuple[bool, ...] | None = None,
        mirror: int | None = None,
    ):
        self.lower = tuple(number("box.lower", fixed("box.lower", x), "m") for x in lower)
        self.upper = tuple(number("box.upper", fixed("box.upper", x), "m") for x in upper)
        self.periodic = (False,) * len(self.lower) if periodic is None else tuple(periodic)
        self.mirror = mirror
        if not len(self.lower) == len(self.upper) == len(self.periodic) in (2, 3):
            raise ValueError(
                "box.lower, box.upper and box.periodic must all have 2 or all have 3 entries, got "
                f"{len(self.lower)}, {len(self.upper)} and {len(self.periodic)}"
            )
        if any(low >= high for low, high in zip(self.lower, self.upper, strict=True)):
            raise ValueError(f"box.upper must exceed box.lower on every axis, got {self.lower} m and {self.upper} m")
        if mirror is not None and (mirror not in range(self.dim) or self.periodic[mirror]):
            raise ValueError(f"box.mirror must be an axis that is not periodic, got {mirror!r}")

    @property
    def dim(self) -> int:
        """The number of dimensions, 2 or 3."""
        return len(self.lower)

    @property
    def open_axis(self) -> int | None:
        """The last axis that is not periodic, if there is one."""
        return next((axis for axis in reversed(range(self.dim)) if not self.periodic[axis]), None)

    @property
    def lengths(self) -> tuple[float, ...]:
        """The length [m] along each axis."""
        return tuple(high - low for low, high in zip(self.lower, self.upper, strict=True))

    def displacement(self, r_ij: Float[Array, "*pairs d"]) -> Float[Array, "*pairs d"]:
        """`r_j − r_i` [m] to the nearest image of j along the periodic axes."""
        if not any(self.periodic):
            return r_ij
        return joined(tuple(self.nearest(axis, x) for axis, x in enumerate(components(r_ij))))

    def nearest(self, axis: int, x: Float[Array, "*pairs"]) -> Float[Array, "*pairs"]:
        """The component of `r_j − r_i` [m] along an axis to the nearest image of j."""
        return x - self.lengths[axis] * jnp.round(x / self.lengths[axis]) if self.periodic[axis] else x

    def wrap(self, position: Float[Array, "*n d"]) -> Float[Array, "*n d"]:
        """Positions [m] moved back by whole periods along the periodic axes."""
        if not any(self.periodic):
            return position
        lower = jnp.array(self.lower, position.dtype)
        inside = lower + jnp.mod(position - lower, jnp.array(self.lengths, position.dtype))
        # Just below the lower end, round-off would give the upper one.
        inside = jnp.where(inside >= jnp.array(self.upper, position.dtype), lower, inside)
        return jnp.where(jnp.array(self.periodic), inside, position)

    def torus(self, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places from the lower corner on [m], and the periods [m], 0 along open axes: what scipy's `KDTree` takes as
        its `boxsize`.
        """
        periods = np.where(self.periodic, self.lengths, 0.0)
        places = np.asarray(position, float) - np.array(self.lower)
        turns = np.where(periods > 0.0, periods, 1.0)
        # Of a tiny negative number the remainder is the period itself.
        return np.where(periods > 0.0, places % turns % turns, places), periods

    def apart(self, r_ij: np.ndarray) -> np.ndarray:
        """`displacement` with NumPy, which compiles nothing for each number of pairs."""
        periods = np.where(self.periodic, self.lengths, np.inf)
        turns = np.where(self.periodic, self.lengths, 0.0)
        return r_ij - turns * np.round(r_ij / periods)

    def described(self) -> dict[str, Any]:
        """Its arguments as values for JSON."""
        return {
            "lower": list(self.lower),
            "upper": list(self.upper),
            "periodic": list(self.periodic),
            "mirror": self.mirror,
        }

    def reflect(
        self, position: Float[Array, "n d"], velocity: Float[Array, "n d"]
    ) -> tuple[Float[Array, "n d"], Float[Array, "n d"]]:
        """Positions [m] behind the mirror put before it, and their velocities [m/s] turned."""
        if self.mirror is None:
            return position, velocity
        plane = self.lower[self.mirror]
        behind = (position[:, self.mirror] < plane)[:, None] & (jnp.arange(self.dim) == self.mirror)
        return jnp.where(behind, 2.0 * plane - position, position), jnp.where(behind, -velocity, velocity)

    def contains(self, position: Float[Array, "*n d"]) -> Bool[Array, "*n"]:
        """Whether a position [m] lies in the box along its open axes. Not finite counts as outside."""
        inside = (position >= jnp.array(self.lower)) & (position < jnp.array(self.upper))
        return jnp.all(inside | jnp.array(self.periodic), axis=-1)
