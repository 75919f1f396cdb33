"""Tuning: the optimiser finds what it should, keeps to bounds, carries on from its file, and says what is wrong."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from hasty import by_diagonal

import jaxmps as mps
from jaxmps import diagnostics

SCHEME = mps.schemes.mps


def bowl(scheme, key):
    """Smallest at a relaxation of 0.5 and a restitution of 0.1."""
    return 1.0 + (scheme.source.relaxation - 0.5) ** 2 + (scheme.collision.restitution - 0.1) ** 2


def both(scheme):
    return [scheme.source.relaxation, scheme.collision.restitution]


def test_the_smallest_loss_is_found_and_told():
    best, history = mps.tune(bowl, SCHEME(), both, optax.adam(0.05), steps=200, progress=False)
    assert float(best.source.relaxation) == pytest.approx(0.5, abs=1e-3)
    assert float(best.collision.restitution) == pytest.approx(0.1, abs=1e-3)
    assert history.ended == "all 200 steps were taken"
    assert history.loss.shape == history.gradient_norm.shape == (200,)
    assert [x.shape for x in history.values] == [(200,), (200,)]
    assert history.values[0][0] == 0.2
    assert history.loss[0] == pytest.approx(1.0 + 0.09 + 0.01)
    assert history.gradient_norm[0] == pytest.approx(np.hypot(0.6, 0.2))
    assert history.loss[history.best] == history.loss.min()
    # All else is as it was.
    for leaf, before in zip(jax.tree.leaves(best), jax.tree.leaves(SCHEME()), strict=True):
        assert leaf.dtype == before.dtype
    assert float(best.free_surface.beta) == 0.97


@pytest.mark.parametrize("estimator", [mps.Forward(), mps.Pathwise()])
def test_forward_and_reverse_mode_take_the_same_way(estimator):
    _, history = mps.tune(bowl, SCHEME(), both, optax.sgd(0.1), steps=5, estimator=estimator, progress=False)
    expected = 0.5 - 0.3 * 0.8 ** np.arange(5)
    np.testing.assert_allclose(history.values[0], expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("bounds", "ends"), [((0.0, 0.4), 0.4), ((None, 0.4), 0.4), ((0.0, None), 0.5), ((0.1, 0.9), 0.5)]
)
def test_values_stay_within_their_bounds(bounds, ends):
    _, history = mps.tune(
        bowl,
        SCHEME(),
        lambda s: s.source.relaxation,
        optax.adam(0.3),
        steps=300,
        bounds=[bounds],
        progress=False,
    )
    (values,) = history.values
    low, high = bounds
    assert low is None or values.min() > low
    assert high is None or values.max() < high
    assert values[-1] == pytest.approx(ends, abs=0.02)
    assert values[0] == pytest.approx(0.2, rel=1e-12)


def test_gradients_are_those_of_the_free_variable():
    tuned = mps.tune(
        bowl, SCHEME(), lambda s: s.source.relaxation, optax.sgd(0.0), steps=1, bounds=[(0.0, 1.0)], progress=False
    )
    # dx/dz = x (1 − x) between zero and one.
    assert tuned[1].gradient_norm[0] == pytest.approx(0.6 * 0.2 * 0.8, rel=1e-12)


def noisy(scheme, key):
    return scheme.source.relaxation * (1.0 + jax.random.normal(key)) + scheme.source.relaxation**2


def test_the_loss_is_the_mean_over_the_keys():
    options = {"optimizer": optax.sgd(0.0), "steps": 2, "progress": False}
    tune = lambda **more: mps.tune(noisy, SCHEME(), lambda s: s.source.relaxation, **options, **more)[1].loss  # noqa: E731
    one, many, fresh = tune(keys=1), tune(keys=4000), tune(keys=1, fresh_keys=True)
    assert one[0] == one[1]
    assert fresh[0] != fresh[1]
    # Four standard errors of the mean.
    assert many[0] == pytest.approx(0.2 + 0.04, abs=4.0 * 0.2 / np.sqrt(4000))


def test_evolution_finds_its_way_without_a_derivative():
    def steps(scheme, key):
        """A staircase: its derivative is zero wherever it exists."""
        return jnp.floor(40.0 * jnp.abs(scheme.source.relaxation - 0.5)) / 40.0

    where = lambda s: s.source.relaxation  # noqa: E731
    with pytest.raises(ValueError, match=r"exactly zero at source.relaxation = 0.2"):
        mps.tune(steps, SCHEME(), where, optax.adam(0.05), steps=3, progress=False)
    estimator = mps.Evolution(sigma=0.1, pairs=8)
    best, _ = mps.tune(steps, SCHEME(), where, optax.adam(0.03), steps=60, estimator=estimator, progress=False)
    assert float(best.source.relaxation) == pytest.approx(0.5, abs=0.05)


def test_evolution_estimates_the_gradient_of_a_smoothed_objective_without_bias():
    # Of a cubic: d/dx E (x + σ ε)³ = 3 x² + 3 σ².
    estimator, x = mps.Evolution(sigma=0.5, pairs=20_000), [jnp.array([1.0, -2.0])]
    value, gradient = estimator(lambda v: jnp.sum(v[0] ** 3), x, jax.random.key(3))
    np.testing.assert_allclose(gradient[0], 3.0 * np.array([1.0, 4.0]) + 0.75, rtol=0.05)
    assert float(value) == pytest.approx(1.0 - 8.0 + 3 * 0.25 * (1.0 - 2.0), rel=0.05)
    # Pairs cancel what is even: nothing but round-off remains of a constant and a square at zero.
    _, gradient = mps.Evolution(pairs=1)(lambda v: 7.0 + jnp.sum(v[0] ** 2), [jnp.zeros(2)], jax.random.key(0))
    assert np.all(np.abs(gradient[0]) < 1e-12)


def test_patience_ends_a_tuning_that_gains_nothing():
    _, history = mps.tune(bowl, SCHEME(), both, optax.sgd(0.0), steps=50, patience=4, progress=False)
    assert len(history.loss) == 5
    assert history.ended == "no smaller loss in 4 steps"


def test_a_tuning_carries_on_from_its_file(tmp_path):
    def tune(steps, file, **more):
        return mps.tune(bowl, SCHEME(), both, optax.adam(0.05), steps=steps, file=file, progress=False, **more)

    file = tmp_path / "tuning"
    whole = tune(12, None)[1]
    tune(5, file)
    calls = []

    def counted(scheme, key):
        calls.append(1)
        return bowl(scheme, key)

    again = mps.tune(counted, SCHEME(), both, optax.adam(0.05), steps=12, file=file, progress=False)[1]
    np.testing.assert_array_equal(again.loss, whole.loss)
    np.testing.assert_array_equal(again.values, whole.values)
    assert len(calls) > 0
    assert list(tmp_path.iterdir()) == [file]
    # Nothing left to do.
    np.testing.assert_array_equal(tune(12, file)[1].loss, whole.loss)
    with pytest.raises(ValueError, match=r"file must be of the same tuning: .* has keys 1, not 2"):
        tune(20, file, keys=2)
    with pytest.raises(ValueError, match="file must be of the same tuning"):
        mps.tune(bowl, SCHEME(), lambda s: s.source.relaxation, optax.adam(0.05), steps=20, file=file, progress=False)
    with pytest.raises(ValueError, match="with the same optimiser"):
        mps.tune(bowl, SCHEME(), both, optax.sgd(0.05, momentum=0.9), steps=20, file=file, progress=False)
    other_start = SCHEME(relaxation=0.3)
    with pytest.raises(ValueError, match=r"file must be of the same tuning: .* has start"):
        mps.tune(bowl, other_start, both, optax.adam(0.05), steps=20, file=file, progress=False)
    (tmp_path / "other").write_bytes(b"\x00\xffsomething else\n")
    with pytest.raises(ValueError, match="file must be one that a tuning has written"):
        tune(3, tmp_path / "other")
    file.write_bytes(file.read_bytes()[:-40])
    with pytest.raises(ValueError, match="file must be of the same tuning"):
        tune(20, file)


def test_what_is_not_finite_ends_a_tuning_with_its_place():
    def cliff(scheme, key):
        x = scheme.source.relaxation
        return jnp.where(x > 0.25, jnp.nan, 1.0 - x)

    best, history = mps.tune(cliff, SCHEME(), lambda s: s.source.relaxation, optax.sgd(0.02), steps=50, progress=False)
    assert "the loss was not finite in step 3, at source.relaxation = 0.26" in history.ended
    assert float(best.source.relaxation) == pytest.approx(0.24)
    with pytest.raises(ValueError, match="the gradient was not finite in step 0"):
        mps.tune(lambda s, _: jnp.sqrt(s.source.relaxation - 0.2), SCHEME(), both, optax.sgd(0.1), steps=3)


def test_bad_calls_are_refused(unchecked):
    def tune(where=both, **more):
        return mps.tune(bowl, SCHEME(), where, optax.sgd(0.1), **{"steps": 3, "progress": False, **more})

    with pytest.raises(ValueError, match="steps must be a whole number of 1 or more, got 0"):
        tune(steps=0)
    with pytest.raises(ValueError, match="bounds must have one entry for each of 2 leaves, got 1"):
        tune(bounds=[(0.0, 1.0)])
    with pytest.raises(ValueError, match=r"source.relaxation must start strictly between its bounds 0.3 and 1.0"):
        tune(bounds=[(0.3, 1.0), None])
    with pytest.raises(ValueError, match=r"derivative is exactly zero at free_surface\.beta = 0\.97"):
        tune(lambda s: [s.source.relaxation, s.free_surface.beta])
    with pytest.raises(ValueError, match="where must select float arrays, got 'mps'"):
        tune(lambda s: s.name)
    flat = lambda tree, key: jnp.zeros(())  # noqa: E731
    with pytest.raises(ValueError, match=r"derivative is exactly zero at start = 0\.2"):
        mps.tune(flat, jnp.array(0.2), lambda x: x, optax.sgd(0.1), steps=1, progress=False)
    with pytest.raises(ValueError, match=r"derivative is exactly zero at \[0\] = 0\.2"):
        mps.tune(flat, (jnp.array(0.2),), lambda x: x[0], optax.sgd(0.1), steps=1, progress=False)
    with pytest.raises(ValueError, match=r"start must start strictly between its bounds 0.3 and 1.0, got 0.2"):
        mps.tune(lambda x, key: x, jnp.array(0.2), lambda x: x, optax.sgd(0.1), steps=1, bounds=[(0.3, 1.0)])
    with pytest.raises(ValueError, match="sigma must be greater than zero, got 0"):
        mps.Evolution(sigma=0.0)
    with pytest.raises(ValueError, match=r"pairs must be a whole number of 1 or more, got 1\.5"):
        mps.Evolution(pairs=1.5)  # type: ignore[arg-type]


@pytest.mark.slow
def test_the_strength_of_the_noise_is_tuned_through_runs_with_one_compilation():
    case = mps.cases.standing_wave(spacing=0.1, floor="mirror")
    scheme = by_diagonal(mps.schemes.stochastic(mps.schemes.mps(), alpha=0.01))
    begin, traced = mps.start(case, scheme), []

    def loss(scheme, key):
        traced.append(1)
        _, info = mps.rollout(case, scheme, begin, steps=20, dt=4e-3, key=key)
        return diagnostics.energy_error(info)

    best, history = mps.tune(
        loss,
        scheme,
        lambda s: s.noise.alpha,
        optax.adam(0.3),
        steps=8,
        bounds=[(0.0, 0.5)],
        keys=2,
        progress=False,
    )
    assert len(traced) == 1
    assert history.loss[-1] < history.loss[0]
    assert abs(float(best.noise.alpha) - 0.01) > 0.002


def test_alpha_ds_without_overlaps_is_refused_with_the_reason():
    scheme = mps.schemes.mps_hs_gc_ds(alpha_ds=0.5)

    def loss(scheme, key):
        """Of a pair one spacing apart."""
        return 1.0 + jnp.maximum(scheme.stabilizer.alpha_ds - 1.0, 0.0)

    with pytest.raises(ValueError, match="alpha_ds acts only while pairs are closer"):
        mps.tune(loss, scheme, lambda s: [s.stabilizer.alpha_ds], optax.adam(0.01), steps=2, progress=False)


def test_ctrl_c_before_the_first_step_is_passed_on():
    def interrupting(scheme, key):
        """Python code that is run when the update is traced: at once."""
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mps.tune(interrupting, SCHEME(), both, optax.sgd(0.1), steps=3, progress=False)


def test_ctrl_c_during_a_later_step_ends_it_with_its_history(tmp_path, monkeypatch):
    from jaxmps.tuning import tuner

    def interrupted(file, about, done):
        if len(done.loss) == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(tuner, "write", interrupted)
    best, history = mps.tune(bowl, SCHEME(), both, optax.sgd(0.1), steps=50, progress=False)
    assert history.ended == "interrupted"
    assert len(history.loss) == 3
    assert float(best.source.relaxation) == pytest.approx(0.5 - 0.3 * 0.8**2)
