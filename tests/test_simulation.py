"""The host's loop and the pure rollout."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hasty import by_diagonal

import jaxmps as mps
from jaxmps.flow import Status, at_rest
from jaxmps.models import AbstractVelocityNoise
from jaxmps.running import loop
from jaxmps.running.recorder import Recorder

pytestmark = pytest.mark.filterwarnings("ignore::jaxmps.SimulationWarning")


@pytest.fixture(scope="module")
def scheme():
    with jax.enable_x64(True):
        yield by_diagonal(mps.schemes.mps())


def dam(spacing: float = 0.1) -> mps.Case:
    return mps.cases.dam_break(spacing=spacing)


def test_the_same_run_twice_is_the_same_bit_for_bit(scheme):
    case = dam()
    first, second = (mps.simulate(case, scheme, until=0.6, save_every=0.2) for _ in range(2))
    assert first.summary["steps"] > 50
    for name in ("position", "velocity", "pressure", "number_density"):
        assert np.array_equal(getattr(first, name), getattr(second, name)), name


def test_the_steps_of_a_run_are_compiled_once(scheme, monkeypatch):
    traced, after = [], []
    usual, save = loop.largest_step, Recorder.save
    monkeypatch.setattr(loop, "largest_step", lambda *arguments: traced.append(1) or usual(*arguments))
    monkeypatch.setattr(Recorder, "save", lambda self, state: after.append(len(traced)) or save(self, state))
    jax.clear_caches()
    mps.simulate(dam(), scheme, until=0.05, save_every=0.02)
    assert after[0] == 0 < after[1] == after[2] == after[3]


def test_a_table_that_is_too_small_is_enlarged_without_changing_the_answer(scheme):
    case = dam()
    roomy = mps.simulate(case, scheme, until=0.1)
    start = mps.start(case, scheme, capacity=10)
    assert start.neighbors.capacity == 10
    tight = mps.simulate(case, scheme, until=0.1, start=start)
    assert tight.status.completed and tight.summary["steps"] == roomy.summary["steps"]
    # No step is lost or done twice; sums over more slots round differently, and no more than that.
    np.testing.assert_allclose(tight.position, roomy.position, rtol=0, atol=1e-6 * case.spacing)


def test_frames_come_at_their_times_and_splitting_a_run_changes_nothing_else(scheme):
    case = dam()
    run = mps.simulate(case, scheme, until=0.25, save_every=0.1, dt=0.005)
    assert np.allclose(run.time, [0.0, 0.1, 0.2, 0.25], rtol=0, atol=1e-12)
    assert run.position.shape == (4, len(case.particles.kind), 2)
    whole = mps.simulate(case, scheme, until=0.25, dt=0.005)
    assert run.summary["steps"] == whole.summary["steps"] == 50
    # Each interval is divided into equal steps, which differ from dt by round-off.
    np.testing.assert_allclose(run.position[-1], whole.position[-1], atol=1e-9)


@pytest.fixture(scope="module")
def higher_order():
    """A scheme whose first solve feels the weight of water, which one that looks at densities does not."""
    with jax.enable_x64(True):
        yield by_diagonal(mps.schemes.mps_hs_gc_ds())


@pytest.mark.slow
def test_the_frame_of_the_start_has_the_hydrostatic_pressure_of_water_at_rest(higher_order, tmp_path):
    case = mps.cases.hydrostatic(spacing=0.05)
    times = {"until": 0.002, "dt": 0.001, "progress": False}
    run = mps.simulate(case, higher_order, out=tmp_path / "run.vtkhdf", **times)
    y, p = run.position[0, :, 1], run.pressure[0]
    # Rows below the half of 0.4 m: the first ones under the surface are off by more, as they are later on.
    for height in (0.025, 0.075, 0.125, 0.175):
        row = run.fluid[0] & (np.abs(y - height) < 0.01)
        assert p[row].mean() == pytest.approx(9810.0 * (0.4 - height), rel=0.06)
    first, _ = mps.rollout(case, higher_order, mps.start(case, higher_order), steps=1, dt=0.001)
    np.testing.assert_allclose(p, first.particles.pressure, atol=1e-9 * p.max())
    np.testing.assert_array_equal(mps.simulate(case, higher_order, **times).pressure, run.pressure)
    for batch in (1, 2):  # by themselves, and in one program
        many = mps.ensemble(case, higher_order, keys=2, batch=batch, **times)
        np.testing.assert_allclose(many.pressure[:, 0], np.stack([p, p]), atol=1e-3 * (batch - 1) * p.max())


@pytest.mark.slow
def test_the_pressure_of_the_start_changes_nothing_of_the_run(higher_order, monkeypatch):
    case, times = mps.cases.hydrostatic(spacing=0.05), {"until": 0.02, "save_every": 0.01, "progress": False}
    run = mps.simulate(case, higher_order, **times)
    assert run.pressure[0].max() > 3000.0
    tight = mps.simulate(case, higher_order, start=mps.start(case, higher_order, capacity=10), **times)
    np.testing.assert_allclose(tight.pressure[0], run.pressure[0], atol=1e-3 * run.pressure[0].max())
    monkeypatch.setattr(Recorder, "complete", lambda *arguments: None)
    without = mps.simulate(case, higher_order, **times)
    assert not without.pressure[0].any()
    for name in ("position", "velocity", "number_density", "surface", "energy"):
        assert np.array_equal(getattr(run, name), getattr(without, name)), name
    assert np.array_equal(run.pressure[1:], without.pressure[1:])
    assert run.summary["steps"] == without.summary["steps"]


def test_a_pressure_that_a_case_or_state_brings_is_kept(scheme):
    case = dam()
    own = eqx.tree_at(lambda c: c.particles.pressure, case, jnp.full_like(case.particles.pressure, 7.0))
    assert np.all(mps.simulate(own, scheme, until=0.01).pressure[0] == 7.0)


def test_a_run_carries_on_from_a_state(scheme):
    case = dam()
    state, _ = mps.rollout(case, scheme, mps.start(case, scheme), steps=50, dt=1e-3)
    run = mps.simulate(case, scheme, until=0.1, save_every=0.04, start=state)
    assert np.allclose(run.time, [0.05, 0.08, 0.1], rtol=0, atol=1e-12)
    with pytest.raises(ValueError, match=r"until must exceed .* 0.05 s, got 0.01 s"):
        mps.simulate(case, scheme, until=0.01, start=state)


def test_a_mistyped_time_between_frames_is_refused(scheme):
    with pytest.raises(ValueError, match=r"save_every must leave at most 1000000 frames up to 1e\+300 s, got 0.01 s"):
        mps.simulate(dam(), scheme, until=1e300, save_every=0.01)


def test_a_time_step_far_too_large_stops_with_cause_time_particle_and_place(scheme, tmp_path):
    case = dam()
    with pytest.warns(mps.SimulationWarning, match="time step too large"):
        run = mps.simulate(case, scheme, until=2.0, save_every=0.1, dt=0.1, out=tmp_path / "run.vtkhdf")
    assert not run.status.completed and Status.TIME_STEP_TOO_LARGE in run.status.flags
    event = run.status.events[0]
    assert event.particle is not None and event.position is not None and event.value is not None
    assert 0 <= event.particle < 50 and event.value > 1.0
    np.testing.assert_allclose(event.position, run.position[-1, event.particle], rtol=1e-6)
    assert np.isfinite(run.position).all() and len(mps.read(tmp_path / "run.vtkhdf")) == len(run)
    with pytest.raises(mps.SimulationError, match=f"particle {event.particle} at"):
        run.status.check()


def test_values_that_are_not_finite_stop_the_run_at_the_last_good_state(scheme):
    case = dam()
    state = mps.start(case, scheme)
    broken = state.particles.velocity.at[7, 0].set(jnp.nan)
    state = eqx.tree_at(lambda s: s.particles.velocity, state, broken)
    run = mps.simulate(case, scheme, until=0.1, dt=1e-3, start=state)
    assert Status.NOT_FINITE in run.status.flags and run.status.events[0].particle == 7
    assert np.isfinite(run.position).all()


def test_a_pressure_solve_that_misses_its_tolerance_is_reported(scheme):
    hasty = by_diagonal(mps.schemes.mps(tolerance=1e-14))
    start = mps.start(dam(), hasty)
    few = mps.Scheme(
        **{f: getattr(hasty, f) for f in hasty.__dataclass_fields__ if f != "max_iterations"},
        max_iterations=12,
    )
    run = mps.simulate(dam(), few, until=0.02, start=start)
    event = next(e for e in run.status.events if e.status == Status.NOT_CONVERGED)
    assert event.count == run.summary["steps"] and event.value is not None and event.value > 1e-14
    assert run.status.completed  # a warning, not a failure


def test_a_particle_that_leaves_the_domain_is_taken_out_counted_and_reported(scheme):
    case = dam()
    position = case.particles.position.at[0].set(jnp.array([1.0, 3.9]))
    velocity = case.particles.velocity.at[0].set(jnp.array([0.0, 5.0]))
    particles = mps.Particles(position, velocity, case.particles.pressure, case.particles.kind, case.particles.phase)
    case = mps.Case(particles, case.fluids, case.gravity, case.spacing, case.box)
    run = mps.simulate(case, scheme, until=0.1, save_every=0.05)
    assert run.status.completed and Status.ESCAPED in run.status.flags
    assert run.kind[0, 0] == mps.Kind.FLUID and run.kind[-1, 0] == mps.Kind.REMOVED
    assert run.summary["fluid_particles"] == 49 and run.status.events[0].particle == 0


@pytest.mark.slow
def test_single_and_double_precision_agree_on_the_front():
    fronts = []
    for x64 in (False, True):
        with jax.enable_x64(x64):
            run = mps.simulate(dam(0.05), mps.schemes.mps(), until=0.4, save_every=0.05)
            assert run.position.dtype == (np.float64 if x64 else np.float32)
            fronts.append(mps.diagnostics.surge_front(run.position, run.fluid, run.spacing))
    np.testing.assert_allclose(fronts[0], fronts[1], rtol=0.02)


def test_a_rollout_takes_the_steps_of_a_run(scheme):
    case = dam()
    run = mps.simulate(case, scheme, until=0.05, dt=1e-3)
    final, info = mps.rollout(case, scheme, mps.start(case, scheme), steps=50, dt=1e-3)
    assert info.status.shape == (50,) and not info.status.any()
    # The run divides its interval into equal steps, which differ from dt by round-off.
    np.testing.assert_allclose(final.particles.position, run.position[-1], atol=1e-9)
    assert float(final.time) == pytest.approx(0.05)


def test_a_rollout_is_compiled_once_for_all_values_of_the_scheme():
    compiled = []

    @jax.jit
    def height(scheme):
        compiled.append(1)
        return mps.rollout(case, scheme, start, steps=20, dt=2e-3)[0].particles.position[:, 1].mean()

    case = dam()
    start = mps.start(case, mps.schemes.mps())
    results = [height(by_diagonal(mps.schemes.mps(relaxation=gamma))) for gamma in (0.1, 0.2, 0.3)]
    assert len(compiled) == 1 and len({float(r) for r in results}) == 3


def test_cases_that_differ_in_their_description_share_what_is_compiled():
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(lambda event, *_, **__: compiled.append(event))
    case, scheme = dam(), by_diagonal(mps.schemes.mps())
    ends = []
    for name in ("first", "second"):
        compiled.clear()
        named = dataclasses.replace(case, name=name, parameters=(("name", name),))
        run = mps.simulate(named, scheme, until=0.01, save_every=0.01)
        state, _ = mps.rollout(named, scheme, mps.start(named, scheme), steps=2)
        ends.append((run.position[-1], state.particles.position))
        assert run.metadata["case"]["name"] == name
    assert not any("backend_compile" in event for event in compiled)
    np.testing.assert_array_equal(ends[0][0], ends[1][0])
    np.testing.assert_array_equal(ends[0][1], ends[1][1])


@pytest.mark.slow
def test_rollouts_run_under_vmap():
    case = dam()
    start = mps.start(case, mps.schemes.mps())
    gammas = jnp.array([0.1, 0.3])

    def final(gamma):
        return mps.rollout(case, mps.schemes.mps(relaxation=gamma), start, steps=5, dt=1e-3)[0].particles.position

    together = jax.vmap(final)(gammas)
    for gamma, position in zip(gammas, together, strict=True):
        np.testing.assert_allclose(position, final(gamma), atol=1e-9)


def test_a_list_overflow_is_told_by_a_rollout():
    case, scheme = dam(), by_diagonal(mps.schemes.mps())
    start = mps.start(case, scheme, capacity=4)
    _, info = mps.rollout(case, scheme, start, steps=1, dt=1e-3)
    assert (np.asarray(info.status) & Status.TABLE_FULL).all()


def test_a_full_table_outranks_what_the_missing_pairs_cause():
    # dt moves every particle by far more than a spacing; told of a full table, the host must repair and not give up.
    case, scheme = dam(), by_diagonal(mps.schemes.mps())
    _, info = mps.rollout(case, scheme, mps.start(case, scheme, capacity=4), steps=1, dt=1.0)
    assert float(info.travel[0]) > 1.0 and int(info.status[0]) == Status.TABLE_FULL
    _, info = mps.rollout(case, scheme, mps.start(case, scheme, capacity=60), steps=1, dt=1.0)
    assert int(info.status[0]) & Status.TIME_STEP_TOO_LARGE


def test_at_rest_without_gravity_a_time_step_is_asked_for(scheme):
    with pytest.raises(ValueError, match="dt must be given"):
        mps.simulate(mps.cases.dam_break(spacing=0.1, gravity=0.0), scheme, until=0.1)


@pytest.mark.parametrize("wrong", [{"until": 0.0}, {"until": float("nan")}, {"save_every": -1.0}, {"dt": 0.0}])
def test_a_wrong_time_is_refused_by_name(scheme, wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        mps.simulate(dam(), scheme, **{"until": 1.0, **wrong})


def test_a_period_shorter_than_two_radii_is_refused():
    position = jnp.array([[0.1, 0.1], [0.2, 0.2]])
    particles = mps.Particles(position, 0 * position, jnp.zeros(2), jnp.zeros(2, jnp.int8), jnp.zeros(2, jnp.int32))
    box = mps.Box((0.0, 0.0), (0.4, 1.0), (True, False))
    case = mps.Case(particles, mps.Fluid([1000.0], [0.0]), [0.0, -9.81], 0.1, box)
    with pytest.raises(ValueError, match=r"two effective radii \(0.42 m\) .* axis x, got 0.4 m"):
        mps.start(case, mps.schemes.mps())


class Runaway(AbstractVelocityNoise):
    """Every step triples the speed: the Courant limit shrinks the time step to nothing."""

    def __call__(self, velocity, loss, mass, periodic, key):
        return 2.0 * velocity


def test_a_run_whose_time_step_collapses_ends_and_names_the_fastest_particle():
    position = np.array([[0.2, 0.5], [0.8, 0.5]])
    particles = at_rest(position, np.zeros(2, int))
    particles = dataclasses.replace(particles, velocity=jnp.array([[0.0, 0.1], [0.0, 0.2]]))
    box = mps.Box((0.0, 0.0), (1.0, 1.0))
    fluids = mps.Fluid([1000.0], [0.0])
    case = mps.Case(particles=particles, fluids=fluids, gravity=[0.0, 0.0], spacing=0.05, box=box)
    scheme = by_diagonal(dataclasses.replace(mps.schemes.mps(), noise=Runaway()))
    with pytest.warns(mps.SimulationWarning, match="time step has collapsed"):
        run = mps.simulate(case, scheme, until=1.0, progress=False)
    (event,) = run.status.events
    assert not run.status.completed
    assert event.status == mps.Status.TIME_STEP_COLLAPSED and event.particle == 1
    # From Δt = 0.2 · 0.05 m / 0.2 m/s on, a third of it each time: the seventh power of 3 exceeds 1000.
    assert event.step == 7
    assert event.value == pytest.approx(0.2 * 3**7)
    assert event.position == pytest.approx((0.8, 0.5 + 7 * 3 * 0.01), rel=1e-6)
