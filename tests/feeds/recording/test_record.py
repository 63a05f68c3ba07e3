"""The command to record, in a process of its own, and what is heard of sockets and brokers."""

from __future__ import annotations

import asyncio
import contextlib
import json
import resource
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader
from support.brokers import free_port, has_ipv6, mosquitto, own_broker
from support.command import Started, plotfeed_here, started
from support.deliveries import NOBODY
from support.own_time import in_own_time
from support.recordings import MS, SCENE, START_NS, messages, read_log
from support.udp_receiver import LOOPBACK_INTERFACE, interface_of
from support.waiting import PATIENCE_S, wait_until

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.recording.record import (
    BrokerSource,
    CaptureSource,
    UdpSource,
    rfc_3339_ns,
    source_of,
)
from plotfeed.feeds.recording.recorder import (
    FLUSH_EVERY_S,
    MAX_WAITING_CHUNKS,
    Recorder,
    SessionRecorder,
)
from plotfeed.feeds.scene.output_keys import Endpoint
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.feeds.transport.ways_out import TransportError
from plotfeed.proto.errors import PlotfeedError
from plotfeed.replay.recorded import Recorded, Stage
from plotfeed.testing import MqttReceiver


@contextlib.contextmanager
def recording(*arguments: object) -> Iterator[Started]:
    """One that has said that it records."""
    with started("record", *arguments) as process:
        line = process.stdout.readline()
        assert line.startswith("recording "), process.communicate()
        yield process


def end(process: Started, how: signal.Signals) -> tuple[int, str, str]:
    process.send_signal(how)
    out, err = process.communicate(PATIENCE_S)
    assert "Traceback" not in err
    return process.wait(), out, err


class Datagrams:
    """Numbered ones of 100 octets, to a port of this machine."""

    def __init__(self, out: socket.socket) -> None:
        self.port, self.sent, self._out = free_port(), 0, out
        self.url = f"udp://127.0.0.1:{self.port}"

    def send(self, count: int) -> None:
        """Some at a time, as soon as those before have been taken: no socket has room for all."""
        for i in range(count):
            payload = self.sent.to_bytes(4, "big") + bytes(96)
            self._out.sendto(payload, ("127.0.0.1", self.port))
            self.sent += 1
            if i % 50 == 49:
                wait_until(self._are_taken, pause=lambda _: time.sleep(0.001))

    def _are_taken(self) -> bool:
        """Nobody is there, or has any that wait, as the kernel tells."""
        rows = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
        ours = (row for row in rows if row[1].endswith(f":{self.port:04X}"))
        return all(row[4].endswith(":00000000") for row in ours)


@pytest.fixture
def datagrams() -> Iterator[Datagrams]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        yield Datagrams(out)


def numbers(found: list[Recorded]) -> list[int]:
    return [int.from_bytes(m.payload[:4], "big") for m in found]


@pytest.mark.parametrize(("how", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 0)])
def test_a_signal_ends_it_with_a_whole_file(
    how: signal.Signals, code: int, tmp_path: Path, datagrams: Datagrams
) -> None:
    path = tmp_path / "a.mcap"
    with recording(datagrams.url, path) as process:
        datagrams.send(100)
        wait_until(lambda: len(read_log(path.read_bytes())[0]) == 100)
        datagrams.send(100)
        returned, out, err = end(process, how)
    assert (returned, err) == (code, "")
    assert out.splitlines()[-1].startswith("messages 200  topics 1  0.02 MB")
    found, reader = read_log(path.read_bytes())
    assert numbers(found) == list(range(200))
    assert reader.damage == []
    assert reader.is_indexed
    with path.open("rb") as file:
        theirs = make_reader(file, validate_crcs=True)
        topics = [f"udp/127.0.0.1/{datagrams.port}"]
        assert sum(1 for _ in theirs.iter_messages(topics)) == 200
        assert theirs.get_header().library.startswith("plotfeed ")


def test_a_full_disk_ends_it_with_what_was_whole(tmp_path: Path, datagrams: Datagrams) -> None:
    path, room = tmp_path / "a.mcap", 100_000
    with recording(datagrams.url, path) as process:
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (room, room))
        while process.poll() is None:
            datagrams.send(200)
            assert datagrams.sent < 1_000_000
        _, err = process.communicate(PATIENCE_S)
    assert process.returncode == 1
    assert err == f"plotfeed: {path}: File too large; what came after is not in the file\n"
    assert path.stat().st_size <= room
    found, reader = read_log(path.read_bytes())
    assert numbers(found) == list(range(len(found)))
    assert 1000 < len(found) < datagrams.sent
    assert reader.damage == [] if reader.is_indexed else reader.damage


def test_it_ends_by_itself_after_a_time_and_says_what_there_was(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    done = plotfeed_here(
        "record", f"udp://127.0.0.1:{free_port()}", path, "--duration", 0.1, "--json"
    )
    assert (done.returncode, done.stderr) == (0, "")
    totals = json.loads(done.stdout)
    assert totals.pop("seconds") >= 0.1
    none = dict.fromkeys(("messages", "octets", "topics", "lost", "dropped", "refused"), 0)
    assert totals == {"file": str(path), **none}
    assert read_log(path.read_bytes())[1].is_indexed
    again = ("record", f"udp://127.0.0.1:{free_port()}", path, "--duration", 0.1)
    refused = plotfeed_here(*again)
    assert refused.returncode == 2
    assert "is there already; --force writes another in its place" in refused.stderr
    assert plotfeed_here(*again, "--force").returncode == 0


def test_a_broker_is_recorded_until_there_are_so_many(tmp_path: Path) -> None:
    port, path = free_port(), tmp_path / "a.mcap"
    url = f"mqtt://127.0.0.1:{port}/site/+/plots"
    done = plotfeed_here("record", url, path)  # without a broker there is no file
    assert done.returncode == 1
    assert done.stderr.startswith("plotfeed: MQTT broker ")
    assert not path.exists()
    with own_broker(tmp_path, port), recording(url, path, "--count", 2) as process:
        client = MqttReceiver(port, 5)
        for topic in ("site/a/plots", "site/a/other", "site/b/plots", "site/c/plots"):
            client.publish(topic, topic.encode(), "text/plain")
        process.wait(PATIENCE_S)
        client.close()
    assert process.returncode == 0
    found, _ = read_log(path.read_bytes())
    topics = ("site/a/plots", "site/b/plots")
    told = [(topic, topic.encode(), "text/plain") for topic in topics]
    assert [(m.topic, m.payload, m.content_type) for m in found] == told


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("http://here", "a.mcap"), "'http://here': expected mqtt://HOST:PORT/TOPIC-FILTER or udp"),
        (("here", "a.mcap"), "'here': expected mqtt://HOST:PORT/TOPIC-FILTER or udp"),
        (("mqtt://me:secret@here/#", "a.mcap"), "a broker's address holds no credentials"),
        (("mqtt://here/a/#/b", "a.mcap"), "'a/#/b': + is a whole level, # is the last one"),
        (("udp://here:1", "a.mcap"), "udp://here:1: expected ADDRESS:PORT"),
        (("udp://127.0.0.1:1", "a.pcap"), "a.pcap: expected a name that ends in .mcap"),
    ],
)
def test_wrong_use_is_one_line_and_exit_code_2(arguments: tuple[str, ...], text: str) -> None:
    done = plotfeed_here("record", *arguments)
    assert done.returncode == 2
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"plotfeed: {text}")
    assert "secret" not in line


def test_a_port_that_is_taken_is_one_line(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        url = f"udp://127.0.0.1:{other.getsockname()[1]}"
        done = plotfeed_here("record", url, tmp_path / "a.mcap")
    assert (done.returncode, done.stderr) == (1, f"plotfeed: {url}: Address already in use\n")
    assert not (tmp_path / "a.mcap").exists()


# What is heard of real sockets and brokers, as it is recorded.

GROUP_4, GROUP_6 = "239.255.77.78", "ff11::7:8"
BLOCK = bytes([48, 0, 6, 1, 2, 3])
on_linux = pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells of each datagram")


class Listener(contextlib.AsyncExitStack):
    """Keeps what a source hears."""

    def __init__(self, source: CaptureSource) -> None:
        super().__init__()
        self.found: list[Recorded] = []
        self._source = source
        self._news = asyncio.Event()

    async def __aenter__(self) -> Listener:
        await self.enter_async_context(self._source.receiving(self._hear))
        return self

    def _hear(self, recorded: Recorded) -> None:
        self.found.append(recorded)
        self._news.set()

    async def wait_for(self, count: int) -> list[Recorded]:
        async with asyncio.timeout(PATIENCE_S):
            while len(self.found) < count:
                self._news.clear()
                await self._news.wait()
        return self.found


@contextlib.contextmanager
def sender(to: str, interface: str | None = None) -> Iterator[socket.socket]:
    is_6 = ":" in to
    with socket.socket(socket.AF_INET6 if is_6 else socket.AF_INET, socket.SOCK_DGRAM) as out:
        if interface is not None and is_6:
            index = socket.if_nametoindex(interface)
            out.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_IF, index)
        elif interface is not None:
            loopback = socket.inet_aton("127.0.0.1")
            out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
        yield out


async def heard_over_udp(source: UdpSource, to: str, port: int, interface: str | None) -> set[str]:
    """The topics of what is heard, once all else of it is as it was sent."""
    payloads = {BLOCK: 48, b"": 0, b"?" * 1400: 0, BLOCK * 3: 48}
    async with Listener(source) as listener:
        with sender(to, interface) as out:
            began_ns = time.time_ns()
            for payload in payloads:
                out.sendto(payload, (to, port))
            found = await listener.wait_for(len(payloads))
            ended_ns = time.time_ns()
            came_from = out.getsockname()[1]
    kinds = {48: "application/x-asterix; cat=48", 0: "application/octet-stream"}
    assert [(m.payload, m.content_type) for m in found] == [
        (payload, kinds[category]) for payload, category in payloads.items()
    ]
    for m in found:
        assert began_ns <= m.log_time_ns == m.publish_time_ns <= ended_ns
        assert m.properties[0][0] == "udp-source"
        assert m.properties[0][1].endswith(f"/{came_from}")
        assert m.stage is Stage.RECEIVED
    assert source.lost in (0, None)
    return {m.topic for m in found}


def place_of(host: str, port: int) -> str:
    if ":" in host and not has_ipv6():
        pytest.skip("this machine has no IPv6 loopback")
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


@pytest.mark.parametrize("bound", ["127.0.0.1", "0.0.0.0", "::1", "::"])  # noqa: S104
@pytest.mark.asyncio
async def test_datagrams_to_one_host_come_with_their_destination(bound: str) -> None:
    to, port = "::1" if ":" in bound else "127.0.0.1", free_port()
    place = place_of(bound, port)
    source = UdpSource(Endpoint.parse(place))
    assert source.shown == f"udp://{place}"
    topics = await heard_over_udp(source, to, port, None)
    assert topics == {f"udp/{to}/{port}"} or sys.platform != "linux"


@pytest.mark.parametrize(
    ("group", "interface"), [(GROUP_4, "127.0.0.1"), (GROUP_4, LOOPBACK_INTERFACE), (GROUP_6, "")]
)
@pytest.mark.asyncio
async def test_a_group_is_joined_where_it_is_said(group: str, interface: str) -> None:
    port = free_port()
    place = place_of(group, port)
    joined_at = interface or interface_of(group)
    source = source_of(f"udp://{place}?interface={joined_at}", {})
    assert isinstance(source, UdpSource)
    assert await heard_over_udp(source, group, port, joined_at) == {f"udp/{group}/{port}"}


@on_linux
@pytest.mark.asyncio
async def test_times_are_those_at_which_the_kernel_took_them() -> None:
    port = free_port()
    source = UdpSource(Endpoint.parse(f"127.0.0.1:{port}"))
    async with Listener(source) as listener:
        assert source.has_kernel_times
        for number in range(1, 21):  # the kernel begins to stamp a little after it is asked to
            with sender("127.0.0.1") as out:
                out.sendto(BLOCK, ("127.0.0.1", port))
            arrived_ns = time.time_ns()  # nobody has read it yet
            time.sleep(0.05)  # noqa: ASYNC251 - the loop is to be held up
            *_, recorded = await listener.wait_for(number)
            if recorded.log_time_ns <= arrived_ns:
                return
        pytest.fail("no datagram has the time at which the kernel took it")


@pytest.mark.asyncio
async def test_at_first_no_datagram_is_older_than_the_one_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stamps = iter([5, 3, 9, 7])
    monkeypatch.setattr(UdpSource, "_kernel_told", lambda *_: ("udp", next(stamps)))

    port = free_port()
    async with Listener(UdpSource(Endpoint.parse(f"127.0.0.1:{port}"))) as listener:
        with sender("127.0.0.1") as out:
            for _ in range(4):
                out.sendto(BLOCK, ("127.0.0.1", port))
        found = await listener.wait_for(4)
    assert [recorded.log_time_ns for recorded in found] == [5, 5, 9, 9]


@on_linux
@pytest.mark.asyncio
async def test_what_the_socket_had_no_room_for_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("plotfeed.feeds.recording.record.BUFFER_OCTETS", 100_000)

    port = free_port()
    source = UdpSource(Endpoint.parse(f"127.0.0.1:{port}"))
    async with Listener(source) as listener:
        with sender("127.0.0.1") as out:
            for _ in range(2000):
                out.sendto(bytes(1000), ("127.0.0.1", port))
    heard, lost = len(listener.found), source.lost
    assert heard > 0
    assert lost is not None
    assert lost > 0
    assert heard + lost == 2000


@pytest.mark.parametrize(
    ("place", "interface", "text"),
    [
        ("127.0.0.1:8600", "lo", "interface: only for multicast, which 127.0.0.1 is not"),
        ("192.0.2.1:8600", None, "udp://192.0.2.1:8600: "),
        (f"{GROUP_4}:8600", "nowhere0", f"udp://{GROUP_4}:8600: "),
    ],
)
@pytest.mark.asyncio
async def test_what_cannot_be_heard_is_an_error(
    place: str, interface: str | None, text: str
) -> None:
    with pytest.raises(TransportError) as caught:
        async with Listener(UdpSource(Endpoint.parse(place), interface)):
            pass
    assert str(caught.value).startswith(text)


DUE_NS = 1_767_268_800_123_456_789
MESSAGES = [
    Message(
        topic="plotfeed/radar/asterix/048",
        payload=BLOCK,
        content_type="application/x-asterix; cat=48",
        due_utc_ns=DUE_NS,
        properties=(("time", "2026-01-01T12:00:00.123456789Z"), ("scan", "7"), ("scan", "8")),
    ),
    Message(
        topic="plotfeed/radar/status",
        payload=b"{}",
        content_type="application/json",
        due_utc_ns=DUE_NS,
        retain=True,
        qos=1,
    ),
]


async def heard_over_mqtt(port: int, versions: tuple[int, ...]) -> list[Recorded]:
    address = BrokerAddress("127.0.0.1", port, versions)

    link, began_ns = MqttTransport(address, "test"), time.time_ns()
    async with Listener(BrokerSource(address, "plotfeed/#")) as listener:
        running = asyncio.create_task(link.run())
        try:
            await link.wait_until_up(PATIENCE_S)
            for message in MESSAGES:
                link.publish([message.again(NOBODY, 1)])
            found = await listener.wait_for(len(MESSAGES))
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)
    assert all(began_ns <= m.log_time_ns <= time.time_ns() for m in found)
    return sorted(found, key=lambda m: m.topic)


@pytest.mark.asyncio
async def test_a_message_is_recorded_with_all_that_came_with_it(tmp_path: Path) -> None:
    port = free_port()
    with mosquitto(tmp_path, port):
        found = await heard_over_mqtt(port, (5,))
    for recorded, message in zip(found, MESSAGES, strict=True):
        for name in ("topic", "payload", "content_type", "properties", "retain", "qos"):
            assert getattr(recorded, name) == getattr(message, name)
    assert found[0].publish_time_ns == DUE_NS
    assert found[1].publish_time_ns == found[1].log_time_ns  # nothing says when it was due


@pytest.mark.parametrize("version", [4, 5])
@pytest.mark.asyncio
async def test_the_embedded_broker_is_heard_too(tmp_path: Path, version: int) -> None:
    port = free_port()
    with own_broker(tmp_path, port):
        found = await heard_over_mqtt(port, (version,))
    for recorded, message in zip(found, MESSAGES, strict=True):
        assert (recorded.topic, recorded.payload) == (message.topic, message.payload)
        told = (message.content_type, message.properties) if version == 5 else ("", ())
        assert (recorded.content_type, recorded.properties) == told


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1970-01-01T00:00:00Z", 0),
        ("1970-01-01T00:00:01.5Z", 1_500_000_000),
        ("1970-01-01T01:00:00.000000001+01:00", 1),
        ("2026-01-01T12:00:00.123456789Z", DUE_NS),
        ("1969-12-31T23:59:59Z", None),
        ("2026-02-30T12:00:00Z", None),
        ("2026-01-01T12:00:00", None),
        ("2026-01-01T12:00:00.1234567890Z", None),
        ("", None),
    ],
)
def test_times_are_exact_or_unknown(text: str, expected: int | None) -> None:
    assert rfc_3339_ns(text) == expected


# Recording beside a session: what is in the file, when, and what a slow or full disk costs.

SENT = Message(
    topic="plotfeed/radar/asterix/048",
    payload=b"\x30\x00\x04\x00",
    content_type="application/x-asterix; cat=48",
    due_utc_ns=START_NS,
    properties=(("sensor", "radar"), ("scan", "7")),
    retain=True,
    qos=1,
)


def as_recorded(t_ns: int, stage: Stage = Stage.RECEIVED) -> Recorded:
    """A message as it is recorded at that time."""
    times = {"log_time_ns": t_ns, "publish_time_ns": SENT.due_utc_ns, "stage": stage}
    alike = ("topic", "payload", "content_type", "properties", "retain", "qos")
    return Recorded(**{name: getattr(SENT, name) for name in alike} | times)


def test_a_message_of_a_session_is_there_before_and_after_its_link(tmp_path: Path) -> None:
    path = tmp_path / "session.mcap"
    with Recorder(path, attachments=[SCENE]) as recorder:
        session = SessionRecorder(recorder, ledger_is_sent=True)
        session.received("plotfeed/telemetry/d1", b"t", None, START_NS - MS)
        session.before_link(SENT)
        session.after_link(SENT, START_NS + 300 * MS)
        session.ledger(SENT)
    assert (recorder.messages, recorder.octets, recorder.failure) == (3, 9, "")
    found, reader = read_log(path.read_bytes())
    assert reader.damage == []
    assert reader.attachment("scene.toml") == SCENE
    telemetry = Recorded(
        topic="plotfeed/telemetry/d1",
        payload=b"t",
        log_time_ns=START_NS - MS,
        publish_time_ns=START_NS - MS,
        stage=Stage.TELEMETRY,
    )
    after = as_recorded(START_NS + 300 * MS, Stage.AFTER)
    assert found == [telemetry, as_recorded(START_NS, Stage.BEFORE), after]


@pytest.mark.asyncio
async def test_what_comes_after_the_end_is_no_trouble(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap")
    recorder.close()
    recorder.write(as_recorded(START_NS))
    recorder.close()
    await recorder.stop()
    assert read_log(recorder.path.read_bytes())[0] == []


def test_a_file_that_is_there_is_kept_unless_it_is_to_go(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("mine")
    with pytest.raises(PlotfeedError, match="is there already; --force"):
        Recorder(path)
    assert path.read_text() == "mine"
    with pytest.raises(FileNotFoundError):
        Recorder(tmp_path / "nowhere" / "a.mcap")
    with Recorder(path, force=True) as recorder:
        recorder.write(as_recorded(-1))  # which no file can hold
        recorder.write(as_recorded(START_NS))
    assert (recorder.refused, recorder.messages) == (1, 1)
    assert len(read_log(path.read_bytes())[0]) == 1


@in_own_time
async def test_while_it_runs_everything_is_soon_in_the_file(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap")
    running = asyncio.create_task(recorder.run())
    for count in range(1, 4):
        recorder.write(as_recorded(START_NS + count))
        await asyncio.sleep(2 * FLUSH_EVERY_S)
        recorder._thread.submit(int).result()  # what was handed to the thread is written
        assert len(read_log(recorder.path.read_bytes())[0]) == count
    await recorder.stop()
    await running  # it ends by itself
    assert read_log(recorder.path.read_bytes())[1].is_indexed


@pytest.mark.parametrize("waits", [False, True])
def test_a_disk_that_stands_still_costs_messages_and_no_time_or_is_waited_for(
    waits: bool, tmp_path: Path
) -> None:
    sent, go_on = messages(10_000, octets=4000), threading.Event()
    recorder = Recorder(tmp_path / "a.mcap", waits=waits)
    recorder._thread.submit(go_on.wait)
    timer = threading.Timer(0.2, go_on.set)
    if waits:
        timer.start()
    for each in sent:
        recorder.write(each)
    assert recorder.messages + recorder.dropped == len(sent)
    assert (recorder.dropped == 0) if waits else (recorder.dropped > 100)
    assert recorder.octets > MAX_WAITING_CHUNKS * 200_000
    go_on.set()
    recorder.close()
    timer.cancel()
    found, reader = read_log(recorder.path.read_bytes())
    assert found == sent[: recorder.messages]
    assert reader.damage == []


@pytest.mark.asyncio
async def test_a_failure_is_told_once_and_ends_the_recording_alone(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap")
    running = asyncio.create_task(recorder.run())
    recorder.write(as_recorded(START_NS))
    recorder._mcap.flush()
    recorder._thread.submit(int).result()  # it is in the file
    recorder._file.close()
    recorder.write(as_recorded(START_NS + 1))
    await running
    assert recorder.failure.startswith(f"{recorder.path}: ")
    assert recorder.failure.endswith("what came after is not in the file")
    recorder.write(as_recorded(START_NS + 2))
    await recorder.stop()
    assert recorder.messages == 2
    found, reader = read_log(recorder.path.read_bytes())
    assert [m.log_time_ns for m in found] == [START_NS]
    assert len(reader.damage) == 1


def test_what_is_missing_in_a_file_is_told(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mcap") as recorder:
        recorder._mcap._last_id = 65_535
        recorder.write(as_recorded(1))
        recorder.dropped = 3
    assert list(recorder.losses()) == [
        f"{recorder.path}: 3 messages were dropped: the disk is slower",
        f"{recorder.path}: 1 messages were not recorded: no such file can hold them",
    ]
