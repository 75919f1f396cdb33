"""The command line, called in this process: each run compiles once, for all tests."""

import contextlib
import dataclasses
import io
import json
import platform
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import platformdirs
import pytest
import typer
from rich.cells import cell_len

from jaxmps.casefile.arguments import build, case_factories, scheme_factories
from jaxmps.command_line import app, main
from jaxmps.command_line.output import conclude
from jaxmps.flow import Event, Outcome, Status
from jaxmps.io import read
from jaxmps.models import DriftFreeVelocity, StochasticVelocity
from jaxmps.running.recorder import Recorder

# A fixed time step of any size runs the same compiled code.
TINY = ("run", "dam_break", "--spacing", "0.1", "--dt", "0.005")
FILES = {"run.vtkhdf", "summary.json", "final.png"}


class Result(NamedTuple):
    code: int
    out: str
    err: str


def call(*argv: object) -> Result:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(argument) for argument in argv])
    return Result(code, out.getvalue(), err.getvalue())


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(autouse=True)
def precision_is_restored() -> Iterator[None]:
    before = jax.config.jax_enable_x64  # type: ignore[attr-defined]
    yield
    jax.config.update("jax_enable_x64", before)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    """A run that went well: its directory, and what the command said."""
    before = jax.config.jax_enable_x64  # type: ignore[attr-defined]
    folder = tmp_path_factory.mktemp("runs") / "made" / "here"
    result = call(*TINY, "--until", 0.05, "--seed", 7, "--out", folder)
    jax.config.update("jax_enable_x64", before)
    return folder, result


@pytest.fixture
def copy(finished: tuple[Path, Result], tmp_path: Path, monkeypatch) -> Path:
    """A copy of that directory in the current one."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(finished[0], tmp_path / "copy")
    return Path("copy")


def test_run_writes_file_summary_and_picture(finished):
    folder, result = finished
    assert (result.code, result.err) == (0, "")
    assert {path.name for path in folder.iterdir()} == FILES
    assert all(str(folder / name) in result.out for name in FILES)
    run = read(folder / "run.vtkhdf")
    assert run.time == pytest.approx([0.0, 0.02, 0.04, 0.05])
    assert run.position.dtype == "float64"
    assert run.metadata["run"]["key"] == [0, 7]
    assert run.status.completed


def test_summary_is_json_with_what_was_counted(finished):
    summary = json.loads((finished[0] / "summary.json").read_text())
    assert summary["status"] == "completed"
    assert (summary["particles"], summary["fluid_particles"]) == (251, 50)
    assert set(summary) >= {
        *("case", "scheme", "particles", "fluid_particles", "steps", "time", "status"),
        *("energy_start", "energy_end", "max_speed", "mean_residual", "wall_seconds"),
        "particle_steps_per_second",
    }


FAULTS = [
    ("run", "missing argument case"),
    ("runn", "runn"),
    ("run dam_brake", "case dam_brake dam_break hydrostatic"),
    ("run dam_break --scheme msp", "scheme msp mps"),
    ("run dam_break --sapcing 0.1", "--sapcing --spacing"),
    ("run dam_break --set widht=0.4", "widht width"),
    ("run dam_break --set elephants=4", "elephants width source.relaxation"),
    ("run dam_break --set width", "NAME=VALUE width"),
    ("run dam_break --set =3", "NAME=VALUE =3"),
    ("run dam_break --set width=", "NAME=VALUE width="),
    ("run dam_break --set width=wide", "width number wide"),
    ("run dam_break --set width=3", "width tank_length 3"),
    ("run dam_break --set width=0.4,0.5", "width number 0.4,0.5"),
    ("run dam_break --set width=0.4 --set width=0.5", "width once 0.4 0.5"),
    ("run dam_break --spacing 0.1 --set spacing=0.2", "spacing once"),
    ("run dam_break --set viscosity=nan", "viscosity finite nan"),
    ("run dam_break --set relaxation=nan", "relaxation finite nan"),
    ("run dam_break --set source.relaxation=inf", "source.relaxation finite inf"),
    ("run dam_break --set clip_pressure=maybe", "clip_pressure true false maybe"),
    ("run dam_break --set max_iterations=1.5", "max_iterations whole 1.5"),
    ("run dam_break --spacing 0", "spacing greater 0"),
    ("run dam_break --spacing -0.1", "spacing greater -0.1"),
    ("run dam_break --spacing nan", "spacing finite nan"),
    ("run dam_break --spacing fine", "spacing number fine"),
    ("run dam_break --until 0", "until greater 0"),
    ("run dam_break --until inf", "until finite inf"),
    ("run dam_break --save-every -1", "save-every greater -1"),
    ("run dam_break --dt nan", "dt finite nan"),
    ("run dam_break --seed -1", "seed between -1"),
    ("run dam_break --seed 1.5", "seed whole 1.5"),
    ("run dam_break --jitter nan", "jitter finite nan"),
    ("run dam_break --jitter 0.5", "jitter between 0.5"),
    ("run dam_break --spacing 0.1 --on-blowup pray", "on-blowup stop halve-dt pray"),
    ("run dam_break --precision half", "precision single double half"),
    ("run dam_break --out copy", "copy/run.vtkhdf exists --force"),
    ("run dam_break --out copy/final.png", "out directory copy/final.png"),
    ("cases dam_brake", "case dam_brake dam_break"),
    ("schemes msp", "scheme msp mps"),
    ("show nowhere.vtkhdf", "file exist nowhere.vtkhdf"),
    ("show copy/final.png", "copy/final.png not a jaxmps run"),
    ("show copy --frame 4", "frame between 3 4"),
    ("show copy --frame last", "frame whole last"),
    ("show copy --color red", "color pressure red"),
    ("show copy --out copy/final.png", "copy/final.png exists --force"),
    ("show copy --out copy", "out file copy"),
    ("show copy --out new.xyz", "xyz png"),
    ("plot speed copy", "what energy front speed"),
    ("plot energy copy --out copy/final.png", "copy/final.png exists --force"),
    ("animate copy --out new.avi", "out .gif new.avi"),
    ("animate copy --fps 0", "fps greater 0"),
    ("animate copy --out copy/final.png", "copy/final.png exists --force"),
]


@pytest.mark.parametrize(("line", "words"), FAULTS, ids=[line for line, _ in FAULTS])
def test_wrong_input_gives_one_line_and_leaves_nothing(copy, line, words):
    before = contents(Path())
    result = call(*line.split(" "))
    assert result.code == 2
    assert result.err.startswith("error: ")
    assert result.err.count("\n") == 1
    assert not [word for word in words.split() if word.lower() not in result.err.lower()]
    assert contents(Path()) == before


def test_one_line_errors_are_not_wrapped(copy, monkeypatch):
    monkeypatch.setenv("COLUMNS", "20")
    assert call("run", "dam_break", "--set", "elephants=4").err.count("\n") == 1


@pytest.mark.parametrize("out", ["copy/run.vtkhdf/below", "/proc/nowhere"])
def test_a_directory_that_cannot_be_written_is_told_before_the_run(copy, out):
    before = contents(Path())
    result = call("run", "dam_break", "--spacing", 0.1, "--until", 1e6, "--out", out)
    assert result.code == 1
    assert result.err.startswith("error: out must lie in a directory that can be written, got ")
    assert (out in result.err, result.err.count("\n")) == (True, 1)
    assert contents(Path()) == before


def test_force_replaces_what_is_there(copy):
    before = contents(copy)
    result = call(*TINY, "--until", 0.03, "--out", copy, "--force")
    assert result.code == 0
    assert read(copy / "run.vtkhdf").time == pytest.approx([0.0, 0.02, 0.03])
    assert all(after != before[name] for name, after in contents(copy).items())


def test_a_time_step_far_too_large_ends_the_run_and_keeps_its_frames(copy):
    result = call(*TINY[:-1], 0.1, "--until", 1, "--save-every", 0.1, "--out", "failed")
    assert result.code == 1
    assert result.err.startswith("error: time step too large: a particle moved")
    assert all(word in result.err for word in ("t = ", "step ", "particle ", " at (", "frames"))
    assert result.err.count("\n") == 1
    assert "failed/failure.png" in result.err and "Advice: try a smaller dt" in result.err
    assert Path("failed", "failure.png").stat().st_size > 0
    run, summary = read("failed/run.vtkhdf"), json.loads(Path("failed/summary.json").read_text())
    assert len(run) >= 1
    assert run.status.flags & Status.TIME_STEP_TOO_LARGE
    assert summary["status"] == str(run.status)
    assert Path("failed/final.png").stat().st_size > 0


def test_half_the_time_step_completes_that_run_with_a_warning_for_each_halving(copy):
    line = (*TINY[:-1], 0.1, "--until", 0.2, "--save-every", 0.1, "--on-blowup", "halve-dt", "--out", "halved")
    result = call(*line)
    assert result.code == 0 and result.err.startswith("warning: the run blew up and went on from its last frame")
    halvings = [e for e in read("halved/run.vtkhdf").status.events if e.status == Status.HALVED]
    assert len(halvings) == result.err.count("half the time step") >= 1
    assert not Path("halved/failure.png").exists()


def test_ctrl_c_keeps_everything_so_far(copy, monkeypatch):
    save, saved = Recorder.save, []
    # Shells start what runs in the background with the signal ignored.
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)

    def save_and_interrupt(recorder, state):
        save(recorder, state)
        saved.append(float(state.time))
        if len(saved) == 3:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Recorder, "save", save_and_interrupt)
    try:
        result = call(*TINY, "--until", 1000, "--save-every", 0.05, "--out", "stopped")
    finally:
        signal.signal(signal.SIGINT, usual)
    assert result.code == 130
    assert result.err.startswith("error: interrupted before its end, at t = ")
    assert result.err.count("\n") == 1
    run = read("stopped/run.vtkhdf")
    assert list(run.time[:3]) == saved[:3]
    assert run.status.flags == Status.INTERRUPTED
    assert {path.name for path in Path("stopped").iterdir()} == FILES
    assert "interrupted" in json.loads(Path("stopped/summary.json").read_text())["status"]
    assert "where it has a checkpoint, `jaxmps resume` or mps.resume carries it on; else run it again" in result.err
    # Where there is one, only that is advised.
    Path("stopped/run.vtkhdf.checkpoint").touch()
    err = io.StringIO()
    with contextlib.redirect_stderr(err), contextlib.redirect_stdout(io.StringIO()):
        assert conclude(run, {name: Path("stopped") / name for name in FILES}) == 130
    assert err.getvalue().endswith("Advice: jaxmps resume stopped carries it on from its checkpoint\n")


def test_events_that_do_not_end_a_run_are_warnings(copy):
    event = Event(int(Status.ESCAPED), 0.5, 10, particle=3, position=(0.1, 0.2), count=2)
    run = dataclasses.replace(read(copy / "run.vtkhdf"), status=Outcome((event,)))
    err = io.StringIO()
    with contextlib.redirect_stderr(err), contextlib.redirect_stdout(io.StringIO()):
        assert conclude(run, {name: copy / name for name in FILES}) == 0
    assert err.getvalue() == f"warning: {event}. Advice: {event.advice}\n"


def test_numbers_that_json_does_not_know_become_null(copy):
    run = read(copy / "run.vtkhdf")
    run.summary["mean_residual"] = float("nan")
    with contextlib.redirect_stdout(io.StringIO()):
        conclude(run, {name: copy / name for name in FILES})
    assert json.loads((copy / "summary.json").read_text())["mean_residual"] is None


def test_show_tells_what_is_in_a_file_and_draws_it(copy):
    result = call("show", copy, "--frame", 1, "--color", "speed")
    assert (result.code, result.err) == (0, "")
    for text in ("dam_break", "tank_length", "source.relaxation", "0.2", "float64", "equinox"):
        assert text in result.out
    for text in ("50 fluid", "4, t = 0 to 0.05 s", "completed", "max_speed"):
        assert text in result.out
    assert (copy / "run_speed_0001.png").stat().st_size > 0
    assert call("show", copy, "--frame", 1, "--color", "speed").code == 2
    assert call("show", copy, "--frame", 1, "--color", "speed", "--force").code == 0


@pytest.mark.parametrize(
    ("command", "made"),
    [("plot energy", "run_energy.png"), ("plot front", "run_front.png"), ("animate", "run.gif")],
)
def test_pictures_lie_next_to_the_file_or_where_they_are_told(copy, command, made):
    assert call(*command.split(), copy / "run.vtkhdf").out.strip() == str(copy / made)
    elsewhere = Path("new", "place", made)
    assert call(*command.split(), copy, "--out", elsewhere).code == 0
    assert elsewhere.stat().st_size > 0


def test_lists_name_all_cases_and_schemes_with_their_arguments():
    for command, known in (("cases", case_factories()), ("schemes", scheme_factories())):
        result = call(command)
        assert result.code == 0
        assert known
        assert all(name in result.out for name in known)
    assert "tank_length" in call("cases", "dam_break").out
    assert "source.relaxation" in call("schemes", "mps").out


def test_every_case_and_scheme_is_built_from_its_defaults():
    for case in case_factories():
        for scheme in scheme_factories():
            made, method = build(case, scheme, None, [])
            assert (made.name, method.name) == (case, scheme)


def test_settings_reach_case_scheme_and_single_values():
    settings = ["width=0.4", "relaxation=0.1", "time_step.courant=0.05", "clip_pressure=false"]
    case, scheme = build("dam_break", "mps", 0.1, [*settings, "max_iterations=50"])
    assert dict(case.parameters)["width"] == 0.4
    assert float(scheme.source.relaxation) == pytest.approx(0.1)  # type: ignore[attr-defined]
    assert float(scheme.time_step.courant) == pytest.approx(0.05)
    assert scheme.clip_pressure is False
    assert scheme.max_iterations == 50


@pytest.mark.parametrize("scheme", ["mps", "mps_hs_gc_ds"])
def test_any_scheme_takes_the_stochastic_velocity_by_its_strength(scheme):
    case, made = build("standing_wave", scheme, 0.1, ["alpha=0.03", "drift_free=true", "floor=mirror"])
    assert made.name == f"stochastic {scheme}" and case.box.mirror == 1
    assert isinstance(made.noise, DriftFreeVelocity) and float(made.noise.alpha) == pytest.approx(0.03)
    assert isinstance(build("standing_wave", scheme, 0.1, ["alpha=0.03"])[1].noise, StochasticVelocity)
    with pytest.raises(ValueError, match="alpha must be between 0 and 1, got 2"):
        build("standing_wave", scheme, 0.1, ["alpha=2"])


def test_the_case_gets_the_ratio_of_the_scheme():
    case, scheme = build("dam_break", "mps", 0.1, ["ratio=3.1"])
    assert dict(case.parameters)["ratio"] == scheme.ratio == 3.1


def test_jitter_moves_the_fluid_with_the_seed():
    places = [
        build("dam_break", "mps", 0.1, [], jitter=amplitude, seed=seed)[0].particles.position
        for amplitude, seed in ((0.0, 1), (0.1, 1), (0.1, 1), (0.1, 2))
    ]
    assert 0.0 < abs(places[1] - places[0]).max() <= 0.01
    assert (places[1] == places[2]).all()
    assert (places[1] != places[3]).any()


def test_version_and_help_need_no_arguments():
    assert call("--version").out.startswith("jaxmps ")
    assert "animate" in call("--help").out
    assert call().code == 0


COMMANDS = sorted(typer.main.get_command(app).commands)  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", [None, *COMMANDS])
def test_help_names_what_options_take_nothing_at_flags_and_fits_in_eighty_columns(name, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    code, out, err = call(*([name] if name else []), "--help")
    assert (code, err) == (0, "")
    assert all(cell_len(line.rstrip()) <= 80 for line in out.splitlines()) and "…" not in out
    group: Any = typer.main.get_command(app)
    command = group.commands[name] if name else group
    options = [one for one in command.get_params(typer.Context(command)) if one.opts[0].startswith("-")]
    assert "--help" in [one.opts[0] for one in options]
    for option in options:
        (words,) = re.findall(rf"^│ (?:\* )? *{option.opts[0]} +(.*)│$", out, re.MULTILINE)
        takes = [] if option.is_flag else [option.metavar]
        assert words.split()[: len(takes) + 1] == [*takes, option.help.split()[0]], words
        assert option.is_flag or re.fullmatch(r"[A-Z]+([:=|][A-Za-z]+)*", option.metavar)


def test_help_does_not_wait_for_jax():
    code = "import sys, jaxmps.command_line; jaxmps.command_line.main(['--help']); sys.exit('jax' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=60)
    assert done.returncode == 0, done.stderr.decode()


@pytest.mark.parametrize("told", [False, True])
def test_what_a_run_compiles_is_kept_for_the_next(told, tmp_path, monkeypatch):
    # In the cache folder of the user, by machine, unless the user says where. Reading it is what these tests do all the
    # time: their workers share one.
    monkeypatch.setattr(platformdirs, "user_cache_path", lambda name: tmp_path / name)
    before = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    assert before, "the tests have a cache of their own"
    chosen = str(tmp_path / "chosen") if told else None
    jax.config.update("jax_compilation_cache_dir", chosen)
    try:
        assert call(*TINY, "--until", 0.01, "--out", tmp_path / "run").code == 0
        found = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    finally:
        jax.config.update("jax_compilation_cache_dir", before)
    assert found == (chosen or str(tmp_path / "jaxmps" / platform.node()))
