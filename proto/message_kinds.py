"""What a message holds, as far as its content type and topic tell.

MQTT 3.1.1 has no content types, and neither have datagrams: then the last levels of the topic
tell it, which are the same in every session (docs/topics.md). Nobody looks into the payload here.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.content_types import (
    ASTERIX,
    COT,
    GEOJSON,
    JSON,
    LEDGER,
    PLOT_BATCH,
    SAPIENT_MESSAGE,
    TELEMETRY,
    TRACK_BATCH,
    is_asterix_topic,
    message_type,
)

OUR_MESSAGES: Mapping[str, Any] = {
    kind.DESCRIPTOR.full_name: kind
    for kind in (
        pb.Telemetry,
        pb.PlotBatch,
        pb.TrackBatch,
        pb.Ledger,
        pb.Refusal,
        pb.SensorStatus,
        pb.SensorDescription,
    )
}
"""Classes of the messages of ours that are sent by themselves, by their full names."""
MEDIA_TYPES = (ASTERIX, JSON, GEOJSON, COT)
"""Those that tell what a message is without naming a message of protobuf."""
LAST_LEVELS = {
    **dict.fromkeys(("errors", "status", "settings", "description", "session"), JSON),
    "plots": PLOT_BATCH,
    "tracks": TRACK_BATCH,
    "truth": LEDGER,
    "sapient": SAPIENT_MESSAGE,
    "cot": COT,
}


@lru_cache(maxsize=1024)
def kind_of(topic: str, content_type: str) -> str:
    """One of `MEDIA_TYPES`, the full name of a message of protobuf, or "" where nothing tells.

    A content type that says none of these, or is empty, leaves it to the topic.
    """
    return _told_by_type(content_type) or _told_by_topic(topic)


def _told_by_type(content_type: str) -> str:
    named = message_type(content_type)
    if named in OUR_MESSAGES:
        return named
    if named.startswith("sapient_msg."):
        return SAPIENT_MESSAGE
    media_type = content_type.partition(";")[0].strip()
    return media_type if media_type in MEDIA_TYPES else ""


def _told_by_topic(topic: str) -> str:
    levels = topic.split("/")
    if levels[-2:-1] == ["telemetry"]:
        return TELEMETRY
    if is_asterix_topic(topic):
        return ASTERIX
    if levels[-2:] == ["sapient", "task"]:
        return SAPIENT_MESSAGE
    return LAST_LEVELS.get(levels[-1], "")
