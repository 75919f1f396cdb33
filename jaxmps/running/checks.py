"""Whether what a run is given fits together: precision, and a state with its case and scheme.

What is static is checked under transformations, too, where kinds and phases have no values.
"""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxmps.flow import Case, Kind, Particles
from jaxmps.scheme import Scheme
from jaxmps.stepping import State


def check_precision(**given: Any) -> None:
    """`ValueError` unless all floats in what is given, by name, have the precision that JAX is set to."""
    wanted = jnp.result_type(float)
    for name, tree in given.items():
        for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
            if eqx.is_inexact_array(leaf) and leaf.dtype != wanted:
                raise ValueError(
                    f"{name} must have the precision that JAX is set to ({wanted}): {name}{jax.tree_util.keystr(path)} "
                    f"is {leaf.dtype}. Set jax_enable_x64 before case, scheme and state are made, or make them again"
                )


def check_start(case: Case, scheme: Scheme, state: State) -> None:
    """`ValueError` unless the state is one of this case, and its list one for this scheme."""
    check_precision(case=case, scheme=scheme, start=state)
    check_particles("start", case, state.particles)
    box, neighbors, radius = case.box, state.neighbors, scheme.ratio * case.spacing
    if len(neighbors.table.idx) != len(case.particles.kind):
        raise ValueError(
            f"start must have a list of {len(case.particles.kind)} particles, as case has them, got one of "
            f"{len(neighbors.table.idx)}"
        )
    if not math.isclose(neighbors.cutoff, radius):
        raise ValueError(
            f"start must have a list for the radius of the scheme, ratio * spacing = {radius:g} m, got one for "
            f"{neighbors.cutoff:g} m: make the state by mps.start with this case and scheme"
        )
    for name in ("lower", "upper", "periodic", "mirror"):
        own, other = getattr(box, name), getattr(neighbors.box, name)
        if own != other:
            raise ValueError(
                f"start must have a list for the box of the case, whose {name} is {own}, got one for {other}: make the "
                "state by mps.start with this case and scheme"
            )


def check_particles(name: str, case: Case, particles: Particles) -> None:
    """`ValueError` unless these are as many as the case has, each of the same kind, or removed, and phase."""
    own = case.particles
    if particles.position.shape != own.position.shape:
        raise ValueError(
            f"{name} must have the particles of case, of the shape {own.position.shape}, got {particles.position.shape}"
        )
    pairs = {"kind": (own.kind, particles.kind), "phase": (own.phase, particles.phase)}
    for what, (expected, found) in pairs.items():
        if isinstance(expected, Tracer) or isinstance(found, Tracer) or expected is found:
            continue
        differs = np.asarray(expected) != np.asarray(found)
        if what == "kind":
            differs &= np.asarray(found) != Kind.REMOVED
        if differs.any():
            i = int(np.argmax(differs))
            raise ValueError(
                f"{name} must have particles of the same {what} as case, where particle {i} has {what} "
                f"{int(expected[i])}, got {int(found[i])} ({np.sum(differs)} such particles)"
            )
