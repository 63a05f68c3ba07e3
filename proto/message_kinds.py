"""What a message holds, by its content type, its topic and its first octets.

MQTT 3.1.1 has no content types, and neither have datagrams: then the last levels of the topic
tell it, which are the same in every session (docs/topics.md). Where trackers and drones publish in
the format of their choice, the payload's first octets tell JSON and ASTERIX from protobuf.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from functools import lru_cache
from typing import Any

from google.protobuf.message import DecodeError as ProtobufDecodeError

from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.layout import HEADER_OCTETS
from plotfeed.proto.content_types import (
    ASTERIX,
    COT,
    GEOJSON,
    JSON,
    LEDGER,
    LEDGER_BATCH,
    PLOT_BATCH,
    SAPIENT_MESSAGE,
    TELEMETRY,
    TRACK_BATCH,
    is_asterix_topic,
    message_type,
)
from plotfeed.proto.ledger_pb2 import LedgerBatch

# Classes of the messages of ours that are sent by themselves, by their full names.
OUR_MESSAGES: Mapping[str, Any] = {
    kind.DESCRIPTOR.full_name: kind
    for kind in (
        pb.Telemetry,
        pb.PlotBatch,
        pb.TrackBatch,
        pb.Ledger,
        LedgerBatch,
        pb.Refusal,
        pb.SensorStatus,
        pb.SensorDescription,
    )
}
# Those that tell what a message is without naming a message of protobuf.
MEDIA_TYPES = (ASTERIX, JSON, GEOJSON, COT)
# Kinds that a topic tells where senders choose the format: categories that they may publish in.
#
# No first octet of a TrackBatch is 62, nor of either message of protobuf a bracket.
OPEN_TO: Mapping[str, Container[int]] = {
    TRACK_BATCH: {62},
    TELEMETRY: {129},
    LEDGER_BATCH: (),
    "": CATEGORIES,
}
LAST_LEVELS = {
    **dict.fromkeys(("errors", "status", "settings", "description", "session"), JSON),
    "plots": PLOT_BATCH,
    "tracks": TRACK_BATCH,
    "truth": LEDGER_BATCH,
    "sapient": SAPIENT_MESSAGE,
    "cot": COT,
}


# The tag of the first field, which no LedgerBatch has.
_OF_LEDGER = b"\n"


def kind_of(topic: str, content_type: str, payload: bytes) -> str:
    """One of `MEDIA_TYPES`, the full name of a message of protobuf, or "" where nothing tells.

    A content type that says none of these, or is empty, leaves it to the topic.
    """
    kind, is_open = _told(topic, content_type)
    if not is_open:
        return kind
    if kind == LEDGER_BATCH:  # or of a version before there were columns
        return LEDGER if payload.startswith(_OF_LEDGER) else kind
    if payload.lstrip(b" \t\r\n").startswith((b"{", b"[")):
        return JSON
    is_block = len(payload) >= int.from_bytes(payload[1:HEADER_OCTETS], "big") > HEADER_OCTETS
    if is_block and payload[0] in OPEN_TO[kind]:
        return ASTERIX
    if kind == TRACK_BATCH:  # unless a time stands where that has the sensor's name
        try:
            is_batch = pb.TrackBatch.FromString(payload).sensor.isprintable()
        except ProtobufDecodeError:
            is_batch = False
        return kind if is_batch else SAPIENT_MESSAGE
    return kind


@lru_cache(maxsize=1024)
def _told(topic: str, content_type: str) -> tuple[str, bool]:
    """What content type and topic tell, and whether the payload may still say otherwise."""
    named, media_type = message_type(content_type), content_type.partition(";")[0].strip()
    if named in OUR_MESSAGES:
        return named, False
    if named.startswith("sapient_msg."):
        return SAPIENT_MESSAGE, False
    if media_type in MEDIA_TYPES:
        return media_type, False
    by_topic = _told_by_topic(topic)
    return by_topic, by_topic in OPEN_TO


def _told_by_topic(topic: str) -> str:
    levels = topic.split("/")
    if levels[-2:-1] in (["telemetry"], ["claimed"]):
        return TELEMETRY
    if is_asterix_topic(topic):
        return ASTERIX
    if levels[-2:] == ["sapient", "task"]:
        return SAPIENT_MESSAGE
    return LAST_LEVELS.get(levels[-1], "")
