"""Parts of a flow whose pressure is known up to a constant only, and how that constant is chosen.

A drop of spray that is so compact that none of its particles passes for free surface, a closed vessel, a periodic box
full of fluid: the matrix of such a part is singular, and one of them would spoil the pressure of all.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxmps._vectors import take

LINK = 1e-3
"""A coupling that is weaker, in units of the diagonal, neither connects particles nor fixes their pressure: what is
tied to the rest by less than that is as good as singular.
"""

Part = Int[Array, " n"]
"""Of each particle the part that it belongs to, zero where the pressure is not known up to a constant only."""


def loose_parts(
    j: Int[Array, "k n"],
    coupling: Float[Array, "k n"],
    sink: Float[Array, " n"],
    diagonal: Float[Array, " n"],
    unknown: Bool[Array, " n"],
    summit: Bool[Array, " n"],
) -> Part:
    """The connected parts of the graph of `coupling` between `unknown` rows in which no row has a `sink`.

    Labels spread by minima over neighbors and by shortcuts, until nothing changes (FastSV; Zhang, Azad & Buluç 2020):
    some rounds, in the logarithm of the diameter. Every part has a `summit`, a row without any link upward; where each
    of these has a sink of its own, which is so in most steps of most flows, no part is loose, and no round is needed.
    """
    number = jnp.arange(1, len(sink) + 1, dtype=jnp.int32)
    known = sink > LINK * diagonal
    linked = coupling > LINK * jnp.minimum(diagonal, take(diagonal, j))
    beyond = jnp.int32(len(sink) + 1)  # no label
    doubtful = jnp.any(summit & unknown & ~known)

    def spread(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        part, _ = carry
        of_part = jnp.where(part > 0, take(part, jnp.maximum(part - 1, 0)), 0)
        least = jnp.min(jnp.where(linked, take(of_part, j), beyond), axis=0, initial=beyond)
        least = jnp.minimum(least, of_part)
        hooked = part.at[jnp.maximum(part - 1, 0)].min(jnp.where(part > 0, least, beyond))
        new = jnp.minimum(hooked, least)
        return new, jnp.any(new != part)

    start = jnp.where(unknown & ~known, number, 0)
    part, _ = jax.lax.while_loop(lambda carry: carry[1], spread, (start, doubtful))
    return jnp.where(doubtful, part, 0)


def without_mean(x: Float[Array, " n"], part: Part) -> Float[Array, " n"]:
    """x less its mean over each part."""
    size = len(x) + 1
    count = jnp.zeros(size, x.dtype).at[part].add(1.0, mode="promise_in_bounds")
    mean = jnp.zeros(size, x.dtype).at[part].add(x, mode="promise_in_bounds") / jnp.maximum(count, 1.0)
    return jnp.where(part > 0, x - take(mean, part), x)
