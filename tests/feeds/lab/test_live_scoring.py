"""A score over a broker: what a tracker publishes goes in, and the score comes out every second."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
from support.command import running
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.schema.asyncapi import document
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.recorded import Stage
from plotfeed.testing import MqttMessage, MqttReceiver

TRACK = {"track": 7, "latitude_deg": 40.45, "longitude_deg": -3.73, "height_m": 700.0}
TRACKER = '[page]\ntracks_topic = "tracker/tracks"\n'


def scene(folder: Path, *, truth: bool) -> Path:
    """One radar that turns twice a second, one drone, and where a tracker publishes."""
    mqtt = f"truth = {str(truth).lower()}"
    return scene_file(folder, scene_text(mqtt=mqtt) + TRACKER)


def test_a_score_is_published_as_it_is_described(tmp_path: Path) -> None:
    with (
        running("run", scene(tmp_path, truth=True)) as session,
        MqttReceiver(session.port("MQTT"), 5, "plotfeed/score") as client,
    ):

        def has_a_track(message: MqttMessage) -> bool:
            """A score with the track, which is said again in case nobody listened before."""
            client.publish("tracker/tracks", json.dumps(TRACK).encode())
            return bool(json.loads(message.payload)["tracks"])

        found = client.wait_for(has_a_track)
    told = json.loads(found.payload)
    described = document()["components"]["messages"]["score"]
    jsonschema.validate(told, described["payload"])
    jsonschema.validate(found.user_properties, described["headers"])
    assert found.content_type == "application/json"
    assert told["tracks"] == 1
    assert told["reports"] >= 1


def test_a_sensors_own_tracker_is_scored_and_recorded_once(tmp_path: Path) -> None:
    topic = "plotfeed/radar/asterix/062"
    own = radar(more='report = ["plots", "asterix-062"]\ntracks = { kind = "plain" }')
    path = scene_file(tmp_path, scene_text(sensors=own) + f'[page]\ntracks_topic = "{topic}"\n')
    record = tmp_path / "own.mcap"
    with (
        running("run", path, "--record", record) as session,
        MqttReceiver(session.port("MQTT"), 5, "plotfeed/score") as client,
    ):
        found = client.wait_for(lambda message: bool(json.loads(message.payload)["tracks"]))
    told = json.loads(found.payload)
    assert told["tracks_topic"] == topic
    assert told["now"]["completeness"] == 1.0, told  # one drone, one track
    with McapReader(record) as log:
        stages = {message.stage for message in log.messages(topics={topic})}
    assert stages == {Stage.BEFORE, Stage.AFTER}  # as the sensor sent it, not as telemetry


def test_where_the_truth_is_not_published_the_score_is_not(tmp_path: Path) -> None:
    with (
        running("run", scene(tmp_path, truth=False)) as session,
        MqttReceiver(session.port("MQTT"), 5, "plotfeed/#") as client,
    ):
        scans: set[int] = set()

        def is_three_seconds_on(message: MqttMessage) -> bool:
            if message.topic.endswith("/plots"):
                scans.add(int(message.user_properties["scan"]))
            return len(scans) > 6  # two a second

        client.wait_for(is_three_seconds_on)
        assert not client.on("plotfeed/score")
