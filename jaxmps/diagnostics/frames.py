"""A run as seen from a body that moves."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from jaxmps.flow.motion import AbstractMotion, Rigid, Still
from jaxmps.results import Run, box_of


def relative(run: Run, motion: AbstractMotion) -> Run:
    """The run in the frame of a rigidly moving tank: its walls stand where they stood at t = 0, and velocities are
    relative to them. Probes, gauges and pictures then see the tank as an instrument on it does.

    Energies and metadata stay those of the frame at rest. Raises `ValueError` for a motion of several bodies: take that
    of one of them.
    """
    if isinstance(motion, Still):
        return run
    if not isinstance(motion, Rigid):
        raise ValueError(f"motion must be that of one rigid body, got {type(motion).__name__}")

    def at_rest(position, velocity, time):
        turn, shift = motion.pose(time)
        own = motion.center + (position - motion.center - shift) @ turn
        carried = jax.jvp(lambda t: motion.place(own, t), (time,), (jnp.ones_like(time),))[1]
        return own, (velocity - carried) @ turn

    dtype = jnp.result_type(float)
    arrays = (jnp.asarray(x, dtype) for x in (run.position, run.velocity, run.time))
    position, velocity = jax.jit(jax.vmap(at_rest))(*arrays)
    # Along periodic axes walls are where they were at t = 0, and not at an image of theirs.
    position = np.asarray(box_of(run).wrap(position))
    return dataclasses.replace(run, position=position, velocity=np.asarray(velocity))
