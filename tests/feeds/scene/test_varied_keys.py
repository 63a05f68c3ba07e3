"""Keys that are varied: what a path names, what values are, and a line for what is wrong."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.scene.levels import levels_of, scene_of
from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.scene.varied_keys import VariedKey
from plotfeed.proto.errors import PlotfeedError

LOSS = 'loss = { kind = "random", probability = 0.1 }'
CAMERA = """
[[sensor]]
id = "look.out"
preset = "spexer-2000-3d-mkii"
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    sensors = radar("north", more=f"link = {{ latency_ms = 5.0, {LOSS} }}") + radar("south")
    return scene_file(tmp_path, scene_text(sensors=sensors + CAMERA))


def values(text: str) -> list[Any]:
    return [json.loads(value) for value in VariedKey.parse(f"key={text}").values]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1e-6,1e-5", [1e-6, 1e-5]),
        ("0:2000:500", [0, 500, 1000, 1500, 2000]),
        ("0:1:0.3", [0.0, 0.3, 0.6, 0.9]),
        ("0:0.7:0.1", [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]),
        ("10:0:-5", [10, 5, 0]),
        ("true, false", [True, False]),
        ("drop,stall", ["drop", "stall"]),
        ('"drop"', ["drop"]),
        ("[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]", [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]),
        ('{ kind = "random", probability = 0.1 }', [{"kind": "random", "probability": 0.1}]),
    ],
)
def test_values_are_as_in_a_scene_or_steps_with_both_ends(text: str, expected: list[Any]) -> None:
    found = values(text)
    assert found == expected
    assert list(map(type, found)) == list(map(type, expected))


def of(file: Path, path: str, value: str) -> Any:
    """The scene at the one level where that key has that value."""
    (level,) = levels_of([file], [VariedKey.parse(f"{path}={value}")])
    return scene_of(level)


def test_a_path_names_a_sensor_by_id_or_type_or_all_of_them(file: Path) -> None:
    north, south, other = of(file, "sensor.north.pfa", "1e-4").sensor
    assert (north.pfa, south.pfa) == (1e-4, 1e-5)
    before = load(file).sensor
    assert (south, other) == before[1:]
    assert {s.pfa for s in of(file, "sensor.active_radar.pfa", "1e-4").sensor} == {1e-4}
    for path in ("link.latency_ms", "sensor.*.link.latency_ms"):
        found = of(file, path, "250").sensor
        assert [s.link.latency_ms for s in found] == [250.0] * 3
        assert found[0].link.loss == before[0].link.loss
    assert of(file, "sensor.0.enabled", "false").sensor[0].enabled is False


def test_a_path_reaches_into_presets_lists_and_ids_with_dots(file: Path) -> None:
    before = load(file).sensor[2]
    found = of(file, "sensor.look.out.scan.period_s", "3.5").sensor[2]
    assert found.scan.period_s == 3.5
    assert found.scan.sectors == before.scan.sectors
    assert found.model_copy(update={"scan": before.scan}) == before
    assert of(file, "sensor.south.position_enu_m", "[1.0,2.0,3.0]").sensor[1].position_enu_m == (
        1.0, 2.0, 3.0,
    )  # fmt: skip
    assert of(file, "drone.visitor.path.0.above_site_m", "90").drone[0].path[0].above_site_m == 90
    assert of(file, "drone.visitor.rcs_m2", "0.5").drone[0].rcs_m2 == 0.5


def test_sensors_of_a_system_are_varied_as_others_are(tmp_path: Path) -> None:
    system = '[[system]]\nid = "gate"\npreset = "dronesentry"\n'
    file = scene_file(tmp_path, scene_text(sensors=system))
    before = {s.id: s for s in load(file).sensor}
    radars = [s for s in before.values() if s.id == "gate-radar"]
    found = {s.id: s for s in of(file, "sensor.gate-radar.range_max_m", "1234").sensor}
    assert found.keys() == before.keys()
    assert found["gate-radar"] == radars[0].model_copy(update={"range_max_m": 1234})
    turned = {s.id: s for s in of(file, "system.gate.position_enu_m", "[9.0, 0.0, 0.0]").sensor}
    assert {s.position_enu_m for s in turned.values()} == {(9.0, 0.0, 0.0)}


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("link.latency_ms", "--vary link.latency_ms: expected KEY=VALUES"),
        ("link.latency_ms=", "--vary link.latency_ms=: expected KEY=VALUES"),
        ("link.latency_ms=0:100:0", "expected three numbers as START:STOP:STEP, not 0:100:0"),
        ("link.latency_ms=0:x:1", "expected three numbers as START:STOP:STEP, not 0:x:1"),
        ("link.latency_ms=0:1e9:1", "has no values, or more than 1000"),
        ("link.latency_ms=5:0:1", "has no values, or more than 1000"),
        ("link.latency_ms=1,1", "a value is there twice"),
        ("link.latency_ms=1,,2", "is no value"),
        ("sensor.east.pfa=1e-5", "no sensor 'east': expected one of north, active_radar, south"),
        ("sensor.3.pfa=1e-5", "no sensor '3': expected one of north"),
        ("sensor.north=1", "a whole sensor; expected sensor.north.KEY"),
        ("scene=1", "a whole table; expected scene.KEY"),
        ("drone.nobody.rcs_m2=1", "no drone 'nobody': expected one of visitor"),
        ("swarm.nobody.count=1", "swarm"),
        ("pfaa=1", "no such key: expected one of"),
        ("sensor.north.pfaa=1", "sensor.north.pfaa: no such key; did you mean pfa?"),
        ("sensor.north.pfa=5", "sensor.north.pfa: "),
        ("sensor.north.pfa=high", "sensor.north.pfa: "),
        ("sensor.north.pfa.deep=1", "sensor.north.pfa is no table"),
        ("sensor.north.link.jitter_ms.x=1", "sensor.north.link.jitter_ms: "),
        ("sensor.north.position_enu_m.7=1", "sensor.north.position_enu_m: "),
        ("link.loss.probability=7", "sensor.north.link.loss.probability: "),
        ("system.gate.position_enu_m=[0.0,0.0,0.0]", "system"),
        ("scene.start_utc=2026-01-01", "a time cannot be varied"),
    ],
)
def test_what_is_wrong_is_one_line_that_says_what_there_is(
    file: Path, asked: str, said: str
) -> None:
    with pytest.raises(PlotfeedError) as refused:
        levels_of([file], [VariedKey.parse(asked)])
    told = str(refused.value)
    assert said in told
    assert told.startswith("--vary ")
    assert "\n" not in told


def test_levels_are_all_combinations_of_scenes_and_values(file: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.toml"
    other.write_text(file.read_text().replace('name = "test"', 'name = "second"'))
    keys = [VariedKey.parse("sensor.north.pfa=1e-6,1e-5"), VariedKey.parse("link.latency_ms=0:2:1")]
    levels = levels_of([file, other], keys)
    assert [level.number for level in levels] == list(range(12))
    assert [(level.scene, *level.values) for level in levels] == [
        (name, pfa, late)
        for name in ("test", "second")
        for pfa in (1e-6, 1e-5)
        for late in (0, 1, 2)
    ]
    with pytest.raises(PlotfeedError, match="a scene is there twice"):
        levels_of([file, file], [])
    with pytest.raises(PlotfeedError, match="a key is there twice"):
        levels_of([file], [keys[0], keys[0]])
