"""What is told of runs, ensembles and tuning on their way: a bar that fits, or lines where nobody sees a bar."""

import contextlib
import io
import itertools
import re
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rich.cells import cell_len
from rich.console import Console

import jaxmps as mps
from jaxmps.command_line import main
from jaxmps.running import display
from jaxmps.running.display import Bar, Told
from jaxmps.running.progress import Counter, Meter, Tally, counter, meter, tally
from jaxmps.running.recorder import Recorder


# A fixed time step of any size runs the same compiled code, that of the tests of the command line.
def dam() -> tuple[mps.Case, mps.Scheme]:
    return mps.cases.dam_break(spacing=0.1), mps.schemes.mps()


USUAL = display.EVERY  # before the tests are told to tell nothing
STEPS: dict[str, Any] = {"until": 0.5, "save_every": 0.02, "dt": 0.005}
LINE = r"t \d\.\d{4} s of 0\.5, \d:\d\d so far, about (\d:\d\d|\?) left, Δt \S+ s, u \S+ m/s(, \S+ s/s)?"
COMPILING = r"compiling …, \d:\d\d so far"


class Clock:
    """Wall time [s] that is set."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch):
        self.now = 0.0
        monkeypatch.setattr(display.clock, "perf_counter", lambda: self.now)


@pytest.fixture
def wall(monkeypatch) -> Clock:
    return Clock(monkeypatch)


def drawn(told: Told, width: int = 80) -> str:
    page = io.StringIO()
    Console(file=page, width=width, force_jupyter=False).print(Bar(told))
    (line,) = page.getvalue().splitlines()
    return line


def states(wall: Clock) -> "list[Told]":
    """Of all three kinds, from the first second to the end of a century, from tiny numbers to vast ones."""
    found: list[Told] = []
    for size, seconds in itertools.product((1e-9, 1e-3, 0.5, 2.0, 123.456, 9.87654e5, 1.23456e12), (0.4, 59.0, 3e9)):
        for number in (1e-12, 1.5, 9.87654e99, float("nan")):
            wall.now = 0.0
            run, tuning, many = Meter(None, size), Tally(None, 10**9), Counter(None, 10**9, "members")
            for share in (0.25, 0.7531):
                wall.now += seconds
                run.update(share * size, number, number)
                tuning.update(int(share * 1e9), -number, number)
                many.add(int(0.3 * 1e9))
            found += [run, tuning, many]
    return found


@pytest.mark.parametrize("width", [40, 80, 120])
def test_a_bar_fills_its_line_and_cuts_nothing(wall, width):
    for told in states(wall):
        line = drawn(told, width)
        assert cell_len(line.rstrip()) <= width and "..." not in line and "…" not in line
        words = told.line(short=True)
        text = line.lstrip("━╸╺ ").rstrip()
        # Whole words, the first and the wall time at least in eighty columns.
        assert any(text == "  ".join(words[:count]) for count in range(1 if width < 80 else 2, len(words) + 1)), line


def test_a_usual_run_shows_all_its_words_and_a_bar_in_eighty_columns(wall):
    run = Meter(None, 2.0)
    for time_now, wall_now in ((0.1, 20.0), (0.4, 50.0)):
        wall.now = wall_now
        run.update(time_now, 1.2e-3, 1.53)
    assert drawn(run) == "━━          t 0.400 s of 2  0:50, left 2:40  Δt 1.20e-03 s  u 1.53 m/s  0.01 s/s"


def test_what_is_left_is_by_the_pace_of_the_last_chunks_and_not_by_that_of_the_compiler(wall):
    run = Meter(None, 3.0, begin=1.0)
    wall.now = 100.0
    run.update(1.1, 1e-3, 1.0)
    assert "1:40, left ?" in drawn(run)
    for k in range(1, 100):
        wall.now += 0.5 if k < 30 else 1.0
        run.update(1.1 + 0.01 * k, 1e-3, 1.0)
    assert run.pace == pytest.approx(0.01) and "left 1:31" in drawn(run)
    many = Counter(None, 100, "members")
    many.add(40)  # were there
    wall.now += 30.0
    many.add(10)
    assert "50 of 100 members" in drawn(many) and "0:30, left 2:30" in drawn(many)


@pytest.mark.parametrize(("seconds", "text"), [(0.0, "0:00"), (59.9, "1:00"), (3599.0, "59:59"), (3600.0, "1:00:00"),
    (359_999.4, "99:59:59"), (360_000.0, "4.17 d"), (1e12, "1.16e+07 d"), (float("inf"), "?")])  # fmt: skip
def test_durations_are_short(seconds, text):
    assert display.duration(seconds) == text


def test_the_first_steps_are_waited_for_with_compiling(wall):
    run, tuning = Meter(None, 2.0, begin=0.5), Tally(None, 10)
    wall.now = 75.0
    run.update(0.5, 0.0, 0.0)  # a neighbor table was full: no step was taken
    assert drawn(run).endswith("compiling …  1:15") and drawn(tuning).endswith("compiling …  1:15")
    run.update(0.6, 1e-3, 1.0)
    tuning.update(1, 2.0, 3.0)
    assert "t 0.600 s of 2" in drawn(run) and "step 1 of 10" in drawn(tuning)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("use", [
    lambda: meter(2.0, None), lambda: counter(5, None, "members"), lambda: tally(5, None)
])  # fmt: skip
def test_a_terminal_sees_a_bar_that_leaves_nothing_behind(use, monkeypatch):
    for name, value in {"TERM": "xterm", "COLUMNS": "80", "NO_COLOR": "1"}.items():
        monkeypatch.setenv(name, value)
    screen = Terminal()
    with contextlib.redirect_stderr(screen), use():
        time.sleep(0.15)
    text = screen.getvalue()
    assert "compiling … " in text or "0 of 5 members " in text
    assert text.endswith("\x1b[1A\x1b[2K")  # up, and the line is empty


def listening(use: Callable[[], object]) -> list[str]:
    """The lines on stderr, of a thread that has ended."""
    err = io.StringIO()
    with contextlib.redirect_stderr(err), contextlib.redirect_stdout(io.StringIO()):
        use()
    assert "jaxmps-progress" not in [thread.name for thread in threading.enumerate()]
    return err.getvalue().splitlines()


def interrupted(path: Path) -> Path:
    """A run that Ctrl-C has ended after its first frame."""

    def save(recorder: Recorder, state: mps.State) -> None:
        original(recorder, state)
        if float(state.time) > 0.0:
            raise KeyboardInterrupt

    original = Recorder.save
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Recorder, "save", save)
        with contextlib.suppress(KeyboardInterrupt), pytest.warns(mps.SimulationWarning):
            mps.simulate(*dam(), **STEPS, out=path, checkpoint_every=0.01, progress=False)
    return path


@pytest.fixture
def every(monkeypatch) -> None:
    monkeypatch.setattr(display, "EVERY", 0.002)


@pytest.mark.slow
def test_runs_tell_how_far_they_are_where_there_is_no_terminal(every, tmp_path):
    command = ["run", "dam_break", "--spacing", "0.1", "--until", "0.5", "--dt", "0.005", "--out", str(tmp_path / "a")]
    path = tmp_path / "run.vtkhdf"
    for use in (
        lambda: mps.simulate(*dam(), **STEPS),
        lambda: main([*command, "--precision", "double"]),
        lambda: mps.resume(interrupted(path), *dam()),
    ):
        lines = listening(use)
        assert lines and all(re.fullmatch(f"{LINE}|{COMPILING}", line) for line in lines), lines
        assert any(re.fullmatch(LINE, line) for line in lines), lines
    lines = listening(lambda: mps.ensemble(*dam(), keys=2, **STEPS))
    assert lines and all(re.fullmatch(r"[012] of 2 members, \d:\d\d so far, about \S+ left", line) for line in lines)


def test_a_run_that_compiles_says_so_before_its_first_step(every):
    def use() -> None:
        with meter(2.0, None) as bar:
            time.sleep(0.2)
            bar.update(0.5, 1e-3, 1.0)
            time.sleep(0.2)

    lines = listening(use)
    assert re.fullmatch(COMPILING, lines[0]) and lines[-1].startswith("t 0.500 s of 2, 0:00 so far, about ? left, ")


def test_nothing_is_told_where_it_is_not_wanted_or_over_in_ten_seconds(every, monkeypatch):
    assert listening(lambda: mps.simulate(*dam(), **STEPS, progress=False)) == []
    assert listening(lambda: mps.ensemble(*dam(), keys=2, **STEPS, progress=False)) == []

    def tuning() -> None:
        with tally(5, None) as show:
            show(1, 2.0, 3.0)
            time.sleep(0.1)

    assert listening(tuning) == []
    assert USUAL == 10.0
    monkeypatch.setattr(display, "EVERY", USUAL)

    def short() -> None:
        with meter(2.0, None) as bar:
            time.sleep(0.1)
            bar.update(0.5, 1e-3, 1.0)

    assert listening(short) == []


def test_a_run_goes_on_when_nobody_listens_any_more(every):
    class Closed(io.StringIO):
        def write(self, text: str) -> int:
            raise BrokenPipeError

    with contextlib.redirect_stderr(Closed()), meter(2.0, None) as bar:
        time.sleep(0.1)
        bar.update(0.5, 1e-3, 1.0)
