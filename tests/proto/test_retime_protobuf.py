from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.timestamp_pb2 import Timestamp
from hypothesis import assume, given
from hypothesis import strategies as st

from plotfeed.feeds.telemetry.position_report import PositionReport, decode
from plotfeed.models.state import AltitudeReference
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.message_kinds import OUR_MESSAGES
from plotfeed.proto.retime import retime_json, retime_protobuf, retime_text
from plotfeed.proto.utc import iso_utc

NS = 1_000_000_000
START = 1_767_268_800 * NS + 123_456_789
TIMES = st.integers(1, 4_000_000_000 * NS)
SHIFTS = st.integers(-1_000_000_000 * NS, 1_000_000_000 * NS)


def filled(kind: Any, t_ns: int) -> Any:
    """A message with something in every field: that time, and where it is absent, 0."""
    message = kind()
    for field in kind.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        if field.message_type is None:
            one = t_ns if field.name.endswith("_utc_ns") else VALUES.get(field.cpp_type, 1)
            if field.is_repeated:
                value[:] = [one, type(one)(), one]
            else:
                setattr(message, field.name, one)
        elif field.message_type.GetOptions().map_entry:
            value["a"] = 1
        elif field.message_type.full_name == Timestamp.DESCRIPTOR.full_name:
            value.FromNanoseconds(t_ns)
        elif field.is_repeated:
            value.append(filled(type(value.add()), t_ns))
        else:
            value.CopyFrom(filled(type(value), t_ns))
    return message


VALUES = {
    FieldDescriptor.CPPTYPE_STRING: "a/b",
    FieldDescriptor.CPPTYPE_DOUBLE: 1.5,
    FieldDescriptor.CPPTYPE_FLOAT: 1.5,
    FieldDescriptor.CPPTYPE_BOOL: True,
}


@pytest.mark.parametrize("kind", OUR_MESSAGES.values(), ids=OUR_MESSAGES)
@given(TIMES, SHIFTS)
def test_every_time_of_ours_moves_exactly_and_nothing_else(
    kind: Any, t_ns: int, shift_ns: int
) -> None:
    assume(t_ns + shift_ns != 0)  # which is an absent one
    moved = retime_protobuf(filled(kind, t_ns).SerializeToString(), kind, shift_ns)
    assert moved == filled(kind, t_ns + shift_ns).SerializeToString()


def test_fields_of_a_newer_schema_are_kept() -> None:
    data = filled(pb.PlotBatch, START).SerializeToString() + b"\xfa\x3e\x03new"
    assert retime_protobuf(data, pb.PlotBatch, 0) == data
    assert retime_protobuf(data, pb.PlotBatch, NS).endswith(b"\xfa\x3e\x03new")


def report(t_ns: int) -> PositionReport:
    return PositionReport(t_ns, 40.1, -3.7, 700.0, AltitudeReference.ELLIPSOID)


@given(st.integers(0, 2_000_000_000 * NS), st.integers(0, 1_000_000_000 * NS))
def test_telemetry_tells_the_other_time_and_all_else(t_ns: int, shift_ns: int) -> None:
    before, after = report(t_ns), report(t_ns + shift_ns)
    assert decode(retime_json(before.to_json(), shift_ns)) == after
    assert decode(retime_protobuf(before.to_protobuf(), pb.Telemetry, shift_ns)) == after


def test_json_keeps_every_other_character() -> None:
    text = '{ "latitude_deg":1.50, "time_utc" : "2026-01-01T12:00:00Z","x":"time_utc"}\n'
    assert retime_json(text.encode(), 90 * NS + 5).decode() == text.replace(
        "12:00:00Z", "12:01:30.000000005Z"
    )


@pytest.mark.parametrize(
    "text",
    [
        '{"x": "\\"time_utc\\":\\"2026-01-01T12:00:00Z\\"", "time_utc": "2026-01-01T12:00:00Z"}',
        '{"x": {"time_utc": "2026-01-01T12:00:00Z"}, "time_utc": "2026-01-01T12:00:00Z"}',
        '{"time\\u005futc": "2026-01-01T12:00:00Z"}',
        '{"time_utc": "2026-01-01T12:00:00\\u005a"}',
        '{"timeUtc": "2026-01-01T13:00:00+01:00"}',
    ],
)
def test_a_time_is_found_however_it_is_written(text: str) -> None:
    before, after = json.loads(text), json.loads(retime_json(text.encode(), NS))
    (name,) = (n for n in ("time_utc", "timeUtc") if n in before)
    assert after == before | {name: "2026-01-01T12:00:01Z"}


def test_a_session_says_in_two_ways_when_it_began() -> None:
    text = f'{{"start_utc": "{iso_utc(START)}", "start_utc_ns": {START}, "seed": {START}}}'
    moved = (
        f'{{"start_utc": "{iso_utc(START + NS)}", "start_utc_ns": {START + NS}, "seed": {START}}}'
    )
    assert retime_json(text.encode(), NS).decode() == moved


@pytest.mark.parametrize("data", [b"", b"{}", b"[]", b"1", b"\xff", b"[" * 9999,
                                  b'{"time_utc": null}', b'{"time_utc": "yesterday"}'])  # fmt: skip
def test_what_is_no_json_of_ours_is_refused(data: bytes) -> None:
    with pytest.raises(DecodeError):
        retime_json(data, NS)


@pytest.mark.parametrize(
    ("data", "kind", "shift_ns"),
    [
        (b"\xff\xff", pb.Telemetry, 1),
        (filled(pb.PlotBatch, 2**63 - 5).SerializeToString(), pb.PlotBatch, 10),
        (pb.Telemetry(time_utc=Timestamp(seconds=253_402_300_799)).SerializeToString(),
         pb.Telemetry, NS),
    ],
)  # fmt: skip
def test_what_cannot_be_moved_is_refused(data: bytes, kind: Any, shift_ns: int) -> None:
    with pytest.raises(DecodeError):
        retime_protobuf(data, kind, shift_ns)


@given(st.integers(-(2**60), 2**62), SHIFTS)
def test_a_written_time_moves_exactly(t_ns: int, shift_ns: int) -> None:
    assert retime_text(iso_utc(t_ns), shift_ns) == iso_utc(t_ns + shift_ns)


@given(st.datetimes(datetime(1971, 1, 1), datetime(2200, 1, 1)), st.integers(-(10**8), 10**8))  # noqa: DTZ001
def test_a_written_time_is_as_precise_as_it_was(time: datetime, shift_s: int) -> None:
    text = time.replace(microsecond=0, tzinfo=UTC)
    for digits in (0, 3, 6, 9):
        end = f"{'.' if digits else ''}{'0' * digits}Z"
        moved = text + timedelta(seconds=shift_s)
        found = retime_text(f"{text:%Y-%m-%dT%H:%M:%S}{end}", shift_s * NS)
        assert found == f"{moved:%Y-%m-%dT%H:%M:%S}{end}"
