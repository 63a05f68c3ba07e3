from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from google.protobuf.descriptor import Descriptor
from hypothesis import given
from hypothesis import strategies as st
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage

from plotfeed.proto.errors import DecodeError
from plotfeed.proto.sapient.decode_sapient import retime_sapient
from plotfeed.proto.sapient.envelope import envelope

NS = 1_000_000_000
START = 1_767_268_800 * NS + 123_456_000
NODE = "4f3c1b6e-7a0d-4d6a-9a57-0b9a8f5f2c11"


def detection(t_ns: int) -> SapientMessage:
    message = envelope(NODE, t_ns)
    message.detection_report.report_id = "01KDWN1Q6P2Y5T8C3V9X4Z7B0M"
    message.detection_report.detection_confidence = 0.0
    return message


@given(st.integers(0, 4_000_000_000_000_000), st.integers(-(2**60), 2**60))
def test_the_stamp_moves_by_whole_microseconds_and_nothing_else(t_us: int, shift_ns: int) -> None:
    t_ns = t_us * 1000
    moved_ns = t_ns + shift_ns // 1000 * 1000
    if moved_ns < 0:
        return
    data = detection(t_ns).SerializeToString()
    assert retime_sapient(data, shift_ns) == detection(moved_ns).SerializeToString()


def test_a_message_is_never_stamped_ahead_of_the_time_at_which_it_leaves() -> None:
    for shift_ns in (1, 999, -1, -999, 123_456_789_123):
        moved = SapientMessage.FromString(
            retime_sapient(detection(START).SerializeToString(), shift_ns)
        )
        assert START + shift_ns - 1000 < moved.timestamp.ToNanoseconds() <= START + shift_ns


def stamps(kind: Descriptor, above: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """The paths of all Timestamps in a message."""
    for field in kind.fields:
        inner = field.message_type
        if inner is None or inner.full_name in above:
            continue
        if inner.full_name == "google.protobuf.Timestamp":
            yield (field.name,)
        else:
            for path in stamps(inner, (*above, kind.full_name)):
                yield (field.name, *path)


PATHS = sorted(stamps(SapientMessage.DESCRIPTOR))


def stamp(message: Any, path: tuple[str, ...]) -> Any:
    """The Timestamp there, made where it is not."""
    for name in path:
        below = getattr(message, name)
        if message.DESCRIPTOR.fields_by_name[name].is_repeated:
            below = below[0] if len(below) else below.add()
        message = below
    return message


@pytest.mark.parametrize("path", PATHS, ids=".".join)
def test_every_timestamp_of_the_standard_moves(path: tuple[str, ...]) -> None:
    message = SapientMessage(node_id=NODE)
    stamp(message, path).FromNanoseconds(START)
    moved = SapientMessage.FromString(retime_sapient(message.SerializeToString(), 5 * NS))
    assert stamp(moved, path).ToNanoseconds() == START + 5 * NS
    stamp(moved, path).FromNanoseconds(START)
    assert moved == message


def test_there_are_such_paths() -> None:
    assert ("timestamp",) in PATHS
    assert len(PATHS) > 5


def test_octets_that_are_no_message_are_refused() -> None:
    with pytest.raises(DecodeError):
        retime_sapient(b"\xff\xff\xff", NS)
