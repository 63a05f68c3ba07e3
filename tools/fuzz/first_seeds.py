"""What fuzzing begins with: whatever is well-formed, as our own encoders and scenes make it."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path

from fuzz.targets import CONTENT_TYPES, HELLO, NS_2026, SAID
from support.scene_files import DRONE, radar, scene_text

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import parsed
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.feeds.transport.sapient import framed
from plotfeed.models.state import AltitudeReference
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.replay.files import FORMATS
from plotfeed.replay.recorded import Recorded, Stage
from plotfeed.testing import fly

GOLDEN = Path(__file__).parents[2] / "tests" / "golden"
# Inputs that once broke something, in a folder for each target.
KEPT = Path(__file__).parent / "seeds"
REPORTS = 'report = ["asterix-048", "asterix-015", "asterix-062", "plots", "sapient"]'
GPX = """<?xml version="1.0"?>
<gpx version="1.1" creator="t" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>
<trkpt lat="50.0" lon="3.0"><ele>100</ele><time>2022-05-01T00:00:00Z</time></trkpt>
<trkpt lat="50.0" lon="3.1"><ele>101</ele><time>2022-05-01T00:00:01.5+02:00</time></trkpt>
</trkseg></trk></gpx>"""
SRT = """1
00:00:00,000 --> 00:00:00,033
<font size="36">SrtCnt : 1, DiffTime : 33ms
2024-05-01 12:00:00,000,000
[latitude: 40.45] [longitude: -3.73] [rel_alt: 10.0 abs_alt: 700.0] </font>

"""
TABLE = """time,latitude_deg,longitude_deg,altitude_m
2026-01-01T12:00:00Z,40.46,-3.73,900
2026-01-01T12:00:01.5Z,40.46,-3.74,901
"""
AIRBORNE = bytes.fromhex("ff12222364fe595e1c18b3ddc6fd600dc30d48084b33aa470200")
SBS_1 = b"MSG,3,1,1,484412,1,,,,,,10000,,,52.25,3.9,,,,,,0\r\n"
BEAST = b"".join(
    b"\x1a3" + bytes(7) + bytes.fromhex(text)
    for text in ("8D40621D58C386435CC412692AD6", "8D40621D58C382D690C8AC2863A7")
)
A_021 = bytes.fromhex("1500160319400e666666feaf385348441200004003e8")
COMMANDS = (
    {"sensor": "active", "set": {"pfa": 1e-4, "link": {"latency_ms": 70.0}}},
    {"sensor": "active", "reset": True},
    {"clock": {"paused": True}},
    {"clock": {"speed": 3.0, "step_s": 1.0}},
)


@cache
def messages() -> tuple[Message, ...]:
    """Of a session of two turns, one message of each kind."""
    text = scene_text(start_utc="2026-01-01T12:00:00Z", sensors=radar(more=REPORTS), port=1883)
    scene = parsed(text.encode(), Path("scene.toml"))
    sent = fly(scene, 1.0, scene.scene.start_utc_ns or 0).messages
    return tuple({f"{m.topic} {m.content_type} {len(m.payload) > 20}": m for m in sent}.values())


def seeds_of(target: str) -> Iterator[bytes]:
    """Seeds for a target, those that were kept among them."""
    kind, _, form = target.partition("-")
    yield b""
    yield from (path.read_bytes() for path in sorted((KEPT / target).glob("*")))
    yield from (path.read_bytes() for path in sorted((GOLDEN / f"{kind}s").glob(f"*.{form}")))
    yield from _recordings(form) if kind == "recording" else OF_TARGET.get(target, list)()


def _payloads(part: str) -> Iterator[bytes]:
    return (message.payload for message in messages() if part in message.topic)


def _shown() -> Iterator[bytes]:
    return (m.content_type.encode() + b"\0" + m.payload for m in messages())


def _telemetry() -> Iterator[bytes]:
    for n, content_type in enumerate(CONTENT_TYPES):
        yield from (bytes([n]) + payload for payload in _reports(content_type))


def _page() -> Iterator[bytes]:
    for number, command in enumerate(COMMANDS):
        yield json.dumps({"number": number, "command": command}).encode()
    yield b'{"look": {"truth": true, "watch": ["radar"]}}'


def _mavlink() -> Iterator[bytes]:
    from pymavlink.dialects.v20 import common

    mav = common.MAVLink(None, srcSystem=1, srcComponent=1)
    for message in (
        mav.system_time_encode(NS_2026 // 1000, 5000),
        mav.global_position_int_encode(5000, 404500000, -37300000, 7000, 1000, 1, 2, 3, 0),
        mav.gps_raw_int_encode(5000, 3, 404500000, -37300000, 7000, 1, 2, 3, 4, 9, 5, 6, 7, 8),
    ):
        yield b"\x10" + bytes(message.pack(mav))


def _tracker() -> Iterator[bytes]:
    yield from (b"\0" + payload for payload in _payloads("/asterix/062"))
    yield b'\0{"track": 7, "latitude_deg": 40.0, "longitude_deg": -3.0, "sigma_east_m": 2.5}'
    point = {"type": "Point", "coordinates": [-3.0, 40.0, 700.0]}
    feature = {"type": "Feature", "id": "a", "geometry": point, "properties": {"speed_m_s": 3.0}}
    yield b"\0" + json.dumps({"type": "FeatureCollection", "features": [feature]}).encode()
    yield b'\0<event uid="a" time="2026-01-01T12:00:00Z"><point lat="40" lon="-3" ce="9"/>'
    line = {"type": "LineString", "coordinates": [[-3.0, 40.0, 700.0]]}
    timed = feature | {"geometry": line, "properties": {"coordTimes": ["2026-01-01T12:00:00Z"]}}
    yield b"\0" + json.dumps(timed).encode()
    track = pb.Track(id="a-1", number=1, time_utc_ns=NS_2026, latitude_deg=40.0, sigma_up_m=3.0)
    yield b"\x01" + pb.TrackBatch(sensor="a", tracks=[track]).SerializeToString()
    yield from (b"\x02" + payload for payload in _payloads("sapient"))


def _raster() -> Iterator[bytes]:
    import numpy as np
    import rasterio
    from rasterio.transform import Affine

    place, how = Affine(0.1, 0.0, -4.0, 0.0, -0.1, 41.0), {"crs": "EPSG:4326", "nodata": -1}
    with rasterio.MemoryFile() as memory:
        with memory.open(
            driver="GTiff", count=1, width=8, height=8, dtype="int16", transform=place, **how
        ) as file:
            file.write(np.full((8, 8), 700, np.int16), 1)
        yield memory.read()


RING = [[-3.73, 40.45], [-3.72, 40.45], [-3.72, 40.46], [-3.73, 40.45]]
HOUSE = {"type": "Polygon", "coordinates": [RING]}
HOUSES = {"features": [{"properties": {"height": 9}, "geometry": HOUSE}]}
ASKED = (
    b"GET /uss/flights?view=40.44,-3.75,40.46,-3.72 HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    b"GET /display_data/a HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer a\r\n\r\n",
)
ANSWERS = (
    b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n{}",
    b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n",
)
EVIL = HELLO.replace(b"good", b"evil")
PACKETS = bytes.fromhex("20020000 9003000101 3007000161 7b7d7d7d d000")


OF_TARGET: dict[str, Callable[[], Iterable[bytes]]] = {
    "raster": _raster,
    "hgt": lambda: [bytes(2 * 3 * 3)],
    "buildings": lambda: [json.dumps(HOUSES).encode()],
    "basemap": lambda: [json.dumps({"type": "Feature", "geometry": HOUSE}).encode()],
    "remote-id-request": lambda: ASKED,
    "http-answer": lambda: ANSWERS,
    "mqtt-packets": lambda: [PACKETS],
    "mqtt-broker": lambda: [EVIL + SAID, EVIL + SAID + bytes.fromhex("c000a20400020161e000")],
    "sapient-frames": lambda: map(framed, _payloads("sapient")),
    "asterix": lambda: _payloads("/asterix/"),
    "plots": lambda: _payloads("/plots"),
    "sapient": lambda: _payloads("sapient"),
    "shown": _shown,
    "tracker": _tracker,
    "telemetry": _telemetry,
    "fast-telemetry": lambda: _reports(None),
    "control": lambda: (json.dumps(command).encode() for command in COMMANDS),
    "page": _page,
    "scene": lambda: [scene_text(port=1883, drones=DRONE).encode()],
    "live-remote-id": lambda: [AIRBORNE],
    "live-mavlink": _mavlink,
    "live-sbs1": lambda: [b"\x10" + SBS_1],
    "live-beast": lambda: [b"\x10" + BEAST],
    "live-asterix-021": lambda: [b"\x09" + A_021],
    "mapped": lambda: [
        b'{"a": {"latitude": 40, "longitude": 3, "altitude": 9, "speed": 2,'
        b' "time": "2026-01-01T00:00:00Z"}, "c": [1, 2]}'
    ],
    "network-remote-id": lambda: [
        b'{"flights": [{"id": "a", "current_state": {"timestamp": {"value": "2026-01-01T00:00:00Z"'
        b'}, "position": {"lat": 40, "lng": 3, "alt": 90, "accuracy_h": "HA3m"}, "speed": 3}}]}'
    ],
    "flight-srt": lambda: [SRT.encode()],
    "flight-ulg": lambda: [(GOLDEN / "flights" / "part.ulg").read_bytes()],
    "flight-gpx": lambda: [GPX.encode()],
    "flight-csv": lambda: [TABLE.encode()],
    "flight-txt": lambda: [TABLE.encode()],
    "flight-tsv": lambda: [TABLE.replace(",", "\t").encode()],
}


def _reports(content_type: str | None) -> Iterator[bytes]:
    report = PositionReport(
        t_utc_ns=NS_2026,
        latitude_deg=40.0,
        longitude_deg=-3.7,
        altitude_m=700.0,
        altitude_reference=AltitudeReference.MEAN_SEA_LEVEL,
        velocity_enu_m_s=(1.0, 2.0, 3.0),
        rcs_m2=0.01,
    )
    if content_type is None or "json" in content_type:
        yield report.to_json()
    if content_type is None or "protobuf" in content_type:
        yield report.to_protobuf()


def _recordings(form: str) -> Iterator[bytes]:
    facts = next(facts for name, facts in FORMATS.items() if str(name) == form)
    if facts.writer is None:
        return
    file = io.BytesIO()
    writer = facts.writer(file)
    for n, message in enumerate(messages()):
        writer.write(
            Recorded(
                topic=message.topic,
                payload=message.payload,
                log_time_ns=NS_2026 + n,
                publish_time_ns=NS_2026,
                content_type=message.content_type,
                properties=tuple(message.properties),
                stage=Stage.AFTER,
            )
        )
    writer.close()
    yield file.getvalue()
