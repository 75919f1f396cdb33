"""Progress bars of runs (time, Δt, speed, simulated seconds per wall second) and of tuning, with the expected end."""

import io
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)


class Meter:
    """Shows how far a run has come; one that is not visible costs nothing."""

    def __init__(self, progress: Progress | None, until: float):
        self._progress, self._until = progress, until
        if progress is not None:
            self._task = progress.add_task("", total=until, t=0.0, dt=0.0, speed=0.0, rate=0.0)

    def update(self, time: float, dt: float, max_speed: float) -> None:
        """Time [s], the last Δt [s], the largest speed [m/s]."""
        if self._progress is None:
            return
        elapsed = self._progress.tasks[self._task].elapsed or 0.0
        rate = time / elapsed if elapsed > 0 else 0.0
        shown: dict[str, Any] = {"t": time, "dt": dt, "speed": max_speed, "rate": rate}
        self._progress.update(self._task, completed=time, **shown)


@contextmanager
def meter(until: float, visible: bool | None) -> Iterator[Meter]:
    """A `Meter` up to the time `until` [s]; by default visible on a terminal and in notebooks."""
    columns = [
        TextColumn("t {task.fields[t]:.3f} s of {task.total:g}"),
        TextColumn("Δt {task.fields[dt]:.2e} s"),
        TextColumn("u {task.fields[speed]:.2f} m/s"),
        TextColumn("{task.fields[rate]:.3g} s/s"),
    ]
    with _bar(columns, visible) as progress:
        yield Meter(progress, until)


@contextmanager
def tally(steps: int, visible: bool | None) -> Iterator[Callable[[int, float, float], None]]:
    """A function of the number of steps taken, the loss and the norm of its gradient, which shows them."""
    columns = [
        TextColumn("step {task.completed:g} of {task.total:g}"),
        TextColumn("loss {task.fields[loss]:.4g}"),
        TextColumn("|gradient| {task.fields[norm]:.3g}"),
    ]
    with _bar(columns, visible) as progress:
        if progress is None:
            yield lambda taken, loss, norm: None
            return
        task = progress.add_task("", total=steps, loss=float("nan"), norm=float("nan"))

        def show(taken: int, loss: float, norm: float) -> None:
            shown: dict[str, Any] = {"loss": loss, "norm": norm}
            progress.update(task, completed=taken, **shown)

        yield show


@contextmanager
def counter(total: int, visible: bool | None, what: str) -> Iterator[Callable[[int], None]]:
    """A function that counts so many more of `total` as done, and shows it."""
    with _bar([TextColumn(f"{{task.completed:g}} of {{task.total:g}} {what}")], visible) as progress:
        if progress is None:
            yield lambda more: None
            return
        task = progress.add_task("", total=total)
        yield lambda more: progress.update(task, advance=more)


@contextmanager
def _bar(columns: Sequence[ProgressColumn], visible: bool | None) -> Iterator[Progress | None]:
    """A bar with these columns and the time that is left; None if it is not visible."""
    notebook = Console().is_jupyter
    console = Console(file=io.StringIO(), force_jupyter=False) if notebook else Console(file=sys.stderr)
    if not (notebook or console.is_terminal if visible is None else visible):
        yield None
        return
    every = [BarColumn(24), *columns, TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn()]
    kind = _InNotebook if notebook else Progress
    with kind(*every, console=console, transient=True, auto_refresh=not notebook) as progress:
        yield progress


class _InNotebook(Progress):
    """A bar in the output of a notebook's cell; rich's own is an invisible one without ipywidgets."""

    def start(self) -> None:
        from IPython.display import DisplayHandle

        self._shown = DisplayHandle()
        self._shown.display({"text/plain": ""}, raw=True)

    def stop(self) -> None:
        self._shown.update({"text/plain": ""}, raw=True)

    def update(self, task_id: TaskID, **fields: Any) -> None:  # type: ignore[override]
        super().update(task_id, **fields)
        page = Console(file=io.StringIO(), force_jupyter=False, width=120)
        page.print(self.get_renderable())
        self._shown.update({"text/plain": page.file.getvalue()}, raw=True)  # type: ignore[attr-defined]
