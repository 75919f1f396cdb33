import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hasty import by_diagonal, quick

import jaxmps as mps
from jaxmps.flow.motion import AbstractSignal, Bodies, Constant, Rigid, Sine, Table
from jaxmps.stepping import largest_step


class Square(AbstractSignal):
    """½ a t²: constant acceleration."""

    acceleration: jax.Array = eqx.field(converter=jnp.asarray)

    def __call__(self, time):
        return 0.5 * self.acceleration * time**2


def rolling(**changes) -> mps.Case:
    case = mps.cases.sloshing(spacing=0.05, height=0.4, depth=0.2, amplitude=4.0)
    return dataclasses.replace(case, **changes)


def walls(particles: mps.Particles) -> np.ndarray:
    return np.isin(particles.kind, (mps.Kind.WALL, mps.Kind.DUMMY))


def rolled(points: np.ndarray, center: np.ndarray, angle: float) -> np.ndarray:
    x, y = (points - center).T
    c, s = math.cos(angle), math.sin(angle)
    return center + np.stack([c * x - s * y, s * x + c * y], axis=1)


def test_the_walls_of_a_rolling_tank_are_where_the_angle_says_with_its_velocity_also_when_a_state_goes_on():
    tank, scheme = rolling(), by_diagonal(mps.schemes.mps_cd_gc_ds())
    start = mps.start(tank, scheme)
    half, info = mps.rollout(tank, scheme, start, steps=8, dt=2e-3)
    whole, _ = mps.rollout(tank, scheme, half, steps=8, dt=2e-3)
    wall, center, omega = walls(tank.particles), np.array([0.45, 0.0]), 2.0 * math.pi / 1.919
    amplitude, own = math.radians(4.0), np.asarray(tank.particles.position)[wall]
    assert not np.any(info.status)
    for state, t in ((start, 0.0), (half, 0.016), (whole, 0.032)):
        place = rolled(own, center, amplitude * math.sin(omega * t))
        np.testing.assert_allclose(np.asarray(state.particles.position)[wall], place, atol=1e-12)
        spin = amplitude * omega * math.cos(omega * t)
        x, y = (place - center).T
        velocity = spin * np.stack([-y, x], axis=1)
        np.testing.assert_allclose(np.asarray(state.particles.velocity)[wall], velocity, atol=1e-12)


def test_a_table_of_a_parabola_is_that_parabola_and_rests_outside_its_times():
    times = np.array([0.0, 0.1, 0.25, 0.3, 0.6])
    table = Table(times, 3.0 * times**2 - times + 2.0)
    for t in (0.0, 0.05, 0.2, 0.27, 0.41, 0.59):
        value, slope = jax.jvp(table, (jnp.asarray(t),), (jnp.ones(()),))
        assert float(value) == pytest.approx(3.0 * t**2 - t + 2.0, abs=1e-12)
        assert float(slope) == pytest.approx(6.0 * t - 1.0, abs=1e-12)
    for t in (-1.0, 2.0):
        value, slope = jax.jvp(table, (jnp.asarray(t),), (jnp.ones(()),))
        assert float(value) == pytest.approx(float(table(jnp.clip(t, 0.0, 0.6)))) and float(slope) == 0.0


@pytest.mark.parametrize(
    ("times", "values", "message"),
    [([0.0, 1.0], [0.0, 1.0], "three entries"), ([0.0, 2.0, 1.0], [0.0, 1.0, 2.0], "must increase")],
)
def test_a_table_that_is_none_is_refused(times, values, message):
    with pytest.raises(ValueError, match=message):
        Table(times, values)


def test_bodies_move_by_themselves():
    tank = rolling()
    position = np.asarray(tank.particles.position)
    paddle = np.where(position[:, 0] < 0.0, 0, np.where(position[:, 0] > 0.9, 1, -1))
    motions = (Rigid([0.0, 0.0], sway=Sine(0.01, 3.0)), Rigid([0.9, 0.0], roll=Sine(0.1, 2.0)))
    case = rolling(motion=Bodies(motions, paddle))
    now = np.asarray(case.motion.drive(tank.particles, tank.particles.position, jnp.asarray(0.04)).position)
    wall = walls(tank.particles)
    left, right, still = (wall & (paddle == k) for k in (0, 1, -1))
    np.testing.assert_allclose(now[left], position[left] + [0.01 * math.sin(0.12), 0.0], atol=1e-12)
    place = rolled(position[right], np.array([0.9, 0.0]), 0.1 * math.sin(0.08))
    np.testing.assert_allclose(now[right], place, atol=1e-12)
    np.testing.assert_array_equal(now[still | ~wall], position[still | ~wall])
    nothing = mps.Run(*[np.zeros(0)] * 9, spacing=0.05, energy=np.zeros((0, 2)))  # type: ignore[misc]
    with pytest.raises(ValueError, match="one rigid body, got Bodies"):
        mps.diagnostics.relative(nothing, case.motion)
    with pytest.raises(ValueError, match="one number for each particle"):
        rolling(motion=Bodies(motions, paddle[1:]))


def test_a_center_of_another_dimension_is_refused():
    with pytest.raises(ValueError, match="center of the motion must have 2 components, got 3"):
        rolling(motion=Rigid([0.0, 0.0, 0.0]))


def carried(sway: float = 0.0, acceleration: float = 0.0) -> mps.Case:
    """A narrow tank full of water, whose first mode is far quicker than its motion."""
    case = mps.cases.hydrostatic(spacing=0.04, length=0.2, height=0.4, freeboard=0.12)
    motion = Rigid([0.0, 0.0], sway=Sine(sway, 4.0, -0.5 * math.pi), heave=Square(acceleration))
    return dataclasses.replace(case, motion=motion, box=mps.Box((-1.0, -0.12), (1.2, 2.0)))


def test_a_lift_that_speeds_up_has_the_hydrostatic_pressure_of_a_larger_gravity():
    extra = 5.0
    case = carried(acceleration=extra)
    # A fixed step: where the step changes, the source that restores the density, which goes as 1 / dt², jumps.
    run = mps.simulate(case, by_diagonal(mps.schemes.mps_cd_gc_ds()), until=0.5, save_every=0.05, dt=2e-3)
    run.status.check()
    seen = mps.diagnostics.relative(run, case.motion)
    lift, wall = 0.5 * extra * run.time**2, walls(case.particles)
    risen = run.position[:, wall, 1] - run.position[0, wall, 1]
    np.testing.assert_allclose(risen, np.broadcast_to(lift[:, None], risen.shape), atol=1e-9)
    later, depths = seen.time > 0.2, np.array([0.1, 0.2, 0.3])
    p = mps.diagnostics.pressure_at(seen, [[0.1, 0.4 - depth] for depth in depths])[later].mean(axis=0)
    np.testing.assert_allclose(p, 1000.0 * (9.81 + extra) * depths, rtol=0.03)
    # At rest in the tank, which has risen by more than its depth.
    assert lift[-1] > 0.4
    assert np.abs(seen.velocity[later][:, case.particles.fluid]).max() < 0.15


def test_water_that_cannot_slosh_has_the_momentum_of_its_tank():
    case = carried(sway=0.1)
    run = mps.simulate(case, by_diagonal(mps.schemes.mps_cd_gc_ds()), until=0.5, save_every=0.05, dt=2e-3)
    run.status.check()
    mean = np.array([run.velocity[k][run.fluid[k], 0].mean() for k in range(len(run))])
    np.testing.assert_allclose(mean[1:], 0.4 * np.sin(4.0 * run.time[1:]), atol=0.04)


def test_a_wall_that_leaves_the_domain_ends_the_run_and_says_so():
    case = carried(sway=5.0)
    with pytest.warns(mps.SimulationWarning, match="a moving wall has left the domain.*larger box"):
        run = mps.simulate(case, by_diagonal(mps.schemes.mps_cd_gc_ds()), until=0.5, save_every=0.05, dt=2e-3)
    assert mps.Status.WALL_OUTSIDE in run.status.flags and not run.status.completed
    assert run.status.fatal is not None and run.status.fatal.particle is not None
    assert walls(case.particles)[run.status.fatal.particle]


def test_the_time_step_knows_how_fast_walls_are():
    case = rolling(motion=Rigid([0.45, 0.0], sway=Sine(1.0, 50.0)))
    scheme = mps.schemes.mps_cd_gc_ds(courant=0.1)
    fast = case.motion.drive(case.particles, case.particles.position, jnp.zeros(()))
    assert float(largest_step(case, scheme, fast)) == pytest.approx(0.1 * 0.05 / 50.0)


def test_derivatives_by_the_amplitude_and_frequency_are_those_of_central_differences():
    tank = rolling()
    scheme = by_diagonal(mps.schemes.mps_cd_gc_ds(tolerance=1e-12))
    start = mps.start(tank, scheme)
    wet = tank.particles.fluid

    @quick
    @jax.value_and_grad
    def energy(values):
        where = lambda c: (c.motion.roll.amplitude, c.motion.roll.frequency)  # noqa: E731
        case = eqx.tree_at(where, tank, tuple(values))
        state, _ = mps.rollout(case, scheme, start, steps=4, dt=2e-3)
        return jnp.mean(jnp.where(wet[:, None], state.particles.velocity, 0.0) ** 2)

    values = jnp.array([math.radians(4.0), 3.0])
    _, gradient = energy(values)
    assert np.all(np.asarray(gradient) != 0.0)
    for k in range(2):
        shift = jnp.zeros(2).at[k].set(1e-5 * float(values[k]))
        difference = (energy(values + shift)[0] - energy(values - shift)[0]) / (2.0 * float(shift[k]))
        assert float(gradient[k]) == pytest.approx(float(difference), rel=1e-4)


def test_theory_of_the_swaying_tank_solves_its_equations():
    # By quadrature of the convolution instead of its closed form, for a motion of any phase.
    length, depth, w, phase, t = 0.9, 0.3, 4.0, 0.7, 1.3
    tau = (np.arange(20000) + 0.5) / 20000 * t
    speed = 0.01 * w * np.cos(w * tau + phase)
    expected = 0.0
    for n in range(1, 80, 2):
        k = n * math.pi / length
        own = math.sqrt(9.81 * k * math.tanh(k * depth))
        push = 4.0 * math.tanh(k * depth) / (math.pi * n)
        expected += push * np.mean(np.cos(own * (t - tau)) * speed) * t * math.cos(k * 0.2)
    found = mps.cases.sloshing_linear(t, 0.2, amplitude=0.01, frequency=w, phase=phase, length=length, depth=depth)
    assert float(found) == pytest.approx(expected, rel=1e-6)


def test_a_tank_at_constant_acceleration_would_have_a_plane_surface():
    # The static part of the response, Σ P_n / ω_n² cos k_n x = (L/2 − x) / g, is the plane of slope −1 / g.
    n, x, length = np.arange(1, 4001, 2), 0.2, 0.9
    own = np.asarray(mps.cases.sloshing_frequency(n, length, 0.3))
    push = 4.0 * np.tanh(n * math.pi / length * 0.3) / (math.pi * n)
    assert np.sum(push / own**2 * np.cos(n * math.pi * x / length)) == pytest.approx((0.45 - x) / 9.81, rel=1e-4)
    assert float(Constant()(jnp.zeros(()))) == 0.0


@pytest.mark.slow
def test_a_small_sway_moves_the_center_of_mass_as_linear_theory_says():
    length, depth, amplitude, w = 0.9, 0.3, 0.02, 4.0
    motion = {"kind": "sway", "amplitude": amplitude, "period": 2.0 * math.pi / w, "phase": -90.0}
    case = mps.cases.sloshing(spacing=0.03, length=length, height=0.5, depth=depth, **motion)
    run = mps.simulate(case, mps.schemes.mps_cd_gc_ds(), until=0.9, save_every=0.05)
    run.status.check()
    seen = mps.diagnostics.relative(run, case.motion)
    center = np.array([seen.position[k][seen.fluid[k], 0].mean() for k in range(len(seen))]) - 0.5 * length
    x = (np.arange(200) + 0.5) / 200 * length
    eta = mps.cases.sloshing_linear(
        seen.time[:, None], x, amplitude=amplitude, frequency=w, phase=-0.5 * math.pi, length=length, depth=depth
    )
    eta = np.asarray(eta)
    expected = np.mean(eta * (x - 0.5 * length), axis=1) / depth
    assert np.abs(expected).max() > 0.01
    # Here are ten rows of particles, and the wave at the walls is one spacing high.
    np.testing.assert_allclose(center, expected, atol=0.15 * np.abs(expected).max())


def test_a_case_file_moves_its_walls(tmp_path):
    text = """
    [case]
    spacing = 0.05
    gravity = [0.0, -9.81]
    lower = [-1.0, -1.0]
    upper = [2.0, 2.0]
    [[fluid]]
    density = 1000.0
    [[fluid.body]]
    box = [[0.0, 0.0], [0.5, 0.2]]
    [[wall]]
    box = [[0.0, 0.0], [0.5, 0.4]]
    side = "outside"
    open = ["+y"]
    [motion]
    center = [0.25, 0.0]
    roll = { amplitude = 0.1, period = 2.0 }
    heave = { times = [0.0, 0.5, 1.0], values = [0.0, 0.1, 0.4] }
    """
    path = tmp_path / "tank.toml"
    path.write_text(text)
    motion = mps.casefile.read(path).case.motion
    # A quarter of the period: the full angle; of the table the parabola 0.4 t².
    place = np.asarray(motion.place(jnp.array([[0.5, 0.0]]), jnp.asarray(0.5)))[0]
    np.testing.assert_allclose(place, [0.25 + 0.25 * math.cos(0.1), 0.25 * math.sin(0.1) + 0.1], atol=1e-12)
    path.write_text(text.replace("amplitude = 0.1, ", ""))
    with pytest.raises(ValueError, match=r"\[motion\]: roll must have amplitude and period, or times and values"):
        mps.casefile.read(path)
    path.write_text(text.replace("0.5, 1.0]", "1.0, 0.5]"))
    with pytest.raises(ValueError, match=r"\[motion\]: times of a table must increase"):
        mps.casefile.read(path)


def test_walls_are_where_they_are_in_the_file_at_every_time_as_vtk_reads_it(tmp_path):
    pytest.importorskip("vtk")
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOHDF import vtkHDFReader

    case = mps.cases.sloshing(spacing=0.1, depth=0.3, amplitude=20.0, period=1.0)
    run = mps.simulate(case, by_diagonal(mps.schemes.mps()), until=0.1, save_every=0.05, out=tmp_path / "run.vtkhdf")
    walls = np.asarray(case.particles.kind) != mps.Kind.FLUID
    reference, center = np.asarray(case.particles.position)[walls], np.asarray(case.motion.center)
    reader = vtkHDFReader()
    reader.SetFileName(str(run.path))
    reader.UpdateInformation()
    for k, time in enumerate((0.0, 0.05, 0.1)):
        reader.SetStep(k)
        reader.Update()
        angle = float(case.motion.roll(jnp.asarray(time)) - case.motion.roll(jnp.asarray(0.0)))
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        expected = center + (reference - center) @ turn.T
        found = vtk_to_numpy(reader.GetOutputDataObject(0).GetPoints().GetData())[walls, :2]
        np.testing.assert_allclose(found, expected, atol=1e-9)
    assert abs(angle) > 0.1
