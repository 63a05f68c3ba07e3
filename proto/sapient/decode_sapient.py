"""SAPIENT bytes to plain values, the few things that a node must hear."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from typing import Any, Literal

from google.protobuf import json_format
from google.protobuf.message import DecodeError as ProtobufDecodeError
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage

from plotfeed.proto.errors import DecodeError
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.proto.retime import retime_protobuf
from plotfeed.proto.sapient.encode_detections import AGE, BISTATIC_RANGE
from plotfeed.proto.sapient.envelope import set_stamp, stamp_ns
from plotfeed.proto.utc import NS

MAX_REASONS = 3
"""That are read of an answer, however many it has."""


@dataclass(frozen=True, slots=True)
class Heard:
    """What a middleware said to a node: of its registration, that something is wrong, or a task."""

    what: Literal["accepted", "refused", "error", "task", "other"]
    reasons: tuple[str, ...] = ()
    """The first of a refusal, or of an error message."""


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


def decode_heard(data: bytes) -> Heard:
    """What a message says to a node that reports; raises `DecodeError`."""
    message = _parsed(data)
    what = message.WhichOneof("content")
    if what == "registration_ack":
        ack = message.registration_ack
        return Heard("accepted" if ack.acceptance else "refused", _first(ack.ack_response_reason))
    if what == "error":
        return Heard("error", _first(message.error.error_message))
    return Heard("task" if what == "task" else "other")


def _first(reasons: Iterable[str]) -> tuple[str, ...]:
    return tuple(islice(reasons, MAX_REASONS))


def plots_in_sapient(data: bytes) -> MeasuredPlots:
    """The detection of a message, if it tells of one; raises `DecodeError`.

    Its time is that of the message, less the age that a plot is told to have.
    """
    message = _parsed(data)
    if not message.HasField("detection_report"):
        return MeasuredPlots.of(())
    report = message.detection_report
    infos = {info.type: info.value for info in report.object_info}
    try:
        age_s, bistatic_m = float(infos.get(AGE, 0)), float(infos.get(BISTATIC_RANGE, "nan"))
        t_utc_ns = message.timestamp.ToNanoseconds() - round(age_s * NS)
    except (ValueError, OverflowError) as error:
        raise DecodeError(f"not a number in object_info: {error}") from None
    told = {"t_utc_ns": t_utc_ns, "bistatic_range_m": bistatic_m}
    place = report.range_bearing
    for name, ours in _PLACES.items():
        if place.HasField(name):
            told[ours] = getattr(place, name)
    return MeasuredPlots.of([told])


_PLACES = {
    "range": "range_m",
    "azimuth": "azimuth_deg",
    "elevation": "elevation_deg",
    "range_error": "sigma_range_m",
    "azimuth_error": "sigma_azimuth_deg",
    "elevation_error": "sigma_elevation_deg",
}
"""Columns of plots, by what SAPIENT calls them."""


def _parsed(data: bytes) -> SapientMessage:
    try:
        message: SapientMessage = SapientMessage.FromString(data)
    except ProtobufDecodeError:
        raise DecodeError(f"{len(data)} octets that are not a SAPIENT message") from None
    if message.WhichOneof("content") is None:
        raise DecodeError(f"{len(data)} octets that are a SAPIENT message without content")
    return message


def restamped_later(data: bytes, by_ns: int) -> bytes:
    """A serialised SapientMessage as if sent so much later; raises `DecodeError`, `EncodeError`."""
    message = _parsed(data)
    stamp = message.timestamp
    set_stamp(message, stamp.seconds * NS + stamp.nanos + by_ns)
    return message.SerializeToString()


def retime_sapient(data: bytes, shift_ns: int) -> bytes:
    """A serialised SapientMessage later by that; raises `DecodeError`.

    The shift is rounded down to whole microseconds, so that stamps of microseconds stay such and
    none is ahead of the time at which it leaves.
    """
    return retime_protobuf(data, SapientMessage, stamp_ns(shift_ns))
