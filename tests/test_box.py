"""The domain."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmps import Box

PERIODIC = Box((-1.0, 2.0), (1.0, 5.0), (True, True))
HALF = Box((-1.0, 2.0), (1.0, 5.0), (True, False))
OPEN = Box((-1.0, 2.0), (1.0, 5.0))
BOTH = pytest.mark.parametrize("precision", ["single", "double"], indirect=True)


def test_axes_are_open_unless_said_otherwise():
    assert OPEN.periodic == (False, False)
    assert OPEN.dim == 2
    assert OPEN.lengths == (2.0, 3.0)


@BOTH
def test_wrap_moves_by_whole_periods_into_the_box(precision):
    position = np.random.default_rng(0).uniform(-20, 20, (200, 2))
    wrapped = np.asarray(PERIODIC.wrap(jnp.array(position)))
    periods = (position - wrapped) / np.array(PERIODIC.lengths)
    # Round-off of positions of up to 20 m.
    tolerance = 1e-5 if precision == "single" else 1e-13
    np.testing.assert_allclose(periods, np.round(periods), atol=tolerance)
    assert np.all(wrapped >= np.array(PERIODIC.lower))
    assert np.all(wrapped <= np.array(PERIODIC.upper))


def test_wrap_leaves_open_axes_alone():
    position = jnp.array([[7.0, -3.0], [-9.5, 11.0]])
    np.testing.assert_array_equal(OPEN.wrap(position), position)
    wrapped = HALF.wrap(position)
    np.testing.assert_array_equal(wrapped[:, 1], position[:, 1])
    np.testing.assert_allclose(wrapped[:, 0], [-1.0, 0.5], atol=1e-15)


def test_wrap_leaves_positions_inside_as_they_are():
    position = jnp.array([[-1.0, 2.0], [0.25, 3.5], [0.75, 4.75]])
    np.testing.assert_array_equal(PERIODIC.wrap(position), position)


def test_displacement_goes_to_the_nearest_image():
    r_ij = jnp.array([[1.9, 2.9], [-1.9, -2.9], [0.9, 1.4], [-0.3, 0.2]])
    np.testing.assert_allclose(
        PERIODIC.displacement(r_ij),
        [[-0.1, -0.1], [0.1, 0.1], [0.9, 1.4], [-0.3, 0.2]],
        atol=1e-15,
    )
    np.testing.assert_allclose(HALF.displacement(r_ij), [[-0.1, 2.9], [0.1, -2.9], [0.9, 1.4], [-0.3, 0.2]], atol=1e-15)
    np.testing.assert_array_equal(OPEN.displacement(r_ij), r_ij)


def test_displacement_is_antisymmetric_and_blind_to_whole_periods():
    rng = np.random.default_rng(1)
    r_ij = jnp.array(rng.uniform(-1, 1, (100, 2)) * 0.45 * np.array(PERIODIC.lengths))
    shift = rng.integers(-3, 4, (100, 2)) * np.array(PERIODIC.lengths)
    np.testing.assert_array_equal(PERIODIC.displacement(-r_ij), -PERIODIC.displacement(r_ij))
    np.testing.assert_allclose(PERIODIC.displacement(r_ij + shift), r_ij, atol=1e-14)


def test_displacement_has_the_unit_derivative():
    jacobian = jax.jacfwd(PERIODIC.displacement)(jnp.array([1.9, -0.2]))
    np.testing.assert_array_equal(jacobian, np.eye(2))


@BOTH
def test_box_contains_its_lower_but_not_its_upper_faces(precision):
    position = jnp.array([[-1.0, 2.0], [0.0, 3.0], [1.0, 3.0], [0.0, 5.0], [-1.1, 3.0], [0.0, 1.9]])
    np.testing.assert_array_equal(OPEN.contains(position), [True, True, False, False, False, False])


def test_box_contains_everything_along_periodic_axes():
    position = jnp.array([[7.0, 3.0], [-7.0, 3.0], [0.0, 6.0]])
    np.testing.assert_array_equal(HALF.contains(position), [True, True, False])


@pytest.mark.parametrize("bad", [jnp.nan, jnp.inf, -jnp.inf])
def test_what_is_not_finite_lies_outside(bad):
    assert not OPEN.contains(jnp.array([0.0, bad]))


@pytest.mark.parametrize(
    ("lower", "upper", "periodic", "said"),
    [
        ((0.0, 0.0), (1.0, 0.0), None, r"box.upper must exceed box.lower.*\(1.0, 0.0\)"),
        ((0.0, 2.0), (1.0, 1.0), None, r"box.upper must exceed box.lower.*\(0.0, 2.0\)"),
        ((0.0, 0.0), (1.0, float("nan")), None, "box.upper must be a finite number.*nan"),
        ((0.0, float("-inf")), (1.0, 1.0), None, "box.lower must be a finite number.*-inf"),
        (("0", 0.0), (1.0, 1.0), None, "box.lower must be a finite number.*'0'"),
        ((0.0, True), (1.0, 2.0), None, "box.lower must be a finite number.*True"),
        ((0.0,), (1.0,), None, "2 or all have 3 entries, got 1, 1 and 1"),
        ((0.0,) * 4, (1.0,) * 4, None, "2 or all have 3 entries, got 4, 4 and 4"),
        ((0.0, 0.0), (1.0, 1.0, 1.0), None, "2 or all have 3 entries, got 2, 3 and 2"),
        ((0.0, 0.0), (1.0, 1.0), (True,), "2 or all have 3 entries, got 2, 2 and 1"),
    ],
)
def test_bad_box_is_refused_by_name_and_value(unchecked, lower, upper, periodic, said):
    with pytest.raises(ValueError, match=said):
        Box(lower, upper, periodic)
