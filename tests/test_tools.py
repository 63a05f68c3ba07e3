"""What tests drive beside the package: each program is looked for, and missed, in one place."""

from __future__ import annotations

import shutil
import subprocess
import sys

import pytest
from support.tools import PACKAGES, ROOT, missing, needed, node_module

# Where they are looked for, and where the reader's own shell is.
OWN_BUSINESS = {"tests/support/tools.py", "tests/support/printed_terminal.py"}


@pytest.fixture
def bare(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine with nothing but Python."""
    monkeypatch.setattr(shutil, "which", lambda *_, **__: None)


@pytest.mark.usefixtures("bare")
def test_a_missing_program_is_a_skip_that_names_debians_package() -> None:
    with pytest.raises(pytest.skip.Exception, match=r"mosquitto_sub .* mosquitto-clients$"):
        needed("mosquitto_sub")
    with pytest.raises(pytest.skip.Exception, match=r"no-such-package of npm .* npm$"):
        node_module("no-such-package")
    assert missing() == [*PACKAGES.values()]


def test_ci_installs_what_that_table_has() -> None:
    assert " tests/support/tools.py)" in (ROOT / ".ci" / "run").read_text()
    command = [sys.executable, "-I", "-S", ROOT / "tests" / "support" / "tools.py"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.split() == missing()


def test_no_other_file_looks_for_programs() -> None:
    docker = "tests/test_container.py"  # an engine has to answer, too
    found = {
        str(path.relative_to(ROOT))
        for path in (ROOT / "tests").rglob("*.py")
        if "shutil.which(" in path.read_text()
    }
    assert found - {"tests/test_tools.py"} == OWN_BUSINESS | {docker}
