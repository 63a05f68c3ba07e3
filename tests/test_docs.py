"""What of the documentation is written by commands is what they write."""

from __future__ import annotations

import re
import runpy
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from plotfeed.feeds.schema.published import text_of
from plotfeed.feeds.sensing.simulation import SimulatedPlots

DOCS = Path(__file__).parents[1] / "docs"
NOT_ON_THE_PAGE = {
    "channel",
    "run_length_deg",
    "sigma_range_rate_m_s",
    "true_range_rate_m_s",
    "merged_drones",
}
"""Columns of plots that few will ask for."""


def test_the_page_of_messages_is_what_its_script_writes() -> None:
    written = runpy.run_path(str(DOCS / "write_messages.py"))["page"]()
    assert (DOCS / "messages.md").read_text() == written, "run python docs/write_messages.py"


def test_every_link_between_pages_leads_somewhere() -> None:
    for page in (*DOCS.glob("*.md"), DOCS.parent / "README.md", DOCS.parent / "CONTRIBUTING.md"):
        for part in page.read_text().split("](")[1:]:
            target = part.partition(")")[0].partition("#")[0]
            if target and "://" not in target:
                assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_schema_beside_the_scenes_is_that_of_the_code() -> None:
    beside = DOCS.parent / "feeds" / "scene" / "examples" / "scene.schema.json"
    assert beside.read_text() == f"{text_of('scene')}\n", "run make pictures"


def test_the_examples_in_python_do_what_their_page_says(
    capsys: pytest.CaptureFixture[str],
) -> None:
    page = (DOCS / "python.md").read_text()
    names: dict[str, Any] = {}
    for code in re.findall(r"```python\n(.*?)```", page, re.DOTALL):
        exec(compile(code, "docs/python.md", "exec"), names)  # noqa: S102 - our own page
    counted = re.search(r"(\d+) of (\d+) looks; expected ([\d.]+)", capsys.readouterr().out)
    assert counted
    hits, looks, expected = map(float, counted.groups())
    assert looks == 60
    assert abs(hits - expected) < 5
    cells = re.findall(r"^\| (`[^|]*`) \| [^|]* \|$", page, re.MULTILINE)
    told = {name for cell in cells for name in re.findall(r"`(\w+)`", cell)}
    assert told == {f.name for f in fields(SimulatedPlots)} - NOT_ON_THE_PAGE
