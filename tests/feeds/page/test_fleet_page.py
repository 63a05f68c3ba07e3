"""The page of a fleet: its scene, how its workers do, and no controls."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.brokers import free_port, mosquitto
from support.mqtt_client import Client
from support.page_updates import read_frame
from support.road import NS, radar, scene
from support.waiting import PATIENCE_S
from websockets.asyncio.client import connect

from plotfeed.feeds.fleet.coordinator import Coordinator
from plotfeed.feeds.fleet.fleet_link import FleetLink
from plotfeed.feeds.fleet.fleet_parts import FleetSettings, Gap, PartHeld, Worker
from plotfeed.feeds.page.fleet_page import shown_on_page
from plotfeed.feeds.page.page_access import PageAddress, Tokens
from plotfeed.feeds.page.updates import SectionKind
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.proto import plotfeed_pb2 as pb


async def nobody() -> Worker:
    raise AssertionError


class Held:
    name = "host:7"


TRACKS = "tracker/tracks"


def a_fleet(port: int = 1) -> tuple[Coordinator, FleetLink]:
    """Of a broker at that port; at port 1 there is none."""
    radars = [radar(id="near"), radar(id="far", position_enu_m=[9e4, 0.0, 0.0])]
    made = scene(radars, seed=1, page={"tracks_topic": TRACKS})
    fleet = Coordinator(made, FleetSettings(workers=2), nobody)
    first = PartHeld("0-0", ("near",), True, "beginning", 0, epoch=2)
    first.worker = Held()  # type: ignore[assignment]
    first.joined_utc_ns, first.sent_until_utc_ns = NS, fleet.now_utc_ns - 3 * NS
    fleet.parts = [first, PartHeld("0-1", ("far",), False, "taking over", NS)]
    fleet.gaps.append(Gap("0-1", ("far",), "host:8 died", NS))
    fleet.takeovers = 1
    return fleet, FleetLink(fleet, BrokerAddress("127.0.0.1", port, (5,)))


@pytest.mark.asyncio
async def test_the_page_tells_how_the_workers_of_a_fleet_do_and_takes_no_command() -> None:
    _, link = a_fleet()
    for name, status in {
        "0-0": {"state": "RUNNING", "lateness_p99_us": 1500.0},
        "gone": {},
    }.items():
        link._hear(f"plotfeed/fleet/{name}", json.dumps(status).encode(), None)
    link._hear("plotfeed/fleet/0-1", b"{nonsense", None)
    news: dict[str, Any] = {}
    async with shown_on_page(PageAddress("127.0.0.1", 0), link, Tokens()) as urls:
        host = urls["page"].removeprefix("http://").rstrip("/")
        async with connect(f"ws://{host}/feed", origin=f"http://{host}") as feed:  # type: ignore[arg-type]
            while "fleet" not in news:
                data = await feed.recv()
                news |= read_frame(data).news if isinstance(data, bytes) else {}
            await feed.send('{"number": 1, "command": {"clock": {"paused": true}}}')
            while isinstance(data := await feed.recv(), bytes) or "number" not in data:
                pass
            assert not json.loads(data)["ok"]
    told = news["fleet"]
    assert (told["takeovers"], told["gaps"]) == (1, 1)
    assert told["last_gaps"] == ["nothing of part 0-1: still open, since host:8 died"]
    first, second = told["parts"]
    assert (first["state"], first["worker"], first["epoch"]) == ("RUNNING", "host:7", 2)
    assert first["age_s"] >= 3.0
    assert first["lateness_p99_ms"] == 1.5
    assert (second["state"], second["age_s"], second["sensors"]) == ("joining", None, ["far"])
    assert {sensor["id"] for sensor in news["scene"]["sensors"]} == {"near", "far"}
    assert set(news["settings"]) == {"near", "far"}
    assert link.statuses.keys() == {"0-0"}


@pytest.mark.asyncio
async def test_the_page_shows_the_plots_and_tracks_that_the_broker_of_a_fleet_delivers(
    tmp_path: Path,
) -> None:
    port = free_port()
    with mosquitto(tmp_path, port):
        fleet, link = a_fleet(port)
        client = await asyncio.to_thread(Client, port, 5, "#")
        batch = pb.PlotBatch(sensor="near")
        batch.plots.add(time_utc_ns=fleet.now_utc_ns, range_m=1200.0, azimuth_deg=30.0)
        track = {"track": 7, "latitude_deg": 40.46, "longitude_deg": -3.72}
        frames: list[Any] = []
        async with shown_on_page(PageAddress("127.0.0.1", 0), link, Tokens()) as urls:
            host = urls["page"].removeprefix("http://").rstrip("/")
            async with (
                asyncio.timeout(PATIENCE_S),
                connect(f"ws://{host}/feed", origin=f"http://{host}") as feed,  # type: ignore[arg-type]
            ):
                while {SectionKind.PLOTS, SectionKind.TRACKS} - {
                    section.kind for frame in frames for section in frame.sections
                }:
                    client.publish("plotfeed/near/plots", batch.SerializeToString())
                    client.publish(TRACKS, json.dumps(track).encode())
                    data = await feed.recv()
                    frames += [read_frame(data)] if isinstance(data, bytes) else []
        client.close()
    seen = {name: value for frame in frames for name, value in columns(frame)}
    assert seen["range_m"] == pytest.approx(1200.0)
    assert seen["azimuth_deg"] == pytest.approx(30.0)
    assert seen["track"] == 7


def columns(frame: Any) -> Iterator[tuple[str, float]]:
    """The first value of each column of a frame."""
    for section in frame.sections:
        for name, values in section.columns.items():
            yield name, values[0]
