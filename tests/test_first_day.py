"""The first day of somebody new: docs/tutorial.md, done as it is printed."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.doc_commands import DOCS
from support.printed_terminal import Saved, Typed, reader, steps


def test_the_tutorial_goes_as_it_is_printed(tmp_path: Path) -> None:
    page = (DOCS / "tutorial.md").read_text()
    told = steps(page)
    typed = [step.command for step in told if isinstance(step, Typed) and step.command != "^C"]
    assert typed == [line[2:] for line in page.splitlines() if line.startswith("$ ")]
    assert {step.name for step in told if isinstance(step, Saved)} == {
        "here.toml",
        "flight.csv",
        "tracker.py",
    }
    terminal = reader(tmp_path, DOCS.parent)
    try:
        for step in told:
            terminal.do(step)
    finally:
        terminal.close()


@pytest.mark.parametrize(
    ("lines", "printed", "same"),
    [
        (["drones 1  plots … late"], "drones 1  plots 20 late\n", True),
        (["drones 1  plots … late"], "drones 2  plots 20 late\n", False),
        (["first", "…", "last"], "first\n\n  more\nlast\n", True),
        (["first", "…", "last"], "first\nlast\n", True),
        (["first"], "first\nmore\n", False),
        (["first", "second"], "second\nfirst\n", False),
        ([], "anything\n", False),
    ],
)
def test_what_is_printed_is_compared_but_for_ellipses(
    lines: list[str], printed: str, *, same: bool
) -> None:
    assert Typed("any", lines).matches(printed) == same
