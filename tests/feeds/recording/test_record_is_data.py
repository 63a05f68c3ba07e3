"""A recording from a stranger, run again: it says neither what is read nor where anything goes."""

from __future__ import annotations

import asyncio
import socket
import stat
import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from support.brokers import free_port, port_is_taken
from support.command import plotfeed, plotfeed_here, running
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.recording.recorder import Recorder, SessionRecord, SessionRecorder
from plotfeed.feeds.scene.scene import Scene, from_tree, load
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.proto.errors import PlotfeedError
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


def test_nothing_it_holds_is_written_elsewhere(tmp_path: Path) -> None:
    names = ["../x", "/x", "a/../../x", ".", "..", "", "secrets/../../x.toml"]
    attachments = [
        Attachment(name=name, media_type="", data=b"planted", log_time_ns=0) for name in names
    ]
    scene = load(scene_file(tmp_path, scene_text(start_utc="2026-01-01T12:00:00Z", port=1883)))
    record = recorded_by_a_stranger(tmp_path / "x.mcap", scene, attachments)
    folder = tmp_path / "room" / "inner"
    folder.mkdir(parents=True)
    before = everything_in(tmp_path)
    SessionRecord.open(record).scene(folder)
    assert everything_in(tmp_path) == before


@pytest.mark.parametrize("name", ["../x", "../outside/flight.csv", "{}/flight.csv"])
def test_what_its_scene_names_outside_is_unpacked_inside(tmp_path: Path, name: str) -> None:
    folder, outside = tmp_path / "inner", tmp_path / "outside"
    folder.mkdir()
    outside.mkdir()
    name = name.format(outside)
    text = scene_text(start_utc="2026-01-01T12:00:00Z", port=1883, drones=FLIGHT.format(file=name))
    scene = without_flights(load(scene_file(outside, text)))
    flight = Attachment(name=name, media_type="", data=CSV, log_time_ns=0)
    record = recorded_by_a_stranger(tmp_path / "x.mcap", scene, [flight])
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
    assert scene.outgoing.broker is None
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

    raw, log, picture, text = (tmp_path / f"a.{kind}" for kind in ("ast", "mcap", "png", "toml"))
    soon = ("--runs", "2", "--duration", "2")
    needs = command("needs", scene, *soon, "--chart", picture, "--lean", text, "--full", raw)
    return {
        "run": ((raw, log), command("run", scene, *simulated, "--write", raw, "--record", log)),
        "convert": ((raw,), command("convert", record, raw)),
        "check": ((picture,), command("check", scene, "--chart", picture)),
        "report": ((picture,), command("report", record, "--chart", picture)),
        "chart": ((picture,), command("chart", scene, *soon, "--chart", picture)),
        "needs": ((picture, text, raw), needs),
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
    assert scene.outgoing.port == listening_at
    assert scene.outgoing.embedded.websocket_origins == (origin,)
    record = recorded_by_a_stranger(tmp_path / "x.mcap", scene)
    with port_is_taken(listening_at), running("run", record) as again:
        assert not any("WebSocket" in line for line in again.introduction)
        assert all(port != listening_at for port, _ in again.ports())
