"""Runs that were stopped in the middle, and what becomes of them."""

import contextlib
import dataclasses
import json
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import jax
import numpy as np
import pytest
from hasty import by_diagonal

import jaxmps as mps
from benchmarks import kills
from jaxmps.command_line import main
from jaxmps.io import checkpoint_of, image, read_checkpoint, write_checkpoint
from jaxmps.io.checkpoint import VERSION
from jaxmps.running import checkpoints, loop, restart

pytestmark = pytest.mark.filterwarnings("ignore::jaxmps.SimulationWarning")
TIMES: dict[str, Any] = {"until": 0.3, "save_every": 0.15}
SCHEMES = {
    "stochastic": lambda: mps.schemes.stochastic(mps.schemes.mps(), alpha=0.05),
    "stabilized": lambda: mps.schemes.mps_hs_gc_ds(),
}


class Killed(BaseException):
    """Stands for a kill in tests that stay in one process: nobody catches it."""


@pytest.fixture(autouse=True)
def short_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four steps after the first sixteen: several checkpoints between two frames."""
    monkeypatch.setattr(loop, "_CHUNK_SECONDS", 0.0)


@pytest.fixture
def killed(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """A run that ends at once after as many checkpoints as it is told."""

    def run(at: int, *arguments: Any, error: type[BaseException] = Killed, **keywords: Any) -> None:
        written = []

        def write_and_end(*what) -> None:
            write_checkpoint(*what)
            written.append(what)
            if len(written) == at:
                raise error

        with monkeypatch.context() as patch:
            patch.setattr(checkpoints, "write_checkpoint", write_and_end)
            with contextlib.suppress(Killed):
                mps.simulate(*arguments, checkpoint_every=0.01, **keywords)
        assert len(written) == at

    yield run


def dam() -> mps.Case:
    return mps.cases.jitter(mps.cases.dam_break(spacing=0.1), 0.1, jax.random.key(1))


def assert_same(ours: Path, theirs: Path, run: mps.Run, alone: mps.Run) -> None:
    found, expected = kills.datasets(ours), kills.datasets(theirs)
    assert found.keys() == expected.keys()
    assert not [name for name in expected if not kills.same(found[name], expected[name])]
    assert run.status == alone.status
    counted = [name for name in alone.summary if name not in kills.NOT_COMPARED]
    assert {name: run.summary[name] for name in counted} == {name: alone.summary[name] for name in counted}


@pytest.mark.parametrize(
    ("precision", "name"),
    [
        ("double", "stochastic"),
        pytest.param("single", "stochastic", marks=pytest.mark.slow),
        pytest.param("single", "stabilized", marks=pytest.mark.slow),
        pytest.param("double", "stabilized", marks=pytest.mark.slow),
    ],
    indirect=["precision"],
)
def test_a_run_that_was_killed_becomes_the_one_that_was_not(precision, name, killed, tmp_path):
    case, scheme, key = dam(), by_diagonal(SCHEMES[name]()), jax.random.key(3)
    alone = mps.simulate(case, scheme, **TIMES, key=key, out=tmp_path / "alone.vtkhdf")
    out, under_way = tmp_path / "run.vtkhdf", []
    for at in (1, 3, 6):
        killed(at, case, scheme, **TIMES, key=key, out=out, overwrite=True)
        _, arrays = read_checkpoint(checkpoint_of(out))
        under_way.append(0 < arrays["carry[1].elapsed"] < arrays["carry[1].duration"])
        run = mps.resume(out, case, scheme)
        assert_same(out, tmp_path / "alone.vtkhdf", run, alone)
        assert not checkpoint_of(out).exists()
    assert under_way == [False, True, True]  # so the clock of the frame under way matters, too
    assert (alone.summary["steps"] > 50, alone.status.completed) == (True, True)
    assert np.ptp(np.diff(alone.time)) < 1e-6 and alone.position.dtype == ("f8" if precision == "double" else "f4")


def test_ctrl_c_list_and_fixed_time_step_survive(killed, tmp_path):
    case, scheme = dam(), by_diagonal(SCHEMES["stochastic"]())
    state = mps.start(case, scheme, skin=0.2, capacity=26)
    common = {**TIMES, "dt": 0.004, "key": jax.random.key(4), "start": state}
    alone = mps.simulate(case, scheme, **common, out=tmp_path / "alone.vtkhdf")
    out = tmp_path / "run.vtkhdf"
    killed(4, case, scheme, **common, out=out, error=KeyboardInterrupt)
    header, _ = read_checkpoint(checkpoint_of(out))
    assert header["list"]["capacity"] == 26
    stopped = mps.read(out)
    assert stopped.status.flags and stopped.time[-1] not in alone.time
    run = mps.resume(out, case, scheme)
    assert_same(out, tmp_path / "alone.vtkhdf", run, alone)


@pytest.fixture(scope="module")
def half(tmp_path_factory) -> Path:
    """A run by the command line, of which half is done: its folder, and beside it that of the whole run."""
    folder = tmp_path_factory.mktemp("half")
    words = "run dam_break --spacing 0.1 --until 0.3 --save-every 0.15 --precision single --seed 3 --set alpha=0.05"
    words = shlex.split(words)
    before, seconds = jax.config.jax_enable_x64, loop._CHUNK_SECONDS
    loop._CHUNK_SECONDS = 0.0
    assert main([*words, "--out", str(folder / "alone")]) == 0
    done = []

    def write_and_end(*what) -> None:
        write_checkpoint(*what)
        done.append(what)
        if len(done) == 8:
            raise Killed

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(checkpoints, "write_checkpoint", write_and_end)
        with pytest.raises(Killed):
            main([*words, "--out", str(folder / "run"), "--checkpoint-every", "0.01"])
    loop._CHUNK_SECONDS = seconds
    jax.config.update("jax_enable_x64", before)
    return folder / "run"


@pytest.fixture
def copy(half: Path, tmp_path: Path) -> Path:
    """A copy of that folder."""
    folder = tmp_path / "run"
    folder.mkdir()
    for path in half.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    return folder


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_the_command_line_resumes_a_run_and_then_says_that_it_has_ended(copy, half, capsys):
    assert len(mps.read(copy / "run.vtkhdf")) == 2
    assert main(["resume", str(copy)]) == 0
    kills.compare(copy, half.parent / "alone")
    before = files(copy)
    assert before.keys() == {"run.vtkhdf", "run.json", "summary.json", "final.png"}
    capsys.readouterr()
    assert main(["resume", str(copy)]) == 0
    said = capsys.readouterr()
    assert said.out.count("\n") == 1 and "has reached its end, t = 0.3 s" in said.out
    assert files(copy) == before


def test_summary_and_picture_that_a_kill_prevented_are_made_by_resume(copy):
    assert main(["resume", str(copy)]) == 0
    text = (copy / "summary.json").read_text()
    for name in ("summary.json", "final.png"):
        (copy / name).unlink()
    assert main(["resume", str(copy)]) == 0
    assert (copy / "summary.json").read_text() == text
    assert (copy / "final.png").stat().st_size > 0


@pytest.mark.parametrize("end", ["torn", "cut", "grown"])
def test_a_file_torn_by_the_kill_is_mended(copy, half, end):
    # Worse than any kill: of the file all is lost but the frames before the checkpoint, and HDF5 cannot open it.
    path, rng = copy / "run.vtkhdf", np.random.default_rng(0)
    whole, frames_end = path.stat().st_size, 0
    with h5py.File(path, "r") as file:
        kept = [range(begin, end) for begin, end in image._chunks(file["VTKHDF"])]
        frames_end = max(piece.stop for piece in kept)
    torn = bytearray(rng.bytes(whole + (100_000 if end == "grown" else 0)))
    for piece in kept:
        torn[piece.start : piece.stop] = path.read_bytes()[piece.start : piece.stop]
    path.write_bytes(torn[:frames_end] if end == "cut" else torn)
    assert not kills.readable(path)
    assert main(["resume", str(copy)]) == 0
    kills.compare(copy, half.parent / "alone")


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1000])


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def renumber(path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content.replace(b"checkpoint %d " % VERSION, b"checkpoint %d " % (VERSION + 1), 1))


def another(path: Path) -> None:
    """The last frame of the checkpoint has another pressure."""
    with h5py.File(path, "r+") as file:
        pressure: Any = file["VTKHDF/PointData/pressure"]
        pressure[:] = 1.0


FAULTS = {
    "truncated": ("run.vtkhdf.checkpoint", cut, "is truncated"),
    "damaged": ("run.vtkhdf.checkpoint", flip, "does not match its checksum"),
    "foreign": ("run.vtkhdf.checkpoint", lambda path: path.write_text("hello"), "is not a jaxmps checkpoint"),
    "empty": ("run.vtkhdf.checkpoint", lambda path: path.write_text(""), "is not a jaxmps checkpoint"),
    "newer": ("run.vtkhdf.checkpoint", renumber, f"of format {VERSION + 1}, this jaxmps reads {VERSION}"),
    "without checkpoint": ("run.vtkhdf.checkpoint", Path.unlink, "has no checkpoint to resume from"),
    "without file": ("run.vtkhdf", Path.unlink, "run.vtkhdf is missing"),
    "with another file": ("run.vtkhdf", another, "is not the file of its checkpoint"),
    "without words": ("run.json", Path.unlink, "run.json is missing"),
    "with torn words": ("run.json", cut, "run.json is damaged"),
    "with other words": (
        "run.json",
        lambda path: path.write_text('{"format": 1, "options": {"precision": 1}}'),
        "opti",
    ),
    "with newer words": ("run.json", lambda path: path.write_text('{"format": 2}'), "must have the format 1, got 2"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_cannot_be_resumed_is_told_in_one_line_and_left_as_it_is(copy, capsys, fault):
    name, spoil, words = FAULTS[fault]
    spoil(copy / name)
    before = files(copy)
    capsys.readouterr()
    assert main(["resume", str(copy)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ") and said.count("\n") == 1
    assert words in said and str(copy) in said
    assert files(copy) == before


@pytest.mark.parametrize("precision", ["single"], indirect=True)
def test_another_case_or_scheme_is_refused_and_the_difference_named(copy, precision):
    out = copy / "run.vtkhdf"
    case, scheme = mps.cases.dam_break(spacing=0.1), SCHEMES["stochastic"]()
    slow = dataclasses.replace(scheme, source=dataclasses.replace(scheme.source, relaxation=jax.numpy.array(0.5)))
    with pytest.raises(ValueError, match=r"^scheme must be .*source\.relaxation was \[?0\.2.* and is \[?0\.5"):
        mps.resume(out, case, slow)
    with pytest.raises(ValueError, match=r"^scheme must be .*tolerance was 0\.0001 and is 1e-05"):
        mps.resume(out, case, dataclasses.replace(scheme, tolerance=1e-5))
    with pytest.raises(ValueError, match=r"^case must be .*particles\.position was float32\[251, 2\]"):
        mps.resume(out, mps.cases.jitter(case, 0.1, jax.random.key(0)), scheme)
    with pytest.raises(ValueError, match=r"^case must be .*spacing was 0\.1 and is 0\.05"):
        mps.resume(out, mps.cases.dam_break(spacing=0.05), scheme)
    with jax.enable_x64(True), pytest.raises(ValueError, match=r"^case must be .*\(float32\) and is .*\(float64\)"):
        mps.resume(out, mps.cases.dam_break(spacing=0.1), SCHEMES["stochastic"]())
    with pytest.raises(FileNotFoundError, match="there is no run at"):
        mps.resume(copy / "nowhere.vtkhdf", case, scheme)


def test_other_versions_of_packages_are_told(copy, capsys, monkeypatch):
    found = restart.versions()
    monkeypatch.setattr(restart, "versions", lambda: {**found, "numpy": "0.9"})
    capsys.readouterr()
    assert main(["resume", str(copy)]) == 0
    warning = "warning: the run may differ in round-off from one that was not stopped: numpy was"
    assert capsys.readouterr().err == f"{warning} {found['numpy']} and is 0.9\n"


def test_checkpoints_need_a_file_and_a_time(tmp_path, capsys):
    case, scheme = mps.cases.dam_break(spacing=0.1), mps.schemes.mps()
    with pytest.raises(ValueError, match=r"checkpoint_every needs out, .* got None"):
        mps.simulate(case, scheme, until=0.1, checkpoint_every=0.1)
    with pytest.raises(ValueError, match="checkpoint_every must be greater than zero, got -1 s"):
        mps.simulate(case, scheme, until=0.1, checkpoint_every=-1.0, out=tmp_path / "run.vtkhdf")
    assert main(["run", "dam_break", "--checkpoint-every", "0", "--out", str(tmp_path / "run")]) == 2
    assert "checkpoint-every must be greater than zero, got 0 s" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_full_disk_is_one_error_and_the_checkpoint_before_is_intact(copy, half, capsys):
    checkpoint, before = copy / "run.vtkhdf.checkpoint", (copy / "run.vtkhdf.checkpoint").read_bytes()
    # What is written to this device meets a full disk, as the system says it.
    (copy / "run.vtkhdf.checkpoint.partial").symlink_to("/dev/full")
    capsys.readouterr()
    assert main(["resume", str(copy)]) == 1
    said = capsys.readouterr().err
    assert said == f"error: {checkpoint} could not be written: No space left on device; the one before it is intact\n"
    assert checkpoint.read_bytes() == before
    assert main(["resume", str(copy)]) == 0
    kills.compare(copy, half.parent / "alone")


@pytest.mark.slow
def test_processes_killed_at_random_instants_lose_nothing(tmp_path, monkeypatch):
    options = shlex.split("dam_break --spacing 0.1 --until 0.4 --save-every 0.01 --checkpoint-every 0.01")
    monkeypatch.setattr(kills, "STEPPING", 0.2)
    counts = kills.harass(tmp_path, 1, seed=0, options=options)
    assert (counts["killed"], counts["resumed"], counts["compared"]) == (1, 1, 1)
    assert json.loads((tmp_path / "alone" / "summary.json").read_text())["completed"]
