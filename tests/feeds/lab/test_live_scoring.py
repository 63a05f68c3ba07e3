"""A score over a broker: tracks that are published go in, and the score comes out every second."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
from support.command import running
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.schema.asyncapi import document
from plotfeed.replay.mcap import McapReader
from plotfeed.replay.recorded import Stage
from plotfeed.testing import MqttMessage, MqttReceiver

OWN = "plotfeed/radar/asterix/062"


def scene(folder: Path, *, truth: bool) -> Path:
    """One radar that turns twice a second, with tracks of its own, which are scored; one drone."""
    own = radar(more='report = ["plots", "asterix-062"]\ntracks = { kind = "plain" }')
    text = scene_text(sensors=own, mqtt=f"truth = {str(truth).lower()}")
    return scene_file(folder, text + f'[page]\ntracks_topic = "{OWN}"\n')


def test_a_score_is_published_as_it_is_described_and_own_tracks_are_recorded_once(
    tmp_path: Path,
) -> None:
    record = tmp_path / "own.mcap"
    with (
        running("run", scene(tmp_path, truth=True), "--record", record) as session,
        MqttReceiver(session.port("MQTT"), 5, "plotfeed/score") as client,
    ):
        found = client.wait_for(lambda message: bool(json.loads(message.payload)["tracks"]))
    told = json.loads(found.payload)
    described = document()["components"]["messages"]["score"]
    jsonschema.validate(told, described["payload"])
    jsonschema.validate(found.user_properties, described["headers"])
    assert (found.content_type, told["tracks_topic"]) == ("application/json", OWN)
    assert told["now"]["completeness"] == 1.0, told  # one drone, one track
    with McapReader(record) as log:
        stages = {message.stage for message in log.messages(topics={OWN})}
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
