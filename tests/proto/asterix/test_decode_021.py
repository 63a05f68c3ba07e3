"""Reports of category 021 are read as another encoder writes them; others are one error."""

from __future__ import annotations

from typing import Any

import pytest

from plotfeed.proto.asterix.decode_cooperative import read_021

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
