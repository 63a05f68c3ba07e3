from __future__ import annotations

import contextlib
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.asterix_input import flags_of
from support.asterix_rule import record_by_rule

from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec import decode as readers
from plotfeed.proto.asterix.codec.decode import (
    Block,
    Value,
    blocks,
    decode,
    decode_lenient,
    records_in,
)
from plotfeed.proto.asterix.codec.layout import Category
from plotfeed.proto.errors import DecodeError

# Written by hand from the layout: FSPEC, then the items in the order of their numbers.
PLOT = bytes.fromhex("f30108 1903 000640 30 01800718 1817ba 3fff")


def block(category: int, body: bytes) -> bytes:
    return bytes([category]) + (len(body) + 3).to_bytes(2, "big") + body


def only(category: int, hexadecimal: str) -> dict[str, Value]:
    (record,) = decode(block(category, bytes.fromhex(hexadecimal)))
    return dict(record.items)


VALID = block(48, PLOT * 2) + block(34, bytes.fromhex("e8 1903 01 0c8000 0080"))


def test_a_plot_reads_as_written() -> None:
    first, second, north = decode(VALID)
    assert first.items == second.items
    assert first.items == {
        "I048/010": {"SAC": 25, "SIC": 3},
        "I048/140": 12.5,
        "I048/020": {"TYP": 1, "SIM": 1, "RDP": 0, "SPI": 0, "RAB": 0},
        "I048/040": {"RHO": 1.5, "THETA": 0x0718 * 360 / 65536},
        "I048/130": {"PRL": 23 * 360 / 8192, "PAM": -70.0},
        "I048/110": -25.0,
    }
    assert north.items["I034/041"] == 1.0
    assert (first.octets, first.at_octet, second.at_octet) == (PLOT, 3, 3 + len(PLOT))


def test_paths_reach_into_items() -> None:
    record = decode(VALID)[0]
    assert record.get("I048/040/RHO") == 1.5
    assert record.get("I048/140") == 12.5
    assert record.get("I048/161") is None
    assert record.get("I048/140/RHO") is None


def test_repetitive_items_are_lists() -> None:
    assert only(48, "01 01 40 0f 04") == {"I048/030": [7, 2]}
    mode_s = only(48, "01 20 02 00000000000001 40 00000000000002 51")["I048/250"]
    assert mode_s == [{"MBDATA": 1, "BDS1": 4, "BDS2": 0}, {"MBDATA": 2, "BDS1": 5, "BDS2": 1}]
    assert only(48, "01 20 00")["I048/250"] == []


def test_compound_items_hold_repetitive_ones() -> None:
    doppler = only(48, "01 01 04 c0 83ff 01 0001 0002 0003")["I048/120"]
    assert doppler == {"CAL": {"D": 1, "CAL": -1.0}, "RDS": [{"DOP": 1.0, "AMB": 2.0, "FRQ": 3.0}]}


def test_text_is_text() -> None:
    assert only(48, "01 40 10c236d41820")["I048/240"] == "DLH65A  "
    assert only(48, "08 6e53")["I048/070"] == {"V": 0, "G": 1, "L": 1, "MODE3A": "7123"}


def test_explicit_fields_keep_their_bytes() -> None:
    assert only(48, "01 01 01 06 03abcd 01") == {"I048/SP": b"\xab\xcd", "I048/RE": b""}


def test_an_extended_item_longer_than_its_layout_is_kept() -> None:
    item = only(48, "20 21 01 01 01 01 01 ab cc")["I048/020"]
    assert isinstance(item, dict)
    assert item["TYP"] == 1
    assert item["IRMACTVAL"] == 0
    assert item["FURTHER"] == b"\xab\xcc"


def test_negative_heights_are_negative() -> None:
    assert only(34, "01 10 fffd 800000 7fffff") == {
        "I034/120": {"HGT": -3.0, "LAT": -180.0, "LON": (2**23 - 1) * 360 / 2**24}
    }


def test_unknown_categories_keep_their_bytes() -> None:
    record, plot, _ = decode(block(247, b"\x01\x02") + block(48, PLOT * 2))
    assert (record.category, record.items, record.octets) == (247, {}, b"\x01\x02")
    assert plot.category == 48


@pytest.mark.parametrize(
    ("data", "at_octet"),
    [
        ("30", 0),
        ("300002", 1),
        ("300004", 1),
        ("300004 00", 4),  # no item at all
        ("300004 80", 4),  # the item is missing
        ("300006 8019 03 30 0004 01", 10),
        ("300006 010101", 6),  # flags without end
        ("300008 0101010180", 7),  # a fifth octet of flags, and no item for it
        ("220006 0201 20", 5),  # a flag of I034/050 that is not assigned
        ("300007 01010104", 7),  # SP without its length
        ("300008 0101010400", 7),  # SP of length 0
        ("300008 0101010405", 8),
        ("300006 0120ff", 6),  # a count without its members
        ("300005 2021", 5),  # an extension that does not come
    ],
)
def test_what_is_broken_is_refused_at_its_octet(data: str, at_octet: int) -> None:
    with pytest.raises(DecodeError) as caught:
        decode(bytes.fromhex(data))
    assert caught.value.at_octet == at_octet


def test_a_broken_record_costs_the_rest_of_its_block_alone() -> None:
    broken = block(48, PLOT + PLOT[:-1])
    records, errors = decode_lenient(VALID + broken + VALID + b"\x30\x00")
    assert [record.category for record in records] == [48, 48, 34, 48, 48, 48, 34]
    assert [error.at_octet for error in errors] == [
        len(VALID) + 3 + 2 * len(PLOT) - 2,
        2 * len(VALID) + len(broken),
    ]


@given(st.binary(max_size=400), st.sampled_from(sorted(CATEGORIES)))
def test_any_body_gives_records_that_lie_where_they_say(body: bytes, category: int) -> None:
    data = block(category, body)
    records, errors = decode_lenient(data)
    at = 3
    for record in records:
        assert record.at_octet == at
        assert data[at : at + len(record.octets)] == record.octets
        at += len(record.octets)
    assert errors or at == len(data)


@given(st.data())
def test_flipped_and_cut_blocks_give_records_or_errors(data: st.DataObject) -> None:
    octets = bytearray(VALID)
    for place in data.draw(st.lists(st.integers(0, len(VALID) - 1), max_size=4)):
        octets[place] = data.draw(st.integers(0, 255))
    decode_lenient(bytes(octets[: data.draw(st.integers(0, len(VALID)))]))


def test_every_cut_of_a_valid_block_is_an_error() -> None:
    whole = block(48, PLOT)
    for length in range(1, len(whole)):
        with pytest.raises(DecodeError):
            decode(whole[:length])


def test_blocks_say_where_their_bodies_are() -> None:
    assert [(b.category, b.at_octet) for b in blocks(VALID)] == [(48, 3), (34, 6 + 2 * len(PLOT))]
    for piece in blocks(VALID):
        assert VALID[piece.at_octet :].startswith(piece.body)


def test_a_count_that_outnumbers_the_input_allocates_nothing() -> None:
    with pytest.raises(DecodeError, match="I034/070 needs 2 octets, 1 are left"):
        decode(bytes.fromhex("220007 0180 ff 00"))


@pytest.mark.parametrize("category", CATEGORIES.values(), ids=lambda c: f"{c.number:03}")
@given(data=st.data())
def test_compiled_readers_read_what_the_rule_reads(category: Category, data: st.DataObject) -> None:
    # Flags of items that are there, so that most of what is drawn is read to its end.
    wanted = data.draw(st.sets(st.sampled_from([n for n, i in enumerate(category.uap) if i])))
    body = flags_of(wanted) + data.draw(st.binary(max_size=400) | st.just(bytes(400)))
    try:
        items, end = record_by_rule(category, body)
    except DecodeError as error:
        with pytest.raises(DecodeError) as caught:
            next(records_in(Block(category.number, body, 0)))
        assert (str(caught.value), caught.value.at_octet) == (str(error), error.at_octet)
        return
    record = next(records_in(Block(category.number, body, 0)))
    assert (record.items, list(record.items)) == (items, list(items))
    assert record.octets == body[:end]


@given(st.lists(st.binary(min_size=2, max_size=6), max_size=30))
def test_plans_of_flags_are_bounded(bodies: list[bytes]) -> None:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(readers, "MAX_PLANS", 3)
        plans = readers.Plans(CATEGORIES[48].uap)
        for body in bodies:
            with contextlib.suppress(*readers.BROKEN):
                plans.read(body, 0)
            assert len(plans._readers) <= 3


def test_a_set_of_flags_that_comes_often_keeps_to_the_bound() -> None:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(readers, "MAX_PLANS", 2)
        patched.setattr(readers, "OFTEN", 2)
        plans = readers.Plans(CATEGORIES[48].uap)
        bodies = [b"\x80\x01\x02"] * 3 + [b"\x40abc"] * 3 + [b"\x08abc"] * 3
        read = [plans.read(body, 0) for body in bodies * 2]
    assert read == [read[place] for place in (0, 3, 6) for _ in range(3)] * 2
    assert len(plans._readers) <= 2
    assert read[0] == ({"I048/010": {"SAC": 1, "SIC": 2}}, 3)


def test_decoding_loads_no_numpy() -> None:
    # It takes longer to load than fifty thousand records take to read.
    code = "import sys, plotfeed.proto.asterix.codec.decode; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
