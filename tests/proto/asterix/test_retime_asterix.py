"""Times in data blocks moved: every one of them, exactly, and nothing else."""

from __future__ import annotations

from datetime import timedelta
from random import Random
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support.asterix_input import slots_octets
from support.given_recordings import recorded_payloads

from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.decode import Record, blocks, decode, records_in
from plotfeed.proto.asterix.codec.layout import DAY_LSB, Category, is_time_of_day
from plotfeed.proto.asterix.codec.retime_asterix import Retimer, TimeFinder
from plotfeed.proto.errors import DecodeError

NS = 1_000_000_000
DAY_NS = 86_400 * NS
RETIMER = Retimer()


def block(category: int, body: bytes) -> bytes:
    return bytes([category]) + (len(body) + 3).to_bytes(2, "big") + body


def some_blocks(seed: int) -> bytes:
    """Data blocks of any categories, each of records of any items."""
    rng = Random(seed)  # noqa: S311
    data = b""
    for category in rng.choices(list(CATEGORIES.values()), k=rng.randrange(4)):
        records = [slots_octets(category.uap, rng) for _ in range(rng.randint(1, 3))]
        data += block(category.number, b"".join(records))
    return data


def comparable(record: Record, shift_lsb: int) -> dict[str, Any]:
    """Its items, with its time of day as it is after the shift."""
    items: dict[str, Any] = dict(record.items)
    name = CATEGORIES[record.category].time
    if name in items:
        items[name] = (int(items[name] * 128) + shift_lsb) % DAY_LSB
    if "TOD" in items.get("I062/390", {}):
        items["I062/390"] = {**items["I062/390"], "TOD": None}
    return items


def assert_times_alone_move(data: bytes, shift_lsb: int) -> int:
    """In whole blocks; how many times of day they have."""
    moved = RETIMER.retime(data, shift_lsb * NS // 128).octets
    assert [comparable(r, shift_lsb) for r in decode(data)] == [
        comparable(r, 0) for r in decode(moved)
    ]
    may_change, count = set[int](), 0
    for each in blocks(data):
        finder = TimeFinder(CATEGORIES[each.category])
        for record in records_in(each):
            times = finder.find(each.body, record.at_octet - each.at_octet)
            count += len(times.of_day)
            for places, octets in ((times.of_day, 3), (times.planned, 4)):
                for place in places:
                    may_change |= set(range(each.at_octet + place, each.at_octet + place + octets))
    assert {i for i, (a, b) in enumerate(zip(data, moved, strict=True)) if a != b} <= may_change
    return count


SHIFTS = st.integers(-2 * DAY_LSB, 2 * DAY_LSB) | st.integers(-(2**37), 2**37)


@given(st.integers(0, 2**64).map(some_blocks), SHIFTS)
def test_every_time_of_day_moves_and_nothing_else(data: bytes, shift_lsb: int) -> None:
    assert_times_alone_move(data, shift_lsb)
    for days in (-2, 0, 20_000):
        assert RETIMER.retime(data, days * DAY_NS).octets == data


@pytest.mark.parametrize("shift_s", [1, 43_200, -70_000, 10**9])
def test_foreign_recordings_are_the_same_but_for_their_times(shift_s: int) -> None:
    for data in recorded_payloads():
        done = RETIMER.retime(data, shift_s * NS)
        assert set(done.left) <= {"octets that are no data block"}  # some end with a trailer
        whole = data[:-8] if done.left else data
        assert assert_times_alone_move(whole, shift_s * 128)
        assert done.octets[len(whole) :] == data[len(whole) :]


@given(st.sampled_from(list(CATEGORIES.values())), st.binary(max_size=60))
@example(CATEGORIES[62], bytes.fromhex("01 01 01 01 80 00 00"))
@example(CATEGORIES[48], bytes.fromhex("80 1903 80 19"))
def test_records_end_where_the_decoder_ends_them(category: Category, body: bytes) -> None:
    def by_decoder() -> list[int]:
        found = [r.at_octet - 3 + len(r.octets) for r in decode(block(category.number, body))]
        return found if body else []

    def by_finder() -> list[int]:
        finder, ends = TimeFinder(category), [0]
        while ends[-1] < len(body):
            ends.append(finder.find(body, ends[-1]).end)
        return ends[1:]

    found: list[list[int] | None] = []
    for ends in (by_decoder, by_finder):
        try:
            found.append(ends())
        except DecodeError:
            found.append(None)
    assert found[0] == found[1]
    for data in (body, block(category.number, body)):
        assert len(RETIMER.retime(data, NS).octets) == len(data)


def test_every_category_has_one_time_of_day() -> None:
    named = {layout.time for layout in CATEGORIES.values()}
    assert named == {
        f"I{each}" for each in ("015/145", "016/140", "025/070", "034/030", "048/140", "062/070",
                                "063/030", "129/070", "205/030")
    }  # fmt: skip
    for layout in CATEGORIES.values():
        assert sum(1 for item in layout.uap if item and is_time_of_day(item)) == 1


def plot_at(time_lsb: int) -> bytes:
    """Category 048: source, time of day and type."""
    return block(48, bytes.fromhex("e0 1903") + time_lsb.to_bytes(3, "big") + b"\x30")


def test_the_first_time_is_found_if_nothing_before_it_is_broken() -> None:
    finder, body = TimeFinder(CATEGORIES[48]), plot_at(77)[3:]
    found = [finder.first_time(body[:octets], 0) for octets in (len(body), len(body) - 1, 2)]
    assert found == [3, 3, None]


@pytest.mark.parametrize(
    ("before_lsb", "shift_ns", "after_lsb"),
    [
        (DAY_LSB - 1, NS, 127),
        (0, -NS, DAY_LSB - 128),
        (100, 3_906_250, 100),  # half an LSB: to even
        (101, 3_906_250, 101),  # the shift, so that times differ by as much as before
        (100, 11_718_750, 102),
        (100, 3_906_251, 101),
        (0, DAY_NS - 3_906_249, 0),
        (DAY_LSB, NS, 128),  # 86400.0, as senders without a modulo write midnight
        (0xFFFFFF, NS, 0xFFFFFF),  # no time of day
    ],
)
def test_midnight_is_passed_both_ways(before_lsb: int, shift_ns: int, after_lsb: int) -> None:
    assert RETIMER.retime(plot_at(before_lsb), shift_ns).octets == plot_at(after_lsb)


def test_what_is_not_known_is_left_alone_and_named() -> None:
    unknown, broken, tail = block(247, b"\x80\x19\x03"), block(48, b"\xff"), b"\xde\xad\xbe\xef"
    done = RETIMER.retime(unknown + plot_at(0) + broken + plot_at(0) + tail, NS)
    assert done.octets == unknown + plot_at(128) + broken + plot_at(128) + tail
    assert done.left == (
        "category 247, of which no layout is known",
        "category 048 in an edition that is not known, or broken",
        "octets that are no data block",
    )


def flight_plan(time_lsb: int, day: int, hour: int, minute: int, second: int | None) -> bytes:
    """Category 062 with a time of day and one planned time."""
    word = 5 << 27 | day << 25 | hour << 16 | minute << 8 | (second is None) << 7 | (second or 0)
    plan = bytes.fromhex("01 08 01") + word.to_bytes(4, "big")
    return block(62, bytes.fromhex("11 01 02") + time_lsb.to_bytes(3, "big") + plan)


DAYS = {0: 0, 1: -1, 2: 1}


@given(
    st.integers(0, DAY_LSB - 1),
    st.integers(0, 86399),
    st.sampled_from([0, 1, 2]),
    st.integers(-3 * 86400, 3 * 86400),
    st.booleans(),
)
def test_planned_times_keep_their_distance_to_the_record(
    time_lsb: int, planned_s: int, code: int, shift_s: int, seconds: bool
) -> None:
    planned_s = planned_s if seconds else planned_s // 60 * 60
    hour, minute, second = planned_s // 3600, planned_s // 60 % 60, planned_s % 60
    data = flight_plan(time_lsb, code, hour, minute, second if seconds else None)
    done = RETIMER.retime(data, shift_s * NS)

    def instants(octets: bytes) -> tuple[timedelta, timedelta]:
        (record,) = decode(octets)
        plan: Any = record.get("I062/390/TOD/0")
        of_day_s: Any = record.get("I062/070")
        assert plan["TYP"] == 5
        planned = timedelta(
            days=DAYS[plan["DAY"]], hours=plan["HOR"], minutes=plan["MIN"], seconds=plan["SEC"]
        )
        return timedelta(seconds=of_day_s), planned

    before, after = instants(data), instants(done.octets)
    if done.left:
        assert after[1] == before[1]
        assert abs(before[1] + (after[0] - before[0])) >= timedelta(days=1)
    else:
        apart = (after[1] - after[0]) - (before[1] - before[0])
        assert abs(apart) <= timedelta(seconds=0 if seconds else 30)
        assert seconds or after[1].seconds % 60 == 0  # it says the minute alone


@pytest.mark.parametrize(
    "data",
    [
        flight_plan(0, 3, 1, 2, 3),
        flight_plan(0, 0, 24, 2, 3),
        flight_plan(0, 0, 1, 60, 3),
        block(62, bytes.fromhex("01 01 02 01 08 01 28000000")),
    ],
)
def test_planned_times_that_are_none_are_left_alone(data: bytes) -> None:
    done = RETIMER.retime(data, 3600 * NS)
    assert done.left
    assert done.octets[-4:] == data[-4:]
