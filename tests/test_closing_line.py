"""The last line of `.ci/run` counts what failed beside others and passed alone."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support.closing_line import closing_line
from support.tools import ROOT

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


MAKE = """#!/bin/bash
for word in "$@"; do case $word in REPORT=*) report=${word#REPORT=} ;; esac; done
[ -n "$report" ] || exit 0
case "$*" in *last-failed*) code=$AGAIN ;; *) code=2 ;; esac
[ "$code" = 0 ] || what="<failure/>"
cat >"$report" <<END
<suite>
<testcase classname="tests.test_a" name="test_a"/>
<testcase classname="tests.test_a" name="test_b">$what</testcase>
</suite>
END
exit "$code"
"""


@pytest.mark.parametrize(
    ("again", "code", "says"),
    [
        ("0", 0, "1 passed, 1 failed beside others and passed alone: tests/test_a.py::test_b"),
        ("2", 1, "1 passed, 0 failed beside others and passed alone; 1 failed: "),
    ],
)
def test_ci_ends_with_that_line_and_fails_by_what_failed_twice(
    tmp_path: Path, again: str, code: int, says: str
) -> None:
    for name in (".ci/run", "tests/support/tools.py", "tests/support/closing_line.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    programs = tmp_path / "bin"
    programs.mkdir()
    for name, text in (("make", MAKE), ("id", "#!/bin/sh\necho 1000\n")):  # nobody who installs
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)
    path = os.pathsep.join([str(programs), os.environ["PATH"]])
    done = subprocess.run(
        ["/bin/bash", tmp_path / ".ci" / "run"],
        env=os.environ | {"PATH": path, "AGAIN": again},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (code, "")
    assert done.stdout.splitlines()[-1].startswith(says)
