"""Runs that blow up: what they tell, and how half the time step brings them to their end."""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hasty import by_diagonal

import jaxmps as mps
from jaxmps.flow import FATAL, MESSAGES, Event, Outcome, Status, at_rest
from jaxmps.flow.status import ADVICE, advice_on
from jaxmps.running import Loop
from jaxmps.running.progress import meter
from jaxmps.running.rescue import Rescue

pytestmark = pytest.mark.filterwarnings("ignore::jaxmps.SimulationWarning")
SPACING, GRAVITY = 0.1, 9.81


@pytest.fixture(scope="module")
def falling() -> Iterator[tuple[mps.Case, mps.Scheme]]:
    """A block of 5 × 5 particles high up in an empty box, and a scheme in which nothing but gravity acts on it."""
    with jax.enable_x64(True):
        points = SPACING * np.stack(np.meshgrid(10.0 + np.arange(5), 40.0 + np.arange(5)), axis=-1).reshape(-1, 2)
        case = mps.Case(
            particles=at_rest(points, np.zeros(25, int)),
            fluids=mps.Fluid([1000.0], [0.0]),
            gravity=[0.0, -GRAVITY],
            spacing=SPACING,
            box=mps.Box((0.0, 0.0), (3.0, 5.0)),
        )
        yield case, by_diagonal(mps.schemes.mps())


@pytest.fixture(scope="module")
def run_of(falling) -> Callable[..., mps.Run]:
    return lambda **settings: mps.simulate(*falling, until=0.4, save_every=0.1, **settings)


def test_half_the_time_step_brings_a_run_to_its_end_where_it_would_have_stopped(run_of):
    stopped, halved = run_of(dt=0.1), run_of(dt=0.1, on_blowup="halve-dt")
    # In the second step of 0.1 s a falling particle moves by 0.196 m, in the first by 0.098 m.
    assert stopped.status.flags == Status.TIME_STEP_TOO_LARGE and stopped.time[-1] == pytest.approx(0.1)
    assert halved.status.completed and halved.time[-1] == pytest.approx(0.4)
    # The step that ends at t moves by g t Δt: 0.05 s are too long for t = 0.25 s, 0.025 s do for 0.4 s.
    events = halved.status.events
    assert [event.status for event in events] == [Status.HALVED] * 2
    assert [(event.time, event.value) for event in events] == [(pytest.approx(0.1), 0.5), (pytest.approx(0.2), 0.25)]
    assert halved.summary["steps"] == 1 + 2 + 4 + 4
    assert all(event.particle is not None and event.position is not None for event in events)


def test_a_fall_with_halved_steps_keeps_its_energy_and_gains_the_speed_of_gravity(run_of):
    run = run_of(dt=0.1, on_blowup="halve-dt")
    np.testing.assert_allclose(run.velocity[..., 1], np.tile(-GRAVITY * run.time[:, None], 25), rtol=1e-12)
    # Steps Δt of symplectic Euler fall deeper by g t Δt / 2 than g t² / 2: that energy is missing, no more.
    steps = np.repeat([0.1, 0.05, 0.025], [1, 2, 8])
    fallen = np.cumsum(steps * GRAVITY * np.cumsum(steps))
    missing = GRAVITY * (fallen[[0, 2, 6, 10]] - 0.5 * GRAVITY * run.time[1:] ** 2)
    np.testing.assert_allclose(run.energy.sum(axis=1)[1:], run.energy[0].sum() - missing, rtol=1e-12)


def test_an_adaptive_time_step_is_halved_by_its_limits(falling):
    case, scheme = falling
    # Without a limit by gravity, the first steps after rest are as long as a frame.
    bold = eqx.tree_at(lambda s: s.time_step, scheme, jax.tree.map(lambda x: 40.0 * x, scheme.time_step))
    run = mps.simulate(case, bold, until=0.4, save_every=0.1, on_blowup="halve-dt")
    assert run.status.completed and len(run.status.events) > 0
    assert not mps.simulate(case, bold, until=0.4, save_every=0.1).status.completed
    np.testing.assert_allclose(run.velocity[-1, :, 1], -GRAVITY * 0.4, rtol=1e-12)


def test_a_hopeless_run_ends_after_ten_halvings_with_its_cause(falling):
    case, scheme = falling
    state = mps.start(case, scheme)
    broken = eqx.tree_at(lambda s: s.particles.velocity, state, state.particles.velocity.at[7, 0].set(jnp.nan))
    run = mps.simulate(case, scheme, until=0.1, dt=0.01, start=broken, on_blowup="halve-dt")
    assert not run.status.completed and run.status.fatal is not None
    assert (run.status.fatal.status, run.status.fatal.particle, run.status.fatal.time) == (Status.NOT_FINITE, 7, 0.0)
    halvings = [event for event in run.status.events if event.status == Status.HALVED]
    assert [event.value for event in halvings] == [0.5**k for k in range(1, 11)]
    with pytest.raises(
        mps.SimulationError, match=r"no longer finite.*half the time step.*Advice: look for overlapping"
    ):
        run.status.check()


class Scripted(Loop):
    """A loop of which frame k fails `failures[k]` times."""

    def __init__(self, failures: list[int]):
        self.failures, self.outcome_, self.halvings = failures, Outcome(), 0

    @property
    def outcome(self) -> Outcome:
        return self.outcome_

    @property
    def snapshot(self) -> Any:
        return self.outcome_

    def put_back(self, snapshot: Any) -> None:
        self.outcome_ = snapshot

    def reach(self, target: float, bar: object, look: object) -> None:
        failed = self.halvings < sum(self.failures[: int(target) + 1])
        self.outcome_ = Outcome((Event(int(Status.NOT_FINITE), target, 0),) if failed else ())

    def halve(self, event: Event) -> None:
        self.halvings += 1


@pytest.mark.parametrize(
    ("failures", "ends"),
    [([10, 0], False), ([11, 0], True), ([5, 0, 5, 0, 5, 0], False), ([1] * 10 + [0], False), ([1] * 11, True)],
)
def test_ten_halvings_in_a_row_are_the_most_and_a_frame_without_one_ends_the_row(failures, ends):
    loop = Scripted(failures)
    rescue = Rescue(loop, "halve-dt")
    for frame in range(len(failures)):
        with meter(1.0, False) as bar:
            rescue.reach(float(frame), bar)
    assert (loop.outcome.fatal is not None) == ends
    assert loop.halvings == (10 if ends else sum(failures))


def test_an_unknown_answer_to_a_blow_up_is_refused_before_anything_is_written(falling, tmp_path):
    with pytest.raises(ValueError, match="on_blowup must be one of stop, halve-dt, got pray"):
        mps.simulate(*falling, until=0.1, on_blowup="pray", out=tmp_path / "run.vtkhdf")
    assert not list(tmp_path.iterdir())


def test_every_cause_has_a_message_and_advice_that_reach_a_person():
    assert set(ADVICE) == set(MESSAGES) == set(Status)
    for bit in Status:
        event = Event(int(bit), 0.5, 10)
        assert Outcome((event,)).advice == event.advice == advice_on(bit)
    both = Outcome((Event(int(Status.ESCAPED), 0.1, 1), Event(int(Status.NOT_FINITE), 0.2, 2)))
    assert both.advice == advice_on(Status.NOT_FINITE) and both.fatal == both.events[1]
    assert Outcome().advice == "" and Outcome().fatal is None


def test_escaped_particles_are_counted_once_and_not_in_a_step_that_was_undone(falling):
    case, scheme = falling
    position = case.particles.position.at[:2, 0].set(jnp.array([0.05, 2.95]))
    velocity = case.particles.velocity.at[:2, 0].set(jnp.array([-1.0, 1.0]))
    particles = dataclasses.replace(case.particles, position=position, velocity=velocity)
    case = dataclasses.replace(case, particles=particles)
    run = mps.simulate(case, scheme, until=0.4, save_every=0.1, dt=0.1, on_blowup="halve-dt")
    assert run.status.completed and run.summary["escaped"] == 2
    escaped = next(event for event in run.status.events if event.status == Status.ESCAPED)
    assert (escaped.count, run.summary["fluid_particles"]) == (2, 23)


def test_the_picture_of_a_failure_shows_the_surroundings_of_the_marked_particle(run_of):
    run = run_of(dt=0.1)
    event = run.status.fatal
    assert event is not None and event.particle is not None and not event.status & ~FATAL
    ax = mps.plotting.failure(run).axes[0]
    (mark,) = ax.lines
    np.testing.assert_allclose(np.ravel(np.asarray(mark.get_data(), float)), run.position[-1, event.particle])
    assert f"particle {event.particle}" in ax.get_title(loc="left") and "time step too large" in ax.get_title(
        loc="left"
    )
    for axis, limits in enumerate((ax.get_xlim(), ax.get_ylim())):
        assert limits[0] < event.position[axis] < limits[1] and limits[1] - limits[0] < 32.0 * SPACING
    with pytest.raises(ValueError, match="run must have failed at a particle, got: completed"):
        mps.plotting.failure(dataclasses.replace(run, status=Outcome()))
