"""What of the documentation is written by commands is what they write."""

from __future__ import annotations

import runpy
from pathlib import Path

from plotfeed.feeds.schema.published import text_of

DOCS = Path(__file__).parents[1] / "docs"


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
