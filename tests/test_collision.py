"""Collisions of particles."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmps._vectors import components
from jaxmps.models import NoCollision, PairCollision
from jaxmps.neighbors import Pairs

SPACING = 0.1
DT = 1e-3
AXIS = np.array([0.6, 0.8])  # line of centers
ACROSS = np.array([-0.8, 0.6])
PAIRS_OF_DENSITY = pytest.mark.parametrize("density", [(1000.0, 1000.0), (1000.0, 2650.0), (600.0, 1000.0)])


def two(gap: float) -> Pairs:
    """Two particles `gap` spacings apart along `AXIS`, and an empty slot for each."""
    r = gap * SPACING * AXIS
    zero = np.zeros(2)
    return Pairs(
        j=jnp.array([[1, 0], [0, 1]]),
        r_ij=components(jnp.array([[r, zero], [-r, zero]])),
        distance=jnp.array([[gap * SPACING, SPACING]] * 2),
        present=jnp.array([[True, False]] * 2),
    )


def collide(u, gap=0.52, density=(1000.0, 1000.0), moves=(True, True), e=0.2) -> np.ndarray:
    """The velocities after the collision."""
    u = jnp.array(u)
    du = PairCollision(0.5, e)(u, two(gap), jnp.array(density), jnp.array(moves), SPACING, jnp.array(DT))
    return np.asarray(u + du)


def approaching(speed: float = 8.0) -> np.ndarray:
    """Two velocities with a relative one of -`speed` along the line of centers."""
    return np.array([1.3 * AXIS + 0.4 * ACROSS, (1.3 - speed) * AXIS - 0.7 * ACROSS])


@PAIRS_OF_DENSITY
@pytest.mark.parametrize("e", [0.0, 0.2, 1.0])
def test_moving_pair_keeps_its_momentum_and_rebounds_with_the_restitution(density, e):
    u = approaching()
    after = collide(u, density=density, e=e)
    rho = np.array(density)
    np.testing.assert_allclose(rho @ after, rho @ u, rtol=1e-13)
    relative = (u[1] - u[0]) @ AXIS
    assert (after[1] - after[0]) @ AXIS == pytest.approx(-e * relative, abs=1e-13)
    # Frictionless: the tangential part stays.
    np.testing.assert_allclose(after @ ACROSS, u @ ACROSS, rtol=1e-13)


@PAIRS_OF_DENSITY
def test_elastic_pair_keeps_its_energy(density):
    u, rho = approaching(), np.array(density)
    after = collide(u, density=density, e=1.0)
    assert rho @ (after**2).sum(axis=1) == pytest.approx(rho @ (u**2).sum(axis=1), rel=1e-13)


def test_pair_that_separates_is_left_alone():
    u = approaching()[::-1].copy()
    np.testing.assert_array_equal(collide(u, gap=0.3), u)


def test_pair_that_stays_farther_apart_than_the_distance_is_left_alone():
    # 8 m/s close 0.08 spacings in this step: to 0.52 from 0.6, to 0.48 from 0.56.
    u = approaching(8.0)
    u[1] = u[1] + (0.7 + 0.4) * ACROSS  # no sideways relative motion, which would add to the distance
    np.testing.assert_array_equal(collide(u, gap=0.6), u)
    assert np.any(collide(u, gap=0.56) != u)


def test_wall_reflects_and_stays_where_it_is():
    u = np.array([2.0 * AXIS + 0.4 * ACROSS, [0.0, 0.0]])
    after = collide(u, gap=0.5, density=(1000.0, 1.0), moves=(True, False), e=0.2)
    np.testing.assert_array_equal(after[1], 0.0)
    np.testing.assert_allclose(after[0], -0.2 * 2.0 * AXIS + 0.4 * ACROSS, rtol=1e-13)


def test_two_fixed_particles_do_not_move():
    u = approaching()
    np.testing.assert_array_equal(collide(u, moves=(False, False)), u)


def test_empty_slots_do_not_collide():
    near = two(0.3)
    near = Pairs(near.j, near.r_ij, near.distance, jnp.zeros_like(near.present))
    du = PairCollision()(jnp.array(approaching()), near, jnp.ones(2), jnp.ones(2, bool), SPACING, jnp.array(DT))
    np.testing.assert_array_equal(du, 0.0)


def test_restitution_has_the_derivative_of_the_closed_form():
    u = approaching()
    slope = jax.jacfwd(
        lambda e: PairCollision(0.5, e)(
            jnp.array(u), two(0.52), jnp.array([1000.0, 3000.0]), jnp.ones(2, bool), SPACING, jnp.array(DT)
        )
    )(jnp.array(0.2))
    relative = (u[1] - u[0]) @ AXIS
    np.testing.assert_allclose(slope, [0.75 * relative * AXIS, -0.25 * relative * AXIS], rtol=1e-13)


def test_without_collisions_nothing_happens():
    du = NoCollision()(jnp.array(approaching()), two(0.3), jnp.ones(2), jnp.ones(2, bool), SPACING, jnp.array(DT))
    np.testing.assert_array_equal(du, 0.0)
