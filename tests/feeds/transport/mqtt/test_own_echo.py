"""A session hears some of its own messages back, and says if they do not come: no false alarm."""

from __future__ import annotations

import asyncio
import re
from pathlib import Path

import pytest
from support.brokers import free_port, mosquitto_with
from support.cut_proxy import proxied
from support.deliveries import NOBODY
from support.scene_files import radar, scene_file, scene_text
from support.scripted_broker import ScriptedBroker, serving
from support.sessions import AtWork, Start, at_work, own_broker, quiet_mosquitto
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.feeds.transport.mqtt import own_echo
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.feeds.transport.mqtt.own_echo import OwnEcho

SENSORS = radar("north", period_s=0.2, sectors=8) + radar("south", period_s=0.2, sectors=8)
DOCUMENTED = Path(__file__).parents[4] / "docs" / "mqtt.md"
WRITES = "\n".join(
    f"topic readwrite plotfeed/{topic}" for topic in ("session", "truth", "+/status", "+/settings")
)
PLOTS = "plotfeed/(north|south)/(plots|asterix/0[0-9]{2})"


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(own_echo, "WAIT_S", 0.5)
    monkeypatch.setattr(own_echo, "NEXT_S", 0.05)
    monkeypatch.setattr(own_echo, "QUIET_S", 2.0)
    monkeypatch.setattr(own_echo, "ROUND_S", 0.1)
    monkeypatch.setenv("PLOTFEED_MQTT_USERNAME", "plotfeed")
    monkeypatch.setenv("PLOTFEED_MQTT_PASSWORD", "secret")
    caplog.set_level("INFO")


def scene(folder: Path, version: str = "any", qos: int = 0) -> Scene:
    mqtt = f'version = "{version}"\nqos = {qos}'
    return load(scene_file(folder, scene_text(sensors=SENSORS, mqtt=mqtt)))


def complaints(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [m for m in caplog.messages if m.startswith(("nothing of what", "cannot tell"))]


async def samples(session: AtWork, heard: int = 0, missed: int = 0) -> None:
    totals = session.totals
    await until(lambda: totals.heard_back >= heard and totals.not_heard_back >= missed)


every_version = pytest.mark.parametrize("version", ["5", "3.1.1"])
every_qos = pytest.mark.parametrize("qos", [0, 1])


@every_qos
@every_version
@pytest.mark.parametrize("may", ["may not be written", "may not be read"])
@pytest.mark.asyncio
async def test_plots_that_an_access_list_refuses_are_told_of_in_a_line(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, version: str, qos: int, may: str
) -> None:
    access = f"{WRITES}\ntopic {'read' if 'written' in may else 'write'} plotfeed/#"
    with mosquitto_with(tmp_path, f"user plotfeed\n{access}") as port:
        async with at_work(scene(tmp_path, version, qos), port) as session:
            await samples(session, missed=1)
    line, *_ = complaints(caplog)
    assert re.match(f"nothing of what is published on {PLOTS} comes back from mqtt://", line)
    assert "does its access list let this session write there, and read there?" in line
    if qos == 0 or version == "3.1.1":
        assert session.totals.undelivered == 0  # what made it necessary


@every_qos
@every_version
@pytest.mark.asyncio
async def test_an_access_list_against_one_sensor_is_told_of_that_one(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, version: str, qos: int
) -> None:
    access = f"{WRITES}\ntopic readwrite plotfeed/north/#\ntopic read plotfeed/#"
    with mosquitto_with(tmp_path, f"user plotfeed\n{access}") as port:
        async with at_work(scene(tmp_path, version, qos), port) as session:
            await samples(session, heard=2, missed=2)
    assert complaints(caplog)
    assert all("published on plotfeed/south/" in line for line in complaints(caplog))
    assert len(complaints(caplog)) == len({*complaints(caplog)})


@every_qos
@every_version
@pytest.mark.asyncio
async def test_the_access_list_of_the_documentation_lets_a_session_hear_itself(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, version: str, qos: int
) -> None:
    (access,) = re.findall(r"^user plotfeed\n(.*?)\n\n", DOCUMENTED.read_text(), re.M | re.S)
    access = access.replace("north/site/7", "plotfeed")
    with mosquitto_with(tmp_path, f"user plotfeed\n{access}") as port:
        async with at_work(scene(tmp_path, version, qos), port) as session:
            await samples(session, heard=8)
    assert (complaints(caplog), session.totals.not_heard_back) == ([], 0)
    assert (session.totals.refused, session.totals.telemetry) == (0, 0)


@pytest.mark.parametrize("start", [quiet_mosquitto, own_broker], ids=["mosquitto", "embedded"])
@every_qos
@pytest.mark.asyncio
async def test_networks_that_stall_and_break_raise_no_alarm(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, start: Start, qos: int
) -> None:
    port = free_port()
    with start(tmp_path, port):
        async with (
            proxied(port) as proxy,
            at_work(scene(tmp_path, "5", qos), proxy.port) as session,
        ):
            for number in range(4):
                await samples(session, heard=session.totals.heard_back + 2)
                if number % 2:
                    proxy.cut()
                else:
                    proxy.hold()
                    await asyncio.sleep(1.5)  # longer than an answer is waited for
                    for wire in proxy._wires:
                        wire.open.set()
            await samples(session, heard=session.totals.heard_back + 2)
    assert (complaints(caplog), session.totals.not_heard_back) == ([], 0)


@pytest.mark.asyncio
async def test_where_the_subscription_is_not_granted_nobody_can_tell(
    caplog: pytest.LogCaptureFixture,
) -> None:
    broker, clock, told = ScriptedBroker(granted=0x87), WallClock(), list[bool]()
    async with serving(broker):
        address = BrokerAddress("127.0.0.1", broker.port, (5,))
        link = MqttTransport(address, "test", on_echo=told.append)
        async with link.connected(PATIENCE_S):
            while not complaints(caplog):
                message = Message("plotfeed/north/plots", b"plots", "", clock.now_ns())
                link.publish([message.again(NOBODY, 1)])
                await asyncio.sleep(0.01)
    assert complaints(caplog) == [
        "cannot tell whether anybody hears what is published on plotfeed/north/plots: "
        f"{address} does not grant the subscription to it (not authorized)"
    ]
    assert told == []


class Asked:
    """A connection that says nothing by itself."""

    def __init__(self) -> None:
        self.subscribed: list[str] = []

    def subscribe(self, topic_filter: str) -> None:
        self.subscribed.append(topic_filter)

    def unsubscribe(self, topic: str) -> None:
        self.subscribed.remove(topic)


@pytest.mark.asyncio
async def test_what_comes_meanwhile_may_stand_before_it_in_a_backlog(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a broker's answers do to what it passes on, under a flood."""
    monkeypatch.setattr(own_echo, "WAIT_S", 1e6)
    told, asked = list[bool](), Asked()
    echo = OwnEcho(BrokerAddress("127.0.0.1", 1883, (5,)), [], told.append)
    echo.begin(asked)  # type: ignore[arg-type]
    for payload in (b"seen", b"sampled", b"before the answer"):
        if payload == b"before the answer":
            echo.answered(None)
        echo.published([Message("plotfeed/north/plots", payload, "", 0)])
    echo._ask_again()
    echo.answered(None)
    assert asked.subscribed == ["plotfeed/north/plots"] * 2
    for _ in range(10):
        assert not echo.heard("plotfeed/telemetry/flood", b"")
        echo._miss()
    assert (told, complaints(caplog)) == ([], [])
    echo._miss()
    assert told == [False]
    assert len(complaints(caplog)) == 1
    echo.begin(None)
