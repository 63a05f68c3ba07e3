"""Writes an example of each message, as sessions publish and take them, for the AsyncAPI document.

Of what is neither JSON nor our protobuf, the octets in base64. Run from the repository's folder:
PYTHONPATH=tests:tests/feeds/schema .venv/bin/python tests/feeds/schema/make_examples.py
"""

from __future__ import annotations

import asyncio
import base64
import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import test_asyncapi as described
from google.protobuf.json_format import MessageToDict
from support.brokers import free_port, own_broker
from support.sapient_tasks import task

from plotfeed.feeds.schema.asyncapi import OURS, document, flows
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.message_kinds import OUR_MESSAGES

FILE = Path(__file__).parents[3] / "feeds" / "schema" / "message_examples.json"
MOST_OCTETS = 1200
CUE = {"azimuth_deg": 45.0, "elevation_deg": 5.0, "dwell_s": 4.0}
COMMAND = {"sensor": "active_radar", "set": {"link": {"latency_ms": 250.0}}}

SCORE = {
    "time_utc": "2026-01-01T12:00:30Z", "cutoff_m": 50.0, "drones": 2, "tracks": 2, "reports": 58,
    "unreadable": 0, "problem": "",
    "now": {
        "gospa_m": 8.1, "ospa_m": 5.7, "completeness": 1.0, "spuriousness": 0.0,
        "position_error_m": 5.7, "latency_s": 0.04, "latency_p95_s": 0.09,
    },
    "window_s": 30,
    "window": {
        "gospa_m": 9.3, "ospa_m": 6.6, "completeness": 0.97, "spuriousness": 0.01,
        "position_error_m": 6.0, "latency_s": 0.04, "latency_p95_s": 0.09,
    },
    "feed_false_rate": 0.01,
    "feed": [
        {"sensor": "radar", "check": "azimuth", "unit": "deg", "claimed": 0.0, "found": 2.01,
         "z": 37.1, "of": 58, "wrong": True, "why_not": ""},
    ],
}  # fmt: skip


def main() -> None:
    """Of what comes more than once, the first that is neither bare nor long."""
    api, port = document(), free_port()
    with TemporaryDirectory() as folder, own_broker(Path(folder), port):
        heard, _, _ = asyncio.run(described.published(described.scene(), port))
    payloads: dict[str, list[bytes]] = {}
    for message in heard:
        (operation,) = described.matching(api, message)
        name = operation.removeprefix("send")
        payloads.setdefault(name[0].lower() + name[1:], []).append(message.payload)
    report = json.dumps(described.TELEMETRY).encode()
    payloads |= {
        "telemetryProtobuf": [_telemetry()],
        "claimedProtobuf": [_telemetry()],
        "telemetryJson": [report],
        "telemetryAsterix129": payloads["asterix129"],
        "control": [json.dumps(COMMAND).encode()],
        "score": [json.dumps(SCORE).encode()],
        "cue": [json.dumps(CUE).encode()],
        "sapientTask": [task(described.ONE, request="Registration")],
    }
    examples = {}
    for flow in flows():
        fit = [octets for octets in payloads[flow.name] if len(octets) <= MOST_OCTETS]
        octets = max(fit or payloads[flow.name][:1], key=len)
        examples[flow.name] = _told(flow.content_type, flow.message, octets)
    lines = (f" {json.dumps(name)}: {json.dumps(example)}" for name, example in examples.items())
    FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n")


def _telemetry() -> bytes:
    report = pb.Telemetry(latitude_deg=40.0, longitude_deg=-3.0, altitude_m=700.0)
    report.time_utc.FromSeconds(1_767_268_800)
    report.altitude_reference = pb.ELLIPSOID
    return report.SerializeToString()


def _told(content_type: str, kind: str, octets: bytes) -> Any:
    if content_type.startswith(("application/json", "application/geo+json")):
        return json.loads(octets)
    if kind.startswith(f"{OURS}."):
        message = OUR_MESSAGES[kind].FromString(octets)
        return MessageToDict(message, preserving_proto_field_name=True)
    return base64.b64encode(octets).decode()


if __name__ == "__main__":
    main()
