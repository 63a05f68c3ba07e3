"""Against asterix-decoder: it reads what we send, and we read what it reads of real radars."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.asterix_input import every_path, numeric_slots, plots, text_constants, udp_payloads
from support.asterix_readers import items_of, read_blocks, values_of
from support.given_recordings import EVERY_CAPTURE, EVERY_FRAME, RadarCapture

from plotfeed.feeds.recording.foreign_recordings import open_recording
from plotfeed.proto.asterix.cat015 import CAT015
from plotfeed.proto.asterix.cat025 import CAT025
from plotfeed.proto.asterix.cat048 import CAT034, CAT048, PlotEncoder048, ServiceEncoder034
from plotfeed.proto.asterix.cat062 import CAT062_1_18, CAT063
from plotfeed.proto.asterix.cat205 import CAT205
from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.decode import FURTHER, Record, Value, blocks, decode
from plotfeed.proto.asterix.codec.encode import Encoder, blocks_of
from plotfeed.proto.asterix.codec.layout import Category, Quantity, Raw
from plotfeed.proto.units import FOOT_M, NM_M

FIRST = np.array([0])

# Registers of Mode S transponders: asterix-decoder shows what they report, and their numbers.
REGISTERS = "I048/250"

ADVISORY = "I048/260"  # A register again, without its number

HEIGHT_OF_STATION = "I034/120"  # asterix-decoder takes a height below 0 for one above


READ = (CAT015, CAT025, CAT034, CAT048, CAT062_1_18, CAT063, CAT205)

# Items that asterix-decoder reads in another way.
OTHERWISE = {
    ADVISORY,
    HEIGHT_OF_STATION,
    "I015/480",  # as zeros
    "I015/600",  # deviations of positions as signed
    "I015/601",  # correlations
    "I015/602",  # and those of velocities, of a second coordinate without their sign
    "I015/603",
    "I015/628",  # elevations below 0 half a turn off
    "I015/631",
    "I062/135",  # in feet
    "I062/136",
}

NOT_READ = {
    "I015/030*2",  # these end the record before its end
    "I015/604/RSVV",
    "I015/626/SDDA",
    "I015/626/CODVR",
    "I015/626/CODVRR",
    "I015/626/CODVRA",
    "I048/020/IRMXPREP",  # its editions have fewer groups: 048 1.21, 062 1.18 and 063 1.3
    "I062/080/M5I",
    "I063/060/TTFEP",
    "I062/380/TID*2",  # a point's number as signed
    "I062/380/ACS",  # these are shown by what they mean
    "I062/380/BDSDATA*2",
    "I062/500/ABA",  # in feet
}


def ours(value: Value) -> list[Any]:
    """The values of an item from left to right."""
    return list(_ours(value))


def _ours(value: Value) -> Iterator[Any]:
    if isinstance(value, dict):
        for name, member in value.items():
            assert name != FURTHER
            yield from _ours(member)
    elif isinstance(value, list):
        for member in value:
            yield from _ours(member)
    else:
        yield value


def assert_agree(records: list[Record], theirs: list[dict[str, Any]], but: set[str]) -> int:
    """Both have the same items in the same records, with the same values; how many values."""
    assert len(records) == len(theirs)
    compared = 0
    for record, other in zip(records, theirs, strict=True):
        items = items_of(other)
        assert record.category == other["category"]
        assert set(record.items) == set(items) != set()
        for name in set(items) - but:
            mine, its = ours(record.items[name]), values_of(items[name])
            if name == REGISTERS:
                mine = [f"{one:X}{two:X}" for one, two in zip(mine[1::3], mine[2::3], strict=True)]
                its = [register["BDS"]["val"] for register in items[name]]
            if name == "I048/240":  # it shows a character that does not exist as a blank
                mine = [text.replace("?", " ") for text in mine]
            assert mine == [_comparable(value) for value in its], name
            compared += len(mine)
    return compared


def _comparable(value: Any) -> Any:
    return pytest.approx(value, rel=1e-6, abs=1e-9) if isinstance(value, float) else value


@EVERY_CAPTURE
def test_a_recording_of_radars_reads_the_same(capture: RadarCapture) -> None:
    payloads = udp_payloads(capture.path)
    records = [record for payload in payloads for record in decode(payload)]
    counts = [sum(r.category == c for r in records) for c in (48, 34)]
    assert counts == [capture.plots, capture.services]
    theirs = [record for payload in read_blocks(payloads) for record in payload]
    values = 30 * capture.plots + 4 * capture.services
    assert assert_agree(records, theirs, {ADVISORY}) > values


@EVERY_FRAME
def test_a_frame_reads_the_same(frame_file: Path) -> None:
    with open_recording(frame_file) as recording:
        payloads = [each.payload for each in recording.reader.messages()]
    records = [r for p in payloads for r in decode(p, CATEGORIES | {62: CAT062_1_18})]
    theirs = [record for payload in read_blocks(payloads) for record in payload]
    assert assert_agree(records, theirs, {ADVISORY, "I062/135", "I062/136", "I062/SP"}) > 15


@EVERY_CAPTURE
def test_radars_send_a_sector_message_after_its_plots(capture: RadarCapture) -> None:
    payloads = udp_payloads(capture.path)
    mixed = 0
    for payload in payloads:
        records = decode(payload)
        categories = [block.category for block in blocks(payload)]
        assert categories in ([48], [34], [48, 34])
        if len(categories) == 2:
            mixed += 1
            assert records[-1].get("I034/000") == 2
            sector = records[-1].get("I034/020")
            thetas = [r.get("I048/040/THETA") for r in records[:-1]]
            assert all(isinstance(theta, float) for theta in thetas if theta is not None)
            assert isinstance(sector, float)
            assert all(0 <= sector - t <= 11.25 for t in thetas if isinstance(t, float))
    assert mixed >= 20


@pytest.mark.parametrize("category", READ, ids=lambda c: f"{c.number:03}")
def test_it_reads_every_item_that_we_can_send(category: Category) -> None:
    rng = np.random.default_rng(7)
    paths = [path for path in every_path(category) if path not in NOT_READ]
    encoder = Encoder(category, paths, constants=text_constants(category))
    columns: dict[str, list[float]] = {}
    for slot in numeric_slots(category):
        assert isinstance(slot.part, Raw | Quantity)
        low, high = slot.part.limits
        if isinstance(slot.part, Quantity):
            high = (slot.part.modulus or high + 1) - 1
            drawn = rng.integers(low, high, 200, endpoint=True) * float(slot.part.lsb)
            columns[slot.path] = drawn.tolist()
        else:
            columns[slot.path] = rng.integers(low, high, 200, endpoint=True).tolist()
    sent = blocks_of(category.number, encoder.records(columns), encoder.record_length)
    editions = CATEGORIES | {category.number: category}
    records = [record for block in sent for record in decode(block, editions)]
    theirs = [record for block in read_blocks(sent) for record in block]
    assert assert_agree(records, theirs, OTHERWISE) > 200 * 12


def test_it_reads_plots_to_half_an_lsb() -> None:
    n = 500
    rng = np.random.default_rng(3)
    measured = plots(
        t_utc_ns=rng.integers(0, 2**60, n),
        range_m=rng.uniform(0, 255 * NM_M, n),
        azimuth_deg=rng.uniform(0, 360, n),
        run_length_deg=rng.uniform(0, 11, n),
        amplitude_dbm=rng.uniform(-127, 127, n),
        height_m=rng.uniform(-500, 10_000, n),
    )
    records = [r for b in read_blocks(PlotEncoder048(25, 3).blocks(measured)) for r in b]
    assert len(records) == n
    items = [{name: values_of(item) for name, item in items_of(r).items()} for r in records]
    assert {tuple(sorted(i)) for i in items} == {
        ("I048/010", "I048/020", "I048/040", "I048/110", "I048/130", "I048/140")
    }
    assert {tuple(i["I048/010"]) for i in items} == {(25, 3)}
    assert {tuple(i["I048/020"]) for i in items} == {(1, 1, 0, 0, 0)}
    rho, theta = np.array([i["I048/040"] for i in items]).T
    prl, pam = np.array([i["I048/130"] for i in items]).T
    (height,) = np.array([i["I048/110"] for i in items]).T
    (seconds,) = np.array([i["I048/140"] for i in items]).T
    turned = (theta - measured.azimuth_deg + 180) % 360 - 180
    late = (seconds - measured.t_utc_ns % (86_400 * 10**9) / 1e9 + 43_200) % 86_400 - 43_200
    for error, half_lsb in (
        (rho - measured.range_m / NM_M, 0.5 / 256),
        (turned, 180 / 65536),
        (prl - measured.run_length_deg, 180 / 8192),
        (pam - measured.amplitude_dbm, 0.5),
        (height - measured.height_m / FOOT_M, 12.5),
        (late, 0.5 / 128),
    ):
        assert np.abs(error).max() <= half_lsb * (1 + 1e-6)


def test_it_reads_service_messages() -> None:
    encoder = ServiceEncoder034(25, 3, antenna_period_s=2.5, place=(40.45, -3.73, 650.0))
    sent = [*encoder.north_markers([10**9], FIRST), *encoder.sector_crossings([0], [45.0], FIRST)]
    north, sector = (
        {name: values_of(item) for name, item in items_of(record).items()}
        for block in read_blocks(sent)
        for record in block
    )
    place = north.pop("I034/120")
    assert place == [650, pytest.approx(40.45, abs=1.1e-5), pytest.approx(-3.73, abs=1.1e-5)]
    assert north == {"I034/010": [25, 3], "I034/000": [1], "I034/030": [1.0], "I034/041": [2.5]}
    assert sector == {"I034/010": [25, 3], "I034/000": [2], "I034/030": [0.0], "I034/020": [45.0]}
