"""A SAPIENT message at another time: its timestamp, and whatever else it says of times.

The ULIDs of reports stay as they are, although each has a time in it: they are names, by which
messages refer to each other.
"""

from __future__ import annotations

from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage

from plotfeed.proto.retime import retime_protobuf
from plotfeed.proto.sapient.envelope import stamp_ns


def retime_sapient(data: bytes, shift_ns: int) -> bytes:
    """A serialised SapientMessage later by that; raises `DecodeError`.

    The shift is rounded down to whole microseconds, so that stamps of microseconds stay such and
    none is ahead of the time at which it leaves.
    """
    return retime_protobuf(data, SapientMessage, stamp_ns(shift_ns))
