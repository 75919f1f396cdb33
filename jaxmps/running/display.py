"""Where progress is shown: as a bar on terminals and in notebooks, as lines elsewhere."""

import io
import math
import sys
import threading
import time as clock
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions
from rich.live import Live
from rich.measure import Measurement
from rich.progress_bar import ProgressBar
from rich.segment import Segment

EVERY = 10.0
"""Wall time [s] from line to line, where there is no bar."""

_NOTEBOOK_COLUMNS, _BAR = 80, (4, 24)  # of these a bar takes what the words leave


class Told(ABC):
    """Something under way: how much of `total` is done, in words, and the wall time that it took and is to take.

    `refresh` is called at each change.
    """

    def __init__(self, refresh: Callable[[], None] | None, total: float, begin: float = 0.0):
        self.total, self.done, self.compiling = total, begin, True
        self._refresh, self._first, self._began = refresh, begin, clock.perf_counter()
        # The pace of the last half minute: time steps change, and what compiles takes longer than what runs.
        self._paces: deque[tuple[float, float]] = deque(maxlen=64)

    @abstractmethod
    def words(self, wall: str) -> list[str]:
        """What is told, the most important first; `wall` tells of the wall time."""

    def reach(self, done: float) -> None:
        """So much of the total is done."""
        self.done = done
        if done > self._first:
            self.compiling = False
        if not self.compiling:
            self._paces.append((clock.perf_counter(), done))
        if self._refresh is not None:
            self._refresh()

    @property
    def fraction(self) -> float:
        return min(max(self.done / self.total, 0.0), 1.0) if self.total else 0.0

    @property
    def pace(self) -> float:
        """How much is done in a second of wall time; 0 where that is not known yet."""
        if len(self._paces) < 2:
            return 0.0
        (then, before), (now, done) = self._paces[0], self._paces[-1]
        return (done - before) / (now - then) if now > then else 0.0

    def line(self, short: bool) -> list[str]:
        """All that is told."""
        spent = duration(clock.perf_counter() - self._began)
        if self.compiling:
            return ["compiling …", spent if short else f"{spent} so far"]
        left = duration((self.total - self.done) / self.pace if self.pace > 0.0 else math.inf)
        return self.words(f"{spent}, left {left}" if short else f"{spent} so far, about {left} left")


def duration(seconds: float) -> str:
    """A wall time in at most ten letters, "?" if it is not known."""
    if not math.isfinite(seconds):
        return "?"
    if seconds >= 360_000:
        return f"{seconds / 86_400:.3g} d"
    minutes, left = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{left:02d}" if minutes >= 60 else f"{minutes}:{left:02d}"


@contextmanager
def shown(visible: bool | None, lines: bool = True) -> Iterator["Screen"]:
    """The screen that fits where this process writes to: none if it is not to be `visible`, and none in place of
    `lines` if these are not wanted.
    """
    screen = _screen(lines) if visible is not False else Screen()
    try:
        yield screen
    finally:
        screen.stop()


def _screen(lines: bool) -> "Screen":
    if Console().is_jupyter:
        return _InNotebook()
    console = Console(file=sys.stderr)
    if console.is_terminal and not console.is_dumb_terminal:
        return _OnTerminal(console)
    return _InFile(sys.stderr) if lines else Screen()


class Screen:
    """Nothing is shown."""

    def start(self, told: Told) -> None:
        """Begins to show it."""

    def refresh(self) -> None:
        """Something has changed."""

    def stop(self) -> None:
        """Shows it no longer, whether it was begun or not."""


class Bar:
    """A line of the width of the console: words, and before them a bar in what room they leave."""

    def __init__(self, told: Told):
        self._told = told

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Segment]:
        words, room = self._told.line(short=True), options.max_width
        while len(words) > 1 and cell_len("  ".join(words)) > room:  # the last are the least important
            words.pop()
        text = "  ".join(words)[:room]
        width = min(room - cell_len(text) - 1, _BAR[1])
        if width >= _BAR[0]:
            bar = ProgressBar(1.0, self._told.fraction, width=width, pulse=self._told.compiling)
            drawn = list(console.render(bar, options.update_width(width)))
            yield from drawn
            text = (
                f"{' ' * (width - Segment.get_line_length(drawn))} {text}"  # without colors only what is done is drawn
            )
        yield Segment(text)
        yield Segment.line()

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        return Measurement(options.max_width, options.max_width)


class _OnTerminal(Screen):
    """A bar that moves by itself, and vanishes at the end."""

    def __init__(self, console: Console):
        self._console, self._live = console, None

    def start(self, told: Told) -> None:
        self._live = Live(Bar(told), console=self._console, transient=True, refresh_per_second=10)
        self._live.start(refresh=True)

    def stop(self) -> None:
        if self._live is not None:
            self._live.stop()


class _InNotebook(Screen):
    """A bar in the output of a notebook's cell, as text: rich's own is an invisible one without ipywidgets."""

    def __init__(self) -> None:
        self._handle: Any = None

    def start(self, told: Told) -> None:
        from IPython.display import DisplayHandle

        self._bar, self._handle = Bar(told), DisplayHandle()
        self._handle.display({"text/plain": ""}, raw=True)
        self.refresh()

    def refresh(self) -> None:
        page = io.StringIO()
        Console(file=page, force_jupyter=False, width=_NOTEBOOK_COLUMNS).print(self._bar)
        self._handle.update({"text/plain": page.getvalue()}, raw=True)

    def stop(self) -> None:
        if self._handle is not None:
            self._handle.update({"text/plain": ""}, raw=True)


class _InFile(Screen):
    """A line at every `EVERY` seconds, from a thread: also while a program is compiled, or steps take longer."""

    def __init__(self, file: Any):
        self._file, self._ended, self._thread = file, threading.Event(), None

    def start(self, told: Told) -> None:
        self._thread = threading.Thread(target=self._tell, args=(told, EVERY), name="jaxmps-progress", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._ended.set()
        if self._thread is not None:
            self._thread.join()

    def _tell(self, told: Told, every: float) -> None:
        while not self._ended.wait(every):
            with suppress(OSError, ValueError):  # a run does not end because nobody listens any more
                print(", ".join(told.line(short=False)), file=self._file, flush=True)
