"""Kills runs with SIGKILL at random instants, resumes them, and compares what they become with a run left alone.

python -m benchmarks.kills [--kills 200] [--seed 0] [--folder DIR] [--json FILE] [-- OPTIONS OF jaxmps run]

Each run is `jaxmps run`, then `jaxmps resume` after each kill, as processes of their own; one that comes to its end is
compared and the next begins. Of ten kills one comes at any time since the process began, imports and the repair of the
file included, four while it takes steps, two while it writes a checkpoint (its partial file is there), and three just
after the file of the run has changed, amid the writing of a frame as a rule. The last run is left to end. All datasets
of the file and all counts of the summary must be the same to the last bit; if not, the exit code is 1. 200 kills take
about 20 minutes.
"""

import argparse
import json
import os
import random
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import h5py
import numpy as np

OPTIONS = shlex.split(
    "dam_break --scheme mps_hs_gc_ds --spacing 0.1 --set alpha=0.02 --until 2 --save-every 0.004 "
    "--checkpoint-every 0.006"
)
KINDS = {"any time": 1, "steps": 4, "checkpoint": 2, "frame": 3}
STARTING, STEPPING = 8.0, 1.2
"""Seconds from the start of a process, and from its first checkpoint, within which it is killed."""
WITHIN_WRITE = 0.006
"""Seconds after the beginning of a write within which the process is killed."""
NOT_COMPARED = {"wall_seconds", "particle_steps_per_second"}


class Failure(RuntimeError):
    """A run that could not be resumed, or became another one."""


class Victim:
    """A run in a folder that is started, killed and resumed; `jaxmps` is the command line of a process."""

    def __init__(self, folder: Path, options: Sequence[str], counts: Counter[str], random: random.Random):
        self.folder, self.counts, self.random = folder, counts, random
        self.file, self.checkpoint = folder / "run.vtkhdf", folder / "run.vtkhdf.checkpoint"
        self.partial = folder / "run.vtkhdf.checkpoint.partial"
        self.resumable = False
        self._begin = ("run", *options, "--out", str(folder), "--force")

    def next(self, kind: str | None) -> bool:
        """Starts or resumes it and kills it, for which there are four kinds, or lets it end; whether it has ended."""
        before = changed_at(self.checkpoint)
        process = start("resume", str(self.folder)) if self.resumable else start(*self._begin)
        self.counts["resumed"] += self.resumable
        if kind is not None:
            self._wait(kind, process, lambda: changed_at(self.checkpoint) != before)
            process.kill()
        _, said = process.communicate()
        self.resumable = self.resumable or self.checkpoint.exists()
        if process.returncode == 0:
            return True
        if process.returncode != -9:
            raise Failure(f"{self.folder} ended with {process.returncode}: {said.decode()}")
        self.counts["killed"] += 1
        self.counts[f"killed: {kind}"] += 1
        self.counts["killed with a checkpoint half written"] += self.partial.exists()
        self.counts["killed after the last step"] += self.resumable and not self.checkpoint.exists()
        self.counts["killed with a file that cannot be read"] += self.file.exists() and not readable(self.file)
        return False

    def _wait(self, kind: str, process: subprocess.Popen[bytes], stepping: Callable[[], bool]) -> None:
        def until(happened: Callable[[], bool], every: float = 2e-4) -> None:
            while process.poll() is None and not happened():
                time.sleep(every)

        if kind == "any time" and self.resumable:
            return until(after(self.random.uniform(0.0, STARTING)), 0.01)
        until(stepping, 0.005)
        until(after(self.random.uniform(0.0, STEPPING)), 0.001)
        if kind == "checkpoint":
            until(self.partial.exists, 0.0)
        elif kind == "frame":
            then = changed_at(self.file)
            until(lambda: changed_at(self.file) != then, 0.0)
        if kind in ("checkpoint", "frame"):
            until(after(self.random.uniform(0.0, WITHIN_WRITE)), 0.0)


def after(seconds: float) -> Callable[[], bool]:
    """Whether they have passed."""
    end = time.perf_counter() + seconds
    return lambda: time.perf_counter() >= end


def changed_at(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except FileNotFoundError:
        return 0


def readable(path: Path) -> bool:
    try:
        return bool(datasets(path))
    except (OSError, RuntimeError, KeyError):
        return False


def datasets(path: Path) -> dict[str, np.ndarray]:
    found = {}
    with h5py.File(path, "r", locking=False) as file:
        file.visititems(lambda name, item: found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
        found["frames"] = np.asarray(file["VTKHDF/Steps"].attrs["NSteps"])
    return found


def start(*arguments: str) -> subprocess.Popen[bytes]:
    code = "import sys; from jaxmps.command_line.main import main; sys.exit(main())"
    command = [sys.executable, "-c", code, *arguments]
    # Programs that compile in a moment are kept, too: there are many of them.
    environment = {**os.environ, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=environment)


def compare(folder: Path, alone: Path) -> None:
    """`Failure` that tells in what the two runs differ."""
    ours, theirs = (datasets(x / "run.vtkhdf") for x in (folder, alone))
    differ = [name for name in {**ours, **theirs} if not same(ours.get(name), theirs.get(name))]
    first, second = (json.loads((x / "summary.json").read_text()) for x in (folder, alone))
    differ += [name for name in first if name not in NOT_COMPARED and first[name] != second[name]]
    if differ:
        raise Failure(f"{folder} is not {alone}: {', '.join(differ)}")


def same(a: np.ndarray | None, b: np.ndarray | None) -> bool:
    """To the last bit."""
    if a is None or b is None or (a.dtype, a.shape) != (b.dtype, b.shape):
        return False
    return a.tolist() == b.tolist() if a.dtype == object else a.tobytes() == b.tobytes()  # strings are pointers


def harass(folder: Path, kills: int, seed: int, options: Sequence[str] = OPTIONS, log: bool = False) -> Counter[str]:
    """So many kills of runs in `folder`; what happened, by its name. Raises `Failure`."""
    counts, dice = Counter({"compared": 0}), random.Random(seed)
    alone = folder / "alone"
    process = start("run", *options, "--out", str(alone))
    _, said = process.communicate()
    if process.returncode:
        raise Failure(f"the run left alone ended with {process.returncode}: {said.decode()}")
    began = time.perf_counter()
    while True:
        victim = Victim(folder / f"run{counts['compared']}", options, counts, dice)
        ended = False
        while not ended:
            kind = dice.choices(list(KINDS), list(KINDS.values()))[0] if counts["killed"] < kills else None
            ended = victim.next(kind)
            if log and counts["killed"] % 10 == 0 and not ended:
                print(f"{time.perf_counter() - began:6.0f} s  {dict(counts)}", flush=True)
        compare(victim.folder, alone)
        shutil.rmtree(victim.folder)
        counts["compared"] += 1
        if counts["killed"] >= kills:
            return counts


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0, help="of the instants")
    parser.add_argument("--folder", type=Path, help="for the runs; else a temporary one")
    parser.add_argument("--json", type=Path, help="file for the counts")
    parser.add_argument("options", nargs="*", default=list(OPTIONS), help="arguments of `jaxmps run`")
    chosen = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="jaxmps-kills-") as made:
        os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(made) / "compiled"))
        began = time.perf_counter()
        try:
            counts = harass(chosen.folder or Path(made), chosen.kills, chosen.seed, chosen.options, log=True)
        except Failure as failure:
            print(f"error: {failure}", file=sys.stderr)
            return 1
    found = {**counts, "minutes": round((time.perf_counter() - began) / 60.0, 1)}
    print(json.dumps(found, indent=2))
    if chosen.json:
        chosen.json.write_text(json.dumps(found, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
