"""The pressure Poisson equation: its matrix, its solution, and derivatives of the solution."""

import functools
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hasty import by_diagonal

import jaxmps
from jaxmps import Box, Kind, cases, schemes
from jaxmps._vectors import components
from jaxmps.flow import at_rest
from jaxmps.kernels import lattice
from jaxmps.models import Compression, DensityDeviation
from jaxmps.neighbors import Pairs
from jaxmps.operators import KernelLaplacian, laplacian, pair_weight
from jaxmps.pressure import PoissonOperator, PressureEquation, poisson_operator, solve_pressure
from jaxmps.pressure.linear import Jacobi
from jaxmps.pressure.linear import solve as solve_plainly

SPACING = 0.1
RADIUS = 2.1 * SPACING
N0, LAM = lattice(2.1, 2)[:2]
BOTH = pytest.mark.parametrize("precision", ["single", "double"], indirect=True)
N = 29
ISOLATED = N - 1


def positions() -> np.ndarray:
    """A jittered patch of 4 x 7 particles, and one far from all others."""
    x, y = np.meshgrid(np.arange(4), np.arange(7))
    points = np.stack([x.ravel(), y.ravel()], axis=1) * SPACING
    points = points + np.random.default_rng(0).uniform(-0.02, 0.02, points.shape)
    return np.concatenate([points, [[9.0, 9.0]]])


@functools.partial(jax.jit, static_argnums=(3, 4))
def solve(operator, b, guess, tolerance, max_iterations):
    return solve_plainly(operator, b, guess, Jacobi(operator.diagonal), tolerance, max_iterations)


DENSITY = np.random.default_rng(1).uniform(500.0, 3000.0, N)
UNKNOWN = np.random.default_rng(2).random(N) > 0.3
UNKNOWN[ISOLATED] = True
EXACT = np.where(UNKNOWN, np.random.default_rng(3).uniform(-1e4, 1e4, N), 0.0)
RIGHT = np.where(UNKNOWN, np.random.default_rng(4).normal(size=N), 0.0)


def all_pairs(points) -> Pairs:
    """The pairs of the patch, differentiable in the points."""
    at = positions()
    close = np.linalg.norm(at[:, None] - at[None], axis=-1) < RADIUS
    np.fill_diagonal(close, False)
    slots = close.sum(axis=1).max() + 1
    j = np.argsort(~close, axis=1, kind="stable")[:, :slots]
    present = np.take_along_axis(close, j, axis=1)
    j = np.where(present, j, np.arange(N)[:, None])
    r_ij = points[j] - points[:, None]
    squared = jnp.sum(r_ij**2, axis=-1)
    return Pairs(jnp.array(j), components(r_ij), jnp.sqrt(jnp.where(present, squared, SPACING**2)), jnp.array(present))


def system(points=None, density=None) -> PoissonOperator:
    near = all_pairs(jnp.array(positions()) if points is None else points)
    density = jnp.array(DENSITY) if density is None else density
    w = pair_weight(near, RADIUS)
    coefficient = KernelLaplacian()(near, w, 2.1, SPACING)
    return poisson_operator(near, coefficient, density, jnp.array(UNKNOWN))


def equation(source, previous) -> PressureEquation:
    return PressureEquation(system(), source, jnp.array(UNKNOWN), previous, Jacobi(system().diagonal))


def dense(operator: PoissonOperator) -> np.ndarray:
    return np.asarray(jax.vmap(lambda e: operator @ e, out_axes=1)(jnp.eye(N)))


def matrix_by_hand() -> np.ndarray:
    """[N11] Eq. 7 with the sign turned and the density of the pair, one pair at a time."""
    points, a = positions(), np.zeros((N, N))
    for i in range(N):
        for j in range(N):
            r = np.linalg.norm(points[j] - points[i])
            if UNKNOWN[i] and i != j and r < RADIUS:
                c = 4 / (LAM * SPACING**2 * N0) * 2 / (DENSITY[i] + DENSITY[j]) * (RADIUS / r - 1)
                a[i, i] += c
                a[i, j] -= c if UNKNOWN[j] else 0.0
        a[i, i] = a[i, i] or 1.0
    return a


def test_matrix_is_that_of_the_formula():
    expected = matrix_by_hand()
    np.testing.assert_allclose(dense(system()), expected, rtol=1e-11, atol=1e-13 * expected.max())


@BOTH
def test_matrix_is_symmetric_and_positive_definite(precision):
    a = dense(system()).astype(float)
    tolerance = 1e-6 if precision == "single" else 1e-14
    np.testing.assert_allclose(a, a.T, atol=tolerance * np.abs(a).max())
    assert np.linalg.eigvalsh(0.5 * (a + a.T)).min() > 0


def test_rows_of_known_particles_are_those_of_the_identity():
    a = dense(system())
    np.testing.assert_array_equal(a[~UNKNOWN], np.eye(N)[~UNKNOWN])
    np.testing.assert_array_equal(a[:, ~UNKNOWN], np.eye(N)[:, ~UNKNOWN])


def test_matrix_is_minus_the_laplacian_over_the_density_for_one_fluid():
    near = all_pairs(jnp.array(positions()))
    w, p = pair_weight(near, RADIUS), jnp.array(EXACT)
    expected = -laplacian(p, near, w, N0, LAM * SPACING**2) / 1000.0
    found = system(density=jnp.full(N, 1000.0)) @ p
    inner = UNKNOWN & (np.arange(N) != ISOLATED)
    np.testing.assert_allclose(found[inner], expected[inner], rtol=1e-10, atol=1e-12)


def test_preconditioner_divides_by_the_diagonal():
    operator = system()
    found = Jacobi(operator.diagonal)(jnp.ones(N))
    np.testing.assert_allclose(found, 1.0 / np.diag(dense(operator)), rtol=1e-14)


@BOTH
def test_manufactured_pressure_is_found(precision):
    operator = system()
    a = matrix_by_hand()
    # Round-off of the precision, magnified by the condition number of the matrix with its diagonal scaled to one.
    tolerance = 1e-5 if precision == "single" else 1e-13
    scale = np.sqrt(np.diag(a))
    condition = np.linalg.cond(a / scale / scale[:, None])
    x, convergence = solve(operator, jnp.array(a @ EXACT), jnp.zeros(N), tolerance, 500)
    assert convergence.converged
    assert convergence.residual <= 2 * tolerance
    error = np.linalg.norm(scale * (x - EXACT)) / np.linalg.norm(scale * EXACT)
    assert error < 10 * condition * tolerance
    np.testing.assert_allclose(np.linalg.solve(a, a @ EXACT), EXACT, rtol=1e-10)


def test_solution_is_that_of_a_direct_solve():
    x, _ = solve(system(), jnp.array(RIGHT), jnp.zeros(N), 1e-13, 500)
    expected = np.linalg.solve(matrix_by_hand(), RIGHT)
    np.testing.assert_allclose(x, expected, atol=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize("iterations", [1, 3])
def test_too_few_iterations_are_told_with_the_true_residual(iterations):
    x, convergence = solve(system(), jnp.array(RIGHT), jnp.zeros(N), 1e-10, iterations)
    residual = np.linalg.norm(RIGHT - matrix_by_hand() @ np.asarray(x)) / np.linalg.norm(RIGHT)
    assert not convergence.converged
    assert float(convergence.residual) == pytest.approx(residual, rel=1e-10)
    assert residual > 1e-4


def test_residual_of_a_solve_that_went_well_is_the_true_one():
    x, convergence = solve(system(), jnp.array(RIGHT), jnp.array(EXACT), 1e-4, 500)
    residual = np.linalg.norm(RIGHT - matrix_by_hand() @ np.asarray(x)) / np.linalg.norm(RIGHT)
    assert convergence.converged
    assert float(convergence.residual) == pytest.approx(residual, rel=1e-8)
    assert 1e-7 < residual < 1e-4


@BOTH
def test_no_source_gives_no_pressure(precision):
    for guess in (jnp.zeros(N), jnp.array(np.where(UNKNOWN, 1e4, 0.0))):
        x, convergence = solve(system(), jnp.zeros(N), guess, 1e-5, 500)
        assert np.all(np.isfinite(x))
        # Of the guess of 1e4 nothing is left but round-off.
        assert np.abs(x).max() <= (1e-1 if precision == "single" else 1e-9) * float(guess.max() > 0)
        assert np.isfinite(convergence.residual)


def test_isolated_particle_keeps_its_right_hand_side_and_disturbs_nobody():
    a = dense(system())
    np.testing.assert_array_equal(a[ISOLATED], np.eye(N)[ISOLATED])
    with_it, _ = solve(system(), jnp.array(RIGHT), jnp.zeros(N), 1e-13, 500)
    without = jnp.array(RIGHT).at[ISOLATED].set(0.0)
    without, _ = solve(system(), without, jnp.zeros(N), 1e-13, 500)
    assert float(with_it[ISOLATED]) == pytest.approx(RIGHT[ISOLATED], rel=1e-12)
    scale = np.abs(np.asarray(with_it)).max()
    np.testing.assert_allclose(with_it[:ISOLATED], without[:ISOLATED], atol=1e-11 * scale)


def test_known_pressures_are_zero_whatever_source_and_guess():
    p, _ = solve_pressure(equation(jnp.full(N, 3.0), jnp.full(N, 7e5)), 1e-10, 500)
    np.testing.assert_array_equal(np.asarray(p)[~UNKNOWN], 0.0)
    expected = np.linalg.solve(matrix_by_hand(), np.where(UNKNOWN & (np.arange(N) != ISOLATED), -3.0, 0.0))
    np.testing.assert_allclose(p, expected, atol=1e-8 * np.abs(expected).max())


def test_too_dense_particles_get_positive_pressure():
    n = jnp.array([0.9, 1.0, 1.1]) * N0
    zero = jnp.zeros(3)
    source = DensityDeviation(0.2)(Compression(n, zero, zero), Compression(zero, zero, zero), N0, jnp.array(1e-3))
    np.testing.assert_allclose(source, [0.2e5, 0.0, -0.2e5], rtol=1e-10, atol=1e-6)
    p, _ = solve_pressure(equation(jnp.full(N, -1.0), jnp.zeros(N)), 1e-10, 500)
    assert np.all(np.asarray(p)[UNKNOWN & (np.arange(N) != ISOLATED)] > 0) and float(p[ISOLATED]) == 0.0


@functools.cache
def step_of_a_tank(clip: bool) -> tuple[jaxmps.Case, jaxmps.State]:
    """A jittered tank after one step."""
    case = cases.hydrostatic(spacing=0.1, length=0.8, height=0.8, freeboard=0.1)
    case = cases.jitter(case, 0.1, jax.random.key(1))
    scheme = by_diagonal(schemes.mps(clip_pressure=clip, tolerance=1e-12))
    state, _ = jaxmps.rollout(case, scheme, jaxmps.start(case, scheme), steps=1, dt=1e-3)
    return case, state


def test_clipping_sets_negative_pressures_to_zero_and_no_others():
    clipped, free = (np.asarray(step_of_a_tank(clip)[1].particles.pressure) for clip in (True, False))
    assert free.min() < -1.0 < 1.0 < free.max()
    np.testing.assert_allclose(clipped, np.maximum(free, 0.0), atol=1e-12 * np.abs(free).max())


def test_surface_and_dummy_particles_have_no_pressure():
    case, state = step_of_a_tank(False)
    p, kind = np.asarray(state.particles.pressure), np.asarray(case.particles.kind)
    assert np.all(p[kind == Kind.DUMMY] == 0)
    assert np.all(p[np.asarray(state.surface)] == 0)
    assert np.any(p[kind == Kind.WALL] != 0)


# Derivatives. The forward solve and its derivatives stop at 1e-13.


def solution(b, density, guess=None):
    guess = jnp.zeros_like(b) if guess is None else guess
    b = jnp.where(jnp.array(UNKNOWN), b, 0.0)
    return solve(system(density=density), b, guess, 1e-13, 1000)[0]


def directions() -> SimpleNamespace:
    rng = np.random.default_rng(5)
    return SimpleNamespace(
        b=jnp.array(rng.normal(size=N)),
        density=jnp.array(100.0 * rng.normal(size=N)),
        x=jnp.array(rng.normal(size=N)),
    )


@pytest.mark.parametrize("argument", ["b", "density"])
def test_forward_and_reverse_derivatives_agree_and_are_central_differences(argument):
    along = directions()
    primal = {"b": jnp.array(RIGHT), "density": jnp.array(DENSITY)}

    @jax.jit
    def f(value):
        return solution(**{**primal, argument: value})

    direction = getattr(along, argument)
    _, tangent = jax.jvp(f, (primal[argument],), (direction,))
    cotangent = jax.vjp(f, primal[argument])[1](along.x)[0]
    forward, reverse = float(along.x @ tangent), float(cotangent @ direction)
    assert abs(forward) > 1e-6 * float(jnp.linalg.norm(along.x) * jnp.linalg.norm(tangent))
    assert forward == pytest.approx(reverse, rel=1e-9)
    # Truncation goes as h^2, round-off as 1e-13 / h.
    h = 1e-4
    difference = (f(primal[argument] + h * direction) - f(primal[argument] - h * direction)) / (2 * h)
    np.testing.assert_allclose(tangent, difference, atol=1e-6 * np.abs(difference).max())


def test_derivative_in_the_right_hand_side_is_a_direct_solve():
    along = directions()
    cotangent = jax.grad(lambda b: along.x @ solution(b, jnp.array(DENSITY)))(jnp.array(RIGHT))
    expected = np.where(UNKNOWN, np.linalg.solve(matrix_by_hand(), along.x), 0.0)
    np.testing.assert_allclose(cotangent, expected, atol=1e-11 * np.abs(expected).max())


def test_derivative_in_the_coefficients_is_minus_the_solution_times_the_adjoint():
    # dL/dA_ij = -y_i x_j with A y = dL/dx; for the diagonal, -y_i x_i.
    along, operator = directions(), system()

    def loss(diagonal):
        changed = eqx.tree_at(lambda o: o.diagonal, operator, diagonal)
        return along.x @ solve(changed, jnp.array(RIGHT), jnp.zeros(N), 1e-13, 1000)[0]

    a = matrix_by_hand()
    expected = -np.linalg.solve(a, along.x) * np.linalg.solve(a, RIGHT)
    found = jax.grad(loss)(operator.diagonal)
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


def test_derivative_in_the_positions_is_that_of_central_differences():
    along, points = directions(), jnp.array(positions())
    direction = jnp.array(np.random.default_rng(6).normal(size=points.shape))

    @jax.jit
    def f(points):
        return along.x @ solve(system(points), jnp.array(RIGHT), jnp.zeros(N), 1e-13, 1000)[0]

    h = 1e-7
    difference = (f(points + h * direction) - f(points - h * direction)) / (2 * h)
    assert abs(difference) > 0
    assert float(jnp.vdot(jax.jit(jax.grad(f))(points), direction)) == pytest.approx(float(difference), rel=1e-5)


@functools.partial(jax.jit, static_argnums=3)
def cotangent_of_the_right_hand_side(b, guess, x_bar, tolerance):
    def loss(b):
        return x_bar @ solve(system(), jnp.where(jnp.array(UNKNOWN), b, 0.0), guess, tolerance, 1000)[0]

    return jax.grad(loss)(b)


@BOTH
@pytest.mark.parametrize("scale", [1.0, 1e8])
@pytest.mark.parametrize("small", [1.0, 1e-8])
def test_derivative_is_unaffected_by_the_guess_and_the_size_of_the_cotangent(precision, scale, small):
    tolerance = 1e-6 if precision == "single" else 1e-12
    x_bar = np.random.default_rng(7).normal(size=N)
    guess = jnp.array(scale * np.random.default_rng(8).normal(size=N))
    found = cotangent_of_the_right_hand_side(jnp.array(RIGHT), guess, jnp.array(small * x_bar), tolerance)
    found = np.asarray(found, float) / small
    expected = np.where(UNKNOWN, np.linalg.solve(matrix_by_hand(), x_bar), 0.0)
    # The tolerance of the adjoint solve times the condition number, which is below 1e3 here.
    np.testing.assert_allclose(found, expected, atol=1e3 * tolerance * np.abs(expected).max())


def test_nothing_is_propagated_to_the_guess():
    def f(guess):
        return solve(system(), jnp.array(RIGHT), guess, 1e-3, 1000)[0]

    _, tangent = jax.jvp(f, (jnp.array(EXACT),), (jnp.ones(N),))
    np.testing.assert_array_equal(tangent, 0.0)
    np.testing.assert_array_equal(jax.grad(lambda g: f(g).sum())(jnp.array(EXACT)), 0.0)


@BOTH
def test_zero_cotangent_gives_zero_and_not_nan(precision):
    found = jax.grad(lambda b: 0.0 * solve(system(), b, jnp.zeros(N), 1e-6, 100)[0].sum())(jnp.array(RIGHT))
    np.testing.assert_array_equal(found, 0.0)


def test_vmap_gives_the_solutions_and_derivatives_of_single_solves():
    rng = np.random.default_rng(9)
    right = jnp.array(np.where(UNKNOWN, rng.normal(size=(3, N)), 0.0))
    density = jnp.array(rng.uniform(500, 3000, (3, N)))
    x_bar = directions().x

    @jax.jit
    def both(b, density):
        return solution(b, density), jax.grad(lambda d: x_bar @ solution(b, d))(density)

    together = jax.vmap(both)(right, density)
    for k in range(3):
        for found, expected in zip(together, both(right[k], density[k]), strict=True):
            scale = float(jnp.abs(expected).max())
            np.testing.assert_allclose(found[k], expected, atol=1e-10 * scale)


def test_single_particle_falls_freely():
    case = jaxmps.Case(
        particles=at_rest(jnp.array([[0.5, 0.5]]), jnp.array([int(Kind.FLUID)])),
        fluids=jaxmps.Fluid(jnp.array([1000.0]), jnp.array([0.0])),
        gravity=jnp.array([0.0, -9.81]),
        spacing=SPACING,
        box=Box((0.0, 0.0), (1.0, 1.0)),
    )
    scheme = by_diagonal(schemes.mps())
    state, info = jaxmps.rollout(case, scheme, jaxmps.start(case, scheme), steps=3, dt=1e-3)
    assert not np.any(info.status)
    np.testing.assert_allclose(state.particles.velocity, [[0.0, -3 * 9.81e-3]], rtol=1e-12)
