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
    """Tests whose names are like one of `tests` may skip for `says`, before a colon or alone."""

    tests: list[str]
    says: str
    why: str

    def allows(self, test: str, reason: str) -> bool:
        """Whether that test may skip, for the one thing that is missing."""
        missing = reason.removeprefix("Skipped: ")
        told = missing == self.says or missing.startswith(f"{self.says}: ")
        return told and any(fnmatch(test, pattern) for pattern in self.tests)


def allowed_skips() -> list[AllowedSkip]:
    """What the list holds."""
    return [AllowedSkip(**entry) for entry in tomllib.loads(LIST.read_text())["skip"]]


def no_skip(report: Any, allowed: list[AllowedSkip]) -> None:
    """Make a failure of a test or file that skipped, unless it may; under CI=true alone."""
    if os.environ.get("CI") != "true" or not report.skipped or hasattr(report, "wasxfail"):
        return
    reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    if not any(each.allows(report.nodeid, reason) for each in allowed):
        report.outcome = "failed"
        report.longrepr = f"{reason}\nUnder CI=true no test skips but for a reason in {LIST.name}."
