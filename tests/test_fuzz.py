"""Random command lines and case files; `python -m benchmarks.fuzz` and `benchmarks.fuzz_files` try many more."""

import pytest
from hypothesis import HealthCheck, given, settings

from benchmarks.fuzz import Harness, command_lines
from benchmarks.fuzz_files import Reader, case_files


@pytest.fixture(scope="module")
def harness(tmp_path_factory: pytest.TempPathFactory) -> Harness:
    return Harness(tmp_path_factory.mktemp("fuzz"), kinds=1)


def test_any_command_line_ends_with_numbers_or_with_an_error_of_one_line(harness):
    @settings(
        max_examples=20, deadline=None, database=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
    )
    @given(command_lines(("dam_break",), ("mps",)))
    def check(line):
        assert harness.fault(line) is None

    harness.codes.clear()
    check()
    assert {0, 2} <= set(harness.codes), harness.codes


def test_the_harness_sees_a_traceback_a_hidden_fault_and_a_result_that_is_no_number(harness, monkeypatch):
    line = ["plot", "energy", "RUN", "--out", "OUT/a.png"]
    assert harness.fault(line) is None
    for code, err, words in (
        (1, "error: unexpected TypeError: no\n", "not foreseen"),
        (2, "error: a\nerror: b\n", "2 lines"),
        (0, "RuntimeWarning: overflow\n", "completed with"),
        (7, "", "exit code 7"),
    ):
        monkeypatch.setattr(harness, "call", lambda words, code=code, err=err: (code, "", err))
        assert words in (harness.fault(line) or "")
    monkeypatch.undo()
    assert "there is no run" in (harness._fault_of_run(0) or "")


def test_any_case_file_makes_a_case_or_is_refused_with_a_line_for_each_fault(tmp_path):
    reader = Reader(tmp_path, runs=1)

    @settings(
        max_examples=25, deadline=None, database=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
    )
    @given(case_files(("tank", "dam_break")))
    def check(text):
        assert reader.fault(text) is None

    check()
    assert {"made", "refused"} <= set(reader.ends), reader.ends
