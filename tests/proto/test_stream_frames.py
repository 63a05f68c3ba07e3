"""Frames of MAVLink and Beast are found in any stream, however cut and whatever is between them."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.proto.mavlink_frames import FrameSplitter, frame_octets, message_id, sender
from plotfeed.proto.mode_s import BeastSplitter, read_squitter

common = pytest.importorskip("pymavlink.dialects.v20.common")
v10 = pytest.importorskip("pymavlink.dialects.v10.common")
POSITION, ATTITUDE = 33, 30


def frame(i: int, number: int = POSITION, *, dialect: Any = common, system: int = 1) -> bytes:
    mav = dialect.MAVLink(None, srcSystem=system, srcComponent=1)
    if number == ATTITUDE:
        return bytes(mav.attitude_encode(i, 0.1, 0.2, 0.3, 0, 0, 0).pack(mav))
    position = (i, 404500000, -37300000, 750_000, 100_000, 100, -200, 5, 0)
    return bytes(mav.global_position_int_encode(*position).pack(mav))


def beast(message: bytes, time: bytes = bytes(6)) -> bytes:
    body = (time + b"\x50" + message).replace(b"\x1a", b"\x1a\x1a")
    return b"\x1a" + {2: b"1", 7: b"2", 14: b"3"}[len(message)] + body


def decode(octets: bytearray) -> Any | None:
    try:
        return common.MAVLink(None).decode(octets)
    except common.MAVError:
        return None


def found(pieces: list[bytes]) -> tuple[list[int], FrameSplitter[Any]]:
    splitter: FrameSplitter[Any] = FrameSplitter({POSITION}, decode)
    return [m.time_boot_ms for p in pieces for m in splitter.split(p)], splitter


def pieces_of(stream: bytes, cuts: list[int]) -> list[bytes]:
    at = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    return [stream[a:b] for a, b in pairwise(at)]


ANYWHERE = st.lists(st.integers(0, 900), max_size=12)


@pytest.mark.parametrize("dialect", [v10, common], ids=["v1", "v2"])
@given(cuts=ANYWHERE)
def test_a_stream_cut_anywhere_gives_every_message_once(dialect: Any, cuts: list[int]) -> None:
    stream = b"".join(frame(i, ATTITUDE if i % 3 else POSITION, dialect=dialect) for i in range(18))
    times, splitter = found(pieces_of(stream, cuts))
    assert times == [0, 3, 6, 9, 12, 15]
    assert (splitter.frames, splitter.damaged) == (18, 0)


@given(ANYWHERE, st.binary(max_size=20))
def test_a_stream_of_beast_cut_anywhere_gives_every_message_once(
    cuts: list[int], garbage: bytes
) -> None:
    messages = [bytes(range(14)), bytes(2), bytes([0x1A]) * 7, b"\x8d\x1a\x31\x1a\x1a\x32\x33"]
    lead = garbage.replace(b"\x1a", b"")
    splitter = BeastSplitter()
    stream = lead + b"".join(beast(m, b"\x1a\x00\x1a\x1a\x00\x33") for m in messages)
    assert [m for piece in pieces_of(stream, cuts) for m in splitter.split(piece)] == messages
    assert splitter.damaged == len(lead)


@given(st.binary(max_size=300), st.integers(0, 20))
def test_garbage_swallows_nothing_that_follows(garbage: bytes, cut: int) -> None:
    frames = [frame(i) for i in range(30)]  # longer than the longest that garbage can pretend to
    stream = garbage + b"".join(frames)
    times, _ = found([stream[:cut], stream[cut:]])
    assert times[-10:] == list(range(20, 30))


def test_a_false_beginning_swallows_nothing_at_all() -> None:
    times, splitter = found([b"\xfd\xff\x00" + b"".join(frame(i) for i in range(20))])
    assert times == list(range(20))
    assert splitter.damaged == 3


def test_a_damaged_frame_costs_itself_alone() -> None:
    damaged = bytearray(frame(1))
    damaged[20] ^= 1
    times, splitter = found([frame(0) + bytes(damaged) + frame(2)])
    assert times == [0, 2]
    assert splitter.damaged == len(damaged)


@given(st.binary(max_size=2000))
def test_whatever_comes_is_taken_and_little_of_it_is_kept(data: bytes) -> None:
    _, splitter = found([data, data[::-1]])
    assert len(splitter._left) < 300
    of_beast = BeastSplitter()
    for piece in (data, data[::-1]):
        for message in of_beast.split(piece):
            read_squitter(message)
    assert len(of_beast._left) <= 50


def test_a_flood_of_false_beginnings_is_not_looked_into_for_ever() -> None:
    tried = 0

    def refuse(_octets: bytearray) -> None:
        nonlocal tried
        tried += 1

    splitter: FrameSplitter[Any] = FrameSplitter({POSITION}, refuse)
    assert list(splitter.split(b"\xfe\x1c\x00\x01\x01\x21" * 10_000)) == []
    assert tried <= 100


def test_sender_message_and_length_are_read_from_both_versions() -> None:
    for dialect in (v10, common):
        octets = frame(5, dialect=dialect, system=77)
        assert (message_id(octets), sender(octets)) == (POSITION, (77, 1))
        assert frame_octets(octets, 0) == len(octets)
    assert frame_octets(b"\xfd\x10\x02" + bytes(40), 0) is None  # flags that nobody knows
