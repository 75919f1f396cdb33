import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hasty import by_diagonal, quick
from scipy.interpolate import PchipInterpolator

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


UNEVEN = np.array([0.0, 0.1, 0.25, 0.3, 0.6, 1.1, 1.2])
TABLES = {
    "rising": [0.0, 0.02, 0.5, 0.6, 2.0, 2.1, 4.0],
    "a gate that opens and closes": [0.0, 0.0, 0.3, 0.3, 0.3, 0.0, 0.0],
    "up and down": [1.0, -1.0, 2.0, 2.5, -3.0, -2.9, 0.0],
    "steep ends": [0.0, 5.0, 4.9, 4.9, 5.0, 5.1, -9.0],
    "an end whose parabola turns": [0.0, 0.1, 3.0, 3.0, 3.0, 3.1, 9.0],
    "at rest": [2.0] * 7,
}


@pytest.mark.parametrize("values", [*TABLES.values(), [0.0, 1.0], [0.0, 1.0, 0.5]], ids=[*TABLES, "two", "three"])
def test_a_table_has_the_values_and_velocities_of_scipys_pchip_and_rests_outside_its_times(values):
    times, values = UNEVEN[: len(values)], np.array(values)
    table, last = Table(times, values), times[-1]
    inside = np.concatenate([np.linspace(0.0, last, 301)[:-1], times[:-1]])
    at = jax.jit(lambda t: jax.jvp(table, (t,), (jnp.ones(()),)))
    value, slope = jax.vmap(at)(jnp.array(inside))
    if len(times) == 2:  # scipy's is the straight line, too
        np.testing.assert_allclose(value, np.interp(inside, times, values), atol=1e-12)
    theirs = PchipInterpolator(times, values)
    np.testing.assert_allclose(value, theirs(inside), atol=1e-12)
    np.testing.assert_allclose(slope, theirs(inside, 1), atol=1e-10)
    for t in (-1.0, last, last + 1.0):
        value, slope = at(jnp.asarray(t))
        assert float(value) == values[0 if t < 0 else -1] and float(slope) == 0.0


def test_a_gate_at_rest_does_not_dive_into_the_floor():
    gate = Table([0.0, 0.5, 0.6, 1.0], [0.0, 0.0, 0.1, 0.1])
    z = np.asarray(jax.vmap(gate)(jnp.linspace(-0.1, 1.1, 1201)))
    assert z.min() == 0.0 and z.max() == pytest.approx(0.1, abs=1e-15)
    assert np.all(np.diff(z) >= -1e-15)


def test_a_linear_table_is_straight_between_its_entries():
    values = np.array(TABLES["up and down"])
    table = Table(UNEVEN, values, interpolation="linear")
    times = np.linspace(-0.2, 1.4, 161) + 1e-4
    value, slope = jax.vmap(lambda t: jax.jvp(table, (t,), (jnp.ones(()),)))(jnp.array(times))
    np.testing.assert_allclose(value, np.interp(times, UNEVEN, values), atol=1e-12)
    piece = np.searchsorted(UNEVEN, times) - 1
    inside = (piece >= 0) & (piece < 6)
    rise = np.diff(values) / np.diff(UNEVEN)
    np.testing.assert_allclose(slope, np.where(inside, rise[np.clip(piece, 0, 5)], 0.0), atol=1e-12)


@pytest.mark.parametrize("name", TABLES)
def test_tables_have_finite_derivatives_which_are_those_of_central_differences_where_there_are_such(name):
    times, values = jnp.array(UNEVEN), jnp.array(TABLES[name])
    at = jnp.array([0.05, 0.17, 0.28, 0.5, 0.9, 1.17])

    def sums(x, t):
        return jnp.sum(jnp.sin(jnp.arange(6) + 1.0) * jax.vmap(Table(t, x))(at))

    by_value, by_time = jax.jit(jax.grad(sums, (0, 1)))(values, times)
    assert np.all(np.isfinite(by_value)) and np.all(np.isfinite(by_time))
    if name in ("rising", "up and down"):  # elsewhere zero rises are where the slope has a kink
        for k in range(7):
            shift = jnp.zeros(7).at[k].set(1e-6)
            difference = (sums(values + shift, times) - sums(values - shift, times)) / 2e-6
            assert float(by_value[k]) == pytest.approx(float(difference), rel=1e-5, abs=1e-7)
            difference = (sums(values, times + shift) - sums(values, times - shift)) / 2e-6
            assert float(by_time[k]) == pytest.approx(float(difference), rel=1e-5, abs=1e-6)


@pytest.mark.parametrize(
    ("times", "values", "message"),
    [
        ([0.0], [0.0], "two entries"),
        ([0.0, 1.0], [0.0, 1.0, 2.0], "of one length"),
        ([0.0, 2.0, 1.0], [0.0, 1.0, 2.0], "must increase"),
        ([0.0, 1.0], [0.0, math.nan], "values of a table must be finite"),
        ([0.0, math.inf], [0.0, 1.0], "times of a table must be finite"),
    ],
)
def test_a_table_that_is_none_is_refused(times, values, message):
    with pytest.raises(ValueError, match=message):
        Table(times, values)


def test_an_interpolation_that_is_not_known_is_refused():
    with pytest.raises(ValueError, match="interpolation must be one of pchip, linear, got cubic"):
        Table([0.0, 1.0], [0.0, 1.0], interpolation="cubic")


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
    # A quarter of the period: the full angle; of the table its second value.
    place = np.asarray(motion.place(jnp.array([[0.5, 0.0]]), jnp.asarray(0.5)))[0]
    np.testing.assert_allclose(place, [0.25 + 0.25 * math.cos(0.1), 0.25 * math.sin(0.1) + 0.1], atol=1e-12)
    assert float(motion.heave(jnp.asarray(0.7))) == pytest.approx(
        float(PchipInterpolator([0, 0.5, 1], [0, 0.1, 0.4])(0.7))
    )
    path.write_text(text.replace("0.4] }", '0.4], interpolation = "linear" }'))
    heave = mps.casefile.read(path).case.motion.heave
    assert float(heave(jnp.asarray(0.7))) == pytest.approx(0.1 + 0.4 * 0.3)
    path.write_text(text.replace("0.4] }", '0.4], interpolation = "cubic" }'))
    with pytest.raises(ValueError, match="interpolation"):
        mps.casefile.read(path)
    path.write_text(text.replace("period = 2.0", 'period = 2.0, interpolation = "linear"'))
    with pytest.raises(ValueError, match="interpolation with times and values only"):
        mps.casefile.read(path)
    path.write_text(text.replace("0.4] }", "0.4], phase = 1.0 }"))
    with pytest.raises(ValueError, match="phase with amplitude and period only"):
        mps.casefile.read(path)
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
