"""Random command lines: each must come to its end, with results that are numbers, or with an error of a single line.

python -m benchmarks.fuzz --examples 2000

Runs are short and small: more particles than `MOST_PARTICLES`, and more kinds of runs to compile than allowed, count as
interrupted before the first step; what takes longer than `SECONDS` is interrupted as by Ctrl-C.
"""

import argparse
import contextlib
import faulthandler
import io
import json
import os
import shutil
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0")

import jax
import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from jaxmps import running
from jaxmps.casefile.arguments import arguments, case_factories, scheme_factories, values_of
from jaxmps.cases import lattice
from jaxmps.command_line import main
from jaxmps.io import read
from jaxmps.running import display

MOST_PARTICLES, SECONDS = 400, 60.0
_SPACING = {"dam_break": "0.125"}
_ODD = ["nan", "inf", "-inf", "1e308", "-1e308", "1e400", "-1", "0", "-0.0", "1e-308", "1e-12", "1e9", "", " ", "junk"]
_ODD += ["0x10", "1_0", "1,2", "true", "None", "½", "--", "=", "0.5.5", "9" * 400]


def _mostly(usual: list[str], odd: bool = True) -> st.SearchStrategy[str]:
    """One of the usual words, or, if it may be odd, as often a number or text of any kind."""
    anything = st.one_of(st.sampled_from(_ODD), st.floats().map(repr), st.integers().map(str), st.text(max_size=5))
    return st.one_of(st.sampled_from(usual), anything) if odd else st.sampled_from(usual)


@st.composite
def settings_of(draw: Any, case: str, scheme: str, odd: bool) -> list[str]:
    """Some `--set NAME=VALUE` with values near those that are there or, if they may be odd, far from them."""
    cases, schemes = case_factories(), scheme_factories()
    known: dict[str, Any] = {}
    if case in cases:
        known |= {name: p.default for name, p in arguments(cases[case]).items()}
    if scheme in schemes:
        known |= {name: p.default for name, p in arguments(schemes[scheme]).items()}
        known |= values_of(schemes[scheme]())
    words = []
    for _ in range(draw(st.integers(1, 3))):
        name = draw(st.sampled_from(sorted(known) or ["spacing"]))
        near = known.get(name)
        values = [near, 0.9 * near, 1.5 * near] if type(near) is float else [near]
        value = draw(_mostly([str(x).strip("[]").replace(" ", "") for x in values], odd))
        words += ["--set", draw(st.sampled_from([f"{name}={value}"] * 9 + [name, value])) if odd else f"{name}={value}"]
    return words


@st.composite
def command_lines(
    draw: Any,
    cases: tuple[str, ...] = ("dam_break", "standing_wave", "square_patch"),
    schemes: tuple[str, ...] = ("mps", "mps_cd_gc_ds"),
) -> list[str]:
    """A command and its options, few of them odd; `RUN` stands for the file of a run, `OUT` for a new directory."""
    if draw(st.integers(0, 4)) == 0:
        return draw(_readings())
    usual = {
        "case": list(cases),
        "--scheme": list(schemes),
        "--spacing": [],
        "--until": ["0.01", "0.02", "0.3"],
        "--save-every": ["0.01", "0.004", "1"],
        "--dt": ["0.005", "0.002", "0.1"],
        "--seed": ["0", "7"],
        "--jitter": ["0", "0.1"],
        "--precision": ["single", "double"],
        "--on-blowup": ["stop", "halve-dt"],
    }
    odd = draw(st.sets(st.sampled_from([*usual, "--set"]), max_size=2)) if draw(st.booleans()) else set()
    case = draw(_mostly(usual.pop("case"), "case" in odd))
    words, scheme = ["run", case, "--out", "OUT"], "mps"
    usual["--spacing"] = [_SPACING.get(case, "0.1")]
    for option, values in usual.items():
        if option in odd or option in ("--spacing", "--until", "--scheme") or draw(st.integers(0, 3)) == 0:
            words += [option, draw(_mostly(values, option in odd))]
            scheme = words[-1] if option == "--scheme" else scheme
    return words + (draw(settings_of(case, scheme, "--set" in odd)) if "--set" in odd or draw(st.booleans()) else [])


@st.composite
def _readings(draw: Any) -> list[str]:
    file = draw(st.sampled_from(["RUN", "RUN", "RUN", "nowhere", "OUT", ""]))
    command = draw(st.sampled_from(["show", "plot", "export", "export"]))
    if command == "plot":
        return ["plot", draw(_mostly(["energy", "front"])), file, "--out", "OUT/a.png"]
    words = [command, file, "--frame", draw(_mostly(["0", "-1", "1", "all"]))]
    if command == "show":
        return [*words, "--color", draw(_mostly(["pressure", "kind"])), "--out", "OUT/a.png"]
    form = draw(_mostly(["csv", "prof", "vtp"]))
    words += ["--to", form, "--out", f"OUT/a.{draw(st.sampled_from([form, form, 'txt']))}".replace("\0", "")]
    types = _mostly(["0=fluid,2=wall,3=dummy", "0=fluid", "0=fluid:1,a=b", "0=fluid:x"])
    return [*words, "--types", draw(types)] if draw(st.booleans()) else words


class Harness:
    """Calls command lines in a directory of their own and says what is wrong with what came of them."""

    def __init__(self, folder: Path, kinds: int):
        self.folder, self.most_kinds, self.kinds = folder, kinds, set()
        self.codes: Counter[int] = Counter()
        self.slowest = (0.0, [""])
        self._out, self._run = folder / "out", folder / "run"
        tiny = ["run", "dam_break", "--spacing", "0.125", "--until", "0.01", "--save-every", "0.005"]
        display.EVERY = 86_400.0  # lines of progress are not what is looked for
        code, _, err = self.call([*tiny, "--out", str(self._run)])
        if code != 0:
            raise RuntimeError(f"the run that others read has failed: {err}")

    def fault(self, line: list[str]) -> str | None:
        """What is wrong with the outcome of a command line, or None."""
        shutil.rmtree(self._out, ignore_errors=True)
        places = {"RUN": str(self._run), "OUT": str(self._out)}
        words = [places.get(word, word.replace("OUT/", f"{self._out}/")) for word in line]
        began = time.perf_counter()
        code, _, err = self.call(words)
        seconds = time.perf_counter() - began
        self.codes[code] += 1
        self.slowest = max(self.slowest, (seconds, line))
        told = err.splitlines()
        if seconds > 3.0 * SECONDS:
            return f"it took {seconds:.0f} s"
        if err.startswith("error: unexpected ") or "Traceback" in err:
            return f"it was not foreseen: {err}"
        if code not in (0, 1, 2, 130):
            return f"exit code {code}: {err}"
        if code != 0 and (len(told) != 1 or not told[0].startswith("error: ")):
            return f"exit code {code} with {len(told)} lines: {err}"
        if code == 0 and not all(text.startswith("warning: ") for text in told):
            return f"completed with {err}"
        return self._fault_of_run(code) if words[0] == "run" and code != 2 else None

    def _fault_of_run(self, code: int) -> str | None:
        file = self._out / "run.vtkhdf"
        if not file.exists():
            return None if code in (1, 130) else "there is no run"
        run = read(file)
        if code == 0:
            summary = json.loads((self._out / "summary.json").read_text())
            absent = [key for key, value in summary.items() if value is None and key != "closest_pair"]
            if absent or not run.status.completed:
                return f"it says completed with {absent} and {run.status}"
        for name in ("time", "position", "velocity", "pressure", "number_density", "energy"):
            if not np.isfinite(getattr(run, name)).all():
                return f"exit code {code} with {name} that is not finite"
        return None

    def call(self, words: list[str]) -> tuple[int, str, str]:
        """Exit code, stdout and stderr."""
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), self._limits():
            return main(words), out.getvalue(), err.getvalue()

    @contextlib.contextmanager
    def _limits(self) -> Iterator[None]:
        simulate, most, x64 = running.simulate, lattice._MOST_POINTS, jax.config.read("jax_enable_x64")
        here = Path.cwd()

        def small(case: Any, scheme: Any, **times: Any) -> Any:
            leaves, structure = jax.tree.flatten((case.undescribed(), scheme))
            kind = (str(structure), tuple(leaf.shape for leaf in leaves), str(leaves[0].dtype), times["dt"] is None)
            if len(case.particles.kind) > MOST_PARTICLES or (
                kind not in self.kinds and len(self.kinds) >= self.most_kinds
            ):
                raise KeyboardInterrupt
            self.kinds.add(kind)
            return simulate(case, scheme, **times)

        def interrupt(*_: Any) -> None:
            raise KeyboardInterrupt

        usual = signal.signal(signal.SIGALRM, interrupt)
        signal.setitimer(signal.ITIMER_REAL, SECONDS)
        running.simulate, lattice._MOST_POINTS = small, 50_000
        os.chdir(self.folder)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, usual)
            running.simulate, lattice._MOST_POINTS = simulate, most
            jax.config.update("jax_enable_x64", x64)
            os.chdir(here)


def main_fuzz(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--examples", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--kinds", type=int, default=20, help="of runs to compile")
    chosen = parser.parse_args(argv)
    end = time.monotonic() + 60.0 * chosen.minutes
    faults: dict[str, list[str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        jax.config.update("jax_compilation_cache_dir", f"{folder}/cache")
        harness = Harness(Path(folder), chosen.kinds)
        check = _collector(harness, faults, end)
        seed(chosen.seed)(
            settings(
                max_examples=chosen.examples,
                deadline=None,
                database=None,
                phases=[Phase.generate],
                suppress_health_check=[HealthCheck.too_slow],
            )(given(command_lines())(check))
        )()
    for fault, line in faults.items():
        print(f"{fault}\n    {line}")
    print(f"exit codes {dict(harness.codes)}, slowest {harness.slowest[0]:.1f} s: {harness.slowest[1]}")
    return 1 if faults else 0


def _collector(harness: Harness, faults: dict[str, list[str]], end: float) -> Callable[[list[str]], None]:
    def check(line: list[str]) -> None:
        if time.monotonic() > end:
            return
        faulthandler.dump_traceback_later(4.0 * SECONDS, exit=True)
        fault = harness.fault(line)
        if fault is not None:
            key = "".join(c for c in fault if not c.isdigit())[:70]
            if key not in {"".join(c for c in known if not c.isdigit())[:70] for known in faults}:
                print(f"FAULT {fault}\n    {line}", flush=True)
                faults[fault] = line
        faulthandler.cancel_dump_traceback_later()

    return check


if __name__ == "__main__":
    raise SystemExit(main_fuzz())
