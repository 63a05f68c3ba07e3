"""Tests in several processes: each is run once, and what becomes of it is told."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

from support import forked

FILES = {
    "test_a.py": """
import os
def test_one(): pass
def test_dies(): os._exit(3)
def test_after(): pass
""",
    "test_b.py": """
import pytest
@pytest.mark.parametrize("n", range(40))
def test_many(n): pass
""",
    "test_c.py": """
def test_fails():
    print("said")
    assert 1 == 2
""",
    "test_d.py": """
import pytest
@pytest.fixture(scope="session")
def late():
    yield
    1 / 0
def test_of_it(late): pass
""",
}


def test_each_test_is_run_once_and_a_process_that_dies_fails_what_it_ran(tmp_path: Path) -> None:
    shutil.copy(forked.__file__, tmp_path / "conftest.py")
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-q", "--processes"]
    done = subprocess.run(
        [*command, "3"], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120
    )
    assert "2 failed, 43 passed, 1 error" in done.stdout, done.stdout + done.stderr
    for said in ("the process that ran it ended, 3", "assert 1 == 2", "said", "ZeroDivisionError"):
        assert said in done.stdout
    assert done.returncode == 1
