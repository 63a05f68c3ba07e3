"""The page of a fleet: its scene, how its parts do, and no controls."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest
from support.brokers import free_port, mosquitto
from support.page_replays import Viewer, feed_of
from support.page_updates import news_of

from plotfeed.feeds.fleet.fleet_watch import FleetWatch
from plotfeed.feeds.page.fleet_page import shown_on_page
from plotfeed.feeds.page.page_access import PageAddress, Tokens
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS, iso_utc
from plotfeed.testing import MqttReceiver, radar, scene

TRACKS = "tracker/tracks"


def a_watch(port: int = 1) -> FleetWatch:
    """At the broker of that port; at port 1 there is none."""
    radars = [radar(id="near"), radar(id="far", position_enu_m=[9e4, 0.0, 0.0])]
    made = scene(radars, seed=1, page={"tracks_topic": TRACKS})
    return FleetWatch(made, BrokerAddress("127.0.0.1", port, (5,)))


def status(part: int, number: int, **more: Any) -> bytes:
    told = {
        "part": part, "parts": 3, "state": "RUNNING", "process": f"p{part}", "worker": "host:7",
        "claim": part, "number": number, "scene": "test", "began_utc_ns": 0,
        "time_utc": iso_utc(WallClock().now_ns()), "sent_until_utc": "", "sent_until_utc_ns": 0,
        "sensors": [("near", "far", "none")[part - 1]], "plots": 5, "missed_scans": 0,
        "lateness_p99_us": 1500.0, "drones": 1, "telemetry": 0, "messages": 1, "undelivered": 0,
    }  # fmt: skip
    return json.dumps({**told, **more}).encode()


@pytest.mark.asyncio
async def test_the_page_tells_how_the_parts_of_a_fleet_do_and_takes_no_command() -> None:
    watch = a_watch()
    gap = {"sensors": ["near"], "from_utc_ns": 0, "to_utc_ns": NS, "why": "host:8 no longer sends"}
    for topic, payload in (
        ("1", status(1, 1)),
        ("1", status(1, 2)),
        ("2", status(2, 1)),
        ("2/session", b'{"session": "p2", "state": "DIED", "heard": []}'),
        ("1/gaps", json.dumps([gap]).encode()),
        ("2/gaps", b'{"nonsense": 1}'),
        ("9", status(1, 1)),
        ("2", b"{nonsense"),
    ):
        watch._hear(f"plotfeed/fleet/{topic}", payload, None)
    shown = shown_on_page(PageAddress("127.0.0.1", 0), watch, Tokens())
    async with shown as urls, feed_of(urls["page"]) as feed:
        viewer = Viewer(feed)
        await viewer.until(lambda: "fleet" in news_of(viewer.frames))
        assert not (await viewer.ask(clock={"paused": True}))["ok"]
    news = news_of(viewer.frames)
    told = news["fleet"]
    assert (told["takeovers"], told["gaps"]) == (1, 1)
    assert told["last_gaps"] == ["nothing of part 1 for 1.00 s: host:8 no longer sends"]
    first, second, third = told["parts"]
    assert (first["state"], first["worker"], first["claim"]) == ("RUNNING", "host:7", 1)
    assert first["age_s"] >= 0.0
    assert first["lateness_p99_us"] == 1500.0
    assert (second["state"], second["age_s"], second["sensors"]) == ("DIED", None, ["far"])
    assert (third["state"], third["plots"]) == ("not heard of", None)
    assert {sensor["id"] for sensor in news["scene"]["sensors"]} == {"near", "far"}
    assert set(news["settings"]) == {"near", "far"}


def test_a_part_that_says_nothing_any_more_is_silent() -> None:
    watch = a_watch()
    watch._hear("plotfeed/fleet/1", status(1, 1), None)
    assert watch.news()["parts"][0]["state"] == "silent"
    watch._hear("plotfeed/fleet/1", status(1, 2, state="ENDED"), None)
    assert watch.news()["parts"][0]["state"] == "ENDED"


@pytest.mark.asyncio
async def test_the_page_shows_the_plots_and_tracks_that_the_broker_of_a_fleet_delivers(
    tmp_path: Path,
) -> None:
    port = free_port()
    with mosquitto(tmp_path, port):
        watch = a_watch(port)
        client = await asyncio.to_thread(MqttReceiver, port, 5, "#")
        batch = pb.PlotBatch(sensor="near")
        batch.plots.add(time_utc_ns=watch.now_utc_ns, range_m=1200.0, azimuth_deg=30.0)
        track = {"track": 7, "latitude_deg": 40.46, "longitude_deg": -3.72}
        seen: dict[str, float] = {}
        shown = shown_on_page(PageAddress("127.0.0.1", 0), watch, Tokens())
        async with shown as urls, feed_of(urls["page"]) as feed:
            viewer = Viewer(feed)

            def both_are_seen() -> bool:
                client.publish("plotfeed/near/plots", batch.SerializeToString())
                client.publish(TRACKS, json.dumps(track).encode())
                for section in (section for f in viewer.frames for section in f.sections):
                    seen.update({name: values[0] for name, values in section.columns.items()})
                return {"range_m", "track"} <= seen.keys()

            await viewer.until(both_are_seen)
        client.close()
    told = [seen[name] for name in ("range_m", "azimuth_deg", "track")]
    assert told == pytest.approx([1200.0, 30.0, 7.0])
