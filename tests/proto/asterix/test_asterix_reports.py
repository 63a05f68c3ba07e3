"""Reports of every kind are byte for byte what libasterix makes of integers worked out by hand.

Each case has what an encoder is given in place of the usual, and what must come of it: libasterix
only puts these integers in their places.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pytest
from asterix.generated import (  # type: ignore[import-not-found]
    Cat_015_1_2,
    Cat_016_1_0,
    Cat_025_1_6,
    Cat_034_1_29,
    Cat_048_1_32,
    Cat_062_1_21,
    Cat_063_1_7,
    Cat_205_1_0,
)
from hypothesis import example, given
from hypothesis import strategies as st
from support.asterix_input import plots, tracks

from plotfeed.proto.asterix.cat015 import Geometry, PlotEncoder015, Scanning
from plotfeed.proto.asterix.cat016 import SystemEncoder016
from plotfeed.proto.asterix.cat025 import CAT025, CAT025_HALF_TURN, status_025
from plotfeed.proto.asterix.cat048 import PlotEncoder048, north_markers, sector_crossings
from plotfeed.proto.asterix.cat062 import TrackEncoder062, status_063
from plotfeed.proto.asterix.cat205 import BearingEncoder205
from plotfeed.proto.asterix.codec.decode import Record, decode
from plotfeed.proto.asterix.codec.encode import Reports
from plotfeed.proto.asterix.codec.layout import Category
from plotfeed.proto.errors import EncodeError

OURS = 25, 3
SOURCE = (("SAC", 25), ("SIC", 3))
SITE = {"latitude_deg": 40.45, "longitude_deg": -3.73}
MIDNIGHT_NS = 1_700_006_400 * 10**9
SECOND_NS = MIDNIGHT_NS + 10**9
# The last that rounds to the day before, and the first that rounds to midnight.
LAST_NS, NEXT_NS = MIDNIGHT_NS - 3_906_251, MIDNIGHT_NS - 3_906_250
LAST = 11_059_199
FIRST, ROWS = np.array([0]), 3

Given = dict[str, Any]
Integers = dict[str, int]
Case = tuple[str, Given, Integers]


def twos(value: int, bits: int) -> int:
    """A number in two's complement."""
    return value & (1 << bits) - 1


def block_of(category: Any, items: Given) -> bytes:
    """A data block of one record of libasterix, with the items that are there."""
    there = {name: item for name, item in items.items() if item not in (None, {})}
    record = category.cv_record.create(there)
    return bytes(category.create([record]).unparse().to_bytes())


def of_bits(sent: Integers, **bits: int) -> Integers:
    """The subfields that are sent."""
    return {name: twos(sent[name], size) for name, size in bits.items() if name in sent}


PLOTS_048: list[Case] = [
    ("2-D, no amplitude", {}, {}),
    ("3-D", {"run_length_deg": 1.40625, "amplitude_dbm": -72.0, "height_m": 762.0},
     {"PRL": 32, "PAM": -72, "3DH": 100}),
    ("2-D with amplitude", {"run_length_deg": 0, "amplitude_dbm": 0}, {"PRL": 0, "PAM": 0}),
    ("height alone", {"height_m": 0.0}, {"3DH": 0}),
    ("amplitude alone", {"amplitude_dbm": -1.0}, {"PAM": -1}),
    ("run length alone", {"run_length_deg": 5.0}, {"PRL": 114}),
    ("a tie of range goes down to even", {"range_m": 18.0859375}, {"RHO": 2}),
    ("rounding reaches north", {"azimuth_deg": 359.998}, {"THETA": 0}),
    ("last time of day", {"t_utc_ns": LAST_NS}, {"TOD": LAST}),
    ("rounding reaches midnight", {"t_utc_ns": NEXT_NS}, {"TOD": 0}),
    ("a tie of time goes down to even", {"t_utc_ns": MIDNIGHT_NS + 3_906_250}, {"TOD": 0}),
    ("below sea level", {"height_m": -100.0}, {"3DH": -13}),
    ("approaches", {"range_rate_m_s": -12.4}, {"CAL": -12}),
]  # fmt: skip


def plot_048(sent: Integers, _row: int) -> bytes:
    return block_of(
        Cat_048_1_32,
        {
            "010": SOURCE,
            "140": sent["TOD"],
            "020": ((1, 1, 0, 0, 0, None),),
            "040": (("RHO", sent["RHO"]), ("THETA", sent["THETA"])),
            "130": of_bits(sent, PRL=8, PAM=8),
            "110": (0, ("3DH", twos(sent["3DH"], 14))) if "3DH" in sent else None,
            "120": {"CAL": (0, 0, twos(sent["CAL"], 10))} if "CAL" in sent else None,
        },
    )


MONOSTATIC: list[Case] = [
    ("2-D", {}, {}),
    ("3-D with everything",
     {"sigma_range_m": 0.26, "sigma_azimuth_deg": 0.5, "elevation_deg": 12.5,
      "sigma_elevation_deg": 1.0, "snr": 100.0, "amplitude_dbm": -101.6},
     {"SDR": 3, "SDASZ": 729, "EL": 4551, "SDEL": 1457, "RPS": 20, "RPP": -102}),
    ("below the horizon", {"elevation_deg": -1.0}, {"EL": -364}),
    ("last time of day", {"t_utc_ns": LAST_NS}, {"TOA": LAST}),
    ("rounding reaches midnight", {"t_utc_ns": NEXT_NS}, {"TOA": 0}),
    ("SNR saturates", {"snr": 1e20}, {"RPS": 127}),
    ("SNR below 1", {"snr": 0.5}, {"RPS": -3}),
    ("of a class", {"kind": "multirotor"}, {"CLS": 300}),
    ("approaches", {"range_rate_m_s": -12.34, "sigma_range_rate_m_s": 0.25},
     {"DV": -1234, "SDDV": 17}),
]  # fmt: skip
MULTISTATIC: list[Case] = [
    ("passive", {"sigma_bistatic_range_m": 12.34}, {"SDR": 124}),
    ("a negative difference", {"bistatic_range_m": -12.3}, {"R": -123}),
]
BEARINGS_015: list[Case] = [
    ("microphones", {"elevation_deg": 30.0}, {"EL": 10_923}),
    ("in a plane", {}, {}),
]
FIRST_OBSERVATION = (1 << 24) - 1


def plot_015(sent: Integers, row: int) -> bytes:
    powers = of_bits(sent, RPS=8)
    if "RPP" in sent:
        powers = {"RPP": (0, twos(sent["RPP"], 9)), **powers}
    observation = (FIRST_OBSERVATION + row) % (1 << 24)
    return block_of(
        Cat_015_1_2,
        {
            "010": SOURCE,
            "000": (1, 0),
            "020": ((sent["MOMU"], 3, 3, 0, None),),
            "145": sent["TOA"],
            "300": [(sent["CLS"], 100)] if "CLS" in sent else None,
            "400": (("PID", 2), ("ON", observation)) if sent["MOMU"] == 1 else None,
            "625": of_bits(sent, R=24, SDR=24),
            "626": of_bits(sent, DV=24, SDDV=16),
            "627": of_bits(sent, AZ=16, SDASZ=16),
            "628": of_bits(sent, EL=16, SDEL=16),
            "630": powers,
        },
    )


DIRECTIONS: list[Case] = [
    ("bearing alone", {}, {}),
    ("everything", {"amplitude_dbm": -80.0, "snr": 100.0, "elevation_deg": 5.004},
     {"LEVEL": 2699, "QUALITY": 128, "ELEVATION": 500}),
    ("quality saturates", {"snr": 1e9}, {"QUALITY": 255}),
    ("no quality below 0 dB", {"snr": 0.1}, {"QUALITY": 0}),
    ("below the horizon", {"elevation_deg": -0.01}, {"ELEVATION": -1}),
    ("measured long before it is sent", {"t_utc_ns": 5 * 10**9}, {}),
    ("rounding reaches north", {"azimuth_deg": 359.996}, {"BEARING": 0}),
    ("last time of day", {"sent_ns": LAST_NS}, {"TOD": LAST}),
    ("rounding reaches midnight", {"sent_ns": NEXT_NS}, {"TOD": 0}),
]  # fmt: skip


def direction_205(sent: Integers, row: int) -> bytes:
    """A bearing from 40.45 N, 3.73 W."""
    names = {"180": ("LEVEL", 16), "190": ("QUALITY", 8), "200": ("ELEVATION", 16)}
    return block_of(
        Cat_205_1_0,
        {
            "010": SOURCE,
            "000": 5,
            "030": sent["TOD"],
            "040": (255 + row) % 256,
            "050": (("LAT", 7_540_427), ("LON", twos(-695_322, 32))),
            "070": sent["BEARING"],
        }
        | {item: twos(sent[n], bits) for item, (n, bits) in names.items() if n in sent},
    )


TRACKS: list[Case] = [
    ("2-D", {}, {}),
    ("everything", {"height_m": 762.0, "climb_m_s": -3.175, "age_s": 1.5, "sigma_east_m": 2.5,
                    "sigma_north_m": 40_000.0},
     {"ALTITUDE": 400, "RATE": -100, "AGE": 6, "SDX": 6, "SDY": 65_535}),
    ("begins, tentative", {"first": True, "tentative": True}, {"TSB": 1, "CNF": 1}),
    ("ends, coasted", {"last": True, "coasted": True}, {"TSE": 1, "CST": 1}),
    ("below the ellipsoid", {"height_m": -10.0}, {"ALTITUDE": -5}),
    ("the south-west", {"latitude_deg": -33.0, "longitude_deg": -70.5, "east_m": -1.0,
                        "north_m": -0.75}, {"LAT": -6_151_646, "LON": -13_142_153, "X": -2,
                                            "Y": -2}),
    ("rounding reaches midnight", {"t_utc_ns": NEXT_NS}, {"TOD": 0}),
]  # fmt: skip
A_TRACK = {
    "t_utc_ns": MIDNIGHT_NS, "track": 4711, "latitude_deg": 40.0, "longitude_deg": 3.0,
    "east_m": 100.0, "north_m": 200.0, "velocity_east_m_s": 10.0, "velocity_north_m_s": -10.0,
}  # fmt: skip
TRACK_SENT = {"TOD": 0, "LAT": 7_456_540, "LON": 559_241, "X": 200, "Y": 400, "VX": 40, "VY": -40}


def track_062(sent: Integers, _row: int) -> bytes:
    high, coasted = "ALTITUDE" in sent, sent.get("CST", 0)
    begins, ends = sent.get("TSB", 0), sent.get("TSE", 0)
    return block_of(
        Cat_062_1_21,
        {
            "010": SOURCE,
            "070": sent["TOD"],
            "105": (("LAT", twos(sent["LAT"], 32)), ("LON", twos(sent["LON"], 32))),
            "100": (("X", twos(sent["X"], 24)), ("Y", twos(sent["Y"], 24))),
            "185": (("VX", twos(sent["VX"], 16)), ("VY", twos(sent["VY"], 16))),
            "040": 4711,
            "080": (
                (1, 0, 1, 2 if high else 0, sent.get("CNF", 0), None),
                (1, ends, begins, 0, 0, 0, 0, None),
                (0, 0, 0, 0, 0, None),
                (coasted, coasted, 0, 0, 0, 0, 0, None),
            ),
            "130": twos(sent["ALTITUDE"], 16) if high else None,
            "220": twos(sent["RATE"], 16) if "RATE" in sent else None,
            "290": {"PSR": sent["AGE"]} if "AGE" in sent else None,
            "500": {"APC": (("X", sent["SDX"]), ("Y", sent["SDY"]))} if "SDX" in sent else None,
        },
    )


def encoded_015(geometry: Geometry) -> Callable[[Given], list[bytes]]:
    encoder = PlotEncoder015(*OURS, geometry=geometry, classes={"multirotor": 300})
    return lambda columns: encoder.blocks(plots(**columns), FIRST_OBSERVATION)


def encoded_205(columns: Given) -> list[bytes]:
    measured = {name: column for name, column in columns.items() if name != "sent_ns"}
    sent_ns = columns["sent_ns"][0] if len(columns["sent_ns"]) else 0
    return BearingEncoder205(*OURS, **SITE).blocks(plots(**measured), sent_ns, 255)


class Kind(NamedTuple):
    """Reports of one kind."""

    encode: Callable[[Given], list[bytes]]
    expect: Callable[[Integers, int], bytes]  # Of the integers of a row
    usual: tuple[Given, Integers]
    cases: Sequence[Case]


PLOT: Given = {"t_utc_ns": MIDNIGHT_NS, "azimuth_deg": 90.0}
NO_RANGE, AT_1_KM = {"range_m": np.nan}, {"range_m": 1000.0}
SENT_015 = {"TOA": 0, "AZ": 16_384}
PAIR = {"bistatic_range_m": 1000.0, "range_m": 600, "channel": 2}
KINDS = {
    "048": Kind(
        lambda columns: PlotEncoder048(*OURS).blocks(plots(**columns)),
        plot_048,
        (PLOT | {"range_m": 18520.0}, {"TOD": 0, "RHO": 2560, "THETA": 16384}),
        PLOTS_048,
    ),
    "015": Kind(
        encoded_015(Geometry.MONOSTATIC),
        plot_015,
        (PLOT | AT_1_KM, SENT_015 | {"R": 10_000, "MOMU": 0}),
        MONOSTATIC,
    ),
    "015 multistatic": Kind(
        encoded_015(Geometry.MULTISTATIC),
        plot_015,
        (PLOT | PAIR, SENT_015 | {"R": 10_000, "MOMU": 1}),
        MULTISTATIC,
    ),
    "015 bearings": Kind(
        encoded_015(Geometry.OTHER), plot_015, (PLOT | NO_RANGE, SENT_015 | {"MOMU": 2}),
        BEARINGS_015,
    ),
    "205": Kind(
        encoded_205,
        direction_205,
        ({"azimuth_deg": 90.0, "sent_ns": SECOND_NS}, {"BEARING": 9000, "TOD": 128}),
        DIRECTIONS,
    ),
    "062": Kind(
        lambda columns: TrackEncoder062(*OURS).blocks(tracks(**columns)),
        track_062,
        (A_TRACK, TRACK_SENT),
        TRACKS,
    ),
}  # fmt: skip


EVERY_KIND = pytest.mark.parametrize("name", KINDS)
EVERY_CASE = pytest.mark.parametrize(
    ("name", "case"),
    [(name, case) for name, kind in KINDS.items() for case in kind.cases],
    ids=lambda of: of if isinstance(of, str) else of[0],
)


def assert_libasterix_makes_the_same(name: str, *cases: Case) -> None:
    """Of rows of all that these cases have in place of the usual."""
    kind = KINDS[name]
    columns, sent = kind.usual
    for _, given_in_its_place, sent_in_its_place in cases:
        columns, sent = columns | given_in_its_place, sent | sent_in_its_place
    blocks = kind.encode({column: [value] * ROWS for column, value in columns.items()})
    expected = [kind.expect(sent, row) for row in range(ROWS)]
    assert all(int.from_bytes(block[1:3], "big") == len(block) for block in blocks)
    assert b"".join(block[3:] for block in blocks) == b"".join(each[3:] for each in expected)
    assert {block[0] for block in blocks} == {each[0] for each in expected}
    assert len(blocks) == (ROWS if name == "205" else 1)


@EVERY_CASE
def test_records_are_those_of_libasterix(name: str, case: Case) -> None:
    assert_libasterix_makes_the_same(name, case)


@EVERY_KIND
@given(data=st.data())
def test_items_do_not_depend_on_each_other(name: str, data: st.DataObject) -> None:
    some = st.lists(st.sampled_from(KINDS[name].cases), max_size=4)
    assert_libasterix_makes_the_same(name, *data.draw(some))


# The part that a column is sent in, and its last bit in the column's unit.
LSBS = {
    "048": {"range_m": ("RHO", 1852 / 256), "azimuth_deg": ("THETA", 360 / 2**16),
            "run_length_deg": ("PRL", 360 / 2**13), "amplitude_dbm": ("PAM", 1.0),
            "height_m": ("3DH", 25 * 0.3048), "range_rate_m_s": ("CAL", 1.0)},
    "015": {"range_m": ("R", 0.1), "range_rate_m_s": ("DV", 0.01), "amplitude_dbm": ("RPP", 1.0),
            "azimuth_deg": ("AZ", 360 / 2**16), "elevation_deg": ("EL", 180 / 2**16)},
    "015 multistatic": {"bistatic_range_m": ("R", 0.1)},
    "015 bearings": {"elevation_deg": ("EL", 180 / 2**16)},
    "205": {"azimuth_deg": ("BEARING", 0.01), "elevation_deg": ("ELEVATION", 0.01)},
    "062": {"east_m": ("X", 0.5), "north_m": ("Y", 0.5), "velocity_east_m_s": ("VX", 0.25),
            "velocity_north_m_s": ("VY", 0.25), "height_m": ("ALTITUDE", 6.25 * 0.3048),
            "climb_m_s": ("RATE", 6.25 * 0.3048 / 60), "age_s": ("AGE", 0.25),
            "latitude_deg": ("LAT", 180 / 2**25), "longitude_deg": ("LON", 180 / 2**25)},
}  # fmt: skip


@EVERY_KIND
@pytest.mark.parametrize(("steps", "sent"), [(1.49, 1), (1.51, 2), (99.51, 100)])
def test_values_are_sent_to_the_nearest_step(name: str, steps: float, sent: int) -> None:
    parts = LSBS[name]
    given_values = {column: steps * lsb for column, (_, lsb) in parts.items()}
    assert_libasterix_makes_the_same(
        name, ("", given_values, {part: sent for part, _ in parts.values()})
    )


@EVERY_KIND
def test_what_is_measured_now_and_then_is_refused(name: str) -> None:
    kind = KINDS[name]
    columns = kind.usual[0].copy()
    for _, given_in_its_place, _ in kind.cases:
        columns |= given_in_its_place
    for column, value in columns.items():
        if not isinstance(value, float) or math.isnan(value):
            continue  # no measurement, or one that is not sent
        for rows in ([value, math.nan], [math.nan, value], [value] * 90 + [math.nan]):
            others = {name: [each] * len(rows) for name, each in columns.items()}
            with pytest.raises(EncodeError):
                kind.encode(others | {column: rows})


@EVERY_KIND
def test_no_rows_make_no_blocks(name: str) -> None:
    kind = KINDS[name]
    assert kind.encode({column: np.empty(0) for column in kind.usual[0]}) == []


# Where the radar stands, south and west and below the ellipsoid, and what is sent of it.
PLACE = [-34.5, -58.25, -12.4]
SENT_PLACE = [("HGT", -12, 16), ("LAT", -1_607_817, 24), ("LON", -2_714_647, 24)]
PERIOD_S = 4.9453125  # 633 / 128


# Time, sector azimuth (None: north marker), and what is sent: time of day, sector.
@pytest.mark.parametrize(
    ("t_utc_ns", "azimuth_deg", "time_of_day", "sector"),
    [
        (SECOND_NS, None, 128, None),
        (MIDNIGHT_NS - 7_812_500, None, LAST, None),
        (MIDNIGHT_NS - 1, None, 0, None),
        (SECOND_NS, 11.25, 128, 8),
        (SECOND_NS, 0.0, 128, 0),
        (SECOND_NS, 360.0, 128, 0),
        (SECOND_NS, 358.59375, 128, 255),
        (SECOND_NS, 359.5, 128, 0),  # rounding wraps
    ],
)
def test_service_messages_in_034(
    t_utc_ns: int, azimuth_deg: float | None, time_of_day: int, sector: int | None
) -> None:
    place = tuple((name, twos(value, bits)) for name, value, bits in SENT_PLACE)
    items: Given = {"010": SOURCE, "030": time_of_day}
    if azimuth_deg is None:
        encoder = north_markers(*OURS, antenna_period_s=PERIOD_S, place=PLACE)
        found = encoder.one_each([t_utc_ns], FIRST)
        items |= {"000": 1, "041": 633, "120": place}
    else:
        azimuths = {"I034/020": [azimuth_deg]}
        found = sector_crossings(*OURS).one_each([t_utc_ns], FIRST, azimuths)
        items |= {"000": 2, "020": sector}
    assert found == [block_of(Cat_034_1_29, items)]


def test_systems_in_016() -> None:
    """Of a passive radar with two transmitters."""
    receiver = (0.0, -180.0, 0.0)
    encoder = SystemEncoder016(
        [25],
        [3],
        transmitters=[[(40.0, -3.0, 700.1), (-40.0, 180.0, -9000.0)]],
        receivers=[receiver],
        reference=receiver,
        period_s=10,
        geoid_undulation_m=52.0,
    )
    half_turn, common = 1 << 31, {"010": SOURCE, "140": 128}
    north, south, west = 477_218_588, twos(-477_218_588, 32), twos(-35_791_394, 32)
    (both,) = encoder.blocks([SECOND_NS], FIRST)
    assert both == [
        block_of(Cat_016_1_0, common | items)
        for items in (
            {
                "000": 1,
                "200": 10,
                "300": [(0, 0, 0), (1, 1, 0)],
                "400": (("LAT", 0), ("LON", half_turn)),
                "405": twos(-208, 16),
            },
            {
                "000": 2,
                "410": [
                    (0, north, west, 2800, 0, 0, 0, 0),
                    (1, south, half_turn, twos(-32_768, 16), 0, 0, 0, 0),
                ],
                "420": [(0, 0, half_turn, 0)],
            },
        )
    ]


def test_status_in_025_and_063() -> None:
    once = np.array([SECOND_NS]), FIRST
    system = status_025(*OURS, (*SITE.values(), 652.0), geoid_undulation_m=52.0)
    status = {
        "010": SOURCE,
        "000": (1, 0),
        "070": 128,
        "100": ((0, 0, 0, None), (0, 0, 0, None)),
        "600": (("LAT", 965_174_595), ("LON", twos(-44_500_633, 32))),
        "610": 2400,
    }
    assert system.one_each(*once) == [block_of(Cat_025_1_6, status)]
    works = {"010": SOURCE, "030": 128, "050": SOURCE, "060": ((0, 0, 0, 0, 0, 0, None),)}
    assert status_063(*OURS).one_each(*once) == [block_of(Cat_063_1_7, works)]


def one(name: str, **columns: Any) -> Record:
    """One report there and back, of what is usual but for those columns."""
    given_to_it = KINDS[name].usual[0] | columns
    (block,) = KINDS[name].encode({column: [value] for column, value in given_to_it.items()})
    (record,) = decode(block)
    return record


MAST = (40.45, -3.73, 700.0)
SYSTEM: dict[str, Any] = {
    "sac": [25], "sic": [3], "transmitters": [[MAST]], "receivers": [MAST], "reference": MAST,
    "period_s": 10,
}  # fmt: skip


def system(**changes: Any) -> SystemEncoder016:
    """Of one transmitter and one receiver, but for the changes."""
    return SystemEncoder016(**SYSTEM | changes)


MICROPHONES = PlotEncoder015(1, 1, classes={"bird": 512})


def radar_at(*place: float, period_s: float = 1.0) -> Reports:
    return north_markers(1, 1, antenna_period_s=period_s, place=place)


def status_at(
    latitude_deg: float, longitude_deg: float, height_m: float = 0.0, **more: Any
) -> Reports:
    return status_025(1, 1, (latitude_deg, longitude_deg, height_m), **more)


@pytest.mark.parametrize(
    ("encode", "said"),
    [
        *((lambda bad=bad: PlotEncoder048(*bad), "I048/010") for bad in ((256, 0), (0, -1))),
        (lambda: north_markers(0, 256, antenna_period_s=1, place=(0, 0, 0)), "I034/010"),
        *((lambda n=n: PlotEncoder048(1, 1, max_octets=n), "max_octets") for n in (20, 70_000)),
        (lambda: PlotEncoder015(1, 1, max_octets=30), "max_octets"),
        (lambda: PlotEncoder015(256, 1), "I015/010/SAC"),
        *((lambda place=place: radar_at(*place), "I034/120")
          for place in ((91.0, 0.0, 0.0), (0.0, 181.0, 0.0), (0.0, 0.0, 4e4), (math.nan,) * 3)),
        *((lambda s=s: radar_at(0.0, 0.0, 0.0, period_s=s), "I034/041")
          for s in (512.0, -1.0, math.nan)),
        *((lambda place=place: status_at(*place), "I025/600")
          for place in ((91.0, 0.0), (0.0, 181.0), (0.0, math.nan))),
        *((lambda to=to: BearingEncoder205(1, 1, latitude_deg=to[0], longitude_deg=to[1]),
           "I205/050") for to in ((90.1, 0.0), (0.0, -180.1), (math.nan, 0.0), (0, math.inf))),
        (lambda: system(period_s=math.nan), "I016/200"),
        (lambda: system(sic=[256]), "I016/010/SIC"),
        (lambda: system(transmitters=[[MAST] * 256]), "I016/300"),
        (lambda: system(transmitters=[[(90.1, 0.0, 0.0)]]), "I016/410/0/LAT"),
        (lambda: system(receivers=[(0.0, 0.0, math.nan)]), "I016/420"),
        (lambda: system(reference=(0.0, math.inf, 0.0)), "I016/400"),
        (lambda: system(transmitters=[[MAST] * 70]), "max_octets"),  # more than a datagram holds
        (lambda: one("015", sigma_elevation_deg=1.0), "I015/628/SDEL: a standard deviation of"),
        (lambda: one("062", latitude_deg=91.0), "I062/105"),
        (lambda: one("062", track=65_536), "I062/040"),
        (lambda: one("062", sigma_east_m=1.0), "I062/500/APC/Y: a column is missing"),
        *((lambda snr=snr: one("015", snr=snr), "I015/630/RPS") for snr in (0.0, -1.0, math.inf)),
        (lambda: MICROPHONES.blocks(plots(kind="jet")), "I015/300/0/CLS: no class for kind 'jet'"),
        (lambda: MICROPHONES.blocks(plots(kind="bird")), "I015/300/0/CLS"),
    ],
)  # fmt: skip
def test_what_cannot_be_sent_is_refused(encode: Callable[[], object], said: str) -> None:
    with pytest.raises(EncodeError, match=said):
        encode()


# Column, its LSB, that of its standard deviation, and the bits of the latter.
DEVIATIONS = {
    "I015/625/SDR": ("range_m", 0.1, 0.1, 24),
    "I015/626/SDDV": ("range_rate_m_s", 0.01, 1 / 64, 16),
    "I015/627/SDASZ": ("azimuth_deg", 360 / 2**16, 180 / 2**18, 16),
    "I015/628/SDEL": ("elevation_deg", 180 / 2**16, 180 / 2**18, 16),
    "I062/500/APC/X": ("east_m", 0.5, 0.5, 16),
}


@pytest.mark.parametrize("path", DEVIATIONS)
@given(sigma=st.floats(0, 1e9))
@example(sigma=0.0)
@example(sigma=1e-300)
@example(sigma=math.inf)
def test_deviations_hold_the_rounding_of_their_value_and_are_rounded_up(
    path: str, sigma: float
) -> None:
    """So none is 0, and none less than the error of what was read."""
    column, lsb, own_lsb, bits = DEVIATIONS[path]
    more = {"sigma_north_m": 1.0} if path.startswith("I062") else {}
    back = one(path[1:4], **{column: 9.0, f"sigma_{column}": sigma}, **more).get(path)
    most = (2**bits - 1) * own_lsb
    exactly = min(math.hypot(sigma, lsb / math.sqrt(12)), most)
    assert isinstance(back, float)
    assert back > 0
    assert exactly * (1 - 1e-12) <= back <= min(exactly + own_lsb, most) * (1 + 1e-12)


def test_heights_of_048_are_above_the_geoid() -> None:
    heights_m, levels_m = np.array([52.0 + 762.0, 0.0, -100.0]), np.array([52.0, 52.0, -100.0])
    for undulation_m, feet in ((levels_m, [2500, -175, 0]), (52.0, [2500, -175, -500])):
        (block,) = PlotEncoder048(1, 1).blocks(plots(height_m=heights_m), undulation_m)
        assert [record.get("I048/110") for record in decode(block)] == feet


def test_a_plot_of_015_says_how_it_was_scanned_and_how_sure_its_class_is() -> None:
    encoder = PlotEncoder015(25, 3, scanning=Scanning.FORWARD, classes={"bird": 3})
    for probability, percent in ((math.nan, 0), (0.25, 25)):
        (block,) = encoder.blocks(plots(kind="bird", kind_probability=probability))
        (record,) = decode(block)
        assert record.get("I015/020") == {"MOMU": 0, "TTAX": 3, "SCD": 1}
        assert record.get("I015/300") == [{"CLS": 3, "PRB": percent}]


@pytest.mark.parametrize("edition", [CAT025, CAT025_HALF_TURN])
def test_the_north_pole_is_as_near_as_the_item_can_say(edition: Category) -> None:
    pole = status_at(90.0, 0.0, category=edition)
    assert pole.one_each(FIRST, FIRST)[0].find(bytes.fromhex("7fffffff00000000")) > 0
    south = status_at(-90.0, 179.0, -1e6)
    (record,) = decode(south.one_each(FIRST, FIRST)[0])
    assert record.get("I025/600") == {"LAT": -90.0, "LON": pytest.approx(179.0, abs=5e-8)}
    assert record.get("I025/610") == -8192.0


def test_systems_and_sensors_say_each_for_itself() -> None:
    each = [{"sic": [3]}, {"sic": [4], "transmitters": [[(40.45, -3.73, 900.0)]]}]
    both = {name: [*of, *each[1].get(name, of)] for name, of in SYSTEM.items()
            if name not in ("reference", "period_s")}  # fmt: skip
    times, which = np.array([10**9, 10**9, 2 * 10**9]), np.array([1, 0, 1])
    assert system(**both).blocks(times, which) == [
        system(**each[i]).blocks([t], FIRST)[0]
        for i, t in zip(which.tolist(), times.tolist(), strict=True)
    ]
    sent = status_063([25, 26], [3, 4]).one_each(times, which)
    for block, source in zip(sent, which.tolist(), strict=True):
        (record,) = decode(block)
        expected = {"SAC": 25 + source, "SIC": 3 + source}
        assert record.get("I063/010") == record.get("I063/050") == expected
