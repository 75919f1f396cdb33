"""What `jaxmps check` says of a run's memory, against the run."""

import os
import subprocess
import sys

import pytest

from jaxmps import casefile
from jaxmps.casefile import RunTable, Setup
from jaxmps.casefile.arguments import build
from jaxmps.casefile.memory import memory

PEAK = """
import re, sys
from pathlib import Path
from jaxmps.command_line import main
code = main(sys.argv[1:])
print("peak", re.search(r"VmHWM:\\s+(\\d+) kB", Path("/proc/self/status").read_text())[1])
sys.exit(code)
"""
"""Not the peak of `resource`: that of a process begins with what the one had that started it."""


@pytest.mark.skipif(sys.platform != "linux", reason="the peak of the memory is read from /proc")
@pytest.mark.slow
def test_a_run_takes_the_memory_that_check_expects_to_a_factor_of_one_and_a_half(tmp_path):
    options = ["run", "dam_break", "--spacing", "0.04", "--until", "0.01", "--out", str(tmp_path), "--force"]
    expected = memory(Setup(*build("dam_break", "mps", 0.04, []), (), RunTable(until=0.01)))
    for said in (expected.first, expected.later):  # compiled, and found in the cache
        # As users have it: the suite's own flags make the compiler take less.
        environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
        environment["JAX_COMPILATION_CACHE_DIR"] = str(tmp_path / "cache")
        command = [sys.executable, "-c", PEAK, *options]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=600)
        assert done.returncode == 0, done.stderr
        taken = int(done.stdout.split()[-1]) * 1024 / 1e6
        assert said / 1.5 < taken < 1.5 * said, (said, taken)


def test_memory_grows_with_slots_and_with_frames_and_compiling_is_told_apart():
    def of(spacing: float, **times: float) -> Setup:
        return Setup(*build("dam_break", "mps", spacing, []), (), RunTable(**times))  # type: ignore[arg-type]

    brief, large = (of(spacing, until=0.1, save_every=0.1) for spacing in (0.1, 0.02))
    n, more = len(brief.case.particles.kind), len(large.case.particles.kind)
    # 27 numbers and 10 indices in each of 20 slots.
    assert memory(large).later - memory(brief).later == pytest.approx((more - n) * 20 * (27 * 8 + 10 * 4) / 1e6)
    many = of(0.02, until=10.0, save_every=0.001)
    assert memory(many).later > 10_000 * more * 66 / 1e6 > memory(large).later
    found = casefile.check(large).expected
    assert found["memory"] == "941 MB in the first run, 581 MB in later ones, which need not compile"
    assert "without compiling" in found["wall time"] and found["compiling"].startswith(
        "about 10 s before the first step"
    )
