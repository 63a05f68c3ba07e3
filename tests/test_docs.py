"""What of the documentation is written by commands is what they write."""

from __future__ import annotations

import asyncio
import json
import re
import subprocess
import sys
from dataclasses import fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from support.doc_commands import COMMANDS, DOCS, doc_command

from plotfeed.feeds.engine.simulation import SimulatedPlots
from plotfeed.feeds.schema import text_of

ROOT = DOCS.parent
PAGES = sorted([*DOCS.glob("*.md"), *ROOT.glob("*.md"), *(ROOT / "examples").glob("*.md")])
ROOMS = ("feeds", "models", "proto", "replay", "tests", "tools", "docs", "examples", "requirements")
# Columns of plots that few will ask for.
NOT_ON_THE_PAGE = {
    "channel",
    "run_length_deg",
    "sigma_range_rate_m_s",
    "true_range_rate_m_s",
    "merged_drones",
    "sensor",
}


@pytest.mark.parametrize(
    ("page", "command"),
    [
        ("messages.md", "write_messages"),
        ("presets.md", "write_presets"),
        ("scene.md", "write_scene_reference"),
    ],
)
def test_a_page_is_what_its_command_writes(page: str, command: str) -> None:
    assert (DOCS / page).read_text(encoding="utf-8") == doc_command(command)["page"](), (
        f"run python docs/commands/{command}.py"
    )


def test_every_command_that_a_page_names_is_there() -> None:
    named = set()
    for page in (*DOCS.glob("*.md"), DOCS.parent / "CONTRIBUTING.md", DOCS.parent / "Makefile"):
        named |= set(re.findall(r"docs/commands/(\w+\.py)", page.read_text()))
    assert len(named) > 5
    assert {name for name in named if not (COMMANDS / name).exists()} == set()


def test_every_command_finds_what_it_imports() -> None:
    missing = set() if find_spec("playwright") else {"draw_page"}
    names = sorted({path.stem for path in COMMANDS.glob("*.py")} - missing)
    command = [sys.executable, "-c", f"import {', '.join(names)}"]
    subprocess.run(command, cwd=COMMANDS, check=True)


def anchors(page: Path) -> set[str]:
    """Of the headings of a page, as GitHub and the site make them."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    heads = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    bare = [re.sub(r"[^\w\s-]", "", head).strip().lower().replace(" ", "-") for head in heads]
    return {
        f"{name}-{n}" if n else name for i, name in enumerate(bare) for n in [bare[:i].count(name)]
    }


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_link_of_a_page_leads_to_a_file_and_heading(page: Path) -> None:
    for target, anchor in re.findall(r"\]\(([^)#\s]*)(?:#([^)\s]*))?\)", page.read_text()):
        there = (page.parent / target).resolve() if target else page
        assert there.is_relative_to(ROOT), f"{target} is outside a clone"
        assert there.exists(), f"{target} is not there"
        assert not anchor or anchor in anchors(there), f"{target} has no #{anchor}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_path_that_a_page_names_is_in_a_clone(page: Path) -> None:
    named = re.findall(rf"`((?:{'|'.join(ROOMS)})/[\w./*-]*)`", page.read_text())
    assert [path for path in named if not list(ROOT.glob(path.rstrip("/")))] == []


def test_the_index_names_every_page_once() -> None:
    named = re.findall(r"\]\(([\w./-]+\.md)\)", (DOCS / "README.md").read_text())
    there = {page.name for page in DOCS.glob("*.md")} - {"README.md"}
    assert sorted(name for name in named if not name.startswith("../")) == sorted(there)


def test_the_scene_page_tells_each_key_of_a_sensor_once_and_its_contents_lead_to_it() -> None:
    parts = (DOCS / "scene.md").read_text().split("\n## ")
    rows = {
        part.split("\n")[0]: [
            key
            for line in re.findall(
                r"^- (?:(?:As in \[.*?\]\(#.*?\)|Below): (?=.*\.$))?(.*)", part, re.MULTILINE
            )
            for key in re.findall(r"`(\w+)`", line.split(": ")[0])
        ]
        for part in parts
    }
    common = rows["`[[sensor]]` of every type"]
    assert {"id", "position_enu_m", "link"} <= set(common)
    definitions = json.loads(text_of("scene"))["$defs"].values()
    sensors = [table for table in definitions if "scan" in table.get("properties", {})]
    assert len(sensors) >= 6
    for table in sensors:
        own = rows[f"`[[sensor]]` of type `{table['properties']['type']['const']}`"]
        assert sorted([*common, *own, "type"]) == sorted(table["propertyNames"]["enum"])
    contents = re.findall(r"\]\(#([\w-]+)\)", parts[0])
    titles = [title for title in list(rows)[1:] if "." not in title]
    assert contents == [re.sub(r"[^\w -]", "", title).replace(" ", "-").lower() for title in titles]


@pytest.mark.asyncio
async def test_the_examples_in_python_do_what_their_page_says(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for code in re.findall(r"```python\n(.*?)```", (DOCS / "engine.md").read_text(), re.DOTALL):
        exec(compile(code, "docs/engine.md", "exec"), {})  # noqa: S102 - our own page
    assert "plotfeed/active/asterix/048" in capsys.readouterr().out
    for code in re.findall(r"```python\n(.*?)```", (DOCS / "testing.md").read_text(), re.DOTALL):
        await asyncio.to_thread(exec, compile(code, "docs/testing.md", "exec"), {})
    assert re.search(
        r"(\d+) plots, 20 of the drone, .*\n\d+ octets on tracks/mine", capsys.readouterr().out
    )
    page = (DOCS / "python.md").read_text()
    names: dict[str, Any] = {}
    for code in re.findall(r"```python\n(.*?)```", page, re.DOTALL):
        exec(compile(code, "docs/python.md", "exec"), names)  # noqa: S102 - our own page
    counted = re.search(r"(\d+) of (\d+) looks; expected ([\d.]+)", capsys.readouterr().out)
    assert counted
    hits, looks, expected = map(float, counted.groups())
    assert looks == 60
    assert abs(hits - expected) < 5
    scene = DOCS.parent / "feeds" / "scene" / "examples" / "section-4.toml"
    n_plots, octets = await names["ten_seconds"](scene)
    assert 0 < n_plots < octets
    cells = re.findall(r"^\| (`[^|]*`) \| [^|]* \|$", page, re.MULTILINE)
    told = {name for cell in cells for name in re.findall(r"`(\w+)`", cell)}
    assert told == {f.name for f in fields(SimulatedPlots)} - NOT_ON_THE_PAGE


def test_every_aim_is_told_in_the_same_words() -> None:
    text = (ROOT / "docs" / "benchmarks.md").read_text()
    aims = [line for line in text.splitlines() if re.search(r"\baims?\b", line, re.IGNORECASE)]
    assert len(aims) > 15
    for line in aims:
        assert re.fullmatch(r"- Aim: .+, .+: (met|\*\*missed\*\*), .*\d.*\.", line), line
