"""A recording from a stranger, run again: it says neither what is read nor where anything goes."""

from __future__ import annotations

import asyncio
import json
import socket
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from socket import SOCK_DGRAM, SOCK_STREAM
from typing import Any

import pytest
from support.brokers import free_port, port_is_taken
from support.command import plotfeed, plotfeed_here, running, started
from support.scene_files import DRONE, radar, scene_file, scene_text
from support.sessions import AtWork
from support.waiting import wait_until

from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.recording.recorder import (
    RecordedTelemetry,
    Recorder,
    SessionRecord,
    SessionRecorder,
    attachments_of,
)
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import Clock, InstantClock, WallClock
from plotfeed.proto.asterix.codec.decode import whole_blocks
from plotfeed.proto.content_types import JSON
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS, iso_utc
from plotfeed.replay.mcap import McapReader
from plotfeed.replay.recorded import Attachment

pytest.importorskip("sapient_msg")

WHISPERED = "not-for-strangers"
FLIGHT = """
[[drone]]
id = "flown"
[drone.flight]
file = "{file}"
altitude_reference = "ellipsoid"
"""
CSV = b"time,latitude_deg,longitude_deg,altitude_m\n" + b"".join(
    f"2026-01-01T12:00:{i:02d}Z,40.46,{-3.73 + i * 1e-4:.6f},900\n".encode() for i in range(30)
)


START = "2026-01-01T12:00:00Z"
START_NS = 1_767_268_800 * NS
SIMULATED = ("--speed", "max", "--broker", "none", "--json")


def scene_of(folder: Path, **more: Any) -> Scene:
    return load(scene_file(folder, scene_text(**{"start_utc": START, "port": 1883, **more})))


def made(folder: Path, seconds: int, path: Path, *more: str) -> Path:
    """The record of a simulated session."""
    scene = scene_file(folder, scene_text(start_utc=START, sensors=radar(), port=1883))
    options = ("--duration", seconds, "--record", path, *SIMULATED, *more)
    done = plotfeed_here("run", scene, *options)
    assert done.returncode == 0, done.stderr
    return path


@pytest.fixture
def record(tmp_path: Path) -> Path:
    return made(tmp_path, 3, tmp_path / "record.mcap")


@contextmanager
def ears(kind: socket.SocketKind) -> Iterator[tuple[socket.socket, str]]:
    with socket.socket(socket.AF_INET, kind) as listener:
        listener.bind(("127.0.0.1", 0))
        if kind is SOCK_STREAM:
            listener.listen()
        listener.setblocking(False)
        yield listener, f"127.0.0.1:{listener.getsockname()[1]}"


def heard(listener: socket.socket) -> bool:
    """Whether anybody has connected, or sent a datagram."""
    try:
        if listener.type is SOCK_STREAM:
            listener.accept()[0].close()
        else:
            listener.recv(65536)
    except BlockingIOError:
        return False
    return True


def scene_with(folder: Path, *, broker: str, udp: str, middleware: str) -> Scene:
    (folder / "secrets.toml").write_text(f'username = "somebody"\npassword = "{WHISPERED}"\n')
    return scene_of(
        folder,
        sensors=radar(more='report = ["asterix-048", "sapient"]'),
        mqtt=f'broker = "mqtt://{broker}"\ncredentials_file = "{folder / "secrets.toml"}"',
        drones=f'[[udp]]\ndestination = "{udp}"\nmax_octets = 200\n'
        f'[sapient]\nmiddleware = "{middleware}"\n{DRONE}',
    )


async def left_by(
    scene: Scene, clock: Clock, seconds: float, *observers: Observer
) -> tuple[SessionCounters, list[Message]]:
    """What a session without a broker counts, and what leaves it."""
    left: list[Message] = []
    totals = await run(
        scene,
        clock=clock,
        broker="none",
        duration_s=seconds,
        observers=observers,
        tap=lambda message, _t: left.append(message),
    )
    return totals, left


def recorded_by_a_stranger(path: Path, scene: Scene, *attachments: Attachment) -> Path:
    """A session's record with that scene's text, however its own session ran."""
    text = Attachment(name="scene.toml", media_type="", data=scene.text.encode(), log_time_ns=0)
    with Recorder(path, attachments=[text, *attachments], waits=True) as recorder:
        observer = SessionRecorder(recorder, ledger_is_sent=True)
        asyncio.run(left_by(scene.enclosed({}), InstantClock(START_NS), 2, observer))
    return path


def test_it_is_sent_nowhere_and_no_secret_of_ours_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PLOTFEED_MQTT_USERNAME", "somebody")
    monkeypatch.setenv("PLOTFEED_MQTT_PASSWORD", WHISPERED)
    with ears(SOCK_STREAM) as broker_at, ears(SOCK_DGRAM) as udp_at, ears(SOCK_STREAM) as other_at:
        listeners, places = zip(broker_at, udp_at, other_at, strict=True)
        broker, udp, middleware = places
        scene = scene_with(tmp_path, broker=broker, udp=udp, middleware=middleware)
        record = recorded_by_a_stranger(tmp_path / "x.mcap", scene)
        done = plotfeed("run", record, "--speed", "max", "--duration", "2")
        assert done.returncode == 0, done.stderr
        assert [heard(listener) for listener in listeners] == [False] * 3
        assert done.stderr == (
            f"plotfeed: {record}: not sent to where its session went: mqtt://{broker} (--broker), "
            f"{udp} (--udp), the middleware {middleware} (--middleware)\n"
        )
        assert WHISPERED not in done.stdout + done.stderr
        asked = plotfeed("run", record, "--speed", "max", "--broker", "none", "--udp", udp)
        assert heard(listeners[1])
        assert not heard(listeners[0])
        assert "(--udp)" not in asked.stderr


def test_the_octets_are_those_of_its_session_all_the_same(tmp_path: Path) -> None:
    """Datagrams of 200 octets cut the blocks of MQTT too, wherever they go."""
    scene = scene_with(tmp_path, broker="h", udp="127.0.0.1:9", middleware="h:1")
    record = recorded_by_a_stranger(tmp_path / "x.mcap", scene)
    assert plotfeed_here("run", record, *SIMULATED, "--write", tmp_path / "again").returncode == 0
    first = plotfeed_here("convert", record, tmp_path / "first.ast")
    assert first.returncode == 0, first.stderr
    octets = (tmp_path / "first.ast").read_bytes()
    assert octets == (tmp_path / "again").read_bytes()
    assert max(len(block.body) + 3 for block in whole_blocks(octets)) <= 200


@pytest.mark.parametrize("name", ["{}/flight.csv", "../outside/flight.csv", "flight.csv", "../x"])
def test_it_reads_only_what_it_brings_along_which_is_unpacked_inside(
    tmp_path: Path, name: str
) -> None:
    folder, outside = tmp_path / "inner", tmp_path / "outside"
    for each in (folder, outside):
        each.mkdir()
    for place in (outside, tmp_path):
        for other in ("flight.csv", "x"):
            (place / other).write_bytes(CSV)
    name = name.format(outside)
    scene = scene_of(outside, drones=FLIGHT.format(file=name))
    bare = scene.model_copy(update={"drone": ()})  # of the same text, so that a record can be made
    assert bare.text == scene.text
    record = recorded_by_a_stranger(tmp_path / "bare.mcap", bare)
    done = plotfeed_here("run", record, *SIMULATED)
    assert done.returncode != 0
    assert done.stderr == (
        f"plotfeed: the recording names the file {name!r} and does not hold it\n"
    )
    planted = ("../y", "/y", "a/../../y", ".", "..", "", "secrets/../../y.toml")
    more = [Attachment(name=other, media_type="", data=b"planted") for other in planted]
    flight = Attachment(name=name, media_type="", data=CSV)
    record = recorded_by_a_stranger(tmp_path / "whole.mcap", bare, flight, *more)
    before = {*tmp_path.rglob("*")}
    unpacked = SessionRecord.open(record).scene(folder)
    (new,) = {*tmp_path.rglob("*")} - before
    assert new.resolve().parent == folder
    assert new == unpacked.file(name)
    assert new.read_bytes() == CSV
    if Path(name).suffix:  # by which the format of a flight is known
        done = plotfeed_here("run", record, *SIMULATED)
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("key", ["ca_file", "client_key_file", "credentials_file"])
def test_files_that_it_names_are_not_even_opened(tmp_path: Path, key: str) -> None:
    scene = scene_of(tmp_path, mqtt=f'broker = "mqtts://h"\n{key} = "/dev/zero"').enclosed({})
    assert scene.outgoing.mqtt.broker is None
    with pytest.raises(PlotfeedError, match="does not hold it"):
        scene.file("/dev/zero")


@pytest.mark.parametrize("option", ["--udp", "--middleware"])
def test_a_place_that_is_none_is_one_line(tmp_path: Path, option: str) -> None:
    scene = scene_file(tmp_path, scene_text(port=1883))
    done = plotfeed_here("run", scene, option, "nowhere", "--broker", "none", "--duration", "1")
    assert done.returncode == 2
    assert done.stderr.startswith(f"plotfeed: {option}: expected ")
    assert len(done.stderr.splitlines()) == 1


def test_a_recording_is_its_owners_alone(tmp_path: Path) -> None:
    record, converted = made(tmp_path, 1, tmp_path / "x.mcap"), tmp_path / "x.ast"
    assert stat.S_IMODE(record.stat().st_mode) == 0o600
    record.chmod(0o644)
    made(tmp_path, 1, record, "--force")
    assert plotfeed_here("convert", record, converted).returncode == 0
    for path in (record, converted):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_no_command_replaces_a_file_unasked(tmp_path: Path) -> None:
    record, scene = made(tmp_path, 1, tmp_path / "source.mcap"), tmp_path / "scene.toml"
    raw, log, picture, lean, full = (
        tmp_path / name for name in ("a.ast", "a.mcap", "a.png", "lean.toml", "full.toml")
    )
    soon = ("--runs", "2", "--duration", "2", "--chart", picture)
    writing: dict[tuple[object, ...], tuple[Path, ...]] = {
        ("run", scene, "--duration", "1", *SIMULATED, "--write", raw, "--record", log): (raw, log),
        ("convert", record, raw): (raw,),
        ("check", scene, "--chart", picture): (picture,),
        ("report", record, "--chart", picture): (picture,),
        ("chart", scene, *soon): (picture,),
        ("needs", scene, *soon, "--write", lean, "--write", full): (picture, lean, full),
    }
    for words, paths in writing.items():
        for path in paths:
            path.write_bytes(b"dear to somebody")
            done = plotfeed_here(*words)
            assert done.returncode == 2, words
            assert done.stderr == (
                f"plotfeed: {path}: is there already; --force writes another in its place\n"
            )
            assert path.read_bytes() == b"dear to somebody"
            path.unlink()
        for path in paths:
            path.write_bytes(b"dear to somebody")
        done = plotfeed_here(*words, "--force")
        assert done.returncode == 0, (words, done.stderr)
        for path in paths:
            assert path.read_bytes() != b"dear to somebody"
            path.unlink()


def test_it_opens_no_door_to_web_pages_and_claims_no_port(tmp_path: Path) -> None:
    listening_at, origin = free_port(), "http://stranger.example"
    doors = f'[mqtt.embedded]\nwebsocket_origins = ["{origin}"]'
    scene = scene_of(tmp_path, port=listening_at, mqtt=doors)
    assert scene.outgoing.mqtt.port == listening_at
    assert scene.outgoing.mqtt.embedded.websocket_origins == (origin,)
    record = recorded_by_a_stranger(tmp_path / "x.mcap", scene)
    with port_is_taken(listening_at), running("run", record) as again:
        assert not any("WebSocket" in line for line in again.introduction)
        assert all(port != listening_at for port, _ in again.ports())


def test_a_record_is_run_again_without_a_word_and_one_from_before_there_were_ticks_with_one(
    record: Path, tmp_path: Path
) -> None:
    old = tmp_path / "old.mcap"
    with McapReader(record) as mcap:
        attached = [mcap.attachment(entry.name) for entry in mcap.attachments()]
        messages = list(mcap.messages())
    with Recorder(old, attachments=filter(None, attached), waits=True) as recorder:
        for message in messages:
            if message.topic.endswith("/session"):
                told = json.loads(message.payload)
                assert told.pop("tick_ms") == 10
                message = message._replace(payload=json.dumps(told).encode())  # noqa: PLW2901
            recorder.write(message)
    for path, has_ticks, says in (
        (record, True, ""),
        (old, False, f"plotfeed: {old} was made before sessions went by ticks"),
    ):
        assert SessionRecord.open(path).has_ticks == has_ticks
        again = plotfeed_here("run", path, *SIMULATED)
        assert again.returncode == 0
        assert again.stderr.startswith(says)
        assert bool(again.stderr) == bool(says)
        assert json.loads(again.stdout)["messages"] > 0


@pytest.mark.asyncio
async def test_what_came_in_while_a_fast_clock_was_held_back_counts_again_as_it_did(
    tmp_path: Path,
) -> None:
    """Reports and changes from outside, at a speed that no machine holds: the same octets."""
    scene = scene_of(tmp_path, sensors=radar())
    path = tmp_path / "x.mcap"
    clock, watch = WallClock(START_NS, speed=10_000.0), AtWork(InstantClock(START_NS))

    async def asking() -> None:
        await watch.begins.wait()
        for number in range(10**9):
            report = {
                "time_utc": iso_utc(clock.now_ns()),
                "latitude_deg": 40.455 + 0.0001 * (number % 5),
                "longitude_deg": -3.72,
                "altitude_m": 900.0,
                "altitude_reference": "ELLIPSOID",
            }
            watch.session._hear("plotfeed/telemetry/other", json.dumps(report).encode(), JSON)
            change = {"sensor": "radar", "set": {"pfa_factor": 1 + number % 7}}
            if number % 2:  # as the page asks
                watch.session.command(change)
            else:
                watch.session._hear("plotfeed/control", json.dumps(change).encode(), JSON)
            await asyncio.sleep(0.002)

    with Recorder(path, attachments=attachments_of(scene, START_NS), waits=True) as recorder:
        beside = asyncio.create_task(asking())
        observer = SessionRecorder(recorder, ledger_is_sent=True)
        totals, first = await left_by(scene, clock, 60.0, watch, observer)
        beside.cancel()
    assert (totals.missed_scans, totals.speed) == (0, 10_000.0)
    assert 1 < (totals.speed_reached or 0) < 5_000
    assert min(totals.controls, totals.telemetry) > 5
    _, again = await left_by(scene, InstantClock(START_NS), 60.0, RecordedTelemetry(path))
    sectors = [(m.topic, m.payload) for m in first if "/asterix/" in m.topic]
    assert len(sectors) > 960
    assert sectors == [(m.topic, m.payload) for m in again if "/asterix/" in m.topic]


class SlowToConnect(InstantClock):
    """A session that connects for a while before its time begins."""

    def start(self) -> int:
        self.jump(self.now_ns() + 146_800_123)
        return super().start()


@pytest.mark.asyncio
async def test_scripted_drones_set_out_when_the_session_is_said_to_begin(tmp_path: Path) -> None:
    scene, path = scene_of(tmp_path, start_utc=None, sensors=radar()), tmp_path / "x.mcap"
    with Recorder(path, attachments=attachments_of(scene, 0), waits=True) as recorder:
        observer = SessionRecorder(recorder, ledger_is_sent=True)
        _, left = await left_by(scene, SlowToConnect(1_700_000_000 * NS), 4.0, observer)
    clock = InstantClock(SessionRecord.open(path).start_utc_ns)
    _, left_again = await left_by(scene, clock, 4.0)
    first, again = (
        sorted((m.topic, m.payload) for m in messages if not m.topic.endswith("/session"))
        for messages in (left, left_again)
    )
    assert first == again
    assert len(first) > 20


def test_a_folder_that_a_killed_run_has_left_is_cleared_by_the_next(
    record: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    (tmp_path / "tmp").mkdir()
    words = ("run", record, "--broker", "none", "--duration", "3600")
    with started(*words) as killed, started(*words):
        wait_until(lambda: len([*(tmp_path / "tmp").glob("plotfeed-run-*/lock")]) == 2)
        left = {*(tmp_path / "tmp").glob("plotfeed-run-*")}
        killed.kill()
        killed.wait()
        with pytest.MonkeyPatch.context() as anew:
            anew.setattr(tempfile, "tempdir", None)  # the environment says which
            assert plotfeed_here("run", record, *SIMULATED).returncode == 0
        still = {*(tmp_path / "tmp").glob("plotfeed-run-*")}
        assert len(still) == 1
        assert still < left


@pytest.mark.parametrize(
    "options", [("--start", "1", "--end", "2"), ("--topic", "plotfeed/radar/#")]
)
def test_a_part_of_a_record_is_a_record(
    options: tuple[str, ...], record: Path, tmp_path: Path
) -> None:
    part = tmp_path / "part.mcap"
    assert plotfeed_here("convert", record, part, *options).returncode == 0
    assert SessionRecord.open(part).start_utc_ns == SessionRecord.open(record).start_utc_ns
    again = plotfeed_here("run", part, *SIMULATED)
    assert (again.returncode, again.stderr) == (0, "")
    with McapReader(record) as whole, McapReader(part) as some:
        told = {m.topic: m.payload for m in whole.messages() if m.log_time_ns == START_NS}
        of_part = list(some.messages())
    if options[0] == "--start":
        first = {m.topic: m.payload for m in of_part if m.log_time_ns == START_NS + NS}
        for name in ("radar/settings", "radar/description", "session"):
            assert first[f"plotfeed/{name}"] == told[f"plotfeed/{name}"]
        assert all(START_NS + NS <= m.log_time_ns < START_NS + 2 * NS for m in of_part)
        report = plotfeed_here("report", part)
        assert "scene test" in report.stdout
        assert "cannot be used" not in report.stdout
    else:
        assert {m.topic.split("/")[1] for m in of_part} == {"radar", "session"}
