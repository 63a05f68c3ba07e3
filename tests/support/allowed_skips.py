"""Which tests may skip where nothing may be missing, by tests/allowed_skips.toml."""

from __future__ import annotations

import os
import tomllib
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

LIST = Path(__file__).parents[1] / "allowed_skips.toml"


@dataclass(frozen=True)
class AllowedSkip:
    """Tests whose names are like `tests` may skip for a reason that has `says` in it."""

    tests: str
    says: str
    why: str


def allowed_skips() -> list[AllowedSkip]:
    """What the list holds."""
    return [AllowedSkip(**entry) for entry in tomllib.loads(LIST.read_text())["skip"]]


def no_skip(report: Any, allowed: list[AllowedSkip]) -> None:
    """Make a failure of a test or file that skipped, unless it may; under CI=true alone."""
    if os.environ.get("CI") != "true" or not report.skipped or hasattr(report, "wasxfail"):
        return
    reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    if not any(fnmatch(report.nodeid, each.tests) and each.says in reason for each in allowed):
        report.outcome = "failed"
        report.longrepr = f"{reason}\nUnder CI=true no test skips but for a reason in {LIST.name}."
