"""Logs in the layouts of real ones, of a path that is known at every instant."""

from __future__ import annotations

import numpy as np
import pytest
from golden.make_flights import (
    GROUND_MSL_M,
    PART_S,
    PHASE_S,
    START,
    WITHOUT_FIX,
    geodetic,
    velocity_m_s,
)
from support.given_files import GOLDEN
from support.given_flights import FLIGHTS, GivenFlight, moved_m

from plotfeed.feeds.telemetry.flights import read
from plotfeed.feeds.telemetry.flights.flight import Flight, FlightOptions
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError

NS = 1_000_000_000
SRT, CSV, BIN = FLIGHTS[:3]
EACH = pytest.mark.parametrize("given", [SRT, CSV, BIN], ids=lambda each: each.file)


def times_s(flight: Flight) -> list[float]:
    start_ns = round(START.timestamp()) * NS
    return [(r.t_utc_ns - start_ns) / NS for r in flight.reports]


@EACH
def test_smoothing_finds_the_velocity_that_was_flown(given: GivenFlight) -> None:
    """Of 11 m steps each second what is left is half a metre each second."""
    flown = np.array([velocity_m_s(t_s) for t_s in times_s(given.flight)])
    found = np.array([r.velocity_enu_m_s for r in given.flight.reports])
    assert np.sqrt(np.mean((found - flown) ** 2)) < (0.6 if given is SRT else 0.03)
    assert np.abs(found - flown).max() < (3.5 if given is SRT else 0.2)
    assert moved_m(given.recorded, given.flight) < (15.0 if given is SRT else 0.05)


def test_what_a_log_leaves_open_is_asked_for_or_told() -> None:
    with pytest.raises(PlotfeedError, match="--set altitude_reference"):
        read(CSV.log)
    assert CSV.recorded.skipped == SRT.recorded.skipped == ()
    told = BIN.recorded.skipped
    assert sum("GPS status 1" in line for line in told) == WITHOUT_FIX
    assert sum("same time" in line for line in told) == len(told) - WITHOUT_FIX == 1


@pytest.mark.parametrize(
    "given", [f for f in FLIGHTS if f.file.endswith(".bin")], ids=lambda each: each.file
)
def test_a_dataflash_log_reads_as_pymavlink_reads_it(
    given: GivenFlight, capfd: pytest.CaptureFixture[str]
) -> None:
    reader = pytest.importorskip("pymavlink.DFReader")
    with reader.DFReader_binary(str(given.log)) as log:
        fixes = {}
        while (m := log.recv_match(type="GPS")) is not None:
            if m.Status >= 3:
                of_week_ms = m.GMS if hasattr(m, "GMS") else m.TimeMS
                fixes.setdefault(of_week_ms, (m.Lat, m.Lng, m.Alt, -m.VZ))
    ours = [
        (r.latitude_deg, r.longitude_deg, r.altitude_m, r.velocity_enu_m_s[2])
        for r in given.recorded.reports
    ]
    assert ours == [pytest.approx(fix, abs=1e-9) for fix in fixes.values()]


ABOVE, SEA = AltitudeReference.ABOVE_TAKEOFF, AltitudeReference.MEAN_SEA_LEVEL
WHOLE = PART_S[1] - PART_S[0]
LOGS = {
    # file: options, records, first, what altitudes are above, error of time, degrees and height
    "eight.srt": ({}, 211, -20.0, ABOVE, (1e-9, 0.5e-4, 0.05)),
    "eight.csv": ({"altitude_reference": SEA}, 211, -20.0, SEA, (1e-9, 1e-7, 0.05)),
    "eight.bin": ({}, 421, -20.0, SEA, (1e-9, 1e-7, 0.05)),
    "airdata.csv": ({}, WHOLE * 10, 0.0, ABOVE, (0.1, 1e-9, 0.002)),
    "litchi.csv": ({}, WHOLE * 5, 0.0, ABOVE, (1e-9, 1e-8, 0.051)),
    "phantomhelp.csv": ({"utc_offset_h": 2.0}, WHOLE * 5, 0.0, ABOVE, (1e-9, 1e-8, 0.016)),
    "old.srt": ({}, WHOLE, 0.0, ABOVE, (1e-9, 1e-6, 0.051)),
    "part.ulg": ({}, WHOLE * 5 - 15, 3.0, SEA, (1e-5, 1e-9, 1e-4)),
    "part.kml": ({}, WHOLE - 1, 0.0, SEA, (1e-9, 1e-8, 0.0051)),
    "part.nmea": ({}, WHOLE * 5 - 2, 0.4, SEA, (1e-9, 1e-7, 0.0051)),
}


@pytest.mark.parametrize("name", LOGS)
def test_each_log_gives_the_path_that_was_flown(name: str) -> None:
    options, records, first_s, above, (time_s, degrees, metres) = LOGS[name]
    if name.endswith(".ulg"):
        pytest.importorskip("pyulog")
    flight = read(GOLDEN / "flights" / name, FlightOptions(**options))  # type: ignore[arg-type]
    assert len(flight.reports) == records
    began_s = PART_S[0] + (PHASE_S if name == "airdata.csv" else 0.0)
    at_s = np.array(times_s(flight)) - began_s
    assert at_s[0] == pytest.approx(first_s, abs=time_s)
    for report, t_s in zip(flight.reports, at_s - at_s[0] + first_s, strict=True):
        latitude_deg, longitude_deg, up_m = geodetic(PART_S[0] + t_s)
        assert report.latitude_deg == pytest.approx(latitude_deg, abs=degrees * 1.1)
        assert report.longitude_deg == pytest.approx(longitude_deg, abs=degrees * 1.1)
        height_m = up_m + (GROUND_MSL_M if above is SEA else 0.0)
        assert report.altitude_m == pytest.approx(height_m, abs=metres)
        assert report.altitude_reference is above


def test_a_film_without_heights_flies_at_the_one_that_is_given() -> None:
    film = GOLDEN / "flights" / "frames.srt"
    with pytest.raises(PlotfeedError, match="--set height_m"):
        read(film)
    flight = read(film, FlightOptions(height_m=60.0))
    assert len(flight.reports) == WHOLE * 5  # of dates alone one in five would be left
    assert np.diff(times_s(flight)) == pytest.approx(0.2)
    assert {(r.altitude_m, r.altitude_reference) for r in flight.reports} == {(60.0, ABOVE)}
