"""Some frames of a run, and runs that stay in their files."""

import copy
import dataclasses
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxmps as mps
from jaxmps.io import reading
from jaxmps.results import Stored

COLUMNS = ("position", "velocity", "pressure", "number_density", "surface", "kind")
N, FRAMES = 7, 6


def written(path: Path, dim: int = 2, seed: int = 0, **metadata: Any) -> mps.Run:
    """A file with random frames, and what is in it, not read from it."""
    rng, n = np.random.default_rng(seed), N
    described = {"case": {"name": "random"}, "scheme": {"name": "none"}, **metadata}
    writer = mps.io.Writer(
        path,
        phase=np.zeros(n),
        density=np.ones(n),
        spacing=0.1,
        dim=dim,
        dtype="f8",
        metadata=described,
        overwrite=True,
    )
    run = mps.Run(
        time=0.5 + 0.25 * np.arange(FRAMES),
        position=rng.normal(size=(FRAMES, n, dim)),
        velocity=rng.normal(size=(FRAMES, n, dim)),
        pressure=rng.normal(size=(FRAMES, n)),
        number_density=rng.normal(size=(FRAMES, n)),
        surface=rng.random((FRAMES, n)) < 0.5,
        kind=np.where(np.arange(n) == 0, 0, rng.integers(0, 3, (FRAMES, n))).astype(np.int8),
        phase=np.zeros(n),
        density=np.ones(n),
        spacing=0.1,
        energy=rng.normal(size=(FRAMES, 2)),
    )
    for k in range(FRAMES):
        writer.append(**{name: getattr(run, name)[k] for name in (*COLUMNS, "time", "energy")})
    writer.finish({"events": []}, {"steps": 42})
    return run


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "run.vtkhdf"


CHOICES: dict[str, tuple[Any, list[int]]] = {
    "all": (None, [0, 1, 2, 3, 4, 5]),
    "a slice": (slice(1, 4), [1, 2, 3]),
    "every other": (slice(None, None, 2), [0, 2, 4]),
    "the last two": (slice(-2, None), [4, 5]),
    "backwards": (slice(None, None, -1), [5, 4, 3, 2, 1, 0]),
    "none": ([], []),
    "one": (3, [3]),
    "the last": (-1, [5]),
    "some, twice": ([4, 0, 1, 0], [4, 0, 1, 0]),
    "a time": (1.0, [2]),
    "times": ([0.5, 1.74, 0.7], [0, 5, 1]),
    "times of numpy": (np.linspace(0.5, 1.75, 3), [0, 2, 5]),
}


@pytest.mark.parametrize("lazy", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("choice", CHOICES)
def test_the_frames_that_are_asked_for_are_read(path, choice, dim, lazy):
    whole = written(path, dim)
    frames, expected = CHOICES[choice]
    run = mps.read(path, frames=frames, lazy=lazy)
    assert len(run) == len(expected) and run.summary == {"steps": 42} and run.status.completed
    for name in (*COLUMNS, "time", "energy"):
        found = np.asarray(getattr(run, name))
        assert found.dtype == getattr(whole, name).dtype
        np.testing.assert_array_equal(found, getattr(whole, name)[expected], err_msg=name)


@pytest.mark.parametrize(
    ("frames", "error", "words"),
    [
        (6, IndexError, "frame must be between -6 and 5, got 6"),
        ([0, -7], IndexError, "frame must be between -6 and 5, got -7"),
        (1.9, ValueError, r"frames must be times within the run, from 0\.5 s to 1\.75 s, got 1\.9 s"),
        ([0.5, 0.4], ValueError, r"got 0\.4 s"),
        (float("nan"), ValueError, "got nan s"),
        ("last", ValueError, "frames must be a slice, whole numbers, or times in s, got 'last'"),
        (True, ValueError, "frames must be a slice, whole numbers, or times in s, got True"),
        ([[0], [1]], ValueError, "frames must be a slice"),
    ],
)
def test_frames_that_are_not_there_are_refused(path, unchecked, frames, error, words):
    written(path)
    with pytest.raises(error, match=words) as told:
        mps.read(path, frames=frames)
    assert "damaged" not in str(told.value)


def rows_read(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Counts, in the list that it returns, the frames that are read from files."""
    counts, usual = [], reading._rows
    monkeypatch.setattr(reading, "_rows", lambda *given: counts.append(len(given[1])) or usual(*given))
    return counts


def test_a_lazy_run_reads_a_frame_when_it_is_asked_for(path, monkeypatch):
    whole, counts = written(path), rows_read(monkeypatch)
    run = mps.read(path, lazy=True)
    assert not counts and isinstance(run.position, Stored)
    assert len(run) == FRAMES and run.position.shape == (FRAMES, N, 2) and "6 frames of 7 particles" in repr(run)
    np.testing.assert_array_equal(run.position[-2, 1:3, 0], whole.position[-2, 1:3, 0])
    np.testing.assert_array_equal(run.velocity[2:4, 5], whole.velocity[2:4, 5])
    assert counts == [1, 2]
    for mine, theirs in zip(run.position, whole.position, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert counts == [1, 2] + [1] * FRAMES
    with pytest.raises(IndexError, match="frame must be between -6 and 5, got 6"):
        _ = run.position[6]


def test_a_lazy_run_is_one_wherever_a_run_is_used(path, tmp_path):
    whole = written(path)
    run = mps.read(path, lazy=True)
    np.testing.assert_array_equal(run.fluid, whole.kind == 0)
    np.testing.assert_array_equal(run.position + 1.0, whole.position + 1.0)
    np.testing.assert_array_equal(2.0 * run.pressure, 2.0 * whole.pressure)
    np.testing.assert_array_equal(run.surface & run.fluid, whole.surface & (whole.kind == 0))
    np.testing.assert_array_equal(run.position[..., 1], whole.position[..., 1])
    np.testing.assert_array_equal(run.pressure[run.fluid], whole.pressure[whole.kind == 0])
    np.testing.assert_array_equal(run.position.astype("f4"), whole.position.astype("f4"))
    assert run.pressure.max() == whole.pressure.max()
    np.testing.assert_allclose(mps.diagnostics.nearest(run), mps.diagnostics.nearest(whole))
    np.testing.assert_allclose(mps.diagnostics.mean_height(run), mps.diagnostics.mean_height(whole))
    mps.io.export(run, tmp_path / "a.csv", 2)
    np.testing.assert_array_equal(mps.io.particles_from(tmp_path / "a.csv").position, whole.position[2])
    np.testing.assert_array_equal(run.to_xarray()["position"], whole.position)
    for back in (pickle.loads(pickle.dumps(run)), copy.deepcopy(run), dataclasses.replace(run, spacing=0.2)):
        np.testing.assert_array_equal(back.position[3], whole.position[3])


def test_a_file_that_has_another_run_by_now_is_not_taken_for_the_one_that_was_read(path):
    written(path)
    run = mps.read(path, lazy=True)
    written(path, seed=1, run={"seed": 1})
    with pytest.raises(ValueError, match=r"run.vtkhdf has another run by now: what was not read of .* is lost"):
        _ = run.position[0]
    path.unlink()
    with pytest.raises(ValueError, match=r"run.vtkhdf is damaged"):
        _ = run.position[0]


def test_a_run_larger_than_half_of_the_memory_that_is_free_stays_in_its_file(path, monkeypatch):
    case, scheme = mps.cases.square_patch(spacing=0.5), mps.schemes.mps()
    simulate = lambda: mps.simulate(case, scheme, until=2e-3, save_every=1e-3, dt=1e-3, out=path, overwrite=True)  # noqa: E731
    small = simulate()
    assert isinstance(small.position, np.ndarray)

    class Free:
        available = 1000.0

    monkeypatch.setattr(reading.psutil, "virtual_memory", Free)
    large = simulate()
    assert isinstance(large.position, Stored) and isinstance(mps.read(path).position, np.ndarray)
    np.testing.assert_array_equal(large.position, small.position)
