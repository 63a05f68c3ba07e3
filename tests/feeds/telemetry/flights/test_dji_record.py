"""Flight records of DJI's apps give the path that was flown, whole or damaged, in any version."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import pytest
from golden.make_flights import START, WITHOUT_SATELLITES, geodetic, velocity_m_s
from hypothesis import given
from hypothesis import strategies as st
from support.dji_flights import part_of_a_flight

from plotfeed.feeds.telemetry.flights import read
from plotfeed.feeds.telemetry.flights.dji_record import read_dji_record, scrambling_key
from plotfeed.feeds.telemetry.flights.flight import Flight, FlightOptions, Log
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError

NS = 1_000_000_000
RECORDS = 4 * 5
START_NS = round((START.timestamp() + 20) * NS)
OF_TYPE_1 = "44446fc915001d38", "f36e43885a933f36", "3a008a6edc262cc4"
"""Keys of first octets 0, 1 and 2, from the table in https://github.com/mikeemoo/dji-log-parser."""
OF_TYPE_2 = "8888de922b003a70", "b72a2c414f93220e", "e6dd8610b5267f6c"


def flown(data: bytes, **options: object) -> Flight:
    log = Log()
    read_dji_record(data, FlightOptions(**options), log)  # type: ignore[arg-type]
    return log.flight("a")


@pytest.mark.parametrize("version", range(1, 13))
def test_every_version_to_12_gives_place_height_velocity_and_time(
    version: int, tmp_path: Path
) -> None:
    path = tmp_path / "DJIFlightRecord_2024-05-14_[11-30-20].txt"
    path.write_bytes(part_of_a_flight(version))
    flight = read(path)
    assert len(flight.reports) == RECORDS - WITHOUT_SATELLITES
    assert flight.dropped == {"position …, …: no GPS fix": WITHOUT_SATELLITES}
    assert flight.stated == (
        f"height in metres, above take-off: OSD, version {version}",
        "time: the app's clock, in CUSTOM",
    )
    for i, report in enumerate(flight.reports, start=WITHOUT_SATELLITES):
        assert report.t_utc_ns == START_NS + i * NS // 5
        place = geodetic(20 + i / 5)
        assert (report.latitude_deg, report.longitude_deg) == pytest.approx(place[:2], abs=1e-9)
        assert report.altitude_m == pytest.approx(place[2], abs=0.051)
        assert report.altitude_reference is AltitudeReference.ABOVE_TAKEOFF
        assert report.velocity_enu_m_s == pytest.approx(velocity_m_s(20 + i / 5), abs=0.051)


def test_keys_are_those_that_others_found() -> None:
    for kind, keys in ((1, OF_TYPE_1), (2, OF_TYPE_2)):
        assert [scrambling_key(kind, first).hex() for first in range(3)] == list(keys)


@pytest.mark.parametrize("details", [4000, 0])
def test_an_encrypted_record_is_told_from_a_table(details: int, tmp_path: Path) -> None:
    path = tmp_path / "DJIFlightRecord.txt"
    head = details.to_bytes(8, "little") + b"\x10\x01" + bytes([14, 0])
    path.write_bytes(head + bytes(range(256)) * 20)
    with pytest.raises(PlotfeedError, match=r"version 14, encrypted, with a key.*Airdata"):
        read(path)


def test_without_the_apps_clock_the_flight_began_when_the_details_say() -> None:
    data = part_of_a_flight(6, has_clock=False)
    flight = flown(data)
    first = WITHOUT_SATELLITES
    assert [r.t_utc_ns for r in flight.reports] == [
        START_NS + i * NS // 5 for i in range(first, RECORDS)
    ]
    assert any("it took off when its details say" in line for line in flight.assumed)
    place = int.from_bytes(data[:8], "little") + 91
    timeless = data[:place] + bytes(8) + data[place + 8 :]
    with pytest.raises(PlotfeedError, match="no time in this record"):
        flown(timeless)
    assert flown(timeless, start_utc_ns=NS).reports[0].t_utc_ns == NS + NS


def test_images_are_no_damage_and_damage_costs_what_it_meets() -> None:
    whole = part_of_a_flight(8)
    assert not any("no record" in line for line in flown(whole).skipped)
    at = whole.index(b"\xff\x01", 1000) + 1  # where an OSD record begins
    flight = flown(whole[:at] + b"\x07\x07\x07" + whole[at:])
    assert len(flight.reports) == RECORDS - WITHOUT_SATELLITES
    assert any(line.startswith(f"offset {at}: 3 octets that are no") for line in flight.skipped)


@given(
    version=st.integers(1, 12),
    at=st.integers(0, 2500),
    junk=st.binary(max_size=40),
    lost=st.integers(0, 40),
)
def test_a_record_cut_or_damaged_anywhere_gives_what_is_whole(
    version: int, at: int, junk: bytes, lost: int
) -> None:
    whole = part_of_a_flight(version)
    with suppress(PlotfeedError):
        times = [r.t_utc_ns for r in flown(whole[:at] + junk + whole[at + lost :]).reports]
        assert times == sorted(set(times))


def test_octets_like_images_without_end_cannot_stall_the_reader() -> None:
    head = part_of_a_flight(5)[:12]
    body = b"\xff\xd8\xff" * 100_000
    data = (12 + len(body)).to_bytes(8, "little") + head[8:] + body
    with pytest.raises(PlotfeedError, match="no positions: expected OSD"):
        flown(data)
