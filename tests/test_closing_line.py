"""The last line of `.ci/run` counts what failed beside others and passed alone."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from support.closing_line import closing_line

CASES = """
import os, pytest

alone = "ALONE" in os.environ

def test_that_passes(): pass

@pytest.mark.parametrize("what", ["a.b"])
def test_that_wants_the_machine(what): assert alone

@pytest.fixture
def left():
    yield
    assert alone

def test_that_tidies_up_alone(left): pass

def test_that_fails(): assert False

def test_that_skips(): pytest.skip("because")
"""


def test_the_last_line_names_what_passed_only_alone_and_what_failed(tmp_path: Path) -> None:
    first, again = tmp_path / "first.xml", tmp_path / "again.xml"
    assert closing_line(first, again) == "no tests ran"
    (tmp_path / "test_cases.py").write_text(CASES)
    command = [sys.executable, "-m", "pytest", "-q", "--rootdir", tmp_path]
    for report, more, environment in (
        (first, ["--numprocesses", "2"], {}),
        (again, ["--last-failed"], {"ALONE": "1"}),
    ):
        options = {"PYTEST_ADDOPTS": f"--junitxml={report}", "CI": ""}
        done = subprocess.run(
            [*command, *more],
            cwd=tmp_path,
            env=os.environ | options | environment,
            capture_output=True,
            check=False,
        )
        assert done.returncode == 1
        if report == first:
            assert closing_line(first, again).startswith(
                "1 passed, 1 skipped, 0 failed beside others and passed alone; 3 failed: "
            )
    assert closing_line(first, again) == (
        "1 passed, 1 skipped, 2 failed beside others and passed alone: "
        "test_cases.py::test_that_tidies_up_alone, test_cases.py::test_that_wants_the_machine[a.b]"
        "; 1 failed: test_cases.py::test_that_fails"
    )
