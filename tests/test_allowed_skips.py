"""Under CI=true a test that skips fails, unless the list says why it may."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support.allowed_skips import LIST, AllowedSkip, allowed_skips

TESTS = LIST.parent
CASES = """
import pytest

def test_without_a_reason():
    pytest.skip("because")

def test_of_a_network():
    pytest.skip("IPv6 is what this machine has")

@pytest.mark.skipif(True, reason="so it is")
def test_by_a_mark():
    pass

@pytest.mark.xfail(reason="known")
def test_that_is_expected_to_fail():
    assert False
"""
WHOLE_FILE = "import pytest\npytest.importorskip('no_such_module')\ndef test_a(): pass\n"


@pytest.mark.parametrize(
    ("ci", "workers", "counts"),
    [
        ("true", ("--processes", "1"), "2 failed, 1 xfailed, 2 errors"),
        ("true", (), "2 failed, 1 xfailed, 2 errors"),
        ("", (), "4 skipped, 1 xfailed"),
    ],
)
def test_a_skip_without_an_entry_fails_where_nothing_may_be_missing(
    tmp_path: Path, ci: str, workers: tuple[str, ...], counts: str
) -> None:
    (tmp_path / "support").mkdir()
    supported = (f"support/{name}.py" for name in ("allowed_skips", "forked", "given_files"))
    for name in ("conftest.py", LIST.name, *supported):
        shutil.copy(TESTS / name, tmp_path / name)
    (tmp_path / "test_cases.py").write_text(CASES)
    (tmp_path / "test_whole.py").write_text(WHOLE_FILE)
    (tmp_path / "pytest.ini").write_text("[pytest]\npythonpath = .\n")
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-q", *workers]
    done = subprocess.run(
        [*command, "--continue-on-collection-errors"],
        cwd=tmp_path,
        env=os.environ | {"CI": ci},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert counts in done.stdout, done.stdout + done.stderr
    assert bool(done.returncode) == bool(ci)


def test_an_entry_allows_one_thing_that_is_missing_to_the_tests_that_it_names() -> None:
    entry = AllowedSkip(["tests/test_a.py*"], "no IPv6", "it is so")
    for test, reason, may in (
        ("tests/test_a.py::test_of_it[6]", "Skipped: no IPv6", True),
        ("tests/test_a.py", "Skipped: no IPv6: [Errno 99]", True),
        ("tests/test_a.py::test_of_it", "Skipped: no IPv6 and no time", False),
        ("tests/test_a.py::test_of_it", "Skipped: there is no IPv6", False),
        ("tests/test_b.py::test_of_it", "Skipped: no IPv6", False),
    ):
        assert entry.allows(test, reason) is may, reason


def test_each_entry_of_the_list_names_tests_that_are_there() -> None:
    for entry in allowed_skips():
        assert entry.why
        assert entry.says
        for pattern in entry.tests:
            assert (TESTS.parent / pattern.removesuffix("*")).is_file(), entry
