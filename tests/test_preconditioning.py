"""The multigrid preconditioner as a matrix, and how many iterations it takes."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flows import PRODUCTS, Counted, Flow, flow, look_up, per_precision, right_hand_side, set_up, set_up_as_found, spray
from hasty import quick
from jaxtyping import Array, Bool

from jaxmps.pressure import AbstractPreconditioner, PressureEquation
from jaxmps.pressure.linear import Jacobi, solve
from jaxmps.pressure.multigrid.elements import apply

BOTH = pytest.mark.parametrize("precision", ["single", "double"], indirect=True)
SINGLE = pytest.mark.parametrize("precision", ["single"], indirect=True)
SHOWN = 400  # columns of a matrix that are computed


STANDS_FOR = {"closed": "square_patch", "nothing": "dam_break"}


class Sample(NamedTuple):
    flow: Flow
    equation: PressureEquation


@per_precision
def sample(name: str) -> Sample:
    """A small flow; one with droplets that count as inside, one without free surface, one with nothing to solve for."""
    one, theirs = spray() if name == "droplets" else (flow(STANDS_FOR.get(name, name), 1), False)
    surface = {"closed": np.zeros_like(one.taken), "nothing": one.taken}.get(name)
    surface = np.asarray(look_up(one)[1]) & ~np.array(theirs) if surface is None else surface
    return Sample(one, set_up(one, jnp.array(surface), right_hand_side(one)))


@quick
def columns(preconditioner, chosen):
    unit = jax.vmap(lambda k: jnp.zeros_like(preconditioner.inverse_diagonal).at[k].set(1.0))(chosen)
    return jax.vmap(preconditioner, out_axes=1)(unit)


def matrix(equation: PressureEquation) -> tuple[np.ndarray, int]:
    """The matrix M of the preconditioner between some particles, the unknown ones first, and how many these are."""
    unknown = np.asarray(equation.unknown)
    assert unknown.sum() <= SHOWN
    chosen = np.argsort(~unknown, kind="stable")[:SHOWN]
    m = np.asarray(columns(equation.preconditioner, jnp.array(chosen)))
    assert np.all(np.delete(m, chosen, axis=0) == 0)
    return m[chosen], int(unknown.sum())


@pytest.mark.parametrize(
    "name", ["droplets", "closed", "nothing", "standing_wave", pytest.param("dam_break_3d", marks=pytest.mark.slow)]
)
def test_multigrid_is_symmetric_and_positive_definite(name):
    equation = sample(name).equation
    assert bool(jnp.any(equation.operator.sink > 0)) == (name not in ("closed", "nothing"))
    m, _ = matrix(equation)
    np.testing.assert_allclose(m, m.T, atol=1e-12 * np.abs(m).max())
    assert np.linalg.eigvalsh(0.5 * (m + m.T)).min() > 0


@BOTH
@pytest.mark.parametrize("name", ["droplets", "closed", "nothing"])
def test_multigrid_is_finite_and_leaves_known_pressures_alone(precision, name):
    equation = sample(name).equation
    m, unknown = matrix(equation)
    assert m.dtype == (np.float64 if precision == "double" else np.float32)
    assert np.all(np.isfinite(m))
    assert (unknown == 0) == (name == "nothing")
    # The diagonal of A is one where nothing is to be solved for.
    np.testing.assert_array_equal(m[unknown:], np.eye(SHOWN)[unknown:])


def test_preconditioner_does_not_mind_positions_a_period_away():
    one, equation = sample("standing_wave")
    periods = np.random.default_rng(2).integers(-2, 3, len(one.taken))
    away = one.at(one.case.particles.position + 48.0 * jnp.array(periods)[:, None] * jnp.array([1.0, 0.0]))
    found = matrix(set_up(away, ~equation.unknown, equation.source))[0]
    np.testing.assert_allclose(found, matrix(equation)[0], atol=1e-9 * np.abs(found).max())


@quick
def energies(position, equation: PressureEquation, slope, constant):
    """xᵀ A x of a linear pressure x of the unknown, and vᵀ K v of the same function v on the finest grid."""
    x = jnp.where(equation.unknown, position @ slope + constant, 0.0)
    level = equation.preconditioner.levels[0]
    grid = level.grid
    axes = [low + h * jnp.arange(m) for low, h, m in zip(grid.lower, grid.size, grid.nodes, strict=True)]
    v = jnp.stack(jnp.meshgrid(*axes, indexing="ij"), axis=-1) @ slope + constant
    return jnp.vdot(x, equation.operator @ x), jnp.vdot(v, apply(level.stencil, v, grid))


@pytest.mark.parametrize("name", ["dam_break", "closed", "standing_wave", "dam_break_3d"])
def test_grid_has_the_energy_of_the_particles_for_linear_pressures(name):
    one, equation = sample(name)
    # Along a periodic axis no function but a constant is linear.
    slope = jnp.where(jnp.array(one.case.box.periodic), 0.0, jnp.array([0.7, -1.3, 0.4])[: one.case.dim])
    found, expected = energies(one.case.particles.position, equation, slope, jnp.array(5.0))
    assert float(expected) > 0
    assert float(found) == pytest.approx(float(expected), rel=1e-11)


class Either(AbstractPreconditioner):
    """Multigrid or Jacobi, in one compilation."""

    multigrid: AbstractPreconditioner
    jacobi: AbstractPreconditioner
    by_diagonal: Bool[Array, ""]

    def __call__(self, residual):
        return jnp.where(self.by_diagonal, self.jacobi(residual), self.multigrid(residual))


@quick
def counted(equation: PressureEquation, by_diagonal):
    """To 1e-6, in single precision to 1e-5, from zero."""
    either = Either(equation.preconditioner, Jacobi(equation.operator.diagonal), by_diagonal)
    b = jnp.where(equation.unknown, equation.source, 0.0)
    tolerance = 1e-6 if b.dtype == jnp.float64 else 1e-5
    return solve(Counted(equation.operator), b, jnp.zeros_like(b), either, tolerance, 2000)


def iterations(equation: PressureEquation, by_diagonal: bool = False) -> tuple[int, np.ndarray]:
    """Products with A that a solve takes, and the pressure."""
    PRODUCTS.clear()
    p, convergence = counted(equation, jnp.array(by_diagonal))
    assert convergence.converged
    jax.effects_barrier()
    return PRODUCTS["all"], np.asarray(p)


OVERHEAD = 3  # products outside the loop of CG
# How many times as many iterations Jacobi takes at twice the scale. The modes of the wave are few.
GROWTH = {
    "dam_break": 1.6,
    "square_patch": 1.6,
    "hydrostatic": 1.6,
    "settling": 1.6,
    "standing_wave": 1.35,
    "dam_break_3d": 1.6,
}


@per_precision
def compared(name: str, scale: int) -> tuple[tuple[int, np.ndarray], tuple[int, np.ndarray]]:
    """With multigrid and with Jacobi."""
    equation = set_up_as_found(flow(name, scale))
    return iterations(equation), iterations(equation, by_diagonal=True)


@pytest.mark.parametrize("name", GROWTH)
def test_iterations_hardly_grow_with_the_number_of_particles_while_those_of_jacobi_do(name):
    (small, small_jacobi), (large, large_jacobi) = ([count for count, _ in compared(name, k)] for k in (1, 2))
    assert small <= 30
    assert large <= min(30, small + 3)
    assert large_jacobi - OVERHEAD >= GROWTH[name] * (small_jacobi - OVERHEAD)


@pytest.mark.parametrize("name", GROWTH)
def test_solution_is_that_with_jacobi(name):
    (_, p), (_, expected) = compared(name, 2)
    # Tolerances of 1e-6 times a condition number of some hundreds.
    np.testing.assert_allclose(p, expected, atol=1e-4 * np.abs(expected).max())


@SINGLE
@pytest.mark.parametrize(
    "name", ["dam_break", *(pytest.param(n, marks=pytest.mark.slow) for n in GROWTH if n != "dam_break")]
)
def test_iterations_are_few_in_single_precision(precision, name):
    equations = [set_up_as_found(flow(name, k)) for k in (1, 2)]
    small, large = (iterations(equation)[0] for equation in equations)
    assert small <= 30
    assert large <= min(30, small + 3)


@BOTH
def test_droplets_are_no_obstacle(precision):
    equation = set_up_as_found(spray()[0])
    assert iterations(equation)[0] <= 30


@BOTH
def test_density_ratio_of_a_thousand_is_no_obstacle(precision):
    for k in (1, 2):
        equation = set_up_as_found(flow("two_layer", k))
        assert iterations(equation)[0] <= 40
