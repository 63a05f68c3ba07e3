"""Problems of a scene name the line of the file and the sensor or drone by its id."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.scene.problems import key_lines
from plotfeed.feeds.scene.scene import SceneError, load

ROOT = Path(__file__).parents[3]
WRITTEN = sorted(
    path for room in ("feeds", "tests", "docs") for path in (ROOT / room).rglob("*.toml")
)
TEXT = scene_text(sensors=radar("west") + radar("east"), port=1883)
TRAPS = '''
a = 1                                   # [[b]] is a comment
"quoted key" = "[b]\\" # no comment"
'literal.key' = 'b = "'
long = """
[not-a-table]
x = 1 \\"""
""""
raw = \'\'\'
[[nor.this]]
\'\'\'
dotted.x . "y z" = { in = [1, { deep = 2 }], out = [] }
list = [
    # a comment, [ and ] in it
    [1, 2],
    { from = "]", to = """
}""" },
    1979-05-27T07:32:00Z,
]
[[sensor]]
id = "a"
[sensor.scan]
period_s = 1
[[sensor.event]]
set = { pfa = 1e-5 }
[[sensor.event]]
set.pfa = 2
[[sensor]]
[[sensor.event]]
last = true
'''


def paths(tree: Any, name: str = "") -> Iterator[tuple[str, str]]:
    """Every key of a tree in the words of problems, and its last part."""
    if isinstance(tree, dict):
        for key, below in tree.items():
            path = f"{name}.{key}" if name else key
            yield path, key
            yield from paths(below, path)
    elif isinstance(tree, list):
        for i, below in enumerate(tree):
            yield from paths(below, f"{name}[{i}]")


@pytest.mark.parametrize(
    "written", [TEXT, TRAPS, *WRITTEN], ids=["text", "traps", *map(str, WRITTEN)]
)
def test_every_key_is_found_in_a_line_that_has_it(written: str | Path) -> None:
    text = written if isinstance(written, str) else written.read_text()
    found, lines = key_lines(text), text.split("\n")
    for path, key in paths(tomllib.loads(text)):
        if path in found:
            assert key in lines[found[path] - 1], path
        else:
            assert any(other.startswith(f"{path}[0]") for other in found), path


def test_traps_have_the_lines_that_they_have() -> None:
    found, lines = key_lines(TRAPS), TRAPS.split("\n")
    for key, line in {
        "raw": "raw = '''",
        "list[0]": "    [1, 2],",
        "list[1].to": '    { from = "]", to = """',
        "list[2]": "    1979-05-27T07:32:00Z,",
        "sensor[0].event[1].set.pfa": "set.pfa = 2",
        "sensor[1].event[0].last": "last = true",
    }.items():
        assert lines[found[key] - 1] == line
    assert not {"b", "not-a-table", "nor"} & {key.partition(".")[0] for key in found}


@given(st.text(alphabet="ab=[]{}.,'\"\\#\n 1", max_size=40))
def test_a_text_that_is_not_toml_has_an_end(text: str) -> None:
    key_lines(text)
    assert key_lines("a = " + "[" * 20_000) == {}  # too deep


@pytest.mark.parametrize(
    ("right", "wrong", "line", "told"),
    [
        ("power_w =", "powr_w =", "powr_w = 500.0", "sensor[1].powr_w of 'east': no such key"),
        ("power_w = 500.0\n", "", 'id = "east"', "sensor[1].power_w of 'east': missing"),
        ("period_s = 0.5\n", "", "[sensor.scan]", "sensor[1].scan.period_s of 'east': missing"),
        ('id = "east"', 'id = "west"', 'id = "west"', "sensor[1].id: the id 'west' is used twice"),
        ("id = ", "sic = 1000\nid = ", "sic = 1000", "sensor[1].sic of 'east': input should be"),
    ],
)
def test_a_problem_names_the_line_and_the_sensor(
    right: str, wrong: str, line: str, told: str, tmp_path: Path
) -> None:
    begin, second, rest = TEXT.rpartition("[[sensor]]")
    assert right in rest
    text = begin + second + rest.replace(right, wrong)
    path = scene_file(tmp_path, text)
    with pytest.raises(SceneError) as caught:
        load(path)
    message, place = next(
        (each, int(each.split("line ")[1].split(":")[0]))
        for each in str(caught.value).split("\n")
        if told in each
    )
    lines = text.split("\n")
    at = lines[place - 1] if "missing" not in told or line.startswith("[") else lines[place]
    assert at == line, message


def test_a_byte_order_mark_is_no_mistake(tmp_path: Path) -> None:
    path = scene_file(tmp_path, "")
    path.write_bytes(b"\xef\xbb\xbf" + TEXT.encode())
    assert load(path).text == TEXT
