"""What lies in tests/golden is what its scripts make."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from support.given_files import GOLDEN


@pytest.mark.parametrize(
    ("script", "folder"),
    [
        ("make_reference.py", "reference"),
        ("make_flights.py", "flights"),
        ("make_recordings.py", "recordings"),
    ],
)
def test_golden_files_are_what_their_script_makes(script: str, folder: str, tmp_path: Path) -> None:
    subprocess.run([sys.executable, GOLDEN / script, tmp_path], check=True, timeout=300)
    made = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    here = {path.name: path.read_bytes() for path in (GOLDEN / folder).iterdir()}
    assert set(here) == set(made)
    assert [name for name, octets in made.items() if here[name] != octets] == []
