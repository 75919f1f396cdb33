"""Viscous flows against closed forms, two fluids and walls, and the time step that they allow."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hasty import by_diagonal

import jaxmps as mps
from jaxmps import Box, Case, Kind
from jaxmps.command_line import main
from jaxmps.flow import Fluid, at_rest
from jaxmps.kernels import lattice
from jaxmps.models import AbstractSource, Viscous
from jaxmps.neighbors import allocate, pairs
from jaxmps.operators import pair_weight
from jaxmps.stepping import limits, step

ROWS, L0 = 20, 0.05
HEIGHT = ROWS * L0


def channel(density: tuple[float, float], viscosity: tuple[float, float], order: tuple[int, int] = (0, 1)) -> Case:
    """Two layers of ten rows each between two plates, periodic, without gravity; walls are of the first phase.

    `order`: the number of the phase of the lower and of the upper fluid.
    """
    x, y = np.meshgrid(np.arange(5) + 0.5, np.arange(-3, ROWS + 3) + 0.5, indexing="ij")
    points = np.stack([x.ravel(), y.ravel()], axis=1) * L0
    row = np.floor(points[:, 1] / L0 + 1e-9)
    inside = (row >= 0) & (row < ROWS)
    kind = np.where(inside, Kind.FLUID, np.where((row == -1) | (row == ROWS), Kind.WALL, Kind.DUMMY))
    phase = np.where(inside, np.where(row < ROWS // 2, order[0], order[1]), 0)
    where = np.argsort(order)
    fluids = Fluid(np.array(density)[where], np.array(viscosity)[where])
    box = Box((0.0, -4 * L0), (5 * L0, HEIGHT + 4 * L0), (True, False))
    return Case(at_rest(points, kind, phase), fluids, [0.0, 0.0], L0, box)


def steady(case: Case, lid: float, force: float) -> tuple[np.ndarray, np.ndarray]:
    """Height [m] and velocity [m/s] along x of the fluid between a floor at rest and a lid, under a body force [N/m³],
    where the viscous force is in balance: the solution of a linear equation.
    """
    p, fluid = case.particles, np.asarray(case.particles.fluid)
    near = pairs(allocate(p.position, case.box, 2.1 * L0, 0.1 * L0, 24), p, L0)
    w, (n0, lam, *_) = pair_weight(near, 2.1 * L0), lattice(2.1, 2)
    nu = case.fluids.viscosity[p.phase]

    def stress(u):
        velocity = jnp.stack([u, 0.0 * u], axis=1)
        a = Viscous()(velocity, nu, case.density, p.fluid, near, w, n0, lam * L0**2)
        return (case.density[:, None] * a)[:, 0]

    walls = jnp.where(p.fluid | (p.position[:, 1] < 0.5 * HEIGHT), 0.0, lid)
    matrix = np.asarray(jax.jacobian(stress)(jnp.zeros(len(fluid))))[np.ix_(fluid, fluid)]
    u = np.linalg.solve(matrix, -force - np.asarray(stress(walls))[fluid])
    return np.asarray(p.position)[fluid, 1], u


class Nothing(AbstractSource):
    """Nothing is to be corrected by pressure."""

    def __call__(self, predicted, current, n0, dt):
        return jnp.zeros_like(predicted.n)


RATIOS = [((1000.0, 1000.0), (0.01, 0.01)), ((1000.0, 1.0), (0.01, 0.01)), ((1.0, 850.0), (0.5, 0.002))]


@pytest.mark.parametrize(("density", "viscosity"), RATIOS)
def test_two_layer_couette_flow_is_that_of_constant_stress(density, viscosity):
    y, u = steady(channel(density, viscosity), lid=1.0, force=0.0)
    lower, upper = (rho * nu for rho, nu in zip(density, viscosity, strict=True))
    stress = 1.0 / (0.5 * HEIGHT / lower + 0.5 * HEIGHT / upper)
    exact = np.where(y < 0.5 * HEIGHT, stress * y / lower, 1.0 - stress * (HEIGHT - y) / upper)
    assert np.abs(u - exact).max() < 0.03


@pytest.mark.parametrize(("density", "viscosity"), RATIOS)
def test_two_layer_poiseuille_flow_is_that_of_two_parabolas(density, viscosity):
    y, u = steady(channel(density, viscosity), lid=0.0, force=2.0)
    lower, upper = (rho * nu for rho, nu in zip(density, viscosity, strict=True))
    # −μ u'' = f; u = 0 at both plates, velocity and stress continuous half way: the stress at the floor is s.
    h, f = 0.5 * HEIGHT, 2.0
    s = f * (h**2 / (2 * lower) + 1.5 * h**2 / upper) / (h / lower + h / upper)
    at_middle = (s * h - 0.5 * f * h**2) / lower
    above = at_middle + ((s - f * h) * (y - h) - 0.5 * f * (y - h) ** 2) / upper
    exact = np.where(y < h, (s * y - 0.5 * f * y**2) / lower, above)
    assert np.abs(u - exact).max() < 0.03 * exact.max()


def test_two_fluids_of_any_density_keep_their_momentum_to_round_off_in_two_hundred_steps():
    case = channel((1000.0, 1.0), (0.05, 0.05))
    fluid = case.particles.fluid
    case = dataclasses.replace(case, particles=jax.tree.map(lambda x: x[fluid], case.particles))
    height = case.particles.position[:, 1] / HEIGHT
    shear = jnp.stack([jnp.sin(2.0 * jnp.pi * height), 0.0 * height], axis=1)
    box = Box((0.0, 0.0), (5 * L0, HEIGHT), (True, True))
    particles = dataclasses.replace(case.particles, velocity=shear)
    case = Case(particles, case.fluids, [0.0, 0.0], L0, box)
    # Pressure forces do not keep it: there are none, but for what the moments of the source make of round-off.
    scheme = by_diagonal(dataclasses.replace(mps.schemes.mps(), source=Nothing()))
    end, info = mps.rollout(case, scheme, mps.start(case, scheme), steps=200, dt=1e-3)
    mass = case.density * L0**2
    before, after = mass @ shear[:, 0], mass @ end.particles.velocity[:, 0]
    assert not np.any(info.status)
    assert float(info.energy.kinetic[-1]) < 0.9 * float(info.energy.kinetic[0])  # viscosity has acted
    assert abs(float(after - before)) < 1e-9 * float(mass @ jnp.abs(shear[:, 0]))


@pytest.mark.parametrize("viscosity", [(0.02, 0.5), (1e-6, 2e-2)])
def test_the_order_of_the_fluids_changes_nothing(viscosity):
    ends = []
    for order in ((0, 1), (1, 0)):
        case = channel((1000.0, 2.0), viscosity, order)
        rng = np.random.default_rng(0)
        p = case.particles
        noise = jnp.array(np.where(np.asarray(p.fluid)[:, None], 0.1 * rng.normal(size=p.position.shape), 0.0))
        case = Case(dataclasses.replace(p, velocity=noise), case.fluids, [0.0, -9.81], L0, case.box)
        scheme = by_diagonal(mps.schemes.mps_hs_gc_ds(tolerance=1e-12))
        ends.append(mps.rollout(case, scheme, mps.start(case, scheme), steps=5, dt=1e-4)[0].particles)
    first, second = ends
    scale = float(jnp.abs(first.pressure).max())
    assert scale > 1.0
    np.testing.assert_allclose(first.pressure, second.pressure, atol=1e-8 * scale)
    np.testing.assert_allclose(first.velocity, second.velocity, atol=1e-10)


def test_a_heavy_fluid_on_a_wall_of_a_light_phase_has_its_whole_weight():
    # The wall is of phase 0, which is 1000 times lighter than what stands on it.
    case = mps.cases.hydrostatic(spacing=0.1, length=0.6, height=0.6, freeboard=0.2)
    p = case.particles
    phase = jnp.where(p.fluid, 1, 0).astype(p.phase.dtype)
    fluids = Fluid([1.0, 1000.0], [0.0, 0.0])
    heavy = Case(dataclasses.replace(p, phase=phase), fluids, case.gravity, case.spacing, case.box)
    scheme = by_diagonal(mps.schemes.mps_hs_gc_ds(tolerance=1e-10))
    found, expected = (
        step(c, scheme, mps.start(c, scheme), jnp.asarray(1e-3), jax.random.key(0))[0].particles.pressure
        for c in (heavy, case)
    )
    wet = np.asarray(p.fluid) | (np.asarray(p.position)[:, 1] < 0.0)
    np.testing.assert_allclose(found[wet], expected[wet], atol=1e-6 * float(expected.max()))
    assert float(expected.max()) == pytest.approx(1000.0 * 9.81 * 0.6, rel=0.15)


def test_viscosity_limits_the_time_step_and_free_fall_stays_free_fall():
    # ν = 0.2 m²/s at l0 = 0.02 m: Δt = 0.5 l0² / (4 ν) is a fifteenth of what gravity alone would allow.
    points = np.stack(np.meshgrid(np.arange(6), np.arange(6), indexing="ij"), -1).reshape(-1, 2) * 0.02 + [0.1, 0.6]
    box = Box((0.0, 0.0), (0.4, 0.8))
    case = Case(at_rest(points, np.zeros(36, int)), Fluid([1000.0], [0.2]), [0.0, -9.81], 0.02, box)
    scheme = by_diagonal(mps.schemes.mps_cd_gc_ds())
    allowed = limits(case, scheme, case.particles)
    assert float(allowed.viscosity) == pytest.approx(0.5 * 0.02**2 / (4 * 0.2), rel=1e-12)
    assert float(allowed.viscosity) < 0.15 * float(allowed.gravity)
    run = mps.simulate(case, scheme, until=0.05, progress=False)
    assert run.status.completed
    np.testing.assert_allclose(run.velocity[-1][:, 1], -9.81 * 0.05, rtol=1e-3)


CHANNEL = """
[case]
name = "channel"
spacing = 0.01
gravity = [0.01, 0.0]
periodic = ["x"]
lower = [0.0, -0.05]
upper = [0.06, 0.15]
[[fluid]]
name = "oil"
density = 900.0
viscosity = 3.5e-3
[[fluid.body]]
box = [[0.0, 0.0], [0.06, 0.1]]
[[wall]]
polyline = [[0.0, 0.0], [0.06, 0.0]]
side = "right"
[[wall]]
polyline = [[0.0, 0.1], [0.06, 0.1]]
side = "left"
[scheme]
name = "mps_cd_gc_ds"
[run]
until = 2.0
"""


def test_a_channel_of_reynolds_number_a_tenth_runs_from_the_command_line_without_dt(tmp_path: Path, capsys):
    (tmp_path / "channel.toml").write_text(CHANNEL)
    assert main(["check", str(tmp_path / "channel.toml"), "--out", str(tmp_path / "check.png")]) == 0
    assert "limited by viscosity" in " ".join(capsys.readouterr().out.split())
    assert main(["run", str(tmp_path / "channel.toml"), "--out", str(tmp_path / "run")]) == 0
    run = mps.read(tmp_path / "run" / "run.vtkhdf")
    assert run.status.completed
    fluid = run.kind[-1] == Kind.FLUID
    y, u = run.position[-1][fluid, 1], run.velocity[-1][fluid, 0]
    # After 0.7 H²/ν the flow is a parabola but for exp(−π² 0.7) = .1 %.
    exact = 0.01 / (2 * 3.5e-3) * y * (0.1 - y)
    assert exact.max() * 0.1 / 3.5e-3 == pytest.approx(0.1, abs=0.01)
    assert np.abs(u - exact).max() < 0.05 * exact.max()
