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

NS = 1_000_000_000
START = 1_767_268_800 * NS + 123_456_000
NODE = "4f3c1b6e-7a0d-4d6a-9a57-0b9a8f5f2c11"


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
@given(st.integers(0, 4_000_000_000_000_000), st.integers(-(2**60), 2**60))
def test_every_timestamp_moves_by_whole_microseconds_and_nothing_else(
    path: tuple[str, ...], t_us: int, shift_ns: int
) -> None:
    """Down, so that none is ahead of the time at which its message leaves."""
    moved_ns = t_us * 1000 + shift_ns // 1000 * 1000
    if moved_ns < 0:
        return
    message = SapientMessage(node_id=NODE)
    message.detection_report.detection_confidence = 0.0
    stamp(message, path).FromNanoseconds(t_us * 1000)
    data = retime_sapient(message.SerializeToString(), shift_ns)
    stamp(message, path).FromNanoseconds(moved_ns)
    assert data == message.SerializeToString()


def test_there_are_such_paths_and_other_octets_are_refused() -> None:
    assert ("timestamp",) in PATHS
    assert len(PATHS) > 5
    with pytest.raises(DecodeError):
        retime_sapient(b"\xff\xff\xff", 1)
