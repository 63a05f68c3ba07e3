from __future__ import annotations

import os
import tempfile
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plotfeed.feeds.telemetry.flights import read
from plotfeed.feeds.telemetry.flights.flight import (
    MAX_SKIPPED,
    Flight,
    FlightOptions,
    Log,
    longest_increasing,
)
from plotfeed.models.state import AltitudeReference
from plotfeed.proto.errors import PlotfeedError

SEA = AltitudeReference.MEAN_SEA_LEVEL


def flight_or_why(path: Path) -> Flight | str:
    try:
        return read(path, FlightOptions(altitude_reference=SEA))
    except PlotfeedError as error:
        return str(error)


@settings(max_examples=200)
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


def test_nothing_is_printed_about_garbage(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for suffix in (".bin", ".tlog", ".gpx"):
        path = tmp_path / f"a{suffix}"
        path.write_bytes(bytes(range(256)) * 20)
        assert isinstance(flight_or_why(path), str)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["absent.csv", ".", "nul\0.csv"])
def test_files_that_cannot_be_opened_are_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(PlotfeedError, match="cannot be read"):
        read(tmp_path / name)


def test_empty_unknown_and_huge_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.xyz"
    for data, why in ((b" \n", "empty file"), (b"abc", "unknown kind")):
        path.write_bytes(data)
        with pytest.raises(PlotfeedError, match=why):
            read(path)
    os.truncate(path, 1 << 40)
    with pytest.raises(PlotfeedError, match="larger than"):
        read(path)


def test_an_offset_that_no_zone_has_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PlotfeedError, match="UTC offset"):
        read(tmp_path / "a.csv", FlightOptions(utc_offset_h=float("nan")))


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


def test_one_wrong_clock_reading_costs_one_record() -> None:
    times = [*range(10), 10_000, *range(10, 20), -5, *range(20, 30)]
    assert [times[i] for i in longest_increasing(times)] == list(range(30))
