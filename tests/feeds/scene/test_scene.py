from __future__ import annotations

import copy
import json
import re
import tempfile
import tomllib
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.cli.check import report
from plotfeed.feeds.scene.examples import MAX_LISTED, MAX_WORDS, head_of, summaries
from plotfeed.feeds.scene.scene import MAX_SCENE_OCTETS, Scene, SceneError, example, from_tree, load
from plotfeed.feeds.schema import text_of
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.proto.errors import PlotfeedError

TEXT = scene_text(start_utc="2026-01-01T12:00:00Z", port=1883)


def problems(folder: Path, text: str | bytes) -> list[str]:
    """The lines of the error, without the file's name, which each of them begins with."""
    path = folder / "scene.toml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    with pytest.raises(SceneError) as caught:
        load(path)
    lines = str(caught.value).split("\n")
    assert all(line.startswith(f"{path}: ") for line in lines)
    assert all(line.isprintable() for line in lines)
    found = [line.removeprefix(f"{path}: ") for line in lines]
    return [re.sub(r"^line [0-9]+: (.*?)( of '.*?')?: ", r"\1: ", line) for line in found]


MISTAKES = {
    "unknown key": (
        ("power_w = 500.0", "power_w = 500.0\npowr_w = 1.0"),
        "sensor[0].powr_w: no such key; did you mean power_w?",
    ),
    "unknown key of the scan": (
        ("period_s = 0.5", "period_s = 0.5\nsector = 8"),
        "sensor[0].scan.sector: no such key; did you mean sectors?",
    ),
    "key of another place": (
        ("period_s = 0.5", "period_s = 0.5\npower_w = 8.0"),
        "sensor[0].scan.power_w: no such key here",
    ),
    "unknown table": (("[mqtt]", "[zzz]\n[mqtt]"), "zzz: no such key"),
    "missing": (("power_w = 500.0", ""), "sensor[0].power_w: missing"),
    "missing in the scan": (("period_s = 0.5", ""), "sensor[0].scan.period_s: missing"),
    "missing table": (
        ("[scene.site]\nlatitude_deg = 40.45\nlongitude_deg = -3.73\nheight_m = 650.0\n", ""),
        "scene.site: missing",
    ),
    "missing kind": (('kind = "rotating"', ""), "sensor[0].scan.kind: missing"),
    "missing type": (('type = "active_radar"', ""), "sensor[0].type: missing"),
    "unknown kind": (
        ('kind = "rotating"', 'kind = "spinning"'),
        "sensor[0].scan.kind: expected one of 'rotating', 'staring', 'electronic', not 'spinning'",
    ),
    "text for a number": (
        ("power_w = 500.0", 'power_w = "500"'),
        "sensor[0].power_w: input should be a valid number, not '500'",
    ),
    "true for a number": (
        ("power_w = 500.0", "power_w = true"),
        "sensor[0].power_w: input should be a valid number, not True",
    ),
    "fraction for a whole number": (
        ("seed = 3", "seed = 3.0"),
        "scene.seed: input should be a valid integer, not 3.0",
    ),
    "number for a table": (
        ("[telemetry]\n", "[telemetryx]\n"),
        "telemetryx: no such key; did you mean telemetry?",
    ),
    "not finite": (
        ("power_w = 500.0", "power_w = nan"),
        "sensor[0].power_w: input should be a finite number, not nan",
    ),
    "infinite": (
        ("gain_tx_dbi = 30.0", "gain_tx_dbi = inf"),
        "sensor[0].gain_tx_dbi: input should be a finite number, not inf",
    ),
    "out of range": (
        ("period_s = 0.5", "period_s = -1.0"),
        "sensor[0].scan.period_s: input should be greater than or equal to 0.02, not -1.0",
    ),
    "beyond the integers": (
        ("seed = 3", "seed = 0x" + "f" * 5000),
        "scene.seed: input should be less than 9223372036854775808, not so large a number",
    ),
    "latitude": (
        ("latitude_deg = 40.45", "latitude_deg = 90.1"),
        "scene.site.latitude_deg: input should be less than or equal to 90, not 90.1",
    ),
    "start without a zone": (
        ("2026-01-01T12:00:00Z", "2026-01-01T12:00:00"),
        "scene.start_utc: write the zone too, such as 2026-01-01T12:00:00Z",
    ),
    "start in quotes": (
        ("2026-01-01T12:00:00Z", '"2026-01-01T12:00:00Z"'),
        "scene.start_utc: expected a time without quotes, such as 2026-01-01T12:00:00Z, not "
        "'2026-01-01T12:00:00Z'",
    ),
    "start that is a day": (
        ("2026-01-01T12:00:00Z", "2026-01-01"),
        "scene.start_utc: expected a time without quotes, such as 2026-01-01T12:00:00Z, not "
        "2026-01-01",
    ),
    "start before time": (
        ("2026-01-01T12:00:00Z", "1969-01-01T12:00:00Z"),
        "scene.start_utc: must be from 1971 to 2199",
    ),
    "start after time": (
        ("2026-01-01T12:00:00Z", "9999-01-01T12:00:00Z"),
        "scene.start_utc: must be from 1971 to 2199",
    ),
    "name with a slash": (
        ('id = "radar"', 'id = "a/b"'),
        "sensor[0].id: a name is 1 to 64 printable characters, without space, '/', '+' or '#'",
    ),
    "name of a topic": (
        ('id = "radar"', 'id = "truth"'),
        "sensor[0].id: the id 'truth' is a topic of the session",
    ),
    "half a place": (
        ("{ east_m = 1500.0, north_m", "{ north_m"),
        "drone[0].path[0]: a place has east_m, north_m and above_site_m, "
        "or latitude_deg, longitude_deg and height_m or, in a scene's file, height_msl_m",
    ),
    "no speed": (
        ("speed_m_s = 15.0", ""),
        "drone[0].speed_m_s: needed, unless every waypoint after the first has one",
    ),
    "wildcard in the prefix": (
        ("[mqtt]", '[mqtt]\nprefix = "a/+/b"'),
        r"mqtt.prefix: string should match pattern '^[^+#\s/]+(/[^+#\s/]+)*$', not 'a/+/b'",
    ),
    "blind everywhere": (
        ("range_max_m = 10_000.0", "range_max_m = 10.0\nrange_min_m = 20.0"),
        "sensor[0].range_min_m: must be less than range_max_m",
    ),
    "more false alarms than can be sent": (
        ("range_resolution_m = 30.0", "range_resolution_m = 0.01\ndoppler_cells = 100"),
        "sensor[0]: 8.1e+05 false alarms a scan; at most 100000 are taken",
    ),
    "a key of two lines": (("seed = 3", 'seed = 3\n"a\\nb" = 1'), "scene.a\\nb: no such key"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line_with_its_key_and_what_was_expected(
    mistake: str, tmp_path: Path
) -> None:
    (right, wrong), line = MISTAKES[mistake]
    assert right in TEXT
    assert problems(tmp_path, TEXT.replace(right, wrong)) == [line]


def test_every_mistake_is_told_at_once(tmp_path: Path) -> None:
    text = TEXT.replace("seed = 3", "seed = -3").replace("pfa = 1e-5", "pfa = 2.0")
    assert [line.partition(":")[0] for line in problems(tmp_path, text)] == [
        "scene.seed",
        "sensor[0].pfa",
    ]


def test_of_very_many_mistakes_some_are_told(tmp_path: Path) -> None:
    text = TEXT.replace("seed = 3", "\n".join(["seed = 3", *(f"k{i} = 1" for i in range(5000))]))
    assert 10 <= len(problems(tmp_path, text)) <= 50


def test_long_values_are_shown_in_part(tmp_path: Path) -> None:
    for key in ('type = "active_radar"', 'kind = "rotating"'):
        wrong = key.partition('"')[0] + '"' + "x" * 100_000 + '"'
        assert len(problems(tmp_path, TEXT.replace(key, wrong))[0]) < 300


def test_two_things_of_one_name_are_refused(tmp_path: Path) -> None:
    assert problems(tmp_path, TEXT + radar()) == ["sensor[1].id: the id 'radar' is used twice"]


def test_a_scene_without_sensors_is_refused(tmp_path: Path) -> None:
    general = TEXT.partition("[[sensor]]")[0]
    assert problems(tmp_path, general) == ["sensor: missing"]
    assert problems(tmp_path, "sensor = []\n" + general) == ["sensor: at least one is needed"]


def test_one_table_where_there_may_be_several_is_refused(tmp_path: Path) -> None:
    text = TEXT.replace("[[drone]]", "[drone]")
    assert problems(tmp_path, text) == ["drone: expected a list, not a table"]


def test_a_mistake_of_toml_is_told_with_its_line(tmp_path: Path) -> None:
    (line,) = problems(tmp_path, "[scene]\nname = test\n")
    assert line.startswith("not TOML: ")
    assert "line 2" in line


@pytest.mark.parametrize("text", [b"a = " + b"[" * 50_000, b"a = " + b"9" * 5000, b"a = 1\na = 2"])
def test_what_toml_cannot_be_is_one_line(text: bytes, tmp_path: Path) -> None:
    (line,) = problems(tmp_path, text)
    assert line.startswith("not TOML: ")


def test_octets_that_are_not_utf_8_are_told_with_their_place(tmp_path: Path) -> None:
    assert problems(tmp_path, b"abc\xff") == ["not UTF-8 at octet 3"]


def test_files_that_are_no_scene_are_refused_before_they_are_read_whole(tmp_path: Path) -> None:
    expected = [f"larger than {MAX_SCENE_OCTETS} octets: not a scene"]
    assert problems(tmp_path, b"#" * (MAX_SCENE_OCTETS + 1)) == expected
    with pytest.raises(SceneError, match="/dev/zero: larger than"):
        load("/dev/zero")


@pytest.mark.parametrize(
    ("name", "why"),
    [("absent.toml", "No such file"), ("", "Is a directory"), ("a\0b", "cannot be read")],
)
def test_files_that_cannot_be_read_are_named(tmp_path: Path, name: str, why: str) -> None:
    with pytest.raises(SceneError, match=why) as caught:
        load(tmp_path / name)
    assert str(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)


@given(st.data())
def test_a_damaged_scene_loads_or_says_why(data: st.DataObject) -> None:
    octets = bytearray(TEXT.encode())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(octets) - 1))
        octets[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        path.write_bytes(octets)
        try:
            assert isinstance(load(path), Scene)
        except SceneError as error:
            assert str(path) in str(error)


json_like = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=5,
)


def leaves(
    tree: Any, path: tuple[str | int, ...] = ()
) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    if isinstance(tree, dict | list):
        steps = tree.items() if isinstance(tree, dict) else enumerate(tree)
        for step, below in steps:
            yield from leaves(below, (*path, step))
    else:
        yield path, tree


def changed(tree: dict[str, Any], path: tuple[str | int, ...], value: Any) -> dict[str, Any]:
    tree = copy.deepcopy(tree)
    here: Any = tree
    for step in path[:-1]:
        here = here[step]
    here[path[-1]] = value
    return tree


EVERY_NUMBER = tomllib.loads(
    scene_text(
        start_utc="2026-01-01T12:00:00Z",
        port=1883,
        general="duration_s = 0.2",
        telemetry="""
            stale_after_s = 3.0
            takeoff_height_m = 0.0
            geoid_undulation_m = 0.0
            max_ahead_s = 2.0
            max_age_s = 60.0
            max_drones = 100
            rcs_m2 = 0.01
            sound_power_db = 80.0
        """,
        sensors=radar(
            period_s=0.05,
            sectors=4,
            more="""
                sac = 1
                sic = 2
                position_enu_m = [0.0, 0.0, 0.0]
                gain_rx_dbi = 30.0
                antenna_efficiency = 0.5
                loss_db = 4.0
                noise_figure_db = 5.0
                n_reference = 16
                range_min_m = 0.0
                receive_beams = 1
                azimuth_min_deg = -180.0
                azimuth_max_deg = 180.0
                doppler_cells = 1
                range_floor_m = 0.0
                azimuth_floor_deg = 0.0
                elevation_floor_deg = 0.0
            """,
        ),
    )
)
NUMBERS = [
    (path, value)
    for path, value in leaves(EVERY_NUMBER)
    if isinstance(value, int | float) and not isinstance(value, bool)
]


@given(st.sampled_from(list(leaves(EVERY_NUMBER))), json_like)
def test_any_value_at_any_key_is_taken_or_refused_in_lines(
    leaf: tuple[tuple[str | int, ...], Any], value: Any
) -> None:
    try:
        from_tree(changed(EVERY_NUMBER, leaf[0], value), Path("scene.toml"))
    except SceneError as error:
        assert all(line.startswith("scene.toml: ") for line in str(error).split("\n"))


@pytest.mark.parametrize(
    ("path", "usual"), NUMBERS, ids=[".".join(str(s) for s in path) for path, _ in NUMBERS]
)
@pytest.mark.asyncio
async def test_a_number_however_extreme_is_refused_or_runs(
    path: tuple[str | int, ...], usual: float
) -> None:
    for extreme in (0, 1e-300, 300, -300, 1e6, 1e9, 1e300):
        value: float = float(extreme)
        if isinstance(usual, int):
            value = int(extreme) if abs(extreme) <= 1e9 else 10**30
        try:
            scene = from_tree(changed(EVERY_NUMBER, path, value), Path("scene.toml"))
            report(scene)
            clock = InstantClock(scene.scene.start_utc_ns)
            await run(scene, clock=clock, broker="none", duration_s=0.1)
        except PlotfeedError as error:
            assert "\n" not in str(error)


def test_the_example_is_the_papers_scenario() -> None:
    scene = example("section-4")
    assert [s.id for s in scene.sensor] == ["active", "mimo", "passive", "microphone"]
    assert scene.scene.start_utc_ns is None


@pytest.fixture(scope="module")
def schema() -> jsonschema.Draft202012Validator:
    tree = json.loads(text_of("scene"))
    jsonschema.Draft202012Validator.check_schema(tree)
    return jsonschema.Draft202012Validator(tree)


def test_the_schema_is_valid_and_takes_the_example(schema: jsonschema.Draft202012Validator) -> None:
    text = files("plotfeed.feeds.scene.examples").joinpath("section-4.toml").read_text()
    schema.validate(tomllib.loads(text))


@pytest.mark.parametrize(
    "mistake",
    ["unknown key", "missing", "text for a number", "unknown kind", "out of range", "latitude"],
)
def test_the_schema_refuses_what_the_scene_refuses(
    mistake: str, schema: jsonschema.Draft202012Validator
) -> None:
    (right, wrong), _ = MISTAKES[mistake]
    tree = tomllib.loads(TEXT.replace("start_utc = 2026-01-01T12:00:00Z", ""))
    schema.validate(tree)
    tree = tomllib.loads(TEXT.replace("start_utc = 2026-01-01T12:00:00Z", "").replace(right, wrong))
    with pytest.raises(jsonschema.ValidationError):
        schema.validate(tree)


def test_every_key_of_the_schema_that_has_a_unit_says_it() -> None:
    schema = json.loads(text_of("scene"))
    chances = {"p", "r", "p13", "p14", "p23", "p31", "p32", "corrupt", "duplicate", "probability"}
    of_laws = {"correlation", "exponent", "reflection", "shape"}
    without_unit = {"pfa", "port", "turns", *of_laws, *chances}
    for table in (schema, *schema["$defs"].values()):
        for name, key in table.get("properties", {}).items():
            assert key.get("type") != "number" or "_" in name or name in without_unit, name


@pytest.mark.parametrize(
    ("text", "expected_ns"),
    [
        ("1971-01-01T00:00:00Z", 31_536_000 * 10**9),
        ("2026-01-01T12:00:00.123456Z", 1_767_268_800_123_456_000),
        ("2026-01-01T14:00:00.000001+02:00", 1_767_268_800_000_001_000),
        ("2199-12-31T23:59:59.999999Z", 7_258_118_399_999_999_000),
    ],
)
def test_the_start_is_exact_to_the_microsecond(text: str, expected_ns: int, tmp_path: Path) -> None:
    scene = load(scene_file(tmp_path, scene_text(start_utc=text)))
    assert scene.scene.start_utc_ns == expected_ns


@given(st.datetimes(datetime(1971, 1, 1), datetime(2199, 12, 31), timezones=st.just(UTC)))  # noqa: DTZ001
def test_no_microsecond_of_the_start_is_lost(start: datetime) -> None:
    tree = changed(EVERY_NUMBER, ("scene", "start_utc"), start)
    start_ns = from_tree(tree, Path("scene.toml")).scene.start_utc_ns
    assert start_ns is not None
    since = start - datetime(1970, 1, 1, tzinfo=UTC)
    assert start_ns % 1000 == 0
    assert start_ns // 1000 == (since.days * 86400 + since.seconds) * 10**6 + since.microseconds


def test_a_scene_cannot_be_changed(tmp_path: Path) -> None:
    scene = load(scene_file(tmp_path, TEXT))
    with pytest.raises(ValueError, match="frozen"):
        scene.scene.seed = 4


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


def test_the_head_says_what_there_is_to_see() -> None:
    head = head_of(HEAD)
    assert head.words == "A coast at night: two radars, and fog. Nobody sees much."
    assert head.summary == "A coast at night"
    assert head.look_for == ("The first radar is late.", "The second is not.")


def test_a_scene_need_not_say_anything() -> None:
    for text in ("", "[scene]\nname = 'x'\n", "#:schema s.json\n[scene]\n", "#\n#\n"):
        assert head_of(text) == ("", ())


def test_a_head_without_end_is_cut() -> None:
    words, look_for = head_of("# " + "x" * 1000 + "\n#\n# What to look for\n" + "# - y\n" * 100)
    assert len(words) == MAX_WORDS
    assert len(look_for) == MAX_LISTED


def test_every_shipped_scene_says_what_it_is() -> None:
    for name, summary in summaries().items():
        head = head_of(example(name).text)
        assert head.summary == summary != ""
        assert len(head.words) < MAX_WORDS
