"""The documentation: what commands write, links and paths, its site, and what it lists."""

from __future__ import annotations

import asyncio
import json
import math
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from support.doc_commands import COMMANDS, DOCS, doc_command
from support.random_scenes import random_tree

from plotfeed import testing
from plotfeed.feeds.engine.simulation import SimulatedPlots
from plotfeed.feeds.scene.examples import summaries
from plotfeed.feeds.scene.output_keys import WaysOut
from plotfeed.feeds.scene.scene import Scene, example, from_tree, load
from plotfeed.feeds.scene.sensors import SENSORS
from plotfeed.feeds.schema import text_of
from plotfeed.proto.asterix.codec.decode import decode

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
    for page in (*PAGES, ROOT / "Makefile"):
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
def test_links_of_a_page_lead_to_files_and_headings_and_its_paths_are_in_a_clone(
    page: Path,
) -> None:
    text = page.read_text()
    for target, anchor in re.findall(r"\]\(([^)#\s]*)(?:#([^)\s]*))?\)", text):
        there = (page.parent / target).resolve() if target else page
        assert there.is_relative_to(ROOT), f"{target} is outside a clone"
        assert there.exists(), f"{target} is not there"
        assert not anchor or anchor in anchors(there), f"{target} has no #{anchor}"
    named = re.findall(rf"`((?:{'|'.join(ROOMS)})/[\w./*-]*)`", text)
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
    scene = ROOT / "feeds" / "scene" / "examples" / "section-4.toml"
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


# The site, as `make docs` builds it.


def test_the_site_has_every_page_finds_their_headings_and_loads_nothing_from_elsewhere(
    tmp_path: Path,
) -> None:
    mkdocs = ROOT / ".venv-docs" / "bin" / "mkdocs"
    if not mkdocs.exists():
        pytest.skip("mkdocs is not installed: make .venv-docs/.ready")
    # Any link that leads nowhere ends it.
    command = [mkdocs, "build", "--strict", "--site-dir", tmp_path, "--config-file", "mkdocs.yml"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    pages = {page.stem for page in DOCS.glob("*.md")} - {"README"}
    assert {*pages, "index", "CONTRIBUTING", "CHANGELOG"} <= {
        page.stem for page in tmp_path.glob("*.html")
    }
    found = json.loads((tmp_path / "search" / "search_index.json").read_text())["docs"]
    assert {"Plots on the Earth", "Changes", "Examples"} <= {entry["title"] for entry in found}
    tag = r"<(?:script|img|link|iframe)[^>]*(?:src|href)=[\"']?((?:https?:)?//[^\"' >]*)"
    imported = r"(?:url\(|@import )[\"']?(?:https?:)?//"
    for kind, loads in (("html", tag), ("css", imported)):
        for file in tmp_path.rglob(f"*.{kind}"):
            assert re.findall(loads, file.read_text()) == [], file


# The page of places where plain forms fail, as its script writes it on any machine.

# Cells of a row that hold figures: of the plain form's error, or of an extreme. On another machine
# they are of the same order alone.
FIGURES = (3, 5)
SUPERSCRIPTS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def figure_of(words: str) -> float | None:
    """The number that the script wrote, without its unit; None where it wrote none."""
    first = words.removeprefix("under ").partition(" ")[0].removesuffix("°")
    power = re.fullmatch(r"(?:(\d)·)?10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)", first)
    if power is not None:
        return float(power[1] or 1) * 10.0 ** int(power[2].translate(SUPERSCRIPTS))
    return float(first) if re.fullmatch(r"[\d.]+", first) else None


def test_the_stability_page_is_what_its_script_writes_but_for_last_digits() -> None:
    stored, written = (
        [[cell.strip() for cell in line.split("|")] for line in page.splitlines()]
        for page in ((DOCS / "stability.md").read_text(), doc_command("write_stability")["page"]())
    )
    for old, new in zip(stored, written, strict=True):
        for k, (before, now) in enumerate(zip(old, new, strict=True)):
            was, found = (figure_of(cell) if k in FIGURES else None for cell in (before, now))
            if was is None or found is None or " looks" in before + now:
                assert now == before, "run python docs/commands/write_stability.py"
            elif was and found:
                assert 1 / 100 <= found / was <= 100, f"{old[1]}: {now}, was {before}"


def test_ours_is_better_than_the_plain_form_in_every_row() -> None:
    for where, form in doc_command("write_stability")["FORMS"].items():
        plain, ours = form()
        assert ours < plain / 1000 or math.isnan(plain), where


def test_every_row_of_the_stability_page_names_a_test_that_is_there() -> None:
    links = re.findall(
        r"\| \[(\w+)\]\(\.\./(tests/[\w/]+\.py)\) \|", (DOCS / "stability.md").read_text()
    )
    assert len(links) > 40
    for name, path in links:
        assert f"def {name}(" in (ROOT / path).read_text(), f"{path}::{name}"


@pytest.mark.parametrize(
    ("error", "unit", "words"),
    [
        (3.4e-6, "", "3·10⁻⁶"),
        (1e-6, "", "10⁻⁶"),
        (0.0, "", "under 10⁻¹⁴"),
        (2e-9, "m", "under 10⁻⁸ m"),
        (0.0, "m", "0 m"),
        (4.0e7, "m", "4·10⁷ m"),
        (1.0, "°", "1°"),
        (17.2, "", "20"),
        (float("nan"), "s", "no number"),
    ],
)
def test_a_figure_is_written_to_one_digit_and_read_again(
    error: float, unit: str, words: str
) -> None:
    assert doc_command("write_stability")["in_words"](error, unit) == words
    if not math.isnan(error) and not words.startswith("under"):
        assert figure_of(words) == pytest.approx(error, rel=0.5)


# The items of ASTERIX that sessions send are those that docs/topics.md lists, and no others.

# With numbers that a scene has agreed on with its receiver.
CLASSES = {
    "claims": ["drone", "bird"],
    "confusion": {"drone": [0.9, 0.1]},
    "otherwise": [0.5, 0.5],
    "codes": {"drone": 3, "bird": 4},
}


def scenes() -> Iterator[Scene]:
    """Shipped scenes, those of the examples, and random ones in every format that sensors have."""
    yield from map(example, summaries())
    yield from map(load, sorted((ROOT / "examples" / "scenes").glob("*.toml")))
    for seed in range(40):
        tree = random_tree(seed)
        for sensor in tree["sensor"]:
            sensor.pop("event", None)
            sensor.pop("link", None)
            fixed = "mount" in sensor or not sensor.get("measures_azimuth", True)
            if "type" in sensor and not fixed and sensor["scan"]["kind"] != "electronic":
                formats = SENSORS[sensor["type"]].formats
                found = [name for name in formats if name.startswith("asterix")]
                sensor["report"] = found or ["plots"]
            if sensor.get("type") == "active_radar":
                sensor["classifier"] = CLASSES
        known = ("scene", "telemetry", "sensor", "drone")
        yield from_tree({key: tree[key] for key in known}, Path("scene.toml"))


def listed() -> dict[int, set[str]]:
    """Items of each category in the table of docs/topics.md."""
    table = (DOCS / "topics.md").read_text().partition("## ASTERIX\n")[2]
    rows = re.findall(r"^\| (\d{3}) \| (.*) \|$", table.partition("\n## ")[0], re.MULTILINE)
    return {int(category): set(re.findall(r"\b\d{3}\b", items)) for category, items in rows}


def test_the_items_that_are_sent_are_those_that_are_listed() -> None:
    sent: defaultdict[int, set[str]] = defaultdict(set)
    for scene in scenes():
        for message in testing.fly(scene.sent_to(WaysOut()), 8.0).messages:
            if "/asterix/" in message.topic:
                for record in decode(message.payload):
                    sent[record.category] |= {item.partition("/")[2] for item in record.items}
    found = listed()
    assert {category: sorted(items) for category, items in sent.items()} == {
        category: sorted(items) for category, items in found.items()
    }
