"""Files of any kind: whatever is in them, a flight that could be flown, or one line of why not."""

from __future__ import annotations

import math
import os
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.given_files import GOLDEN
from support.given_flights import flown, moved_m, speeds

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
from plotfeed.feeds.telemetry.flights.smoothed import (
    DEGREE_DECIMALS,
    METRE_DECIMALS,
    quantum,
    smoothed,
)
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.models.state import AltitudeReference, Floats
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

SEA = AltitudeReference.MEAN_SEA_LEVEL


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


def test_files_that_cannot_be_opened_or_understood_are_refused_in_a_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for name in ("absent.csv", ".", "nul\0.csv"):
        with pytest.raises(PlotfeedError, match="cannot be read"):
            read(tmp_path / name)
    path = tmp_path / "a.xyz"
    for data, why in ((b" \n", "empty file"), (b"abc", "unknown kind")):
        path.write_bytes(data)
        with pytest.raises(PlotfeedError, match=why):
            read(path)
    for suffix in (".bin", ".tlog", ".gpx"):
        garbage = tmp_path / f"a{suffix}"
        garbage.write_bytes(bytes(range(256)) * 20)
        with pytest.raises(PlotfeedError) as refused:
            read(garbage)
        assert str(refused.value).startswith(f"{garbage}: ")
        assert "\n" not in str(refused.value)
    assert capfd.readouterr() == ("", "")
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


def jumps(there: range, number: int) -> list[PositionReport]:
    return [report(i, latitude_deg=50.0 + 0.02 * (i in there)) for i in range(number)]


def test_what_was_flown_is_told_from_jumps_and_other_sources() -> None:
    """Steps of a coarse log, a jump that persists, one there and back, and a second source."""
    coarse = [report(i, latitude_deg=50.0 + (i // 5) * 1e-4 - i * 1e-5) for i in range(40)]
    assert courses(coarse) == courses([]) == Courses({})
    assert courses(jumps(range(20, 100), 100)) == Courses({}, starts=(20,))
    assert courses(jumps(range(20, 40), 100)).refused.keys() == {*range(20, 40)}
    both = courses(jumps(range(0, 90, 3), 90))
    assert both.refused.keys() == {*range(0, 90, 3)}
    assert (both.starts, both.second) == ((), 30)
    fast = [report(i, latitude_deg=50.0 + i * 1e-3) for i in range(40)]
    assert courses(fast, 600.0).refused == {}
    assert len(courses(fast, 100.0).refused) > 20


def test_nothing_leads_from_before_a_new_start_to_it_and_no_speed_is_taken_for_it() -> None:
    log = Log()
    log.found += [(f"line {i}", one) for i, one in enumerate(jumps(range(30, 60), 60))]
    flight = log.flight("a")
    assert flight.starts == (30,)
    assert "new start" in flight.assumed[0]
    for one in smoothed(flight).reports:
        assert np.hypot(*one.velocity_enu_m_s[:2]) < 10.0


# Steps in which a log writes positions, and velocities that it has or lacks.

M_PER_DEG = 111_229.0  # of latitude at 50 north


def steady(t_s: Floats, north_m: Floats, decimals: int = 12, east_deg: float = 3.0) -> Flight:
    latitudes = np.round(50.0 + north_m / M_PER_DEG, decimals)
    reports = tuple(
        PositionReport(round(t * NS), float(latitude), east_deg, 100.0, SEA)
        for t, latitude in zip(t_s, latitudes, strict=True)
    )
    return Flight(name="a", reports=reports)


@pytest.mark.parametrize(("rate_hz", "speed_m_s"), [(1.0, 2.0), (5.0, 6.0), (30.0, 15.0)])
def test_steady_flight_in_eleven_metre_steps_gives_its_speed(
    rate_hz: float, speed_m_s: float
) -> None:
    t_s = np.arange(0, 60, 1 / rate_hz)
    coarse = steady(t_s, t_s * speed_m_s, decimals=4)
    smooth = smoothed(coarse)
    assert moved_m(coarse, smooth) < 15
    inner = speeds(smooth)[len(t_s) // 6 : -len(t_s) // 6]
    assert inner == pytest.approx(speed_m_s, abs=0.25 * speed_m_s + 0.5)
    assert inner.mean() == pytest.approx(speed_m_s, rel=0.05)


def test_a_fine_log_is_left_as_it_is_and_gaps_of_its_velocities_are_filled() -> None:
    t_s = np.arange(0, 60, 0.2)
    fine = steady(t_s, 50 * np.sin(t_s / 5), decimals=7)
    smooth = smoothed(fine)
    assert moved_m(fine, smooth) < 0.02
    assert speeds(smooth)[5:-5] == pytest.approx(np.abs(10 * np.cos(t_s / 5))[5:-5], abs=0.3)
    t_s = np.arange(30.0)
    whole = steady(t_s, t_s * 5)
    told = tuple(r._replace(velocity_enu_m_s=(1.0, math.nan, math.nan)) for r in whole.reports)
    velocity = smoothed(replace(whole, reports=told)).reports[10].velocity_enu_m_s
    assert velocity == pytest.approx((1.0, 5.0, 0.0), abs=1e-3)


@pytest.mark.parametrize(("gap_s", "bridged"), [(5.0, True), (6.0, False)])
def test_a_break_in_the_log_is_not_bridged(gap_s: float, bridged: bool) -> None:
    """What is before it and after it is as if each were a log of its own."""
    t_s = np.concatenate([np.arange(20.0), 19.0 + gap_s + np.arange(20.0)])
    broken = steady(t_s, 10 * np.minimum(t_s, 38.0 - t_s), decimals=4)
    halves = [replace(broken, reports=broken.reports[half]) for half in (np.s_[:20], np.s_[20:])]
    alone = [one.velocity_enu_m_s for half in halves for one in smoothed(half).reports]
    whole = [one.velocity_enu_m_s for one in smoothed(broken).reports]
    assert np.allclose(whole, alone, rtol=0, atol=1e-6) != bridged
    assert [whole[15][1], whole[25][1]] == pytest.approx([10.0, -10.0], abs=4)


def test_a_log_that_is_sparse_all_over_is_one_stretch() -> None:
    t_s = np.arange(0, 300.0, 10.0)
    assert speeds(smoothed(steady(t_s, t_s * 7))) == pytest.approx(7.0, rel=1e-3)
    one = steady(np.zeros(1), np.zeros(1))
    assert smoothed(one) == one


def test_the_antimeridian_is_crossed_without_a_jump() -> None:
    t_s = np.arange(20.0)
    across = steady(t_s, 0 * t_s)
    east = tuple(
        r._replace(longitude_deg=(179.999 + i * 1e-4 + 180) % 360 - 180)
        for i, r in enumerate(across.reports)
    )
    smooth = smoothed(replace(across, reports=east))
    assert speeds(smooth) == pytest.approx(7.17, abs=0.05)
    assert all(-180 <= r.longitude_deg <= 180 for r in smooth.reports)
    assert moved_m(replace(across, reports=east), smooth) < 0.1


@pytest.mark.parametrize(
    ("values", "decimals", "expected"),
    [
        ([36.6146, 36.6147, 36.6172], DEGREE_DECIMALS, 1e-4),
        ([-35.3623714, -35.3623715], DEGREE_DECIMALS, 1e-7),
        ([50 + k / 600_000 for k in (0, 0, 1, 1, 1, 2, 4, 4, 4, 4)], DEGREE_DECIMALS, 1 / 600_000),
        ([math.pi, math.e, math.sqrt(2), 1.1], DEGREE_DECIMALS, 0.0),
        # One that is damaged does not hide the step.
        ([50.00000123, *np.round(50 + np.arange(60) * 1e-4, 4)], DEGREE_DECIMALS, 1e-4),
        ([0.3, 87.9, -0.1], METRE_DECIMALS, 0.1),
        ([5.0, 7.0, 5.0], METRE_DECIMALS, 1.0),
    ],
)
def test_the_step_in_which_values_are_written(
    values: list[float], decimals: range, expected: float
) -> None:
    assert quantum(np.array(values), decimals) == pytest.approx(expected, rel=1e-3)
