"""A session hears some of its own messages back, and says if they do not come: no false alarm.

With mosquitto, of which it is learned that it refuses without a word, and with ours in own time.
"""

from __future__ import annotations

import asyncio
import json
import re
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace

import pytest
from support.brokers import broker_here, mosquitto_with
from support.deliveries import NOBODY
from support.own_time import LoopClock, in_own_time
from support.scene_files import radar, scene_file, scene_text
from support.scripted_broker import ScriptedBroker
from support.servers import proxied, serving
from support.sessions import AtWork, at_work
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.transport.mqtt import own_echo
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.broker import Rights, User
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.feeds.transport.mqtt.own_echo import OwnEcho
from plotfeed.testing import MqttReceiver

FAST = radar("north", period_s=0.2, sectors=8) + radar("south", period_s=0.2, sectors=8)
# For own time, in which what a session works out is all that costs anything.
SLOW = radar("north", period_s=1.0, sectors=4) + radar("south", period_s=1.0, sectors=4)
DOCUMENTED = Path(__file__).parents[4] / "docs" / "mqtt.md"
WRITES = "\n".join(
    f"topic readwrite plotfeed/{topic}" for topic in ("session", "truth", "+/status", "+/settings")
)
PLOTS = "plotfeed/(north|south)/(plots|asterix/0[0-9]{2})"


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of mosquitto, which has no time of its own."""
    for name, seconds in (("WAIT_S", 0.5), ("NEXT_S", 0.05), ("QUIET_S", 2.0), ("ROUND_S", 0.1)):
        monkeypatch.setattr(own_echo, name, seconds)


@pytest.fixture(autouse=True)
def with_a_name(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setenv("PLOTFEED_MQTT_USERNAME", "plotfeed")
    monkeypatch.setenv("PLOTFEED_MQTT_PASSWORD", "secret")
    caplog.set_level("INFO")


def scene(folder: Path, version: str = "any", qos: int = 0, sensors: str = FAST) -> Scene:
    mqtt = f'version = "{version}"\nqos = {qos}'
    return load(scene_file(folder, scene_text(sensors=sensors, mqtt=mqtt)))


def complaints(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [m for m in caplog.messages if m.startswith(("nothing of what", "cannot tell"))]


async def samples(session: AtWork, heard: int = 0, missed: int = 0) -> None:
    totals = session.totals
    await until(lambda: totals.heard_back >= heard and totals.not_heard_back >= missed)


REFUSES_PLOTS = (
    f"nothing of what is published on {PLOTS} comes back from mqtt://.*"
    r"does its access list let this session write there, and read there\?"
)


@pytest.mark.parametrize("mqtt", [("5", 0), ("3.1.1", 1)])
@pytest.mark.parametrize(
    ("access", "says"),
    [(WRITES, REFUSES_PLOTS), ("", "nothing comes back from plotfeed/session: .*plotfeed/control")],
)
@pytest.mark.usefixtures("impatient")
@pytest.mark.asyncio
async def test_what_an_access_list_of_mosquitto_refuses_is_told_of_in_a_line(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, access: str, says: str, mqtt: tuple[str, int]
) -> None:
    """It grants the subscriptions that it denies. Of the session's own topic that is said first."""
    with mosquitto_with(tmp_path, f"user plotfeed\n{access}\ntopic write plotfeed/#") as port:
        async with at_work(scene(tmp_path, *mqtt), port) as session:
            await samples(session, missed=1)
    line, *_ = (m for m in caplog.messages if "comes back" in m)
    assert re.match(says, line)
    assert session.totals.undelivered == 0  # what made it necessary


@pytest.mark.parametrize(("version", "qos"), [("5", 1), ("3.1.1", 0)])
@pytest.mark.usefixtures("impatient")
@pytest.mark.asyncio
async def test_the_access_list_of_the_documentation_is_enough(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, version: str, qos: int
) -> None:
    """For all that a session sends and takes, and to hear itself."""
    (access,) = re.findall(r"^user plotfeed\n.*?(?=^```)", DOCUMENTED.read_text(), re.M | re.S)
    access = access.replace("north/site/7", "plotfeed")
    with mosquitto_with(tmp_path, access) as port, MqttReceiver(port, 5, "plotfeed/#") as client:
        async with at_work(scene(tmp_path, version, qos), port) as session:
            await samples(session, heard=8)
            totals = session.totals
            assert (totals.refused, totals.telemetry, totals.not_heard_back) == (0, 0, 0)
            client.publish("plotfeed/control", b'{"sensor": "north", "set": {"enabled": false}}')
            settings = "plotfeed/north/settings"
            await until(lambda: json.loads(client.on(settings)[-1])["controlled"])
            client.publish("plotfeed/telemetry/x", b"rubbish")
            await until(lambda: client.on("plotfeed/errors"))
    assert caplog.messages == []


@pytest.mark.parametrize("version", ["5", "3.1.1"])
@pytest.mark.parametrize("qos", [0, 1])
@in_own_time
async def test_rights_that_one_sensor_lacks_are_told_of_that_one(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, version: str, qos: int
) -> None:
    lacks = Rights(publishes_not=[f"plotfeed/south/{end}" for end in ("plots", "asterix/+")])
    users = {"plotfeed": asdict(User("secret", lacks))}
    async with (
        broker_here(users=users) as port,
        at_work(scene(tmp_path, version, qos, SLOW), port, clock=LoopClock()) as session,
    ):
        await samples(session, heard=2, missed=2)
    assert complaints(caplog)
    assert all("published on plotfeed/south/" in line for line in complaints(caplog))
    assert len(complaints(caplog)) == len({*complaints(caplog)})


@pytest.mark.parametrize("qos", [0, 1])
@in_own_time
async def test_networks_that_stall_and_break_raise_no_alarm(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, qos: int
) -> None:
    async with (
        broker_here() as port,
        proxied(port) as proxy,
        at_work(scene(tmp_path, "5", qos, SLOW), proxy.port, clock=LoopClock()) as session,
    ):
        for number in range(3):
            await samples(session, heard=session.totals.heard_back + 1)
            if number % 2:
                proxy.cut()
            else:
                proxy.hold()
                await asyncio.sleep(3 * own_echo.WAIT_S)  # longer than an answer is waited for
                for wire in proxy._wires:
                    wire.open.set()
        await samples(session, heard=session.totals.heard_back + 1)
    assert (complaints(caplog), session.totals.not_heard_back) == ([], 0)


@in_own_time
async def test_where_the_subscription_is_not_granted_nobody_can_tell(
    caplog: pytest.LogCaptureFixture,
) -> None:
    broker, told = ScriptedBroker(granted=0x87), list[bool]()
    async with serving(broker.serve, broker.port) as broker.port:
        address = BrokerAddress("127.0.0.1", broker.port, (5,))
        link = MqttTransport(address, "test", on_echo=told.append)
        async with link.connected(PATIENCE_S):
            while not complaints(caplog):
                message = Message("plotfeed/north/plots", b"plots", "", 0)
                link.publish([message.again(NOBODY, 1)])
                await asyncio.sleep(0.1)
    assert complaints(caplog) == [
        "cannot tell whether anybody hears what is published on plotfeed/north/plots: "
        f"{address} does not grant the subscription to it (not authorized)"
    ]
    assert told == []


@in_own_time
async def test_what_comes_meanwhile_may_stand_before_it_in_a_backlog(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """As a broker's answers do to what it passes on, under a flood."""
    told, subscribed = list[bool](), list[str]()
    # A connection that says nothing by itself.
    asked = SimpleNamespace(subscribe=subscribed.append, unsubscribe=subscribed.remove)
    echo = OwnEcho(BrokerAddress("127.0.0.1", 1883, (5,)), [], told.append)
    echo.begin(asked)
    for payload in (b"seen", b"sampled", b"before the answer"):
        if payload == b"before the answer":
            echo.answered(None)
        echo.published([Message("plotfeed/north/plots", payload, "", 0)])
    await asyncio.sleep(own_echo.WAIT_S + 0.1)
    echo.answered(None)
    assert subscribed == ["plotfeed/north/plots"] * 2
    for _ in range(10):
        assert not echo.heard("plotfeed/telemetry/flood", b"")
        await asyncio.sleep(own_echo.WAIT_S)
    assert (told, complaints(caplog)) == ([], [])
    await asyncio.sleep(own_echo.WAIT_S)
    assert told == [False]
    assert len(complaints(caplog)) == 1
    plots = [Message("plotfeed/north/plots", b"again", "", 0)]
    for seconds, is_sampled in ((own_echo.NEXT_S, False), (own_echo.QUIET_S, True)):
        await asyncio.sleep(seconds + 0.1)  # a topic is sampled once in a round
        before = len(subscribed)
        for _ in range(2):
            echo.published(plots)
        assert len(subscribed) - before == is_sampled
    echo.begin(None)
