from __future__ import annotations

import json
from pathlib import Path

from support.command import running
from support.mqtt_websocket import browsing
from support.scene_files import radar, scene_file, scene_text

from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.codec.decode import decode_lenient

FAST = radar(period_s=0.2, sectors=8)


def test_a_browser_receives_what_other_subscribers_do(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text(sensors=FAST, mqtt='prefix = "north/site/7"'))
    wanted = {"asterix/048", "asterix/034", "plots", "status"}
    seen = {}
    with (
        running("run", scene) as session,
        browsing(session.port("WebSocket"), "north/site/7/#") as page,
    ):
        for message in page.published():
            kind = message.topic.removeprefix("north/site/7/radar/")
            seen[kind] = message
            if wanted <= seen.keys():
                break
    for category in (48, 34):
        records, errors = decode_lenient(seen[f"asterix/{category:03d}"].payload)
        assert not errors
        assert {record.category for record in records} == {category}
    assert pb.PlotBatch.FromString(seen["plots"].payload).sensor == "radar"
    assert json.loads(seen["status"].payload)["state"] == "ONLINE"


def test_a_page_that_comes_late_is_told_the_status(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text(sensors=FAST))
    with running("run", scene) as session:
        for _ in range(2):  # the first may come before the status
            with browsing(session.port("WebSocket"), "plotfeed/radar/status") as page:
                message = next(page.published())
    assert message.retained
    assert json.loads(message.payload)["state"] == "ONLINE"
