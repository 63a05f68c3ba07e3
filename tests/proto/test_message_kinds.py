"""A message's content type says what it holds, and where it has none, its topic does."""

from __future__ import annotations

import pytest

from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.content_types import (
    ASTERIX,
    COT,
    GEOJSON,
    JSON,
    LEDGER,
    LEDGER_BATCH,
    PLOT_BATCH,
    PROTOBUF,
    SAPIENT_MESSAGE,
    TELEMETRY,
    TRACK_BATCH,
    asterix_content_type,
    json_content_type,
    protobuf_content_type,
)
from plotfeed.proto.ledger_pb2 import LedgerBatch
from plotfeed.proto.message_kinds import OUR_MESSAGES, kind_of

UNTOLD = b"\n\x05radar\x10\x07"  # What begins as a message of protobuf does
TOLD_BY_TYPE = {
    asterix_content_type(48): ASTERIX,
    ASTERIX: ASTERIX,
    json_content_type("plotfeed.AirTraffic"): JSON,
    json_content_type("plotfeed.TrackFeatures", GEOJSON): GEOJSON,
    COT: COT,
    protobuf_content_type(SAPIENT_MESSAGE): SAPIENT_MESSAGE,
    protobuf_content_type("sapient_msg.bsi_flex_335_v3_0.SapientMessage"): SAPIENT_MESSAGE,
    f'{PROTOBUF};messageType="{PLOT_BATCH}"; charset=x': PLOT_BATCH,
    **{protobuf_content_type(name): name for name in OUR_MESSAGES},
}
TOLD_BY_TOPIC = {
    "p/radar/asterix/048": ASTERIX,
    "p/radar/plots": PLOT_BATCH,
    "p/radar/tracks": TRACK_BATCH,
    "p/truth": LEDGER,
    "p/radar/sapient": SAPIENT_MESSAGE,
    "p/radar/sapient/task": SAPIENT_MESSAGE,
    "p/radar/cot": COT,
    "p/errors": JSON,
    "p/radar/description": JSON,
    "p/session": JSON,
    "p/claimed/alpha": TELEMETRY,
    "p/telemetry/plots": TELEMETRY,
    "p/telemetry/asterix": TELEMETRY,
    "asterix/truth/more/plots": PLOT_BATCH,
    "udp/10.0.0.1/8600": "",
    "plots/of/others": "",
    "": "",
}


@pytest.mark.parametrize("topic", TOLD_BY_TOPIC)
def test_a_content_type_says_what_a_message_is_and_else_its_topic_does(topic: str) -> None:
    assert {told: kind_of(topic, told, UNTOLD) for told in TOLD_BY_TYPE} == TOLD_BY_TYPE
    for nothing in ("", PROTOBUF, protobuf_content_type("no.such.Thing"), "image/png"):
        assert kind_of(topic, nothing, UNTOLD) == TOLD_BY_TOPIC[topic]


BLOCK = bytes([62, 0, 4, 0])
TOLD_BY_CONTENT = [
    ("p/truth", LedgerBatch(sensors=["radar"]).SerializeToString(), LEDGER_BATCH),
    ("tracker/tracks", pb.TrackBatch(sensor="radar", scan=7).SerializeToString(), TRACK_BATCH),
    ("tracker/tracks", BLOCK, ASTERIX),
    ("tracker/tracks", BLOCK + BLOCK, ASTERIX),
    ("tracker/tracks", b"[]", JSON),
    ("tracker/tracks", b' \r\n{"track": 1}', JSON),
    ("tracker/tracks", b"\n\x0c\x08\x80\xe1\x83\xd2\x06\x10\x80\x94\xeb\xdc\x03", SAPIENT_MESSAGE),
    ("tracker/tracks", b"\xff\xff", SAPIENT_MESSAGE),
    ("tracker/out", BLOCK, ASTERIX),
    ("tracker/out", b"[]", JSON),
    ("tracker/out", bytes([0, 0, 4, 0]), ""),
    ("tracker/out", b"", ""),
    ("p/telemetry/alpha", b"{}", JSON),
    ("p/claimed/alpha", b"{}", JSON),
    ("p/telemetry/alpha", bytes([129, 0, 4, 0]), ASTERIX),
    ("p/telemetry/alpha", BLOCK, TELEMETRY),
    ("p/radar/plots", b"{}", PLOT_BATCH),
]


@pytest.mark.parametrize(("topic", "payload", "kind"), TOLD_BY_CONTENT)
def test_first_octets_tell_the_format_where_the_sender_chooses_it(
    topic: str, payload: bytes, kind: str
) -> None:
    assert kind_of(topic, "", payload) == kind
    assert kind_of(topic, asterix_content_type(48), payload) == ASTERIX
