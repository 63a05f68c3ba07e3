"""Writes docs/stability.md: where plain forms fail, by how much, and what ours do there.

python docs/commands/write_stability.py
"""

from __future__ import annotations

import re
from pathlib import Path

from pages import table
from stability_case import Case, in_words
from stability_chances import DETECTION
from stability_effects import EFFECTS, LINKS
from stability_joint import JOINT
from stability_places import BISTATIC, FRAMES
from stability_sensors import CLUTTER, SENSORS
from stability_times import TIMES

PAGE = Path(__file__).parents[1] / "stability.md"
TESTS = Path(__file__).parents[2] / "tests"
INTRODUCTION = """# Where plain forms fail

Written by `python docs/commands/write_stability.py` (`make pictures` runs it), which computes
both forms, and their errors against sixty digits of mpmath. Errors are relative where they have
no unit; what begins with "under" is rounding alone, and "no number" is a NaN or an infinity. Each
row is held by the test that its last column names.
"""
HEAD = ("where", "plain form", "its error", "ours", "its error", "test")
GROUPS = (
    ("Bistatic geometry and propagation", BISTATIC),
    ("Several stations", JOINT),
    ("Frames and angles", FRAMES),
    ("Detection", DETECTION),
    ("Times, scans and chance", TIMES),
    ("False alarms, and effects that a scene may name", (*EFFECTS, *CLUTTER)),
    ("Antennas, arrays, classifiers, steered beams and cameras", SENSORS),
    ("Links", LINKS),
)
PICTURES = {
    "Bistatic geometry and propagation": """
![Relative error of the bistatic range beside the baseline](stability-baseline.png)

A metre off the baseline the plain sum has lost half of its digits, and a tenth of a millimetre off
all of them, wherever between the two; ours has the same digits everywhere
(`python docs/commands/draw_stability.py`).
""",
    "Detection": """
![Errors on the way to four limits](stability-limits.png)

The closer to the limit, the more digits the plain form has lost. Ours keep theirs; next to the
vertical, what is left is the rounding of an elevation of nearly 90°. Dots at the foot: no error.
""",
}


def cases() -> list[tuple[str, list[Case]]]:
    """All rows, by the headings that they stand under; raises if a row's test is not there."""
    groups = [(title, [row() for row in rows]) for title, rows in GROUPS]
    for _, rows in groups:
        for case in rows:
            if not test_is_there(case.test):
                raise SystemExit(f"docs/stability: there is no test {case.test}")
    return groups


def test_is_there(name: str) -> bool:
    """Whether tests/ has that file and that function."""
    path, _, function = name.partition("::")
    file = TESTS / path
    return file.exists() and bool(re.search(rf"^def {function}\(", file.read_text(), re.MULTILINE))


def row(case: Case) -> tuple[str, ...]:
    """Cells of a table."""
    path, _, function = case.test.partition("::")
    plain, ours = in_words(case.plain, case.unit), in_words(case.ours, case.unit)
    test = f"[{function}](../tests/{path})"
    return case.where, case.plain_form, plain, case.cure, ours, test


def page() -> str:
    """The whole page."""
    lines = [INTRODUCTION]
    for title, rows in cases():
        lines += [f"## {title}", "", *table(HEAD, map(row, rows)), PICTURES.get(title, "")]
    return "\n".join(lines).rstrip() + "\n"


if __name__ == "__main__":
    PAGE.write_text(page())
