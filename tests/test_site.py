"""The site of the documentation, as `make docs` builds it."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import pytest
from support.doc_commands import DOCS

ROOT = DOCS.parent
MKDOCS = ROOT / ".venv-docs" / "bin" / "mkdocs"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built into a folder of its own; any link that leads nowhere ends it."""
    if not MKDOCS.exists():
        pytest.skip("mkdocs is not installed: make .venv-docs/.ready")
    folder = tmp_path_factory.mktemp("site")
    command = [MKDOCS, "build", "--strict", "--site-dir", folder, "--config-file", "mkdocs.yml"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


def test_every_page_is_in_it_and_its_headings_are_found(site: Path) -> None:
    pages = {page.stem for page in DOCS.glob("*.md")} - {"README"}
    assert {*pages, "index", "CONTRIBUTING", "CHANGELOG"} <= {
        page.stem for page in site.glob("*.html")
    }
    found = json.loads((site / "search" / "search_index.json").read_text())["docs"]
    assert {"Plots on the Earth", "Changes", "Examples"} <= {entry["title"] for entry in found}


def test_nothing_that_it_loads_is_elsewhere(site: Path) -> None:
    loads = re.compile(
        r"<(?:script|img|link|iframe)[^>]*(?:src|href)=[\"']?((?:https?:)?//[^\"' >]*)"
    )
    for page in site.rglob("*.html"):
        assert loads.findall(page.read_text()) == [], page.name
    for sheet in site.rglob("*.css"):
        assert re.findall(r"(?:url\(|@import )[\"']?(?:https?:)?//", sheet.read_text()) == [], sheet
