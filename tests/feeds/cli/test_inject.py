"""`inject`: flights and live sources published, what sessions say of them, and when it is 1."""

from __future__ import annotations

import asyncio
import json
import math
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.brokers import free_port, mosquitto
from support.command import plotfeed, plotfeed_here, running
from support.scene_files import radar, scene_text
from support.vehicles import sending_vehicle

from plotfeed.feeds.cli import inject
from plotfeed.feeds.cli.inject import MAX_SPEED, SessionAnswers, retimed
from plotfeed.feeds.telemetry.flights.flight import Flight
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.feeds.transport.live_source import LiveSource
from plotfeed.feeds.transport.mqtt.connection import MqttConnection
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.ledger import entries_in
from plotfeed.testing import MqttMessage, MqttReceiver

S = 1_000_000_000
NOWHERE = ("--broker", "mqtt://127.0.0.1:1")
ELLIPSOID = ("--set", "altitude_reference=ellipsoid")
# Of now, whenever that is.
AIRBORNE = "".join(
    f"MSG,3,1,1,{icao},1,,,,,,1000,,,40.45,{longitude},,,,,,0\n"
    for icao, longitude in (("484412", "-3.72"), ("485020", "-3.74"))
)
SRT_BLOCK = """{n}
00:00:0{n},000 --> 00:00:0{n},999
2026-01-01 12:00:0{n}.000
[iso: 100] [latitude: 40.460{n}] [longitude: -3.72] [rel_alt: 20.0 abs_alt: 700.0]

"""
REPORT = PositionReport(
    t_utc_ns=1,
    latitude_deg=40.01,
    longitude_deg=3.0,
    altitude_m=0.0,
    altitude_reference=AltitudeReference.ABOVE_TAKEOFF,
    velocity_enu_m_s=(1.0, 2.0, math.nan),
    velocity_accuracy_m_s=0.5,
)


def flown(*t_s: float) -> Flight:
    reports = [REPORT._replace(t_utc_ns=round(t * S), latitude_deg=50 + t * 1e-5) for t in t_s]
    return Flight(name="a", reports=tuple(reports))


def test_a_flight_keeps_its_tempo_or_is_shifted_and_hurried_with_its_velocities() -> None:
    whole = flown(1000.1, 1000.3, 1002.7)
    assert list(retimed(whole)) == list(whole.reports)
    due = [r.t_utc_ns for r in retimed(flown(1000, 1001, 1003), start_utc_ns=7 * S)]
    assert due == [7 * S, 8 * S, 10 * S]
    sent = list(retimed(flown(1000, 1001, 1003), speed=2.0, start_utc_ns=7 * S))
    assert [r.t_utc_ns for r in sent] == [7 * S, 7 * S + S // 2, 8 * S + S // 2]
    assert repr(sent[0].velocity_enu_m_s) == "(2.0, 4.0, nan)"
    assert sent[0].velocity_accuracy_m_s == 1.0
    for speed in (0.0, -1.0, math.nan, math.inf, MAX_SPEED + 1):
        with pytest.raises(PlotfeedError, match="speed"):
            retimed(flown(1.0), speed=speed)


@given(
    st.lists(st.floats(0, 1e6), min_size=1, max_size=20, unique_by=lambda t: round(t, 4)),
    st.floats(0.01, MAX_SPEED),
)
def test_reports_stay_in_order(t_s: list[float], speed: float) -> None:
    sent = list(retimed(flown(*sorted(t_s)), speed=speed, start_utc_ns=S))
    assert len(sent) == len(t_s)
    assert all(a.t_utc_ns < b.t_utc_ns for a, b in pairwise(sent))
    assert sent[0].t_utc_ns == S


WRONG_WORDS: tuple[tuple[tuple[str, ...], str], ...] = (
    (("mavlink:pigeon:1",), "expected one of"),
    (("mavlink:udp::14550", "--drone", "{serial}"), "--drone: {serial} is not known"),
    (("mavlink:udp::14550", "--speed", "2"), "are for files"),
    (("remote-id:-",), "expected one of http, https, mcast, udp, udpin, udpout"),
    (
        ("mavlink:udp::14550", "--set", "interface=lo"),
        "--set interface: only for a multicast group",
    ),
    (("mavlink:udp::14550", "--set", "columns.time=t"), "--set columns: no such key here"),
    (("mavlink:udp::14550", "--set", "ask_hz"), "--set ask_hz: expected KEY=VALUE"),
    (("mavlink:udp::14550", "--set", "ask_hz=0"), "--set ask_hz: "),
    (("nothing.srt", "--set", "utc_offset_h=far"), "--set utc_offset_h: "),
    (("nothing.srt", "--gps-order", "lat-lon"), "It is --set gps_order=VALUE now."),
    (("nothing.srt",), "cannot be read: No such file"),
)


def test_wrong_words_are_told_before_anything_is_sent(flight: Path) -> None:
    for words, says in WRONG_WORDS:
        done = plotfeed_here("inject", *words, *NOWHERE)
        assert done.returncode == 2
        assert says in done.stderr, words
    for name in ("a/b", "a+", "#", "x" * 65, "a\nb"):
        done = plotfeed_here("inject", flight, "--drone", name, *NOWHERE, *ELLIPSOID)
        assert done.returncode == 2
        assert "--drone: " in done.stderr
        assert "expected 1 to 64 printable characters" in done.stderr
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        done = plotfeed_here("inject", f"mavlink:udp://:{port}", *NOWHERE)
    assert done.returncode == 1
    assert done.stderr == f"plotfeed: mavlink:udpin:127.0.0.1:{port}: Address already in use\n"


@pytest.mark.asyncio
async def test_whatever_comes_on_the_topics_is_no_error_and_the_nearest_sensor_is_told() -> None:
    answers = SessionAnswers("p", "d")
    for kind in ("errors", "session", "radar/description", "radar/status"):
        for told in (b"", b"{}", b"[]", b"1", b"\xff", b"[" * 100_000, b'{"sensor": {}}'):
            answers.hear(f"p/{kind}", told, None)
    assert answers.scene is None
    assert answers.nearest([]) is None
    await asyncio.wait_for(answers.end(), 1.0)
    # The nearest sensor is the one whose range is entered deepest.
    for name, latitude_deg, range_m in (("short", 40.0, 100.0), ("long", 40.02, 9000.0)):
        place = {"latitude_deg": latitude_deg, "longitude_deg": 3.0, "height_m": 100.0}
        described = {"sensor": name, "range_max_m": range_m, **place}
        answers.hear(f"p/{name}/description", json.dumps(described).encode(), None)
    sensor, near_m, sees_m, hindrance = answers.nearest([REPORT]) or ("", 0.0, 0.0, None)
    assert (sensor, sees_m, hindrance) == ("long", 9000.0, None)
    assert near_m == pytest.approx(1110.4, abs=2.0)


Inject = Callable[..., CompletedProcess[str]]


@contextmanager
def session(folder: Path, name: str, **scene: str) -> Iterator[tuple[str, Inject]]:
    """The address of the broker of one at work, and what injects into it."""
    path = folder / f"{name}.toml"
    path.write_text(scene_text(sensors=radar(sectors=8), drones="", **scene))
    with running("run", path) as process:
        url = f"mqtt://127.0.0.1:{process.port('MQTT')}"

        def inject(*words: object, **more: Any) -> CompletedProcess[str]:
            return plotfeed("inject", *words, "--broker", url, **more)

        yield url, inject


def flies_as_it_is_said(folder: Path, flight: Path) -> None:
    """A flight of a file is taken in whichever way it is encoded, and what became of it told."""
    with (
        session(folder, "encodings") as (url, inject),
        MqttReceiver(int(url.rpartition(":")[2]), 5, "plotfeed/truth") as client,
    ):
        for encoding in ("json", "protobuf"):
            drone = f"by-{encoding}"
            done = inject(flight, "--now", "--drone", drone, "--encoding", encoding, *ELLIPSOID)
            assert (done.returncode, done.stderr) == (0, "")
            sent = f"8 reports sent to {url} as plotfeed/telemetry/{drone}, 0 und"
            assert sent in done.stdout
            assert "session of test: the flight comes to 1.11 km from radar" in done.stdout

            def is_seen(message: MqttMessage) -> bool:
                looks = (look for e in entries_in(message.payload) for look in e.looks)
                return any(look.drone == drone for look in looks)  # noqa: B023 - at once

            client.wait_for(is_seen)


def is_told_why_it_is_refused(folder: Path, flight: Path) -> None:
    far = folder / "far.csv"
    far.write_text(flight.read_text().replace("40.46", "-33.0"))
    with session(folder, "refusals") as (_, inject):
        for words, says in (
            ((flight, *ELLIPSOID), "meanwhile the session refused, of all that came: stale 8"),
            ((far, "--now", *ELLIPSOID), "no sensor can see the flight"),
            ((flight, "--now", *ELLIPSOID, "--prefix", "other"), "no session was there"),
        ):
            done = inject(*words)
            assert done.returncode == 1
            assert says in done.stderr


def needs_the_height_of_its_takeoff(folder: Path, _flight: Path) -> None:
    path = folder / "dji.srt"
    path.write_text("".join(SRT_BLOCK.format(n=n) for n in (1, 2, 3)))
    with session(folder, "heights", telemetry="") as (_, inject):
        options = ("--now", "--speed", "10", "--set", "altitude_reference=above_takeoff")
        done = inject(path, *options)
        assert done.returncode == 1
        assert "3 refused" in done.stdout
        assert "the scene lacks telemetry.takeoff_height_m" in done.stderr
        done = inject(path, *options, "--set", "takeoff_height_m=650")
        assert done.returncode == 0
        assert "0 refused" in done.stdout


def comes_from_autopilots_and_receivers(folder: Path, _flight: Path) -> None:
    port = free_port()
    with session(folder, "sources") as (_, inject):
        with sending_vehicle(port):
            done = inject(f"mavlink:udp://:{port}", "--duration", "4")
        to_the_end = inject("sbs1:-", stdin=f"nonsense\n{AIRBORNE}")
    assert done.returncode == 0, done.stderr
    assert f"listens to mavlink:udpin:127.0.0.1:{port}, drones are mav-{{system}}" in done.stdout
    assert "drones: mav-1" in done.stdout
    assert "undelivered 0" in done.stdout
    assert "refused" not in done.stderr
    assert to_the_end.returncode == 0, to_the_end.stderr
    assert "drones: 484412, 485020" in to_the_end.stdout
    assert "not taken: undecodable 1: a line 'nonsense'; expected SBS-1" in to_the_end.stderr


INJECTIONS = (
    flies_as_it_is_said,
    is_told_why_it_is_refused,
    needs_the_height_of_its_takeoff,
    comes_from_autopilots_and_receivers,
)


def test_what_is_injected_into_sessions(tmp_path: Path, flight: Path) -> None:
    """All at once, each with a session of its own: they mostly wait for its next status."""
    pytest.importorskip("pymavlink")
    with ThreadPoolExecutor(len(INJECTIONS)) as threads:
        for done in [threads.submit(each, tmp_path, flight) for each in INJECTIONS]:
            done.result()


def test_what_comes_after_the_end_is_not_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a vehicle that goes on while the broker is slow to let go."""
    pytest.importorskip("pymavlink")
    events: list[str] = []
    take, leave, close = inject._Relay._take, LiveSource.close, MqttConnection.close

    async def close_slowly(connection: MqttConnection) -> None:
        events.append("link closes")
        await asyncio.sleep(0.5)
        await close(connection)

    def noting(real: Callable[..., Any], event: str) -> Callable[..., Any]:
        return lambda *given: (events.append(event), real(*given))[1]

    monkeypatch.setattr(MqttConnection, "close", close_slowly)
    monkeypatch.setattr(inject._Relay, "_take", noting(take, "report"))
    monkeypatch.setattr(LiveSource, "close", noting(leave, "source closes"))
    port, broker_port = free_port(), free_port()
    broker = ("--broker", f"mqtt://127.0.0.1:{broker_port}")
    with mosquitto(tmp_path, broker_port), sending_vehicle(port):
        done = plotfeed_here("inject", f"mavlink:udp://:{port}", *broker, "--duration", "1")
    assert "drones: mav-1" in done.stdout
    end = events.index("source closes")
    assert events.index("report") < end < events.index("link closes")
    assert "report" not in events[end:]
