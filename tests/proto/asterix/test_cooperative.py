"""Reports of aircraft that say where they are are read as another encoder writes them."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from plotfeed.proto.asterix.cat129 import TargetEncoder129
from plotfeed.proto.asterix.decode_cooperative import read_021, read_129
from plotfeed.proto.errors import DecodeError

NOON_NS = 1_700_006_400 * 10**9 + 43_200 * 10**9
SN = "1581F45T2201"
# Category 129 is worked out by hand, for want of another encoder.
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
HERE: dict[str, Any] = {
    "serials": [SN], "t_utc_ns": [NOON_NS], "latitude_deg": [LATITUDE], "longitude_deg": [LONGITUDE]
}  # fmt: skip


def test_reports_of_129_are_written_and_read_as_worked_by_hand() -> None:
    assert TargetEncoder129(country="ES").blocks(**HERE) == [BY_HAND["plain"]]
    numbers = (666.7, -1.0, 12.0, 10.0, -10.0, -1.0)
    altitude_m, height_m, accuracy_m, *velocity_m_s = numbers
    more = {"altitude_m": altitude_m, "height_m": height_m, "accuracy_m": accuracy_m}
    sent = TargetEncoder129(25, 3, country="ES").blocks(**HERE, **more, velocity_m_s=[velocity_m_s])
    without_names = bytes.fromhex("810031 8ff380 1903") + BY_HAND["everything"][14:]
    assert sent == [without_names]
    plain, everything = read_129(BY_HAND["plain"] + BY_HAND["everything"])
    assert (plain.identity, plain.country, plain.t_of_day_s) == (SN, "ES", 43_200.0)
    assert (plain.latitude_deg, plain.longitude_deg) == (LATITUDE, LONGITUDE)
    assert math.isnan(plain.altitude_m)
    assert math.isnan(plain.accuracy_m)
    assert (everything.manufacturer, everything.model) == ("DJI", "M4T")
    names = ("altitude_m", "height_m", "accuracy_m", "velocity_east_m_s", "velocity_north_m_s")
    told = [getattr(everything, name) for name in (*names, "climb_m_s")]
    assert told == pytest.approx(numbers)


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
        (BY_HAND["plain"].replace(SN.encode(), b"\x1b[2J\xff1234567").hex(),
         ("1b5b324aff31323334353637", 43_200)),  # what is no text is hexadecimal
        (BY_HAND["plain"].replace(SN.encode(), b"SN1".ljust(12, b"\0")).hex(), ("SN1", 43_200)),
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
