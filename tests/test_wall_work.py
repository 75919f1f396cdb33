"""The work of moving walls: against the energy that the water has, and what is left for the noise to give back."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from hasty import by_diagonal

import jaxmps as mps
from jaxmps import Case
from jaxmps.motion import Bodies, Rigid, Sine, Still


def tank(motion=None, **sides) -> Case:
    case = mps.cases.hydrostatic(**({"spacing": 0.05, "length": 0.4, "height": 0.2, "freeboard": 0.2} | sides))
    box = mps.Box(tuple(x - 0.3 for x in case.box.lower), tuple(x + 0.3 for x in case.box.upper))
    return Case(case.particles, case.fluids, case.gravity, case.spacing, box, motion=motion or Still())


def heaving(amplitude: float) -> Rigid:
    return Rigid([0.2, 0.1], heave=Sine(amplitude, 6.0, -0.5 * np.pi))


def scheme() -> mps.Scheme:
    return by_diagonal(mps.schemes.mps_cd_gc_ds(tolerance=1e-8))


def balance(run: mps.Run) -> tuple[float, float]:
    """What walls, noise and stabilizer gave, and what of it is there or dissipated [J/kg]."""
    s = run.summary
    given = s["wall_work"] + s["noise_work"] + s["stabilizer_work"]
    return given, s["energy_end"] - s["energy_start"] + s["dissipated"]


@pytest.mark.parametrize(
    "moved",
    [
        {"heave": (0.05, 6.0, -0.5 * np.pi)},
        pytest.param({"sway": (0.03, 9.0, -0.5 * np.pi)}, marks=pytest.mark.slow),
        {"roll": (0.2, 5.0, 0.0)},
    ],
    ids=str,
)
def test_walls_that_move_as_one_body_give_the_water_what_it_gains(moved):
    motion = Rigid([0.2, 0.1], **{name: Sine(*values) for name, values in moved.items()})
    run = mps.simulate(tank(motion), scheme(), until=0.3, dt=2e-3)
    swing = np.ptp(run.energy.sum(axis=1)) + abs(run.summary["wall_work"])
    assert run.status.completed and swing > 1e-3
    given, found = balance(run)
    # Nothing is left over but the potential energy of half a step.
    assert found == pytest.approx(given, abs=0.02 * swing)


def test_a_column_that_is_lifted_has_the_energy_of_its_height_from_its_floor():
    # Half a swing: from rest at the bottom to rest at the top, 2 × 5 cm.
    run = mps.simulate(tank(heaving(0.05)), scheme(), until=np.pi / 6.0, dt=2e-3)
    assert run.summary["wall_work"] == pytest.approx(9.81 * 0.1, rel=0.03)


def test_two_bodies_share_the_work_by_the_pressure_before_them():
    # The left wall is a piston, all else stands still. Pushed slowly, water of depth h has ½ ρ g h² before it.
    case = tank(length=0.8, height=0.4)
    left = np.asarray(case.particles.position)[:, 0] < 0.0
    push = Rigid([0.0, 0.0], sway=Sine(0.02, 2.5, -0.5 * np.pi))
    body = np.where(left & ~np.asarray(case.particles.fluid), 0, -1)
    moving = dataclasses.replace(case, motion=Bodies((push,), jnp.array(body)))
    until, path = np.pi / 2.5 / 2.0, 0.02
    run = mps.simulate(moving, scheme(), until=until, dt=2e-3)
    static = 0.5 * 9.81 * 0.4**2 * path / (0.8 * 0.4)
    assert run.summary["wall_work"] == pytest.approx(static, rel=0.2)


def test_noise_gives_back_what_is_dissipated_and_not_what_walls_take():
    # At rest and in a heave of ± 5 cm, which moves all of the water as one.
    def given(motion) -> float:
        noisy = mps.schemes.stochastic(scheme(), alpha=0.04)
        return mps.simulate(tank(motion), noisy, until=2.0 * np.pi / 6.0, dt=2e-3).summary["noise_work"]

    rest, heave = given(None), given(heaving(0.05))
    assert heave < 4.0 * rest + 1e-3


def test_walls_at_rest_do_no_work():
    run = mps.simulate(tank(), scheme(), until=0.1, dt=2e-3)
    assert run.summary["wall_work"] == 0.0
    given, found = balance(run)
    assert found == pytest.approx(given, abs=1e-4)
