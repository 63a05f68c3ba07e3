"""`plotfeed fleet status` where a broker keeps what no fleet has said."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.brokers import free_port, mosquitto
from support.command import plotfeed_here
from support.mqtt_client import listening
from support.scene_files import scene_file, scene_text

FLEET = {
    "scene": "test",
    "state": "RUNNING",
    "began_utc": "2026-01-01T12:00:00Z",
    "takeovers": 0,
    "parts": [
        {
            "part": name,
            "sensors": ["north"],
            "sends": True,
            "worker": "host:7",
            "epoch": 1,
            "sent_until_utc": "2026-01-01T12:00:00Z",
        }
        for name in ("0", "1")
    ],
    "gaps": [],
}
STATUS = {"state": "RUNNING", "plots": 12_345, "missed_scans": 0, "lateness_p99_us": 200.0}


@pytest.mark.parametrize(
    ("retained", "lines", "code"),
    [
        ({"": {}}, ["plotfeed/fleet is left out", "no fleet says on plotfeed/fleet"], 1),
        ({"": "rubbish"}, ["plotfeed/fleet is left out", "no fleet says on plotfeed/fleet"], 1),
        ({"": {**FLEET, "parts": [{}]}}, ["parts[0].part", "no fleet says"], 1),
        ({"": {**FLEET, "gaps": 3}}, ["gaps", "no fleet says"], 1),
        ({"": FLEET, "/0": STATUS, "/1": [1]}, ["plotfeed/fleet/1 is left out"], 0),
        ({"": FLEET, "/0": STATUS, "/1": {"plots": "x"}}, ["fleet/1 is left out"], 0),
    ],
)
def test_what_a_broker_keeps_that_no_fleet_said_is_told_of_and_the_rest_is_shown(
    tmp_path: Path, retained: dict[str, object], lines: list[str], code: int
) -> None:
    port = free_port()
    scene = scene_file(tmp_path, scene_text())
    with mosquitto(tmp_path, port), listening(port, 5, "plotfeed/#") as client:
        for level, told in sorted(retained.items(), reverse=True):
            client.publish(f"plotfeed/fleet{level}", json.dumps(told).encode(), retain=True)
        client.wait_for(lambda m: m.topic == "plotfeed/fleet")
        done = plotfeed_here("fleet", "status", scene, "--broker", f"mqtt://127.0.0.1:{port}")
    assert done.returncode == code, done.stderr
    assert len(done.stderr.splitlines()) == len(lines), done.stderr
    for line, words in zip(done.stderr.splitlines(), lines, strict=True):
        assert words in line
    if not code:
        assert "12345" in done.stdout
        assert "\n1 " in done.stdout
