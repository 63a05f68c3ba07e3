"""A recording from a stranger, run again: it says neither what is read nor where anything goes."""

from __future__ import annotations

import asyncio
import json
import socket
import stat
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from support.brokers import free_port, port_is_taken
from support.command import plotfeed, plotfeed_here, running, started
from support.scene_files import radar, scene_file, scene_text
from support.sessions import AtWork
from support.waiting import wait_until

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.recording.recorder import (
    RecordedTelemetry,
    Recorder,
    SessionRecord,
    SessionRecorder,
    attachments_of,
)
from plotfeed.feeds.scene.scene import Scene, from_tree, load
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock, WallClock
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


@contextmanager
def ears(kind: socket.SocketKind) -> Iterator[tuple[socket.socket, str]]:
    with socket.socket(socket.AF_INET, kind) as listener:
        listener.bind(("127.0.0.1", 0))
        if kind is socket.SOCK_STREAM:
            listener.listen()
        listener.setblocking(False)
        yield listener, f"127.0.0.1:{listener.getsockname()[1]}"


def heard(listener: socket.socket) -> bool:
    """Whether anybody has connected, or sent a datagram."""
    try:
        if listener.type is socket.SOCK_STREAM:
            listener.accept()[0].close()
        else:
            listener.recv(65536)
    except BlockingIOError:
        return False
    return True


def scene_with(folder: Path, *, broker: str, udp: str, middleware: str) -> Scene:
    (folder / "secrets.toml").write_text(f'username = "somebody"\npassword = "{WHISPERED}"\n')
    text = scene_text(
        start_utc="2026-01-01T12:00:00Z",
        sensors=radar(more='report = ["asterix-048", "sapient"]'),
        port=1883,
        mqtt=f'broker = "mqtt://{broker}"\ncredentials_file = "{folder / "secrets.toml"}"',
    )
    text += f'[[udp]]\ndestination = "{udp}"\nmax_octets = 200\n'
    text += f'[sapient]\nmiddleware = "{middleware}"\n'
    return load(scene_file(folder, text))


def recorded_by_a_stranger(
    path: Path, scene: Scene, attachments: list[Attachment] | None = None
) -> Path:
    """A session's record with that scene's text, however its own session ran."""
    attached = Attachment(name="scene.toml", media_type="", data=scene.text.encode(), log_time_ns=0)
    with Recorder(path, attachments=[attached, *(attachments or [])], waits=True) as recorder:
        observers = [SessionRecorder(recorder, ledger_is_sent=True)]
        clock = InstantClock(scene.scene.start_utc_ns)
        asyncio.run(
            run(scene.enclosed({}), clock=clock, broker="none", duration_s=2, observers=observers)
        )
    return path


def test_it_is_sent_nowhere_and_no_secret_of_ours_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PLOTFEED_MQTT_USERNAME", "somebody")
    monkeypatch.setenv("PLOTFEED_MQTT_PASSWORD", WHISPERED)
    with ExitStack() as listening:
        listeners, places = zip(
            *(
                listening.enter_context(ears(kind))
                for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM, socket.SOCK_STREAM)
            ),
            strict=True,
        )
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
    written = tmp_path / "again"
    options = ("--speed", "max", "--broker", "none", "--write", written)
    assert plotfeed_here("run", record, *options).returncode == 0
    assert max(len(block) for block in blocks(written.read_bytes())) <= 200
    first = plotfeed_here("convert", record, tmp_path / "first.ast")
    assert first.returncode == 0, first.stderr
    assert (tmp_path / "first.ast").read_bytes() == written.read_bytes()


def blocks(octets: bytes) -> Iterator[bytes]:
    while octets:
        length = int.from_bytes(octets[1:3], "big")
        yield octets[:length]
        octets = octets[length:]


@pytest.mark.parametrize("name", ["{}/flight.csv", "../outside/flight.csv", "flight.csv"])
def test_it_reads_only_what_it_brings_along(tmp_path: Path, name: str) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    for folder in (outside, tmp_path):
        (folder / "flight.csv").write_bytes(CSV)
    name = name.format(outside)
    text = scene_text(start_utc="2026-01-01T12:00:00Z", port=1883, drones=FLIGHT.format(file=name))
    scene = load(scene_file(outside, text))
    bare = recorded_by_a_stranger(tmp_path / "bare.mcap", without_flights(scene))
    done = plotfeed_here("run", bare, "--speed", "max", "--broker", "none")
    assert done.returncode != 0
    assert done.stderr == (
        f"plotfeed: the recording names the file {name!r} and does not hold it\n"
    )
    flight = Attachment(name=name, media_type="", data=CSV, log_time_ns=0)
    whole = recorded_by_a_stranger(tmp_path / "whole.mcap", without_flights(scene), [flight])
    done = plotfeed_here("run", whole, "--speed", "max", "--broker", "none", "--json")
    assert done.returncode == 0, done.stderr


def without_flights(scene: Scene) -> Scene:
    """A scene of that text that flies nothing, so that a record of it can be made."""
    other = scene.model_copy(update={"drone": ()})
    assert other.text == scene.text
    return other


@pytest.mark.parametrize("name", ["../x", "../outside/flight.csv", "{}/flight.csv"])
def test_what_its_scene_names_outside_is_unpacked_inside_and_nothing_else_is(
    tmp_path: Path, name: str
) -> None:
    folder, outside = tmp_path / "inner", tmp_path / "outside"
    folder.mkdir()
    outside.mkdir()
    name = name.format(outside)
    text = scene_text(start_utc="2026-01-01T12:00:00Z", port=1883, drones=FLIGHT.format(file=name))
    scene = without_flights(load(scene_file(outside, text)))
    planted = [
        Attachment(name=other, media_type="", data=b"planted")
        for other in ("../y", "/y", "a/../../y", ".", "..", "", "secrets/../../y.toml")
    ]
    flight = Attachment(name=name, media_type="", data=CSV)
    record = recorded_by_a_stranger(tmp_path / "x.mcap", scene, [flight, *planted])
    before = everything_in(tmp_path)
    unpacked = SessionRecord.open(record).scene(folder)
    (new,) = everything_in(tmp_path) - before
    assert new.resolve().parent == folder
    assert new == unpacked.file(name)
    assert new.read_bytes() == CSV


def everything_in(folder: Path) -> set[Path]:
    return set(folder.rglob("*"))


@pytest.mark.parametrize("key", ["ca_file", "client_key_file", "credentials_file"])
def test_files_that_it_names_are_not_even_opened(tmp_path: Path, key: str) -> None:
    tree = {
        "scene": {"name": "x", "seed": 1, "site": SITE},
        "mqtt": {"broker": "mqtts://h", key: "/dev/zero"},
        "sensor": [{"id": "mic", "preset": "widealert"}],
    }
    scene = from_tree(tree, tmp_path / "scene.toml").enclosed({})
    assert scene.outgoing.mqtt.broker is None
    with pytest.raises(PlotfeedError, match="does not hold it"):
        scene.file("/dev/zero")


SITE = {"latitude_deg": 40.0, "longitude_deg": -3.0, "height_m": 600.0}


@pytest.mark.parametrize("option", ["--udp", "--middleware"])
def test_a_place_that_is_none_is_one_line(tmp_path: Path, option: str) -> None:
    scene = scene_file(tmp_path, scene_text(port=1883))
    done = plotfeed_here("run", scene, option, "nowhere", "--broker", "none", "--duration", "1")
    assert done.returncode == 2
    assert done.stderr.startswith(f"plotfeed: {option}: expected ")
    assert len(done.stderr.splitlines()) == 1


def mode_of(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_recording_is_its_owners_alone(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text(start_utc="2026-01-01T12:00:00Z", port=1883))
    record, converted = tmp_path / "x.mcap", tmp_path / "x.ast"
    simulated = ("--speed", "max", "--broker", "none", "--duration", "1", "--json")
    assert plotfeed_here("run", scene, *simulated, "--record", record).returncode == 0
    assert mode_of(record) == 0o600
    record.chmod(0o644)
    assert plotfeed_here("run", scene, *simulated, "--record", record, "--force").returncode == 0
    assert mode_of(record) == 0o600
    assert plotfeed_here("convert", record, converted).returncode == 0
    assert mode_of(converted) == 0o600


Command = Callable[..., subprocess.CompletedProcess[str]]


def written_by(tmp_path: Path) -> dict[str, tuple[tuple[Path, ...], Command]]:
    """The files that each command writes, and the command."""
    scene = scene_file(tmp_path, scene_text(start_utc="2026-01-01T12:00:00Z", port=1883))
    record = tmp_path / "source.mcap"
    simulated = ("--speed", "max", "--broker", "none", "--duration", "1", "--json")
    assert plotfeed_here("run", scene, *simulated, "--record", record).returncode == 0

    def command(*words: object) -> Command:
        return lambda *more: plotfeed_here(*words, *more)

    raw, log, picture = (tmp_path / f"a.{kind}" for kind in ("ast", "mcap", "png"))
    lean, full = tmp_path / "lean.toml", tmp_path / "a-full.toml"
    soon = ("--runs", "2", "--duration", "2")
    needs = command("needs", scene, *soon, "--chart", picture, "--write", lean, "--write", full)
    return {
        "run": ((raw, log), command("run", scene, *simulated, "--write", raw, "--record", log)),
        "convert": ((raw,), command("convert", record, raw)),
        "check": ((picture,), command("check", scene, "--chart", picture)),
        "report": ((picture,), command("report", record, "--chart", picture)),
        "chart": ((picture,), command("chart", scene, *soon, "--chart", picture)),
        "needs": ((picture, lean, full), needs),
    }


def test_no_command_replaces_a_file_unasked(tmp_path: Path) -> None:
    for name, (paths, run_command) in written_by(tmp_path).items():
        for path in paths:
            path.write_bytes(b"dear to somebody")
            done = run_command()
            assert done.returncode == 2, name
            assert done.stderr == (
                f"plotfeed: {path}: is there already; --force writes another in its place\n"
            )
            assert path.read_bytes() == b"dear to somebody"
            if path is not paths[-1]:
                path.unlink()
        for path in paths:
            path.write_bytes(b"dear to somebody")
        done = run_command("--force")
        assert done.returncode == 0, (name, done.stderr)
        for path in paths:
            assert path.read_bytes() != b"dear to somebody"
            path.unlink()


def test_it_opens_no_door_to_web_pages_and_claims_no_port(tmp_path: Path) -> None:
    listening_at, origin = free_port(), "http://stranger.example"
    text = scene_text(
        start_utc="2026-01-01T12:00:00Z",
        port=listening_at,
        mqtt=f'[mqtt.embedded]\nwebsocket_origins = ["{origin}"]',
    )
    scene = load(scene_file(tmp_path, text))
    assert scene.outgoing.mqtt.port == listening_at
    assert scene.outgoing.mqtt.embedded.websocket_origins == (origin,)
    record = recorded_by_a_stranger(tmp_path / "x.mcap", scene)
    with port_is_taken(listening_at), running("run", record) as again:
        assert not any("WebSocket" in line for line in again.introduction)
        assert all(port != listening_at for port, _ in again.ports())


START_NS = 1_767_268_800 * NS
SIMULATED = ("--speed", "max", "--broker", "none", "--json")


@pytest.fixture
def record(tmp_path: Path) -> Path:
    text = scene_text(start_utc="2026-01-01T12:00:00Z", sensors=radar(), port=1883)
    path = tmp_path / "record.mcap"
    scene = scene_file(tmp_path, text)
    done = plotfeed_here("run", scene, "--duration", "3", "--record", path, *SIMULATED)
    assert done.returncode == 0, done.stderr
    return path


def without_ticks(record: Path, path: Path) -> Path:
    """The record as a session made it that knew no ticks."""
    with McapReader(record) as mcap:
        attached = [mcap.attachment(entry.name) for entry in mcap.attachments()]
        messages = list(mcap.messages())
    recorder = Recorder(path, attachments=[one for one in attached if one is not None], waits=True)
    for message in messages:
        if message.topic.endswith("/session"):
            told = json.loads(message.payload)
            assert told.pop("tick_ms") == 10
            message = message._replace(payload=json.dumps(told).encode())  # noqa: PLW2901
        recorder.write(message)
    recorder.close()
    return path


def test_a_record_is_run_again_without_a_word(record: Path) -> None:
    assert SessionRecord.open(record).has_ticks
    again = plotfeed_here("run", record, *SIMULATED)
    assert again.returncode == 0
    assert again.stderr == ""
    assert json.loads(again.stdout)["messages"] > 0


def test_a_record_from_before_there_were_ticks_is_run_and_told_of(
    record: Path, tmp_path: Path
) -> None:
    old = without_ticks(record, tmp_path / "old.mcap")
    assert not SessionRecord.open(old).has_ticks
    again = plotfeed_here("run", old, *SIMULATED)
    assert again.returncode == 0
    assert again.stderr.startswith(f"plotfeed: {old} was made before sessions went by ticks")
    assert json.loads(again.stdout)["messages"] > 0


@pytest.mark.asyncio
async def test_what_came_in_while_a_fast_clock_was_held_back_counts_again_as_it_did(
    tmp_path: Path,
) -> None:
    """Reports and changes from outside, at a speed that no machine holds: the same octets."""
    text = scene_text(start_utc="2026-01-01T12:00:00Z", sensors=radar(), port=1883)
    scene = load(scene_file(tmp_path, text))
    path, first, again = tmp_path / "x.mcap", list[Message](), list[Message]()
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
        totals = await run(
            scene,
            clock=clock,
            broker="none",
            duration_s=60.0,
            observers=[watch, SessionRecorder(recorder, ledger_is_sent=True)],
            tap=lambda message, _t: first.append(message),
        )
        beside.cancel()
    assert (totals.missed_scans, totals.speed) == (0, 10_000.0)
    assert 1 < (totals.speed_reached or 0) < 5_000
    assert min(totals.controls, totals.telemetry) > 5
    await run(
        scene,
        clock=InstantClock(START_NS),
        broker="none",
        duration_s=60.0,
        observers=[RecordedTelemetry(path)],
        tap=lambda message, _t: again.append(message),
    )
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
    scene = load(scene_file(tmp_path, scene_text(sensors=radar(), port=1883)))
    path, first, again = tmp_path / "x.mcap", list[Message](), list[Message]()
    with Recorder(path, attachments=attachments_of(scene, 0), waits=True) as recorder:
        observers = [SessionRecorder(recorder, ledger_is_sent=True)]
        clock = SlowToConnect(1_700_000_000_000_000_000)
        taps = {"tap": lambda message, _t: first.append(message)}
        await run(scene, clock=clock, broker="none", duration_s=4.0, observers=observers, **taps)
    clock = InstantClock(SessionRecord.open(path).start_utc_ns)
    taps = {"tap": lambda message, _t: again.append(message)}
    await run(scene, clock=clock, broker="none", duration_s=4.0, **taps)
    first, again = (
        sorted((m.topic, m.payload) for m in messages if not m.topic.endswith("/session"))
        for messages in (first, again)
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
