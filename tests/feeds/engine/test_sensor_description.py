"""What sensors say of themselves: enough to put what they report on the Earth."""

from __future__ import annotations

import asyncio
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf import json_format
from support.brokers import free_port, own_broker
from support.sessions import at_work, simulated

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.fields import frame_at, geodetic
from plotfeed.feeds.scene.scene import Scene, example
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.models.frames import enu_to_aer, geodetic_to_ecef, geoid_undulation_m, wrap_180
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, fly, held, radar, rotating, scene

DOCS = Path(__file__).parents[3] / "docs"


def sent(scene: Scene, duration_s: float) -> list[Message]:
    ran = simulated(scene, duration_s, clock=InstantClock(START_NS))
    return [message for message, _ in ran.said]


def descriptions(messages: list[Message], sensor: str) -> list[pb.SensorDescription]:
    theirs = [m for m in messages if m.topic == f"plotfeed/{sensor}/description"]
    assert all(m.retain and m.qos == 1 for m in theirs)
    return [json_format.Parse(m.payload, pb.SensorDescription()) for m in theirs]


def test_a_session_says_where_its_site_and_sensors_are_and_on_which_topics_they_report() -> None:
    there_is = example("section-4")
    messages = sent(there_is, 11.0)
    session, _ = (m.payload for m in messages if m.topic == "plotfeed/session")
    site = {"latitude_deg": 40.45, "longitude_deg": -3.73, "height_m": 650.0}
    assert json.loads(session)["site"] == site
    for sensor in there_is.sensor:
        (told,) = descriptions(messages, sensor.id)
        statuses = [m.payload for m in messages if m.topic == f"plotfeed/{sensor.id}/status"]
        assert len(statuses) == 4
        for status in (json_format.Parse(payload, pb.SensorStatus()) for payload in statuses):
            for name in ("latitude_deg", "longitude_deg", "height_m"):
                assert getattr(status, name) == getattr(told, name)
        here = frame_at(there_is.scene.site, sensor.position_enu_m)
        said = geodetic_to_ecef(told.latitude_deg, told.longitude_deg, told.height_m)
        assert np.abs(said - here.origin_ecef_m).max() < 1e-3
        level_m = geoid_undulation_m(here.latitude_deg, here.longitude_deg)
        assert told.height_m - told.altitude_m == pytest.approx(level_m, abs=1e-3)
        assert (told.sac, told.sic) == (sensor.sac, sensor.sic)
        assert (told.scan_period_s, told.sectors) == (sensor.scan.period_s, sensor.scan.sectors)
        assert told.time_utc.ToNanoseconds() == START_NS
        root = f"plotfeed/{sensor.id}/"
        reported = {
            (m.topic, m.content_type) for m in messages if m.topic.startswith(root) and not m.retain
        }
        outputs = {(o.topic, o.content_type) for o in told.outputs}
        assert reported <= outputs
        # But for those of whom there is nothing to report, all topics that are told are used.
        assert len(outputs - reported) <= 1
        assert [t.id for t in told.transmitters] == [t.id for t in sensor.illuminators]
        for number, transmitter in enumerate(sensor.illuminators):
            place = geodetic(there_is.scene.site, transmitter.place)
            one = told.transmitters[number]
            assert one.channel == number
            assert [one.latitude_deg, one.longitude_deg, one.height_m] == pytest.approx(place)


def test_who_reports_in_no_asterix_has_no_source_there() -> None:
    silent = scene([radar(report=["plots"])], seed=1)
    (told,) = descriptions(sent(silent, 1.0), "radar")
    assert not told.HasField("sac")
    assert not told.HasField("sic")
    assert [o.topic for o in told.outputs] == ["plotfeed/radar/plots"]


EVENTS = [
    {"from_s": 2.0, "to_s": 4.0, "set": {"range_max_m": 5000.0}},
    {"from_s": 6.0, "set": {"link": {"latency_ms": 20.0}}},
    {"from_s": 8.0, "set": {"enabled": False}},
]


def test_a_sensor_that_changes_says_so_and_since_when() -> None:
    messages = sent(scene([radar(event=EVENTS)], seed=1), 10.0)
    told = descriptions(messages, "radar")
    assert [d.range_max_m for d in told] == [20_000.0, 5000.0, 20_000.0, 20_000.0]
    assert [d.enabled for d in told] == [True, True, True, False]
    since_s = [(d.time_utc.ToNanoseconds() - START_NS) / NS for d in told]
    assert since_s == [0.0, 2.0, 4.0, 8.0]  # a link is none of its business
    settings = [json.loads(m.payload) for m in messages if m.topic == "plotfeed/radar/settings"]
    assert [s["in_force"].get("range_max_m") for s in settings] == [2e4, 5e3, 2e4, 2e4, 2e4]
    assert [s["in_force"].get("enabled", True) for s in settings] == [True] * 4 + [False]


def test_the_north_marker_of_034_says_where_the_radar_is() -> None:
    far = [3000.0, -2000.0, 40.0]
    turning = radar(id="turning", scan=rotating(1.0, 4), position_enu_m=far)
    other = radar(id="other", scan=rotating(2.0, 4))
    there_is = scene([turning, radar(id="staring"), other], seed=1)
    road = fly(there_is, 5.0)
    for sensor in (there_is.sensor[0], there_is.sensor[2]):
        here = frame_at(there_is.scene.site, sensor.position_enu_m)
        records = road.records(sensor.id, 34)
        north = [r for r in records if r.get("I034/000") == 1]
        assert len(north) == 5.0 // sensor.scan.period_s
        for record in records:
            assert ("I034/120" in record.items) == (record in north)
        for record in north:
            assert record.get("I034/120/LAT") == pytest.approx(here.latitude_deg, abs=1.1e-5)
            assert record.get("I034/120/LON") == pytest.approx(here.longitude_deg, abs=1.1e-5)
            assert record.get("I034/120/HGT") == round(here.height_m)


@pytest.mark.asyncio
async def test_by_mqtt_alone_plots_are_put_where_the_drone_is(tmp_path: Path) -> None:
    """The example of docs/mqtt.md, beside the true places that the ledger has."""
    (code,) = re.findall(r"```python\n(.*?)```", (DOCS / "mqtt.md").read_text(), re.DOTALL)
    names: dict[str, Any] = {}
    exec(compile(code, "docs/mqtt.md", "exec"), names)  # noqa: S102 - our own page
    told, port = names["plots_on_the_earth"], free_port()
    scan, place = rotating(1.0, 16), [800.0, 300.0, 20.0]
    drones = [held("d", 60.0, 8.0, 1500.0, rcs_m2=0.1)]
    there_is = scene([radar(scan=scan, position_enu_m=place)], drones, seed=1)
    with own_broker(tmp_path, port):
        async with at_work(there_is, port) as session:
            found = await asyncio.to_thread(told, "127.0.0.1", port, seconds=3.0)
            plots = [plot for entry in session.entries for plot in entry.plots if plot.drone]
    here = frame_at(there_is.scene.site, there_is.sensor[0].position_enu_m)
    truth = {plot.time_utc_ns: plot for plot in plots}
    known = [(truth[t_ns], place) for _, t_ns, *place in found if t_ns in truth]
    assert len(known) >= 3
    for plot, place in known:
        azimuth_deg, _, range_m = enu_to_aer(here.from_ecef(geodetic_to_ecef(*place)))
        assert range_m == pytest.approx(plot.range_m, abs=150.0)
        assert abs(wrap_180(azimuth_deg - plot.azimuth_deg)) < 3.0
