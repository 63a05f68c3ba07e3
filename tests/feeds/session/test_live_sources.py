"""A session listens to autopilots itself, and is run again from its record without them."""

from __future__ import annotations

import contextlib
import json
import math
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.brokers import free_port, own_broker
from support.command import plotfeed
from support.scene_files import DRONE, radar, scene_text
from support.sessions import at_work
from support.vehicles import vehicle
from support.waiting import until

from plotfeed.feeds.recording.recorder import Recorder, SessionRecorder, attachments_of
from plotfeed.feeds.scene.scene import Scene, parsed
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock, WallClock
from plotfeed.models.frames import ecef_to_geodetic
from plotfeed.proto.errors import PlotfeedError
from plotfeed.testing import MqttReceiver

pytest.importorskip("pymavlink")


def scene(*sources: str, telemetry: str = "", drones: str = "") -> Scene:
    tables = "".join(f"[[telemetry.source]]\n{source}\n" for source in sources)
    more = {"telemetry": f"{telemetry}\n{tables}", "drones": drones}
    text = scene_text(sensors=radar(period_s=0.5), **more)
    return parsed(text.encode(), Path("scene.toml"))


@pytest.mark.asyncio
async def test_autopilots_are_seen_where_they_say_and_a_record_runs_again_without_them(
    tmp_path: Path,
) -> None:
    port, path = free_port(), tmp_path / "there.mcap"
    of = scene(f'url = "mavlink:udpin:127.0.0.1:{port}"\nrcs_m2 = 0.5')
    theirs = f"udpout:127.0.0.1:{port}"
    recorder = Recorder(path, attachments=attachments_of(of, WallClock().now_ns()))
    with recorder, vehicle(theirs, "--system", 1, "--system", 9):
        async with at_work(of, None, SessionRecorder(recorder, ledger_is_sent=False)) as session:
            await until(lambda: session.totals.telemetry > 20)
            await until(lambda: session.totals.plots > session.totals.false_alarms)
            trajectories = session.session.trajectories
            assert sorted(trajectories.names) == ["mav-1", "mav-9"]
            state = trajectories.state_at(session.clock.now_ns() - 500_000_000)
            latitude_deg, longitude_deg, height_m = ecef_to_geodetic(state.position_ecef_m)
            # A circle of 200 m around a centre, so and so far east of it; 750 m above the sea.
            offset_m = dict(zip(("mav-1", "mav-9"), (100, 900), strict=True))
            for i, drone in enumerate(state.drone):
                east_m = (longitude_deg[i] + 3.73) * 84_900 - offset_m[trajectories.names[drone]]
                north_m = (latitude_deg[i] - 40.45) * 111_200
                assert math.hypot(east_m, north_m) == pytest.approx(200, abs=10)
            assert height_m == pytest.approx([802.0] * len(height_m), abs=3)
            assert session.totals.refused == 0
    again = plotfeed("run", path, "--broker", "none", "--speed", "max", "--json")
    assert again.returncode == 0, again.stderr
    totals = json.loads(again.stdout)
    assert totals["telemetry"] > 0
    assert totals["plots"] > totals["false_alarms"]


@pytest.fixture
def sender() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.setblocking(False)
        yield found


@pytest.mark.asyncio
async def test_aircraft_are_seen_beside_drones_and_what_is_no_mavlink_is_counted_and_told(
    sender: socket.socket,
) -> None:
    port = free_port()
    sources = f'url = "sbs1:udpin:127.0.0.1:{port}"', f'url = "mavlink:udp://:{port + 1}"'
    of = scene(*sources, telemetry="max_speed_m_s = 350.0", drones=DRONE)
    line = "MSG,3,1,1,484412,1,,,,,,{},,,40.47,-3.73,,,,,,0\r\n"
    async with at_work(of, None) as session:

        def flies() -> bool:
            sender.sendto(b"GET / HTTP/1.1\r\n\r\n", ("127.0.0.1", port + 1))
            told = line.format(3000 + session.totals.telemetry)
            sender.sendto(told.encode(), ("127.0.0.1", port))
            return session.totals.telemetry > 20

        await until(flies)
        assert sorted(session.session.trajectories.names) == ["484412", "visitor"]
    assert session.totals.refused_by.keys() == {"undecodable"}
    expected = "/telemetry/mavlink: 18 octets that are no MAVLink frame"
    assert expected in session.totals.last_refusal


MAPPING = """[[telemetry.mapping]]
topic = "fleet/{drone}/state"
latitude = "lat"
longitude = "lon"
altitude = "alt"
altitude_reference = "ellipsoid"
"""


@pytest.mark.asyncio
async def test_what_another_system_publishes_is_taken_by_its_mapping(tmp_path: Path) -> None:
    port = free_port()
    with own_broker(tmp_path, port), MqttReceiver(port, 5) as other:
        async with at_work(scene(telemetry=MAPPING), port) as session:
            for n in range(3):
                said = json.dumps({"lat": 40.46 + n * 1e-6, "lon": -3.73, "alt": 900})
                other.publish("fleet/u7/state", said.encode())
            other.publish("fleet/u8/state", b'{"lat": "n/a"}')
            await until(lambda: (session.totals.telemetry, session.totals.refused) == (3, 1))
            assert session.session.trajectories.names == ["u7"]
    expected = "plotfeed/telemetry/u8: lat is 'n/a'; expected a number"
    assert session.totals.last_refusal == expected


@pytest.mark.asyncio
async def test_simulated_time_has_no_live_sources() -> None:
    with pytest.raises(PlotfeedError, match=r"telemetry\.source: live sources need real time"):
        await run(scene('url = "mavlink:udp://:14550"'), clock=InstantClock(), broker="none")


@pytest.mark.parametrize(
    ("source", "says"),
    [
        ('url = "mavlink:udp"', "telemetry.source[0].url: expected HOST:PORT"),
        ('url = "radio:udp::1"', "telemetry.source[0].url: expected KIND:TRANSPORT:PLACE"),
        ('url = "mavlink:pigeon:1"', "telemetry.source[0].url: expected one of"),
        ('url = "mavlink:udp::1"\ndrone = "{serial}"', "{serial} is not known of mavlink"),
        ('url = "sbs1:-"\nask_hz = 1.0', "telemetry.source[0].ask_hz: only for mavlink"),
        ('url = "beast:tcp:a:1"', "telemetry.max_speed_m_s: must be stated beside ADS-B"),
        ('url = "remote-id:http://a/b"', "telemetry.source[0].view: network Remote ID"),
        ('url = "remote-id:http://u:p@a/b"\nview = [1, 2, 3, 4]', "without user"),
        ('url = "mavlink:udp::1"\nqnh_hpa = 1000.0', "telemetry.source[0].qnh_hpa: only"),
        ('url = "mavlink:udp::1"\ninterface = "lo"', "telemetry.source[0].interface: only"),
        ('url = "mavlink:mcast:"\ninterface = ""', "telemetry.source[0].interface: expected"),
        ('url = "mavlink:udp::1"\nask_hz = 1000.0', "telemetry.source[0].ask_hz"),
    ],
)
def test_a_wrong_source_is_told_by_its_key(source: str, says: str) -> None:
    with pytest.raises(PlotfeedError) as error:
        scene(source)
    assert says in str(error.value)


@pytest.mark.asyncio
async def test_an_autopilot_that_sends_what_it_is_asked_for_is_followed(
    sender: socket.socket,
) -> None:
    common = pytest.importorskip("pymavlink.dialects.v20.common")
    mav, asked, port = common.MAVLink(None, 4, 1), dict[int, float](), free_port()
    async with at_work(scene(f'url = "mavlink:udp://:{port}"\nask_hz = 5'), None) as session:

        def follows() -> bool:
            said = mav.heartbeat_encode(2, 3, 0, 0, 4)
            if 33 in asked:
                place = (404_500_000, -37_300_000, 750_000, 100_000)
                boot_ms = round(1000 * time.monotonic()) % 2**32
                said = mav.global_position_int_encode(boot_ms, *place, 0, 0, 0, 0)
            sender.sendto(said.pack(mav), ("127.0.0.1", port))
            with contextlib.suppress(BlockingIOError):
                while True:
                    for message in mav.parse_buffer(sender.recv(2048)) or []:
                        if message.get_type() == "COMMAND_LONG" and message.command == 511:
                            asked[int(message.param1)] = message.param2
            return session.totals.telemetry > 0

        await until(follows)
        assert session.session.trajectories.names == ["mav-4"]
    assert asked == {33: 200_000, 24: 200_000, 2: 1_000_000, 242: 1_000_000}
