"""The last line of `.ci/run`: how many tests passed, which only by themselves, and which never.

Its arguments are pytest's reports as JUnit XML, of all tests and of those that failed, once more; a
report that is not there is of a run that never began.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from pathlib import Path
from xml.etree import ElementTree as ET


def results(report: Path) -> dict[str, str]:
    """What became of each test: passed, failed or skipped."""
    parts = defaultdict(set)
    if report.exists():
        for case in ET.parse(report).iter("testcase"):  # noqa: S314 - pytest wrote it
            name = f"{case.get('classname', '').replace('.', '/')}.py::{case.get('name')}"
            parts[name] |= {part.tag for part in case}
    return {
        name: "failed" if tags & {"failure", "error"} else "skipped" * ("skipped" in tags)
        for name, tags in parts.items()
    }


def closing_line(first: Path, again: Path) -> str:
    """In words."""
    beside, alone = results(first), results(again)
    if not beside:
        return "no tests ran"
    failed = sorted(name for name, result in beside.items() if result == "failed")
    held = [name for name in failed if alone.get(name, "failed") != "failed"]
    twice = [name for name in failed if name not in held]
    counts = [f"{sum(not result for result in beside.values())} passed"]
    if skipped := sum(result == "skipped" for result in beside.values()):
        counts.append(f"{skipped} skipped")
    line = ", ".join([*counts, f"{len(held)} failed beside others and passed alone"])
    line += f": {', '.join(held)}" * bool(held)
    return line + f"; {len(twice)} failed: {', '.join(twice)}" * bool(twice)


if __name__ == "__main__":
    print(closing_line(*map(Path, sys.argv[1:3])))
