"""SAPIENT bytes to plain values, the few things that a node must hear."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from google.protobuf import json_format
from google.protobuf.message import DecodeError as ProtobufDecodeError
from google.protobuf.message import DecodeError as ProtobufError
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage

from plotfeed.proto.errors import DecodeError
from plotfeed.proto.retime import retime_protobuf
from plotfeed.proto.sapient.envelope import stamp_ns


@dataclass(frozen=True, slots=True)
class Answer:
    """What a middleware said: `accepted` of a registration, None if it is about anything else."""

    accepted: bool | None
    reasons: tuple[str, ...]
    """Of a refusal, or of an error message."""


def decode(data: bytes) -> dict[str, Any]:
    """A SapientMessage as a JSON mapping with the names of the standard; raises `DecodeError`."""
    message = _parsed(data)
    try:
        mapping: dict[str, Any] = json_format.MessageToDict(
            message, preserving_proto_field_name=True
        )
    except (json_format.Error, ValueError, RecursionError, OverflowError) as error:
        # Such as a timestamp of the year 10,000.
        raise DecodeError(f"not a SAPIENT message: {error}") from None
    return mapping


def decode_answer(data: bytes) -> Answer:
    """What a message says to a node that reports; raises `DecodeError`."""
    message = _parsed(data)
    if message.HasField("registration_ack"):
        ack = message.registration_ack
        return Answer(ack.acceptance, tuple(ack.ack_response_reason))
    return Answer(None, tuple(message.error.error_message))


def _parsed(data: bytes) -> SapientMessage:
    try:
        message: SapientMessage = SapientMessage.FromString(data)
    except ProtobufDecodeError:
        raise DecodeError(f"{len(data)} octets that are not a SAPIENT message") from None
    if message.WhichOneof("content") is None:
        raise DecodeError(f"{len(data)} octets that are a SAPIENT message without content")
    return message


MICROSECOND_NS = 1000


def restamped(payload: bytes, t_utc_ns: int) -> bytes:
    """The same message, sent at that time, to the microsecond; raises `DecodeError`."""
    message = SapientMessage()
    try:
        message.ParseFromString(payload)
    except ProtobufError:
        raise DecodeError("not a message of SAPIENT") from None
    message.timestamp.FromNanoseconds(t_utc_ns // MICROSECOND_NS * MICROSECOND_NS)
    return bytes(message.SerializeToString())


def retime_sapient(data: bytes, shift_ns: int) -> bytes:
    """A serialised SapientMessage later by that; raises `DecodeError`.

    The shift is rounded down to whole microseconds, so that stamps of microseconds stay such and
    none is ahead of the time at which it leaves.
    """
    return retime_protobuf(data, SapientMessage, stamp_ns(shift_ns))
