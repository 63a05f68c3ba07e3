"""Another time stamp on a message of SAPIENT."""

from __future__ import annotations

from google.protobuf.message import DecodeError as ProtobufError
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage

from plotfeed.proto.errors import DecodeError

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
