"""The command to record, in a process of its own: ended, killed, and out of room."""

from __future__ import annotations

import contextlib
import json
import resource
import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader
from support.brokers import free_port, own_broker
from support.command import Started, plotfeed_here, started
from support.recordings import read_log
from support.waiting import PATIENCE_S, wait_until

from plotfeed.feeds.recording.record import source_of
from plotfeed.replay.recorded import Recorded
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
    """Numbered ones, to a port of this machine."""

    def __init__(self, out: socket.socket, octets: int = 100) -> None:
        self.port = free_port()
        self.sent = 0
        self._out = out
        self._octets = octets

    @property
    def url(self) -> str:
        return f"udp://127.0.0.1:{self.port}"

    def send(self, count: int) -> None:
        """Some at a time, as soon as those before have been taken: no socket has room for all."""
        for i in range(count):
            payload = self.sent.to_bytes(4, "big") + bytes(self._octets - 4)
            self._out.sendto(payload, ("127.0.0.1", self.port))
            self.sent += 1
            if i % 50 == 49:
                wait_until(self._are_taken, pause=lambda _: time.sleep(0.001))

    def _are_taken(self) -> bool:
        """Nobody is there, or has any that wait, as the kernel tells."""
        rows = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
        return all(
            row[4].endswith(":00000000") for row in rows if row[1].endswith(f":{self.port:04X}")
        )


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


def test_a_kill_costs_no_more_than_what_was_not_yet_in_the_file(
    tmp_path: Path, datagrams: Datagrams
) -> None:
    path = tmp_path / "a.mcap"
    with recording(datagrams.url, path) as process:
        for _ in range(20):
            datagrams.send(400)
        wait_until(lambda: len(read_log(path.read_bytes())[0]) > 4000)
        process.kill()
        process.wait()
    found, reader = read_log(path.read_bytes())
    kept = len(found)
    assert numbers(found) == list(range(kept))  # the end is missing, and nothing else
    assert 4000 < kept <= datagrams.sent
    assert not reader.is_indexed
    assert all(damage.offset > path.stat().st_size * 0.9 for damage in reader.damage)
    assert reader.damage


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


def test_it_ends_by_itself_after_so_many(tmp_path: Path, datagrams: Datagrams) -> None:
    path = tmp_path / "a.mcap"
    with recording(datagrams.url, path, "--count", 70) as process:
        datagrams.send(100)
        process.wait(PATIENCE_S)
    assert process.returncode == 0
    assert numbers(read_log(path.read_bytes())[0]) == list(range(70))


def test_it_ends_by_itself_after_a_time_and_says_what_there_was(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    done = plotfeed_here(
        "record", f"udp://127.0.0.1:{free_port()}", path, "--duration", 0.1, "--json"
    )
    assert (done.returncode, done.stderr) == (0, "")
    totals = json.loads(done.stdout)
    assert totals.pop("seconds") >= 0.1
    assert totals == {
        "file": str(path),
        "messages": 0,
        "octets": 0,
        "topics": 0,
        "lost": 0,
        "dropped": 0,
        "refused": 0,
    }
    assert read_log(path.read_bytes())[1].is_indexed
    again = ("record", f"udp://127.0.0.1:{free_port()}", path, "--duration", 0.1)
    refused = plotfeed_here(*again)
    assert refused.returncode == 2
    assert "is there already; --force writes another in its place" in refused.stderr
    assert plotfeed_here(*again, "--force").returncode == 0


def test_a_broker_is_recorded(tmp_path: Path) -> None:
    port, path = free_port(), tmp_path / "a.mcap"
    with own_broker(tmp_path, port):
        url = f"mqtt://127.0.0.1:{port}/site/+/plots"
        with recording(url, path, "--count", 2) as process:
            client = MqttReceiver(port, 5)
            for topic in ("site/a/plots", "site/a/other", "site/b/plots"):
                client.publish(topic, topic.encode(), "text/plain")
            process.wait(PATIENCE_S)
            client.close()
    assert process.returncode == 0
    found, _ = read_log(path.read_bytes())
    assert [(m.topic, m.payload, m.content_type) for m in found] == [
        ("site/a/plots", b"site/a/plots", "text/plain"),
        ("site/b/plots", b"site/b/plots", "text/plain"),
    ]


def test_without_a_broker_there_is_no_file(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    done = plotfeed_here("record", f"mqtt://127.0.0.1:{free_port()}/x", path)
    assert done.returncode == 1
    assert done.stderr.startswith("plotfeed: MQTT broker ")
    assert not path.exists()


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
    assert done.returncode == 1
    assert done.stderr == f"plotfeed: {url}: Address already in use\n"
    assert not (tmp_path / "a.mcap").exists()


def test_a_group_is_joined_where_its_address_says() -> None:
    assert vars(source_of("udp://239.1.2.3:1?interface=lo", {}))["_interface"] == "lo"
