"""All that takes octets from outside, each as a function that fails only by errors of our own."""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import io
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from unittest.mock import AsyncMock, Mock

from support.read_here import found_here

from plotfeed.feeds.engine import terrain_files
from plotfeed.feeds.formats.told_tracks import tracks_in
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.page.scene_outline import load_basemap
from plotfeed.feeds.page.updates import ControlRequest, request_in
from plotfeed.feeds.recording.decoded_text import message_lines
from plotfeed.feeds.recording.record_text import Style
from plotfeed.feeds.scene.changes import changed, command_of, parsed
from plotfeed.feeds.scene.output_keys import RemoteIdService
from plotfeed.feeds.scene.scene import example
from plotfeed.feeds.scene.scene import parsed as scene_in
from plotfeed.feeds.scene.telemetry_keys import KINDS, TelemetryMapping, TelemetrySource
from plotfeed.feeds.telemetry.flights import (
    BY_SUFFIX,
    FlightOptions,
    Reader,
    autopilot_logs,
    markup,
)
from plotfeed.feeds.telemetry.flights.flight import Log
from plotfeed.feeds.telemetry.live.heard import UNFORESEEN
from plotfeed.feeds.telemetry.live.mapped_reports import MappedReports
from plotfeed.feeds.telemetry.live.remote_id import NetworkRemoteIdReports
from plotfeed.feeds.telemetry.position_report import Refused, decode, fast_decode
from plotfeed.feeds.transport.http import HttpClient
from plotfeed.feeds.transport.listening import RemoteIdTransport
from plotfeed.feeds.transport.live_source import listener_of
from plotfeed.feeds.transport.mqtt.broker import Broker, Rights
from plotfeed.feeds.transport.mqtt.packets import (
    BrokerReader,
    connect_packet,
    publish_packet,
    subscribe_packet,
)
from plotfeed.feeds.transport.sapient import next_message
from plotfeed.models.frames import LocalFrame
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.asterix.codec.decode import decode_lenient
from plotfeed.proto.asterix.decode_plots import plots_and_tracks_in
from plotfeed.proto.content_types import JSON, SAPIENT_MESSAGE, TRACK_BATCH, protobuf_content_type
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.plot_messages import plots_in_batch
from plotfeed.replay.files import FORMATS, FileFormat

Target = Callable[[bytes], object]
MOST = 2_000  # Messages that are looked at of one file
NS_2026 = 1_767_225_600_000_000_000
SENSOR = example("section-4").sensor[0]


def asterix(data: bytes) -> None:
    """Records, and the plots in them."""
    decode_lenient(data)
    plots_and_tracks_in(data, NS_2026)


def plots(data: bytes) -> None:
    """A batch of our own."""
    plots_in_batch(data)


TRACK_TYPES = ("", protobuf_content_type(TRACK_BATCH), protobuf_content_type(SAPIENT_MESSAGE))
CONTENT_TYPES = (None, "application/json", "application/x-protobuf", "application/asterix")


def telemetry(data: bytes) -> None:
    """A report, by its content type; the fast way says what the careful one says, or nothing."""
    content_type = CONTENT_TYPES[data[0] % len(CONTENT_TYPES)] if data else None
    fast = fast_decode(data[1:], content_type)
    report = decode(data[1:], content_type, now_utc_ns=NS_2026)
    assert fast is None or repr(fast) == repr(report)


def fast_telemetry(data: bytes) -> None:
    """What the fast way takes the careful one takes."""
    if fast_decode(data, None) is not None:
        try:
            decode(data, None)
        except PlotfeedError as error:
            raise AssertionError(f"taken, and refused: {error}") from error


def control(data: bytes) -> None:
    """A command from the control topic, and what becomes of a sensor."""
    command = parsed(data)
    if command.set is not None:
        changed(SENSOR, command.set)


def page(data: bytes) -> None:
    """What a browser says."""
    request = request_in(data.decode("utf-8", "replace"))
    if isinstance(request, ControlRequest) and isinstance(request.command, dict):
        command = command_of(request.command)
        if command.set is not None:
            changed(SENSOR, command.set)


def scene(data: bytes) -> None:
    """A scene file."""
    scene_in(data, Path("scene.toml"))


def sapient(data: bytes) -> None:
    """What a SAPIENT middleware says."""
    from plotfeed.proto.sapient.decode_sapient import decode, decode_heard, decode_task

    for read in (decode, decode_heard, decode_task):
        with contextlib.suppress(PlotfeedError):
            read(data)


def shown(data: bytes) -> None:
    """A message as `show` prints it, whatever its content type says."""
    head, _, payload = data.partition(b"\0")
    for style in Style:
        for line in message_lines("a/b", payload, head.decode("utf-8", "replace"), style, {}):
            assert style is not Style.JSON or json.loads(line)


def recording(form: FileFormat) -> Target:
    """A recording of that format."""

    def read(data: bytes) -> None:
        reader = FORMATS[form].reader
        assert reader is not None
        opened = reader(io.BytesIO(data), 0)
        opened.attachments()
        for _, _message in zip(range(MOST), opened.messages(), strict=False):
            pass

    return read


def live(kind: str) -> Target:
    """What comes from a live source of that kind, in two pieces."""

    def read(data: bytes) -> None:
        listener = listener_of(TelemetrySource(url=LIVE[kind]))
        cut = data[0] if data else 0
        for piece in (data[1 : 1 + cut], data[1 + cut :]):
            for heard in listener.hear("1.2.3.4:5", piece, NS_2026):
                assert len(heard.drone) <= 64

    return read


LIVE = {kind: f"{kind}:udp::1" for kind in KINDS}


def flight(reader: Reader) -> Target:
    """A flight's log, by that reader."""

    def read(data: bytes) -> None:
        options = FlightOptions(altitude_reference=AltitudeReference.ELLIPSOID)
        reader(data, options, Log())

    return read


def mapped(data: bytes) -> None:
    """JSON of another system, by a mapping."""
    keys = {name: f"a.{name}" for name in ("latitude", "longitude", "altitude", "time", "speed")}
    tree = {"topic": "a/{drone}", "altitude_reference": "ellipsoid", "course": "c.1", **keys}
    heard = MappedReports([TelemetryMapping.model_validate(tree)]).hear("a/b", data, NS_2026)
    assert heard is not None
    assert not (isinstance(heard.said, Refused) and UNFORESEEN in heard.said.detail)


def network_remote_id(data: bytes) -> None:
    """An answer of a service provider."""
    list(NetworkRemoteIdReports("{id}").hear("", data, NS_2026))


def http_answer(data: bytes) -> None:
    """What a server says, whose answer is waited for no longer than it is there."""

    async def ask() -> None:
        client, reader = HttpClient("http://127.0.0.1/", None), asyncio.StreamReader(limit=1 << 16)
        reader.feed_data(data)
        reader.feed_eof()
        client._streams = reader, AsyncMock(write=Mock(), close=Mock())
        await client.ask("GET", (), b"", timeout_s=60.0, most=1 << 20)

    asyncio.run(ask())


def remote_id_request(data: bytes) -> None:
    """What somebody asks our service of network Remote ID."""
    settings = RemoteIdService(host="127.0.0.1", port=1)
    RemoteIdTransport(settings, lambda: NS_2026)._answer(data.decode("latin-1"))


def mqtt_packets(data: bytes) -> None:
    """What a broker says."""
    for version in (4, 5):
        with contextlib.suppress(PlotfeedError):
            list(BrokerReader(version).receive(data))


def mqtt_broker(data: bytes) -> None:
    """What a client says to our broker, which serves another one all the same."""
    broker, heard = Broker(anonymous=Rights()), bytearray()
    good = broker.connect(heard.extend, Mock())
    good.receive(HELLO)
    bad = broker.connect(Mock(), Mock())
    bad.receive(data[:30])
    bad.receive(data[30:])
    broker.tick(1.0)
    bad.end()
    had = len(heard)
    good.receive(SAID)
    assert len(heard) > had


SAID = publish_packet(Message(topic="a", payload=b"{}", content_type=JSON, due_utc_ns=0), 5)
HELLO = connect_packet("good", 5, keep_alive_s=60) + subscribe_packet(1, "#", 5)


def sapient_frames(data: bytes) -> None:
    """A stream of a SAPIENT middleware."""

    async def read() -> None:
        octets = asyncio.StreamReader()
        octets.feed_data(data)
        octets.feed_eof()
        with contextlib.suppress(EOFError):
            while True:
                await next_message(octets)

    asyncio.run(read())


def raster(data: bytes) -> None:
    """A file of that name, whatever is in it."""
    (FOLDER / "a.tif").write_bytes(data)
    terrain_files._tile(FOLDER / "a.tif", "a.tif")


def hgt(data: bytes) -> None:
    """A tile of SRTM."""
    terrain_files._of_hgt(data, "N40W004.hgt")


def buildings(data: bytes) -> None:
    """Footprints."""
    (FOLDER / "a.json").write_bytes(data)
    list(terrain_files._footprints(FOLDER / "a.json", "a.json", "height"))


def basemap(data: bytes) -> None:
    """What lies under the page's map."""
    (FOLDER / "a.geojson").write_bytes(data)
    load_basemap("a.geojson", FOLDER / "a.geojson", example("section-4").scene.site)


def tracker(data: bytes) -> None:
    """What the tracker under test publishes, by its content type."""
    content_type = TRACK_TYPES[data[0] % len(TRACK_TYPES)] if data else ""
    tracks_in(data[1:], content_type, NS_2026, LocalFrame(40.0, -3.0, 600.0))


# What these tests try is what is found, not in which process.
for module in (autopilot_logs, markup, terrain_files):
    module.read_apart = found_here
FOLDER = Path(mkdtemp(prefix="plotfeed-fuzz-"))
atexit.register(rmtree, FOLDER, ignore_errors=True)

TARGETS: Mapping[str, Target] = {
    "http-answer": http_answer,
    "remote-id-request": remote_id_request,
    "mqtt-packets": mqtt_packets,
    "mqtt-broker": mqtt_broker,
    "sapient-frames": sapient_frames,
    "raster": raster,
    "hgt": hgt,
    "buildings": buildings,
    "basemap": basemap,
    "mapped": mapped,
    "network-remote-id": network_remote_id,
    "asterix": asterix,
    "plots": plots,
    "telemetry": telemetry,
    "fast-telemetry": fast_telemetry,
    "control": control,
    "page": page,
    "scene": scene,
    "sapient": sapient,
    "shown": shown,
    "tracker": tracker,
    **{f"recording-{form}": recording(form) for form, f in FORMATS.items() if f.reader},
    **{f"live-{kind}": live(kind) for kind in LIVE},
    **{f"flight-{suffix[1:]}": flight(reader) for suffix, reader in BY_SUFFIX.items()},
}


FLIGHTS, LIVES, RECORDINGS = (
    tuple(name for name in TARGETS if name.startswith(kind))
    for kind in ("flight-", "live-", "recording-")
)
# By module of `feeds`, what comes in by the doors that it opens; nothing where nobody reads it.
DOORS: Mapping[str, tuple[str, ...]] = {
    "engine/terrain_files.py": ("raster", "hgt", "buildings"),
    "console/cluster.py": (),
    "page/application.py": ("page",),
    "page/server.py": ("page",),
    "page/scene_outline.py": ("basemap",),
    "recording/record.py": ("shown", *RECORDINGS),
    "telemetry/flights/__init__.py": FLIGHTS,
    "telemetry/flights/autopilot_logs.py": ("flight-ulg",),
    "telemetry/flights/markup.py": ("flight-gpx", "flight-kml"),
    "testing/mqtt_receiver.py": (),
    "transport/broker_process.py": ("mqtt-broker",),
    "transport/http.py": ("http-answer",),
    "transport/listening.py": ("remote-id-request",),
    "transport/live_source.py": (*LIVES, "network-remote-id"),
    "transport/mqtt/connection.py": (
        *("mqtt-packets", "telemetry", "fast-telemetry", "mapped", "control", "tracker"),
    ),
    "transport/sapient.py": ("sapient", "sapient-frames"),
    "transport/tak.py": (),
}


def attempt(name: str, data: bytes) -> bool:
    """Whether a target takes that; raises what it must not raise."""
    try:
        TARGETS[name](data)
    except PlotfeedError as error:
        assert len(str(error)) < 20_000
        return False
    return True
