"""How tests run: in several processes, without a skip but for listed reasons and programs."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support import forked
from support.allowed_skips import LIST, AllowedSkip, allowed_skips
from support.tools import PACKAGES, ROOT, missing, needed, node_module

TESTS = ROOT / "tests"
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
SKIPS = {
    "test_cases.py": """
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
""",
    "test_whole.py": "import pytest\npytest.importorskip('no_such_module')\ndef test_a(): pass\n",
    "pytest.ini": "[pytest]\npythonpath = .\n",
}


def run_of(
    folder: Path, files: dict[str, str], *words: str, ci: str = ""
) -> subprocess.CompletedProcess[str]:
    """A run of pytest on those files, in their folder."""
    for name, text in files.items():
        (folder / name).write_text(text)
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-q", *words],
        cwd=folder,
        env=os.environ | {"CI": ci},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


def test_each_test_is_run_once_and_a_process_that_dies_fails_what_it_ran(tmp_path: Path) -> None:
    shutil.copy(forked.__file__, tmp_path / "conftest.py")
    done = run_of(tmp_path, FILES, "--processes", "3")
    assert "2 failed, 43 passed, 1 error" in done.stdout, done.stdout + done.stderr
    for said in ("the process that ran it ended, 3", "assert 1 == 2", "said", "ZeroDivisionError"):
        assert said in done.stdout
    assert done.returncode == 1


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
    done = run_of(tmp_path, SKIPS, *workers, "--continue-on-collection-errors", ci=ci)
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
    for entry in allowed_skips():
        assert entry.why
        assert entry.says
        assert all((ROOT / pattern.removesuffix("*")).is_file() for pattern in entry.tests), entry


def test_a_missing_program_is_a_skip_that_names_debians_package(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """On a machine with nothing but Python."""
    monkeypatch.setattr(shutil, "which", lambda *_, **__: None)
    with pytest.raises(pytest.skip.Exception, match=r"mosquitto_sub .* mosquitto-clients$"):
        needed("mosquitto_sub")
    with pytest.raises(pytest.skip.Exception, match=r"no-such-package of npm .* npm$"):
        node_module("no-such-package")
    assert missing() == [*PACKAGES.values()]


def test_programs_are_looked_for_in_one_place_which_ci_installs() -> None:
    assert " tests/support/tools.py)" in (ROOT / ".ci" / "run").read_text()
    command = [sys.executable, "-I", "-S", TESTS / "support" / "tools.py"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.split() == missing()
    looks = {path for path in TESTS.rglob("*.py") if "shutil.which(" in path.read_text()}
    # Besides, the reader's own shell is looked for, and an engine of containers has to answer.
    own = (
        "support/tools.py",
        "support/printed_terminal.py",
        "test_packaging.py",
        Path(__file__).name,
    )
    assert looks == {TESTS / name for name in own}
