from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.engine.sensor_description import description_of
from plotfeed.feeds.page.scene_outline import connections
from plotfeed.feeds.scene.scene import example, load

if TYPE_CHECKING:
    pass

URLS = {"MQTT": "mqtt://127.0.0.1:1884 (port 1884 is taken)"}
UDP = """
[[udp]]
destination = "239.255.0.1:8600"
interface = "lo"

[[udp]]
destination = "127.0.0.1:8601"
sensors = ["other"]
"""


def test_topics_are_those_that_the_sensors_describe() -> None:
    scene = example("field-day")
    told = connections(scene, URLS)
    assert told["brokers"] == [
        {"protocol": "MQTT", "url": "mqtt://127.0.0.1:1884", "needs_password": False}
    ]
    for sensor in scene.sensor:
        outputs = [o.topic for o in description_of(scene, scene.sea_level(), sensor).outputs]
        assert [t["topic"] for t in told["sensors"][sensor.id]["topics"]] == outputs != []
    assert "truth" not in json.dumps(told)
    assert "control" not in json.dumps(told)


def test_a_sensor_is_told_where_its_own_datagrams_go(tmp_path: Path) -> None:
    text = scene_text(sensors=radar("one") + radar("other")) + UDP
    scene = load(scene_file(tmp_path, text))
    told = connections(scene, URLS)["sensors"]
    assert [to["destination"] for to in told["one"]["udp"]] == ["239.255.0.1:8600"]
    assert [to["destination"] for to in told["other"]["udp"]] == [
        "239.255.0.1:8600",
        "127.0.0.1:8601",
    ]
    told = connections(scene, URLS, sends_udp=False)["sensors"]
    assert told["other"]["udp"] == []
