"""Reports of category 021 are read as another encoder writes them; others are one error."""

from __future__ import annotations

import contextlib
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.proto.asterix.decode_021 import Edition021, read_021
from plotfeed.proto.errors import DecodeError

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


SPECS: dict[Edition021, str] = {
    "0.23": "Cat_021_0_23",
    "0.24": "Cat_021_0_24",
    "0.25": "Cat_021_0_25",
    "0.26": "Cat_021_0_26",
    "2.1": "Cat_021_2_1",
    "2.4": "Cat_021_2_4",
    "2.7": "Cat_021_2_7",
}
"""What libasterix calls them."""


def block(items: dict[str, Any], edition: Edition021 = "2.7") -> bytes:
    from asterix import generated

    spec = getattr(generated, SPECS[edition])
    record = spec.cv_record.create(items)
    return bytes(spec.create([record]).unparse().to_bytes())


def of_old(edition: Edition021, items: dict[str, Any]) -> dict[str, Any]:
    """The same in the items of an edition to 0.26."""
    bits = 24 if edition == "0.23" else 32
    coarser = 7 if edition == "0.23" else 5
    signed = (half - (half >> 31 << 32) for half in items["131"])
    return {key: items[key] for key in ("010", "080", "140", "145", "020")} | {
        "030": items["073"],
        "130": tuple((half >> coarser) % (1 << bits) for half in signed),
        "157": -100 % (1 << 16),
        "160": items["160"][1:],
    }


@pytest.mark.parametrize("edition", SPECS)
@pytest.mark.parametrize("others", [{}, OTHERS])
def test_a_report_says_where_an_aircraft_is(edition: Edition021, others: dict[str, Any]) -> None:
    items = {**SAID, **others}
    if edition < "1":
        items = of_old(edition, items)
        if others:
            items |= {"150": 7, "151": 300, "165": ((1, 0, 5),), "170": 0, "095": 3, "032": 9}
            items |= {"146": 5, "148": 3, "200": 1}
            items |= {"070": 0o1234, "131": -40 % 256} if edition == "0.26" else {}
    (report,) = read_021(block(items, edition), edition)
    assert (report.icao, report.emitter, report.t_of_day_s) == ("484412", 13, 43_200.5)
    finest_deg = {"0.23": 180 / 2**23}.get(edition, 180 / 2**25 if edition < "1" else 1e-6)
    assert report.latitude_deg == pytest.approx(40.5, abs=finest_deg)
    assert report.longitude_deg == pytest.approx(-3.7, abs=finest_deg)
    assert report.height_m == pytest.approx(1000 * 6.25 * 0.3048)
    assert report.flight_level_m == pytest.approx(200 * 100 * 0.3048)
    assert report.velocity_east_m_s == pytest.approx(1000 / 2**14 * 1852)
    assert report.velocity_north_m_s == pytest.approx(0, abs=1e-9)
    assert report.climb_m_s == pytest.approx(-100 * 6.25 * 0.3048 / 60)


def test_what_has_no_place_is_no_report_and_several_are_several() -> None:
    nowhere = {key: value for key, value in SAID.items() if key != "131"}
    assert read_021(block(nowhere)) == []
    assert len(read_021(block(SAID) + block(SAID))) == 2


@given(st.sampled_from(["0.23", "0.26", "2.7"]), st.binary(max_size=80), st.integers(0, 60))
def test_any_octets_are_reports_or_an_error(edition: Edition021, data: bytes, cut: int) -> None:
    whole = block(SAID)
    for octets in (data, b"\x15" + (len(data) + 3).to_bytes(2, "big") + data, whole[:cut] + data):
        with contextlib.suppress(DecodeError):
            read_021(octets, edition)
