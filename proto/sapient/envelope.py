"""The envelope of every message: who sends it, and when."""

from __future__ import annotations

from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage

from plotfeed.proto.sapient.checks import check_time

ICD_VERSION = "BSI Flex 335 v2.0"
STAMP_NS = 1000
"""Timestamps are whole microseconds: what a datetime holds, and no more."""


def stamp_ns(t_utc_ns: int) -> int:
    """The timestamp of a message sent then: never ahead of it."""
    return t_utc_ns // STAMP_NS * STAMP_NS


def envelope(node_id: str, t_utc_ns: int) -> SapientMessage:
    """A message without content; raises `EncodeError`."""
    message = SapientMessage(node_id=node_id)
    set_stamp(message, t_utc_ns)
    return message


def set_stamp(message: SapientMessage, t_utc_ns: int) -> None:
    """Write when it is sent; raises `EncodeError`."""
    check_time(t_utc_ns)
    message.timestamp.seconds, ns = divmod(stamp_ns(t_utc_ns), 1_000_000_000)
    message.timestamp.nanos = ns
