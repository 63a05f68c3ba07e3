"""Reports of aircraft that say where they are are read as another encoder writes them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from plotfeed.proto.asterix.cat129 import TargetEncoder129
from plotfeed.proto.asterix.codec.decode import decode
from plotfeed.proto.asterix.decode_cooperative import read_021, read_129
from plotfeed.proto.errors import DecodeError, EncodeError
from plotfeed.proto.utc import NS

DAY_NS = 86_400 * NS
NOON_NS = 1_700_006_400 * NS + DAY_NS // 2
SN = "1581F45T2201"
# Category 129 is worked out by hand, for want of another encoder. Its plainest record has items 1,
# 5, 6 and 7, and 8: source, serial number, country, 43200 s * 128 = 5529600, and the place.
PLACE = "0e666666 ff555555"  # 241591910 and -11184811 in 180/2^30 deg
PLAIN = bytes.fromhex(f"81 0020 8f80 0000 313538314634355432323031 4553 546000 {PLACE}")
NUMBERS = (
    "001a0b"  # 6667: 666.7 m
    "fffff6"  # -10: -1.0 m
    "000c"  # 12 m
)
VELOCITY = "003e8ffc18 0fff9c"  # 1000, -1000 and -100: 10, -10 and -1 m/s
# Items 1, 5 to 7; 8 to 11 and 14; 15.
SENT = bytes.fromhex(f"81 0031 8ff380 1903 {PLAIN[7:24].hex()} {PLACE} {NUMBERS} {VELOCITY}")
EVERYTHING = bytes.fromhex(
    "81 003c ff fb 80"  # items 1 to 7; 8 to 12 and 14; 15
    "0000"  # source 0/0
    "0a0b"  # destination 10/11
    "444a49 4d3454"  # DJI, M4T
    f"{PLAIN[7:24].hex()} {PLACE} {NUMBERS}"
    f"9f0000 {VELOCITY}"  # 10 01 1111
)
LATITUDE, LONGITUDE = 241_591_910 * 180 / 2**30, -11_184_811 * 180 / 2**30
HERE: dict[str, Any] = {
    "serials": [SN], "t_utc_ns": [NOON_NS], "latitude_deg": [LATITUDE], "longitude_deg": [LONGITUDE]
}  # fmt: skip
MORE: dict[str, Any] = {
    "altitude_m": [666.7], "height_m": [-1.0], "accuracy_m": [12.0], "velocity_m_s": [[10, -10, -1]]
}  # fmt: skip


def test_reports_of_129_are_written_as_worked_by_hand() -> None:
    assert TargetEncoder129(country="ES").blocks(**HERE) == [PLAIN]
    assert TargetEncoder129(25, 3, country="ES").blocks(**HERE, **MORE) == [SENT]


def test_reports_of_129_are_read_as_worked_by_hand() -> None:
    (record,) = decode(EVERYTHING)
    assert record.items == {
        "I129/010": {"SAC": 0, "SIC": 0},
        "I129/015": {"DAC": 10, "DIC": 11},
        "I129/020": "DJI",
        "I129/030": "M4T",
        "I129/040": SN,
        "I129/050": "ES",
        "I129/070": 43_200.0,
        "I129/080": {"LAT": LATITUDE, "LON": LONGITUDE},
        "I129/090": pytest.approx(666.7),
        "I129/100": pytest.approx(-1.0),
        "I129/110": 12.0,
        "I129/120": {"UCC": 2, "ARC": 1, "AEC": 15},
        "I129/185": {"VX": pytest.approx(10.0), "VY": pytest.approx(-10.0)},
        "I129/220": pytest.approx(-1.0),
    }
    plain, everything = read_129(PLAIN + EVERYTHING)
    assert (plain.identity, plain.country, plain.t_of_day_s) == (SN, "ES", 43_200.0)
    assert (plain.latitude_deg, plain.longitude_deg) == (LATITUDE, LONGITUDE)
    assert math.isnan(plain.altitude_m)
    assert math.isnan(plain.accuracy_m)
    assert (everything.manufacturer, everything.model) == ("DJI", "M4T")
    names = ("altitude_m", "height_m", "accuracy_m", "velocity_east_m_s", "velocity_north_m_s")
    told = [getattr(everything, name) for name in (*names, "climb_m_s")]
    assert told == pytest.approx((666.7, -1.0, 12.0, 10.0, -10.0, -1.0))


ITEMS = {"altitude_m": {"090"}, "height_m": {"100"}, "accuracy_m": {"110"},
         "velocity_m_s": {"185", "220"}}  # fmt: skip


@given(st.sets(st.sampled_from(sorted(MORE))))
def test_what_is_not_measured_is_not_sent(chosen: set[str]) -> None:
    (block,) = TargetEncoder129(country="ES").blocks(
        **HERE, **{name: MORE[name] for name in chosen}
    )
    (record,) = decode(block)
    always = {"010", "040", "050", "070", "080"}
    assert {item[5:] for item in record.items} == always.union(*(ITEMS[name] for name in chosen))


@pytest.mark.parametrize(("before_midnight_ns", "sent"), [(3_906_251, -1), (3_906_250, 0)])
def test_times_are_rounded_within_the_day(before_midnight_ns: int, sent: int) -> None:
    midnight_ns = NOON_NS + DAY_NS // 2
    (block,) = TargetEncoder129(country="ES").blocks(
        **HERE | {"t_utc_ns": [midnight_ns - before_midnight_ns]}
    )
    assert decode(block)[0].get("I129/070") == (sent % (86_400 * 128)) / 128


REFUSED = [
    ({"serials": ["1234567890123"]}, "I129/040"),
    ({"serials": ["naïve"]}, "I129/040"),
    ({"serials": ["a\nb"]}, "I129/040"),
    ({"latitude_deg": [181.0]}, "I129/080"),
    ({"longitude_deg": [181.0]}, "I129/080"),
    ({"t_utc_ns": np.array([1.5])}, "I129/070"),
    *(({name: [MORE[name][0], np.multiply(MORE[name][0], math.nan)]}, "I129/") for name in MORE),
]


@pytest.mark.parametrize(("columns", "said"), REFUSED)
def test_what_cannot_be_sent_in_129_is_refused(columns: dict[str, Any], said: str) -> None:
    n = max(map(len, columns.values()))
    with pytest.raises(EncodeError, match=said):
        TargetEncoder129(country="ES").blocks(
            **{name: [*column] * n for name, column in HERE.items()} | columns
        )


def test_a_country_has_two_letters() -> None:
    with pytest.raises(EncodeError, match="I129/050"):
        TargetEncoder129(country="ESP")


@pytest.mark.parametrize(
    ("accuracy_m", "read_m"),
    [(0.0, 1), (0.2, 1), (12.0, 12), (12.01, 13), (255, 255), (255.1, None)],
)
def test_accuracies_are_rounded_up_and_beyond_255_m_unknown(
    accuracy_m: float, read_m: float | None
) -> None:
    (block,) = TargetEncoder129(country="ES").blocks(**HERE, accuracy_m=[accuracy_m])
    (report,) = read_129(block)
    assert read_m is None if math.isnan(report.accuracy_m) else report.accuracy_m == read_m


@pytest.mark.parametrize(
    ("block", "says"),
    [
        # Without a serial number the rest of the name is the identity.
        ("81 0018 b780 0000 444a49 4d3454 4553 546000 00000000 00000000", ("ES-DJI-M4T", 43_200)),
        ("81 0012 8380 0000 a8c000 00000000 00000000", ("", 0)),  # a whole day is midnight
        (PLAIN.replace(SN.encode(), b"\x1b[2J\xff1234567").hex(),
         ("1b5b324aff31323334353637", 43_200)),  # what is no text is hexadecimal
        (PLAIN.replace(SN.encode(), b"SN1".ljust(12, b"\0")).hex(), ("SN1", 43_200)),
    ],
)  # fmt: skip
def test_names_and_times_are_read_as_senders_write_them(
    block: str, says: tuple[str, float]
) -> None:
    octets = bytes.fromhex(block)
    (report,) = read_129(octets[:1] + len(octets).to_bytes(2, "big") + octets[3:])
    assert (report.identity, report.t_of_day_s) == says


@pytest.mark.parametrize(
    ("block", "reason"),
    [
        ("30000ef01903000000300a004000", "category 48, not 129"),
        ("810006 80 0000", "without I129/070"),
        ("810009 82 0000 546000", "without I129/080"),
        ("810012 8380 0000 a8c001 00000000 00000000", "beyond midnight"),
        ("810012 8380 0000 546000 20000001 00000000", "off the globe"),
        ("810012 8380 0000 546000 00000000 40000001", "off the globe"),
        ("810012 8380 0000 546000 00000000 400000", "octets"),
    ],
)
def test_what_is_no_report_is_refused(block: str, reason: str) -> None:
    with pytest.raises(DecodeError, match=reason):
        read_129(bytes.fromhex(block))


@given(st.floats(-90, 90), st.floats(-180, 180), st.text("ABC123", max_size=12))
@example(90.0, 180.0, "A")
@example(-90.0, -180.0, "123456789012")
def test_places_and_serial_numbers_come_back(lat: float, lon: float, serial: str) -> None:
    blocks = TargetEncoder129(country="ES").blocks([serial] * 3, [0] * 3, [lat] * 3, [lon] * 3)
    assert len(blocks) == 3
    for (report,) in map(read_129, blocks):
        assert report.serial == serial
        assert abs(report.latitude_deg - lat) <= 90 / 2**30
        assert abs(report.longitude_deg - lon) <= 90 / 2**30


SAID: dict[str, Any] = {
    "010": (1, 2),
    "080": 0x484412,
    "073": 43_200 * 128 + 64,
    "131": (241_591_910, (1 << 32) - 22_071_360),
    "140": 1000,
    "145": 800,
    "157": (0, (1 << 15) - 100),
    "160": (0, 1000, 16_384),
    "020": 13,
}
OTHERS: dict[str, Any] = {"015": 7, "161": 300, "070": 0o1234, "146": 5, "008": 3, "132": -40 % 256}
# What libasterix calls them.
SPECS: dict[str, str] = {"2.1": "Cat_021_2_1", "2.4": "Cat_021_2_4", "2.7": "Cat_021_2_7"}


def block_021(items: dict[str, Any], edition: str = "2.7") -> bytes:
    from asterix import generated

    spec = getattr(generated, SPECS[edition])
    return bytes(spec.create([spec.cv_record.create(items)]).unparse().to_bytes())


@pytest.mark.parametrize("edition", SPECS)
@pytest.mark.parametrize("others", [{}, OTHERS])
def test_a_report_of_021_says_where_an_aircraft_is(edition: str, others: dict[str, Any]) -> None:
    (report,) = read_021(block_021({**SAID, **others}, edition))
    assert (report.icao, report.emitter, report.t_of_day_s) == ("484412", 13, 43_200.5)
    assert report.latitude_deg == pytest.approx(40.5, abs=1e-6)
    assert report.longitude_deg == pytest.approx(-3.7, abs=1e-6)
    assert report.height_m == pytest.approx(1000 * 6.25 * 0.3048)
    assert report.flight_level_m == pytest.approx(200 * 100 * 0.3048)
    assert report.velocity_east_m_s == pytest.approx(1000 / 2**14 * 1852)
    assert report.velocity_north_m_s == pytest.approx(0, abs=1e-9)
    assert report.climb_m_s == pytest.approx(-100 * 6.25 * 0.3048 / 60)


def test_what_has_no_place_is_no_report_and_several_are_several() -> None:
    nowhere = {key: value for key, value in SAID.items() if key != "131"}
    assert read_021(block_021(nowhere)) == []
    assert len(read_021(block_021(SAID) + block_021(SAID))) == 2
    with pytest.raises(DecodeError, match="category 48, not 21"):
        read_021(bytes.fromhex("30000ef01903000000300a004000"))
