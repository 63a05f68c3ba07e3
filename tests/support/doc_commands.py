"""Commands that write and draw pages of the documentation, to be asked what they would write."""

from __future__ import annotations

import runpy
from functools import cache
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).parents[2] / "docs"
COMMANDS = DOCS / "commands"


@cache
def doc_command(name: str) -> dict[str, Any]:
    """What a command defines, by name; they import from each other, as scripts of one folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(COMMANDS))
        return runpy.run_path(str(COMMANDS / f"{name}.py"))
