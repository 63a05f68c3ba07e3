"""SAPIENT bytes to plain values, and the few things that a node must hear."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from google.protobuf import json_format
from google.protobuf.message import DecodeError as ProtobufDecodeError
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage

from plotfeed.proto.errors import DecodeError


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
