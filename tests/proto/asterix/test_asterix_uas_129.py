"""Category 129; the octets of the first test are worked by hand, for want of another decoder."""

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

NOON_NS = 1_700_006_400 * 10**9 + 43_200 * 10**9
SN = "1581F45T2201"
BY_HAND = {
    "plain": bytes.fromhex(
        "81 0020"  # category, 32 octets
        "8f 80"  # items 1, 5, 6, 7; 8
        "0000"
        "313538314634355432323031"
        "4553"
        "546000"  # 43200 * 128 = 5529600
        "0e666666 ff555555"
    ),
    "everything": bytes.fromhex(
        "81 0037"  # 55 octets
        "bf f3 80"  # items 1, 3 to 7; 8 to 11 and 14; 15
        "1903"
        "444a49"
        "4d3454"
        "313538314634355432323031"
        "4553"
        "546000"
        "0e666666 ff555555"
        "001a0b"  # 666.7 m
        "fffff6"  # -1.0 m
        "000c"  # 12 m
        "003e8ffc18"  # 10 and -10 m/s
        "0fff9c"  # -1 m/s
    ),
}
LATITUDE, LONGITUDE = 0x0E666666 * 180 / 2**30, -0xAAAAAB * 180 / 2**30


def test_octets_worked_by_hand() -> None:
    place = ([SN], [NOON_NS], [LATITUDE], [LONGITUDE])
    assert TargetEncoder129(country="ES").blocks(*place) == [BY_HAND["plain"]]
    encoder = TargetEncoder129(25, 3, country="ES", manufacturer="DJI", model="M4T")
    assert encoder.blocks(
        *place,
        altitude_m=[666.7],
        height_m=[-1.0],
        accuracy_m=[12.0],
        velocity_m_s=[[10.0, -10.0, -1.0]],
    ) == [BY_HAND["everything"]]


@pytest.mark.parametrize(
    ("accuracy_m", "read_m"),
    [(0.0, 1), (0.2, 1), (12.0, 12), (12.01, 13), (255, 255), (255.1, None)],
)
def test_accuracies_are_rounded_up_and_beyond_255_m_unknown(
    accuracy_m: float, read_m: float | None
) -> None:
    place = ([SN], [NOON_NS], [LATITUDE], [LONGITUDE])
    (block,) = TargetEncoder129(country="ES").blocks(*place, accuracy_m=[accuracy_m])
    (report,) = read_129(block)
    assert read_m is None if math.isnan(report.accuracy_m) else report.accuracy_m == read_m


def test_reports_read_as_they_were_written() -> None:
    plain, everything = read_129(BY_HAND["plain"] + BY_HAND["everything"])
    assert (plain.identity, plain.country, plain.t_of_day_s) == (SN, "ES", 43_200.0)
    assert (plain.latitude_deg, plain.longitude_deg) == (LATITUDE, LONGITUDE)
    assert math.isnan(plain.altitude_m)
    assert math.isnan(plain.accuracy_m)
    assert (everything.manufacturer, everything.model) == ("DJI", "M4T")
    numbers = (
        everything.altitude_m,
        everything.height_m,
        everything.accuracy_m,
        everything.velocity_east_m_s,
        everything.velocity_north_m_s,
        everything.climb_m_s,
    )
    assert numbers == pytest.approx((666.7, -1.0, 12.0, 10.0, -10.0, -1.0))


def test_without_a_serial_number_the_rest_of_the_name_is_the_identity() -> None:
    block = bytes.fromhex("81 0018 b780 0000 444a49 4d3454 4553 546000 00000000 00000000")
    fixed = block[:1] + len(block).to_bytes(2, "big") + block[3:]
    (report,) = read_129(fixed)
    assert report.identity == "ES-DJI-M4T"


def test_a_whole_day_is_midnight() -> None:
    (report,) = read_129(bytes.fromhex("810012 8380 0000 a8c000 00000000 00000000"))
    assert report.t_of_day_s == 0.0


def test_a_serial_number_that_is_no_text_is_hexadecimal() -> None:
    block = BY_HAND["plain"].replace(SN.encode(), b"\x1b[2J\xff1234567")
    assert read_129(block)[0].identity == "1b5b324aff31323334353637"
    padded = BY_HAND["plain"].replace(SN.encode(), b"SN1".ljust(12, b"\0"))
    assert read_129(padded)[0].identity == "SN1"


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


@given(
    st.floats(-90, 90),
    st.floats(-180, 180),
    st.floats(-1e6, 1e6),
    st.integers(0, 2**62),
    st.text("ABC123", max_size=12),
)
@example(90.0, 180.0, 838_860.7, NOON_NS + 43_200 * 10**9 - 1, "A")
@example(-90.0, -180.0, -838_860.8, 0, "123456789012")
def test_reports_come_back_to_half_an_lsb(
    latitude_deg: float, longitude_deg: float, altitude_m: float, t_utc_ns: int, serial: str
) -> None:
    encoder = TargetEncoder129(country="ES")
    (block,) = encoder.blocks(
        [serial], [t_utc_ns], [latitude_deg], [longitude_deg], altitude_m=[altitude_m]
    )
    (report,) = read_129(block)
    assert report.serial == serial
    assert abs(report.latitude_deg - latitude_deg) <= 90 / 2**30
    assert abs(report.longitude_deg - longitude_deg) <= 90 / 2**30
    clipped = min(max(altitude_m, -838_860.8), 838_860.7)
    assert abs(report.altitude_m - clipped) <= 0.05 * (1 + 1e-6)
    late = math.remainder(report.t_of_day_s - t_utc_ns % 86_400_000_000_000 / 1e9, 86_400)
    assert abs(late) <= 0.5 / 128 + 1e-9


def test_each_aircraft_has_a_block_of_its_own() -> None:
    n = 120
    degrees = np.linspace(-80, 80, n)
    serials = [f"SN{row:05}" for row in range(n)]
    blocks = TargetEncoder129(country="ES").blocks(serials, [NOON_NS] * n, degrees, degrees)
    assert [len(decode(block)) for block in blocks] == [1] * n
    assert [read_129(block)[0].serial for block in blocks] == serials
    assert TargetEncoder129(country="ES").blocks([], [], [], []) == []


@pytest.mark.parametrize(
    "wrong",
    [
        {"latitude_deg": [90.1]},
        {"latitude_deg": [math.nan]},
        {"longitude_deg": [180.1]},
        {"altitude_m": [math.nan]},
        {"serials": ["1234567890123"]},
        {"serials": ["naïve"]},
        {"serials": ["a\nb"]},
        {"t_utc_ns": [1.5]},
        {"t_utc_ns": [1, 2]},
    ],
)
def test_what_cannot_be_sent_is_refused(wrong: dict[str, Any]) -> None:
    columns: dict[str, Any] = {
        "serials": ["SN1"],
        "t_utc_ns": [NOON_NS],
        "latitude_deg": [1.0],
        "longitude_deg": [1.0],
        "altitude_m": [1.0],
    }
    with pytest.raises(EncodeError):
        TargetEncoder129(country="ES").blocks(**columns | wrong)


@pytest.mark.parametrize("wrong", [{"country": "ESP"}, {"country": "ES", "model": "M400"}])
def test_names_that_do_not_fit_are_refused_at_once(wrong: dict[str, str]) -> None:
    with pytest.raises(EncodeError):
        TargetEncoder129(**wrong)


# Reports of category 021 are read as another encoder writes them; others are one error.


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


def block(items: dict[str, Any], edition: str = "2.7") -> bytes:
    from asterix import generated

    spec = getattr(generated, SPECS[edition])
    record = spec.cv_record.create(items)
    return bytes(spec.create([record]).unparse().to_bytes())


@pytest.mark.parametrize("edition", SPECS)
@pytest.mark.parametrize("others", [{}, OTHERS])
def test_a_report_says_where_an_aircraft_is(edition: str, others: dict[str, Any]) -> None:
    (report,) = read_021(block({**SAID, **others}, edition))
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
    assert read_021(block(nowhere)) == []
    assert len(read_021(block(SAID) + block(SAID))) == 2
