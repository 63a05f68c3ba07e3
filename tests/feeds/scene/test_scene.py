from __future__ import annotations

import copy
import json
import math
import re
import tomllib
from collections.abc import Iterator
from datetime import UTC, date, datetime, timedelta
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeAlias

import jsonschema
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from support import every_kind
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.cli.check import report
from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.scene.examples import MAX_LISTED, MAX_WORDS, head_of
from plotfeed.feeds.scene.problems import key_lines
from plotfeed.feeds.scene.scene import MAX_SCENE_OCTETS, General, SceneError, from_tree, load
from plotfeed.feeds.schema import text_of
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS

Schema: TypeAlias = jsonschema.Draft202012Validator


@pytest.fixture(scope="module")
def schema() -> Schema:
    """That of scenes, which takes seconds to make."""
    tree = json.loads(text_of("scene"))
    Schema.check_schema(tree)
    return Schema(tree)


TEXT = scene_text(start_utc="2026-01-01T12:00:00Z", port=1883)


def problems(folder: Path, text: str | bytes) -> list[str]:
    """The lines of the error, without the file's name, which each of them begins with."""
    path = folder / "scene.toml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    with pytest.raises(SceneError) as caught:
        load(path)
    lines = str(caught.value).split("\n")
    assert all(line.startswith(f"{path}: ") and line.isprintable() for line in lines)
    return [re.sub(r"^line [0-9]+: ", "", line.removeprefix(f"{path}: ")) for line in lines]


def changed(tree: dict[str, Any], key: str, value: Any) -> dict[str, Any]:
    """The tree with another value of a key such as drone[0].path[0].east_m; without it for None."""
    tree = copy.deepcopy(tree)
    *above, last = (int(n) if n else name for name, n in re.findall(r"([a-z]\w*)|\[(\d+)\]", key))
    here: Any = tree
    for step in above:
        here = here[step]
    if value is None:
        del here[last]
    else:
        here[last] = value
    return tree


TREE = tomllib.loads(TEXT)
A_PLACE = (
    "a place has east_m, north_m and above_site_m, or latitude_deg, longitude_deg and height_m or, "
    "in a scene's file, height_msl_m"
)
A_TIME = "expected a time without quotes, such as 2026-01-01T12:00:00Z, not "
A_NAME = "a name is 1 to 64 printable characters, without space, '/', '+' or '#'"
PREFIX = r"string should match pattern '^[^+#\s/]+(/[^+#\s/]+)*$', not 'a/+/b'"
NO_NUMBER = "input should be a valid number, not "
# A key, what stands there instead (None: nothing does), and what is said of it.
MISTAKES: list[tuple[str, Any, str]] = [
    ("sensor[0].powr_w", 1.0, "no such key; did you mean power_w?"),
    ("sensor[0].scan.sector", 8, "no such key; did you mean sectors?"),
    ("sensor[0].scan.power_w", 8.0, "no such key here"),
    ("zzz", {}, "no such key"),
    ("telemetryx", {}, "no such key; did you mean telemetry?"),
    ("sensor[0].power_w", None, "missing"),
    ("sensor[0].scan.period_s", None, "missing"),
    ("scene.site", None, "missing"),
    ("sensor[0].scan.kind", None, "missing"),
    ("sensor[0].type", None, "missing"),
    ("sensor[0].scan.kind", "spinning",
     "expected one of 'rotating', 'staring', 'electronic', not 'spinning'"),
    ("sensor[0].power_w", "500", f"{NO_NUMBER}'500'"),
    ("sensor[0].power_w", True, f"{NO_NUMBER}True"),
    ("scene.seed", 3.0, "input should be a valid integer, not 3.0"),
    ("drone", {}, "expected a list, not a table"),
    ("sensor[0].power_w", math.nan, "input should be a finite number, not nan"),
    ("sensor[0].gain_tx_dbi", math.inf, "input should be a finite number, not inf"),
    ("sensor[0].scan.period_s", -1.0, "input should be greater than or equal to 0.02, not -1.0"),
    ("scene.seed", 16**5000,
     "input should be less than 9223372036854775808, not so large a number"),
    ("scene.site.latitude_deg", 90.1, "input should be less than or equal to 90, not 90.1"),
    ("scene.start_utc", datetime(2026, 1, 1, 12),  # noqa: DTZ001
     "write the zone too, such as 2026-01-01T12:00:00Z"),
    ("scene.start_utc", "2026-01-01T12:00:00Z", f"{A_TIME}'2026-01-01T12:00:00Z'"),
    ("scene.start_utc", date(2026, 1, 1), f"{A_TIME}2026-01-01"),
    ("scene.start_utc", datetime(1969, 1, 1, tzinfo=UTC), "must be from 1971 to 2199"),
    ("scene.start_utc", datetime(9999, 1, 1, tzinfo=UTC), "must be from 1971 to 2199"),
    ("sensor[0].id", "a/b", A_NAME),
    ("sensor[0].id", "truth", "the id 'truth' is a topic of the session"),
    ("sensor", [*TREE["sensor"]] * 2, "the id 'radar' is used twice"),
    ("sensor", None, "missing"),
    ("sensor", [], "at least one is needed"),
    ("drone[0].path[0].east_m", None, A_PLACE),
    ("drone[0].speed_m_s", None, "needed, unless every waypoint after the first has one"),
    ("mqtt.prefix", "a/+/b", PREFIX),
    ("sensor[0].range_min_m", 20_000.0, "must be less than range_max_m"),
    ("sensor[0].doppler_cells", 300_000, "8.1e+05 false alarms a scan; at most 100000 are taken"),
]  # fmt: skip
# What is said of another key than that which was changed.
ELSEWHERE = {
    "the id 'radar' is used twice": "sensor[1].id",
    A_PLACE: "drone[0].path[0]",
    "8.1e+05 false alarms a scan; at most 100000 are taken": "sensor[0]",
}


@pytest.mark.parametrize(("key", "value", "says"), MISTAKES, ids=[m[0] for m in MISTAKES])
def test_a_mistake_is_one_problem_with_its_key_and_what_was_expected(
    key: str, value: Any, says: str
) -> None:
    with pytest.raises(SceneError) as caught:
        from_tree(changed(TREE, key, value), Path("scene.toml"))
    assert caught.value.problems == [(ELSEWHERE.get(says, key), says)]


def test_every_mistake_is_told_at_once_in_lines_of_which_some_are_enough(tmp_path: Path) -> None:
    text = TEXT.replace("seed = 3", "seed = -3").replace("pfa = 1e-5", "pfa = 2.0")
    keys = [line.partition(":")[0] for line in problems(tmp_path, text)]
    assert keys == ["scene.seed", "sensor[0].pfa of 'radar'"]
    many = "\n".join(["seed = 3", "a\\nb = 1", *(f"k{i} = 1" for i in range(5000))])
    told = problems(tmp_path, TEXT.replace("seed = 3", many.replace("a\\nb", '"a\\nb"')))
    assert 10 <= len(told) <= 50
    assert "scene.a\\nb: no such key" in told
    long = TEXT.replace('"active_radar"', f'"{"x" * 100_000}"')
    assert len(problems(tmp_path, long)[0]) < 300


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"[scene]\nname = test\n", "not TOML: .*line 2.*"),
        (b"a = " + b"[" * 50_000, "not TOML: .*"),
        (b"a = " + b"9" * 5000, "not TOML: .*"),
        (b"a = 1\na = 2", "not TOML: .*"),
        (b"abc\xff", "not UTF-8 at octet 3"),
        (b"#" * (MAX_SCENE_OCTETS + 1), f"larger than {MAX_SCENE_OCTETS} octets: not a scene"),
    ],
    ids=["text", "depth", "digits", "twice", "octets", "size"],
)
def test_what_is_no_scene_is_told_in_a_line(data: bytes, says: str, tmp_path: Path) -> None:
    (line,) = problems(tmp_path, data)
    assert re.fullmatch(says, line)


@pytest.mark.parametrize(
    ("path", "why"),
    [
        ("absent.toml", "absent.toml: No such file"),
        ("", "Is a directory"),
        ("a\0b", "cannot be read"),
        ("/dev/zero", "/dev/zero: larger than"),
    ],
)
def test_files_that_cannot_be_read_are_named(tmp_path: Path, path: str, why: str) -> None:
    with pytest.raises(SceneError, match=why) as caught:
        load(tmp_path / path)
    assert "\n" not in str(caught.value)


FLOORS = ("range_floor_m", "azimuth_floor_deg", "elevation_floor_deg")
json_like = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=5,
)


def walked(tree: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every key and every member of a list, by its path in the words of problems."""
    members = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for key, below in members:
        here = f"{path}.{key}".lstrip(".") if isinstance(tree, dict) else f"{path}[{key}]"
        yield here, below
        if isinstance(below, dict | list):
            yield from walked(below, here)


# Every key of a scene of one radar, what it leaves out among them.
EVERY_NUMBER = json.loads(
    from_tree(TREE, Path()).model_dump_json(
        include={"scene", "telemetry", "sensor", "drone"}, exclude_none=True
    )
)
EVERY_NUMBER["scene"] |= {"start_utc": TREE["scene"]["start_utc"], "duration_s": 0.2}
EVERY_NUMBER["sensor"][0] |= {"gain_rx_dbi": 30.0, **dict.fromkeys(FLOORS, 0.0)}
LEAVES = [(k, v) for k, v in walked(EVERY_NUMBER) if not isinstance(v, dict | list)]
NUMBERS = [(k, v) for k, v in LEAVES if isinstance(v, int | float) and not isinstance(v, bool)]


@settings(max_examples=30)
@given(st.sampled_from(LEAVES), json_like.filter(lambda value: value is not None))
def test_any_value_at_any_key_is_taken_or_refused_in_lines(
    leaf: tuple[str, Any], value: Any
) -> None:
    try:
        from_tree(changed(EVERY_NUMBER, leaf[0], value), Path("scene.toml"))
    except SceneError as error:
        assert all(line.startswith("scene.toml: ") for line in str(error).split("\n"))


@pytest.mark.parametrize(("key", "usual"), NUMBERS, ids=[key for key, _ in NUMBERS])
def test_a_number_however_extreme_is_refused_or_runs(key: str, usual: float) -> None:
    for extreme in (0, 1e-300, 300, -300, 1e6, 1e9, 1e300):
        value: float = float(extreme)
        if isinstance(usual, int):
            value = int(extreme) if abs(extreme) <= 1e9 else 10**30
        try:
            scene = from_tree(changed(EVERY_NUMBER, key, value), Path("scene.toml"))
            report(scene)
            engine = Engine(scene, START_NS)
            for _ in engine.until(START_NS + NS // 10):
                pass
        except PlotfeedError as error:
            assert "\n" not in str(error)


def test_the_schema_takes_what_the_scene_takes_and_refuses_what_it_refuses(schema: Schema) -> None:
    text = files("plotfeed.feeds.scene.examples").joinpath("section-4.toml").read_text()
    schema.validate(tomllib.loads(text))
    tree = changed(TREE, "scene.start_utc", None)
    schema.validate(tree)
    kinds = ("no such key", "missing", NO_NUMBER, "expected one of", "input should be greater")
    for key, value, says in MISTAKES:
        if says.startswith((*kinds, "input should be less than or")):
            assert not schema.is_valid(changed(tree, key, value)), key


GENERAL = {k: v for k, v in TREE["scene"].items() if k != "start_utc"}
NOWHERE = {"latitude_deg": 1.0, "longitude_deg": 2.0}
ABOVE, ABOVE_SEA = {"height_m": 1.0}, {"height_msl_m": 1.0}
DORUK = {"id": "a", "preset": "doruk"}


def illuminated(**keys: Any) -> dict[str, Any]:
    place = every_kind.PASSIVE["transmitters"][0]["place"]  # type: ignore[index]
    return every_kind.PASSIVE | {"transmitters": [{"id": "tv", "place": place, **keys}]}


@pytest.mark.parametrize(
    ("tables", "is_valid"),
    [
        ({"system": [{"id": "gate", "preset": "dronesentry"}]}, True),
        ({}, False),
        ({"sensor": [DORUK]}, True),
        ({"sensor": [DORUK | {"preset": "dorak"}]}, False),
        ({"sensor": [illuminated(preset="fm")]}, True),
        ({"sensor": [illuminated(erp_w=1.0)]}, False),
        *(
            ({"sensor": [DORUK], "scene": GENERAL | {"site": NOWHERE | heights}}, is_valid)
            for heights, is_valid in (
                (ABOVE, True), (ABOVE_SEA, True), ({}, False), (ABOVE | ABOVE_SEA, False)
            )
        ),
    ],
)  # fmt: skip
def test_the_schema_knows_what_stands_in_the_place_of_what(
    tables: dict[str, Any], is_valid: bool, schema: Schema
) -> None:
    assert schema.is_valid({"scene": GENERAL} | tables) == is_valid


def test_every_key_of_the_schema_says_its_unit_and_what_tells_kinds_apart(schema: Schema) -> None:
    chances = {"p", "r", "p13", "p14", "p23", "p31", "p32", "corrupt", "duplicate", "probability"}
    of_laws = {"correlation", "exponent", "reflection", "shape"}
    without_unit = {"pfa", "port", "turns", *of_laws, *chances}
    tree: Any = schema.schema
    for table in (tree, *tree["$defs"].values()):
        for name, key in table.get("properties", {}).items():
            assert key.get("type") != "number" or "_" in name or name in without_unit, name
            assert name not in {"kind", "type"} or key["description"], table["title"]


ZONES = st.timezones() | st.just(UTC)


@given(st.datetimes(datetime(1971, 1, 3), datetime(2199, 12, 29), timezones=ZONES))  # noqa: DTZ001
def test_no_microsecond_of_the_start_is_lost(start: datetime) -> None:
    general = General.model_validate(TREE["scene"] | {"start_utc": start})
    start_ns = general.start_utc_ns
    assert start_ns is not None
    since = start - datetime(1970, 1, 1, tzinfo=UTC)
    assert start_ns == since // timedelta(microseconds=1) * 1000
    with pytest.raises(ValueError, match="frozen"):
        general.seed = 4


HEAD = """#:schema scene.schema.json
# A coast at night: two radars,
# and fog. Nobody sees much.
#
# What to look for
# - The first radar
#   is late.
# - The second is not.
#
# The map is drawn by hand.

[scene]
# - not of the head
"""


def test_the_head_says_what_there_is_to_see_and_is_cut() -> None:
    head = head_of(HEAD)
    assert head.words == "A coast at night: two radars, and fog. Nobody sees much."
    assert head.summary == "A coast at night"
    assert head.look_for == ("The first radar is late.", "The second is not.")
    for text in ("", "[scene]\nname = 'x'\n", "#:schema s.json\n[scene]\n", "#\n#\n"):
        assert head_of(text) == ("", ())
    words, look_for = head_of("# " + "x" * 1000 + "\n#\n# What to look for\n" + "# - y\n" * 100)
    assert (len(words), len(look_for)) == (MAX_WORDS, MAX_LISTED)


# Problems name the line of the file and the sensor or drone by its id.

ROOT = Path(__file__).parents[3]
WRITTEN = sorted(
    path for room in ("feeds", "tests", "docs") for path in (ROOT / room).rglob("*.toml")
)
TWO_RADARS = scene_text(sensors=radar("west") + radar("east"), port=1883)
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


@pytest.mark.parametrize(
    "written", [TWO_RADARS, TRAPS, *WRITTEN], ids=["text", "traps", *map(str, WRITTEN)]
)
def test_every_key_is_found_in_a_line_that_has_it(written: str | Path) -> None:
    text = written if isinstance(written, str) else written.read_text()
    found, lines = key_lines(text), text.split("\n")
    for path, _ in walked(tomllib.loads(text)):
        key = path.rpartition(".")[2]
        if key.endswith("]"):
            continue  # a member of a list, which stands by itself or behind others
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
@example("a=[=")
def test_a_text_that_is_not_toml_has_an_end(text: str) -> None:
    key_lines(text)
    assert key_lines("a = " + "[" * 20_000) == {}  # too deep


@pytest.mark.parametrize(
    ("right", "wrong", "line", "told"),
    [
        ("power_w =", "powr_w =", "powr_w = 500.0", "sensor[1].powr_w of 'east': no such key"),
        ("power_w = 500.0\n", "", "[[sensor]]", "sensor[1].power_w of 'east': missing"),
        ("period_s = 0.5\n", "", "[sensor.scan]", "sensor[1].scan.period_s of 'east': missing"),
        ('id = "east"', 'id = "west"', 'id = "west"', "sensor[1].id: the id 'west' is used twice"),
        ("id = ", "sic = 1000\nid = ", "sic = 1000", "sensor[1].sic of 'east': input should be"),
    ],
)
def test_a_problem_names_the_line_and_the_sensor(
    right: str, wrong: str, line: str, told: str, tmp_path: Path
) -> None:
    begin, second, rest = TWO_RADARS.rpartition("[[sensor]]")
    assert right in rest
    text = begin + second + rest.replace(right, wrong)
    at = text.count("\n", 0, text.index(line, len(begin))) + 1
    with pytest.raises(SceneError) as caught:
        load(scene_file(tmp_path, text))
    assert f"line {at}: {told}" in str(caught.value)


def test_a_byte_order_mark_is_no_mistake(tmp_path: Path) -> None:
    path = scene_file(tmp_path, "")
    path.write_bytes(b"\xef\xbb\xbf" + TWO_RADARS.encode())
    assert load(path).text == TWO_RADARS
