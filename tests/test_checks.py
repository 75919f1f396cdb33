"""What is given to a run has to fit together: the state to case and scheme, and all to the precision of JAX."""

import dataclasses
import math

import equinox as eqx
import jax
import optax
import pytest
from hasty import by_diagonal

import jaxmps as mps

SHORT = {"steps": 1, "dt": 1e-3}


def patch(**changes) -> mps.Case:
    return dataclasses.replace(mps.cases.square_patch(spacing=0.25), **changes)


def scheme(ratio: float = 2.1) -> mps.Scheme:
    return by_diagonal(mps.schemes.mps(ratio=ratio))


def both(case, method, state):
    """The two calls that take a state, and the pure one under a transformation."""
    yield lambda: mps.simulate(case, method, until=1e-3, dt=1e-3, start=state)
    yield lambda: mps.rollout(case, method, state, **SHORT)
    yield lambda: jax.jit(lambda s: mps.rollout(case, method, s, **SHORT)[0].time)(state)


def test_a_state_whose_list_is_for_another_radius_is_refused():
    case, state = patch(), mps.start(patch(), scheme())
    for call in both(case, scheme(ratio=3.1), state):
        with pytest.raises(ValueError, match=r"start must .* ratio \* spacing = 0\.775 m, got one for 0\.525 m: make"):
            call()


def test_a_state_of_another_number_of_particles_dimension_or_box_is_refused():
    state = mps.start(patch(), scheme())
    finer = mps.cases.square_patch(spacing=0.2)
    solid = mps.cases.hydrostatic(spacing=0.1, length=0.1, height=0.1, depth=0.1)
    wider = patch(box=mps.Box((-3.0, -2.0), (2.0, 2.0)))
    round_ = patch(box=mps.Box((-2.0, -2.0), (2.0, 2.0), (True, False)))
    for case, words in (
        (finer, r"start must have the particles of case, of the shape \(25, 2\), got \(16, 2\)"),
        (solid, r"start must have the particles of case, of the shape \(\d+, 3\), got \(16, 2\)"),
        (wider, r"box of the case, whose lower is \(-3\.0, -2\.0\), got one for \(-2\.0, -2\.0\)"),
        (round_, r"box of the case, whose periodic is \(True, False\), got one for \(False, False\)"),
    ):
        for call in both(case, scheme(), state):
            with pytest.raises(ValueError, match=words) as told:
                call()
            assert "\n" not in str(told.value)


def test_a_state_with_particles_of_another_kind_or_phase_is_refused_but_not_one_that_has_lost_some():
    case = patch(fluids=mps.Fluid([1000.0, 800.0], [0.0, 0.0]))
    state = mps.start(case, scheme())
    walls = eqx.tree_at(lambda s: s.particles.kind, state, state.particles.kind.at[3:5].set(mps.Kind.WALL))
    mixed = eqx.tree_at(lambda s: s.particles.phase, state, state.particles.phase.at[2].set(1))
    for wrong, words in ((walls, "kind as case, .* 3 has kind 0, got 1 .2 such"), (mixed, "2 has phase 0, got 1")):
        for call in list(both(case, scheme(), wrong))[:2]:  # under a transformation there are no values to check
            with pytest.raises(ValueError, match=words):
                call()
    lost = eqx.tree_at(lambda s: s.particles.kind, state, state.particles.kind.at[3].set(mps.Kind.REMOVED))
    end, _ = mps.rollout(case, scheme(), lost, **SHORT)
    assert int(end.particles.kind[3]) == mps.Kind.REMOVED and math.isclose(float(end.time), 1e-3)


@pytest.mark.parametrize("precision", ["single", "double"], indirect=True)
def test_what_was_made_in_the_other_precision_is_refused_by_every_way_to_run_it(precision):
    with jax.enable_x64(precision == "single"):
        case, method = patch(), scheme()
        state = mps.start(case, method)
    names = {"single": "float32", "double": "float64"}
    now, then = names[precision], names["double" if precision == "single" else "single"]
    words = rf"case must have the precision that JAX is set to \({now}\): case\.particles\.position is {then}\. Set jax"
    loss = lambda s, key: mps.rollout(case, s, state, **SHORT)[1].energy.total[0]  # noqa: E731
    own = scheme()
    calls = [
        *both(case, method, state),
        lambda: mps.start(case, method),
        lambda: mps.simulate(case, method, until=1e-3, dt=1e-3),
        lambda: mps.ensemble(case, method, keys=2, until=1e-3, dt=1e-3, progress=False),
        lambda: mps.tune(loss, own, lambda s: s.source.relaxation, optax.sgd(0.1), steps=1, progress=False),
    ]
    for call in calls:
        with pytest.raises(ValueError, match=words) as told:
            call()
        assert "\n" not in str(told.value)
    with pytest.raises(ValueError, match=r"scheme must have the precision .*: scheme\.\S+ is " + then):
        mps.simulate(patch(), method, until=1e-3, dt=1e-3)
    with pytest.raises(ValueError, match=r"start must have the precision .*: start\.particles\.position is " + then):
        mps.simulate(patch(), own, until=1e-3, dt=1e-3, start=state)


def test_of_several_members_each_has_to_have_the_precision(tmp_path):
    with jax.enable_x64(False):
        narrow = patch()
    with pytest.raises(ValueError, match=r"differ from the first in values alone, not in the shape or precision"):
        mps.ensemble([patch(), narrow], scheme(), keys=2, until=1e-3, dt=1e-3, out=tmp_path / "many")
    with pytest.raises(ValueError, match="case must have the precision"):
        mps.ensemble([narrow, narrow], scheme(), keys=2, until=1e-3, dt=1e-3, out=tmp_path / "many")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("precision", ["single"], indirect=True)
@pytest.mark.parametrize("density", [1e308, 1e-308])
def test_numbers_beyond_single_precision_are_refused_by_name(precision, density):
    said = r"density must be zero or of a size from 1.2e-38 to 3.4e\+38, as far as float32 goes, got 1e.?308"
    with pytest.raises(ValueError, match=said):
        mps.cases.dam_break(spacing=0.1, density=density)
