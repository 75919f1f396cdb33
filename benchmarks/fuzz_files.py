"""Random case files: each must make a case of finite numbers, which runs ten steps if it is small, or be refused with a
line for each fault.

python -m benchmarks.fuzz_files --examples 2000 [--runs 20] [--seed 0]

A file is a template (the own geometry or a built-in case) of which some lines are changed, lost, doubled or torn.
"""

import argparse
import signal
import tempfile
import warnings
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from jaxmps import simulate
from jaxmps.casefile import CaseFileError, read, template
from jaxmps.stepping import largest_step

NAMES = ("tank", "dam_break", "hydrostatic", "standing_wave", "square_patch")
SECONDS = 60
_SMALL = 1200  # particles of a case that is run
_STEPS = 10
_ODD = ["nan", "inf", "-inf", "1e308", "-1e308", "-1", "0", "-0.0", "1e-308", "1e9", '""', '"junk"', "true", "[]", "{}"]
_ODD += ["[[]]", "[0.0]", "[0.0, 0.0]", "[[0.0, 0.0], [1.0, 1.0]]", "1979-05-27", "0x10", "½", "=", ""]


@st.composite
def case_files(draw: Any, names: Sequence[str]) -> str:
    """The text of a case file."""
    lines = [line for line in template(draw(st.sampled_from(names))).splitlines() if line.strip()]
    for _ in range(draw(st.integers(1, 3))):
        k = draw(st.integers(0, len(lines) - 1))
        key, sign, value = lines[k].partition("=")
        change = draw(st.sampled_from(["value"] * 6 + ["number"] * 4 + ["lost", "doubled", "key", "torn", "junk"]))
        if change == "value" and sign:
            lines[k] = f"{key}= {draw(st.sampled_from(_ODD))}"
        elif change == "number" and sign:
            lines[k] = f"{key}= {draw(st.one_of(st.floats(), st.integers(-(10**6), 10**6)))!r}"
        elif change == "lost":
            lines[k] = ""
        elif change == "doubled":
            lines.insert(k, lines[k])
        elif change == "key" and sign:
            lines[k] = f"{draw(st.text('abcdefg_.', min_size=1, max_size=6))} ={value}"
        elif change == "torn":
            lines[k] = lines[k][: draw(st.integers(0, len(lines[k])))]
        elif change == "junk":
            lines[k] = draw(st.text(max_size=20))
    return "\n".join(lines) + "\n"


class Reader:
    """Reads files and tells what is wrong; runs those of the first so many cases that are small."""

    def __init__(self, folder: Path, runs: int):
        self.path, self.runs, self.ends = folder / "case.toml", runs, Counter()

    def fault(self, text: str) -> str | None:
        """What is wrong with how this file was dealt with; None if nothing is."""
        self.path.write_text(text, encoding="utf-8")
        before = signal.signal(signal.SIGALRM, _too_long)
        signal.alarm(SECONDS)
        try:
            return self._fault()
        except Exception as error:  # whatever a user would see as a traceback
            return f"{type(error).__name__}: {error}"
        finally:
            signal.alarm(0)
            signal.signal(signal.SIGALRM, before)

    def _fault(self) -> str | None:
        try:
            setup = read(self.path)
        except CaseFileError as error:
            self.ends["refused"] += 1
            torn = [line for line in error.faults if "\n" in line or not line.startswith(str(self.path))]
            return f"not one line that names the file: {torn[0]!r}" if torn else None
        self.ends["made"] += 1
        particles = setup.case.particles
        if not all(np.isfinite(x).all() for x in (particles.position, particles.velocity, setup.case.gravity)):
            return "a case with numbers that are not finite"
        if self.runs > 0 and len(particles.kind) <= _SMALL:
            self.runs -= 1
            return self._run(setup)
        return None

    def _run(self, setup: Any) -> str | None:
        dt = min(float(largest_step(setup.case, setup.scheme, setup.case.particles)), 1e-3)
        if dt < 1e-12:
            return None
        self.ends["run"] += 1
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            run = simulate(setup.case, setup.scheme, until=_STEPS * dt, dt=dt, progress=False)
        broken = run.status.completed and not np.isfinite(run.position).all()
        return "a run that completed with numbers that are not finite" if broken else None


def _too_long(*_: Any) -> None:
    raise TimeoutError(f"more than {SECONDS} s")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--examples", type=int, default=2000)
    parser.add_argument("--runs", type=int, default=20, help="files that are run, for each is compiled")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    quiet = [HealthCheck.too_slow, HealthCheck.data_too_large]
    with tempfile.TemporaryDirectory() as folder:
        reader = Reader(Path(folder), options.runs)

        @seed(options.seed)
        @settings(
            max_examples=options.examples,
            deadline=None,
            database=None,
            suppress_health_check=quiet,
            phases=[Phase.generate, Phase.shrink],
        )
        @given(case_files(NAMES))
        def check(text: str) -> None:
            found = reader.fault(text)
            assert found is None, f"{found}\n{text}"

        check()
        print(", ".join(f"{count} {end}" for end, count in reader.ends.items()))


if __name__ == "__main__":
    main()
