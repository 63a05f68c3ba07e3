"""Files of any kind: whatever is in them, a flight that could be flown, or one line of why not."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.given_files import GOLDEN
from support.given_flights import flown

from plotfeed.feeds.cli.inject import summary_lines
from plotfeed.feeds.telemetry.flights import read
from plotfeed.feeds.telemetry.flights.flight import (
    MAX_SKIPPED,
    Courses,
    Flight,
    FlightOptions,
    Log,
    courses,
    longest_increasing,
)
from plotfeed.feeds.telemetry.flights.smoothed import smoothed
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError

SEA = AltitudeReference.MEAN_SEA_LEVEL


def flight_or_why(path: Path) -> Flight | str:
    try:
        return read(path, FlightOptions(altitude_reference=SEA))
    except PlotfeedError as error:
        return str(error)


@given(
    st.sampled_from([".srt", ".csv", ".bin", ".tlog", ".gpx", ".txt", ""]),
    st.binary(max_size=300),
    st.sampled_from(
        [b"", b"\xa3\x95\x80", b"<?xml ", b"1\n00:00:00,000 --> ", b"time,lat,lon,alt\n"]
    ),
)
def test_arbitrary_files_give_one_line_that_names_them(
    suffix: str, data: bytes, head: bytes
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"flight{suffix}"
        path.write_bytes(head + data)
        why = flight_or_why(path)
    assert isinstance(why, str)
    assert why.startswith(str(path))
    assert "\n" not in why


LOGS = [path for path in (GOLDEN / "flights").iterdir() if path.suffix != ".py"]


@settings(max_examples=100)
@given(st.data())
def test_logs_that_are_cut_or_damaged_anywhere_give_what_is_whole_or_a_clear_error(
    data: st.DataObject,
) -> None:
    """The beginning of each, which is quicker read; of a ULog and XML all."""
    path = data.draw(st.sampled_from(LOGS))
    if path.suffix == ".ulg":
        pytest.importorskip("pyulog")
    octets = bytearray(path.read_bytes()[:7000])
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(octets)))
        octets[at : at + data.draw(st.integers(0, 30))] = data.draw(
            st.binary(max_size=10) | st.sampled_from([b"9" * 400, b")(-->", b"\n\n\n", b'"', b",,"])
        )
    with suppress(PlotfeedError):
        flight = flown(path.suffix, bytes(octets), altitude_reference=SEA, height_m=9.0)
        times = [r.t_utc_ns for r in flight.reports]
        assert times == sorted(set(times))
        assert list(summary_lines(flight))


@pytest.mark.parametrize(("version", "details"), [(1, 4000), (8, 500), (14, 4000), (14, 0)])
def test_a_binary_record_of_a_dji_app_is_refused_with_what_reads_it(
    version: int, details: int, tmp_path: Path
) -> None:
    path = tmp_path / "DJIFlightRecord.txt"
    head = details.to_bytes(8, "little") + b"\x10\x01" + bytes([version, 0])
    path.write_bytes(head + bytes(range(256)) * 20)
    with pytest.raises(PlotfeedError, match=rf"version {version}, which plotfeed .*Airdata"):
        read(path)


def test_nothing_is_printed_about_garbage(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for suffix in (".bin", ".tlog", ".gpx"):
        path = tmp_path / f"a{suffix}"
        path.write_bytes(bytes(range(256)) * 20)
        assert isinstance(flight_or_why(path), str)
    assert capfd.readouterr() == ("", "")


def test_files_that_cannot_be_opened_or_understood_are_refused(tmp_path: Path) -> None:
    for name in ("absent.csv", ".", "nul\0.csv"):
        with pytest.raises(PlotfeedError, match="cannot be read"):
            read(tmp_path / name)
    path = tmp_path / "a.xyz"
    for data, why in ((b" \n", "empty file"), (b"abc", "unknown kind")):
        path.write_bytes(data)
        with pytest.raises(PlotfeedError, match=why):
            read(path)
    os.truncate(path, 1 << 40)
    with pytest.raises(PlotfeedError, match="larger than"):
        read(path)
    with pytest.raises(PlotfeedError, match="UTC offset"):
        read(path, FlightOptions(utc_offset_h=float("nan")))


def test_the_list_of_what_was_skipped_is_bounded() -> None:
    log = Log()
    log.take("line 1", 1, (1.0, 1.0), (1.0, SEA))
    for i in range(MAX_SKIPPED + 5):
        log.skip(f"line {i}", "bad")
    flight = log.flight("a")
    assert len(flight.skipped) == MAX_SKIPPED + 1
    assert flight.skipped[-1] == "and 5 more"


@given(st.lists(st.integers(0, 20), max_size=60))
def test_the_longest_increasing_run_of_times_is_kept(times: list[int]) -> None:
    kept = longest_increasing(times)
    assert all(i < j and times[i] < times[j] for i, j in pairwise(kept))
    longest = [1] * len(times)
    for j in range(len(times)):
        for i in range(j):
            if times[i] < times[j]:
                longest[j] = max(longest[j], longest[i] + 1)
    assert len(kept) == max(longest, default=0)


def report(i: int, *, latitude_deg: float = 50.0, altitude_m: float = 100.0) -> PositionReport:
    return PositionReport(
        t_utc_ns=i * 200_000_000,
        latitude_deg=latitude_deg + i * 1e-5,
        longitude_deg=180.0 - (i % 2) * 360.0,
        altitude_m=altitude_m,
        altitude_reference=SEA,
    )


@given(st.sets(st.integers(0, 39), max_size=9), st.booleans())
def test_wrong_fixes_are_found_wherever_they_are(wrong: set[int], high: bool) -> None:
    reports = [
        report(i, altitude_m=100.0 + 900.0 * high, latitude_deg=50.0 + 2.0 * (not high))
        if i in wrong
        else report(i)
        for i in range(40)
    ]
    assert courses(reports).refused.keys() == wrong


def jumps(there: set[int], number: int) -> list[PositionReport]:
    return [report(i, latitude_deg=50.0 + 0.02 * (i in there)) for i in range(number)]


def test_what_was_flown_is_told_from_jumps_and_other_sources() -> None:
    """Steps of a coarse log, a jump that persists, one there and back, and a second source."""
    coarse = [report(i, latitude_deg=50.0 + (i // 5) * 1e-4 - i * 1e-5) for i in range(40)]
    assert courses(coarse) == courses([]) == Courses({})
    assert courses(jumps({*range(20, 100)}, 100)) == Courses({}, starts=(20,))
    assert courses(jumps({*range(20, 40)}, 100)).refused.keys() == {*range(20, 40)}
    both = courses(jumps({*range(0, 90, 3)}, 90))
    assert both.refused.keys() == {*range(0, 90, 3)}
    assert (both.starts, both.second) == ((), 30)
    fast = [report(i, latitude_deg=50.0 + i * 1e-3) for i in range(40)]
    assert courses(fast, 600.0).refused == {}
    assert len(courses(fast, 100.0).refused) > 20


def test_nothing_leads_from_before_a_new_start_to_it_and_no_speed_is_taken_for_it() -> None:
    log = Log()
    log.found += [(f"line {i}", one) for i, one in enumerate(jumps({*range(30, 60)}, 60))]
    flight = log.flight("a")
    assert flight.starts == (30,)
    assert "new start" in flight.assumed[0]
    for one in smoothed(flight).reports:
        assert np.hypot(*one.velocity_enu_m_s[:2]) < 10.0
