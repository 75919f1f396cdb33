"""A tank after the impact, of any size: what is hardest for a solver that wants its unknowns connected."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.spatial import cKDTree

import jaxmps as mps
from benchmarks.disorder import RATIO, disordered
from jaxmps.cases.lattice import WATER, block_in_tank, cells, dummy_layers, materials, tank_case
from jaxmps.flow import Kind

LENGTH, HEIGHT = 2.0, 2.0
"""Of the tank [m]."""


def splash(particles: int, seed: int = 0) -> mps.Case:
    """A tank after the impact, with exactly so many particles (1500 or more): drawn, so that any size is at hand.

    Water with waves, a jet that has run up the right wall and turns over, a film of two particles on the left wall,
    detached sheets, and droplets of 1 to 20 particles, one in twenty of all. Particles are out of order and move with
    smooth random velocities of some m/s.
    """
    spacing, count = 0.02, len(_lattice(0.02))
    for _ in range(8):
        spacing *= (count / (0.95 * particles)) ** 0.5
        count = len(_lattice(spacing))
    random = np.random.default_rng(seed)
    drops = _droplets(spacing, particles - count, random)
    case = disordered(_tank(spacing, drops), random)
    position = case.particles.position
    velocity = jnp.asarray(_swirls(np.asarray(position, float), random), position.dtype)
    velocity = jnp.where(case.particles.fluid[:, None], velocity, 0.0)
    return dataclasses.replace(case, particles=eqx.tree_at(lambda p: p.velocity, case.particles, velocity))


def _connected(x: np.ndarray, y: np.ndarray, spacing: float) -> np.ndarray:
    """Whether there is water at a place [m], droplets apart."""
    water = y < 0.21 + 0.06 * np.sin(5.7 * x + 0.5) + 0.02 * np.sin(17.0 * x + 2.0)
    water |= (x > LENGTH - 0.05 - 0.10 * (1.0 - y / 1.2) ** 2) & (y < 1.2)
    angle = np.arctan2(y - 1.2, x - LENGTH + 0.26)
    across = np.abs(np.hypot(y - 1.2, x - LENGTH + 0.26) - 0.235)
    water |= (angle > 0.0) & (across < 0.03 * (1.0 - angle / 4.0))
    water |= (x < 2.0 * spacing) & (y < 0.9)
    for center_x, center_y, degrees, length in (
        (0.5, 0.95, 35.0, 0.4),
        (1.05, 1.3, -20.0, 0.3),
        (1.0, 0.7, 70.0, 0.25),
    ):
        along = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
        right, up = x - center_x, y - center_y
        thickness = max(0.012, 2.5 * spacing)
        inside = np.abs(along[0] * right + along[1] * up) < 0.5 * length
        water |= inside & (np.abs(along[0] * up - along[1] * right) < 0.5 * thickness)
    return water


def _lattice(spacing: float) -> np.ndarray:
    """The lattice points of walls and connected water."""
    size = cells(LENGTH, spacing), cells(HEIGHT, spacing)
    points, kind = block_in_tank(size, (size[0], 0), size[1], dummy_layers(RATIO), (False, False))
    return points[(kind != Kind.FLUID) | _connected(*(points.T + 0.5) * spacing, spacing)]


def _tank(spacing: float, drops: np.ndarray) -> mps.Case:
    """The case of connected water and of droplets in these cells of the lattice."""

    def phase(position: np.ndarray) -> np.ndarray:
        in_drop = drops[tuple(np.floor(position / spacing).astype(int).T)]
        return np.where(_connected(*position.T, spacing) | in_drop, 0, -1)

    return tank_case(
        name="splash",
        parameters={"spacing": spacing},
        block=drops.shape,
        inside=(drops.shape[0], 0),
        wall_height=drops.shape[1],
        headroom=2.0 * HEIGHT,
        spacing=spacing,
        ratio=RATIO,
        gravity=9.81,
        fluids=materials({"density": WATER["density"]}, {"viscosity": WATER["viscosity"]}),
        phase=phase,
    )


def _droplets(spacing: float, particles: int, random: np.random.Generator) -> np.ndarray:
    """Which cells of the lattice hold one of so many particles in droplets, which touch neither each other nor water.

    A droplet has a patch of 8 by 8 cells to itself and fills the 4 by 5 of them in the middle from its center outward.
    """
    shape = (cells(LENGTH, spacing), cells(HEIGHT, spacing))
    corners = np.stack(np.meshgrid(*(np.arange(0, s - 8, 8) for s in shape), indexing="ij"), -1).reshape(-1, 2)
    around = np.stack(np.meshgrid(np.arange(2, 6), np.arange(2, 7), indexing="ij"), -1).reshape(-1, 2)
    around = around[np.argsort(np.linalg.norm(around - np.array([3.6, 4.1]), axis=1))]
    free = cKDTree(_lattice(spacing)).query(corners + 4.0)[0] > 6.0
    drops, left = np.zeros(shape, bool), particles
    for corner in random.permutation(corners[free]):
        if left <= 0:
            return drops
        size = min(left, int(np.exp(random.uniform(0.0, np.log(21.0)))))
        drops[tuple((corner + around[:size]).T)] = True
        left -= size
    raise ValueError(f"there is no room for {left} of the particles")


def _swirls(position: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """A smooth velocity [m/s] without divergence: the curl of some waves."""
    velocity = np.zeros_like(position)
    for _ in range(8):
        wave, phase, speed = random.uniform(-8.0, 8.0, 2), random.uniform(0.0, 6.3), random.uniform(0.3, 1.0)
        velocity += speed * np.cos(position @ wave + phase)[:, None] * np.array([-wave[1], wave[0]]) / np.hypot(*wave)
    return velocity
