from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from plotfeed.models.beam import (
    AzimuthCover,
    Sector,
    Timetable,
    ahead_of_beam_deg,
    beam_is_late_by,
    beam_times_ns,
    passes_between,
    time_after_share_ns,
)
from plotfeed.models.frames import wrap_180
from plotfeed.models.state import Bools, Floats

S = 1_000_000_000
T0 = 1_700_000_000 * S

periods_ns = st.integers(20_000_000, 3600 * S)
sector_counts = st.integers(1, 256)
times_ns = st.integers(0, 2**62)


@given(times_ns, periods_ns, sector_counts)
def test_every_time_is_in_the_sector_that_it_is_said_to_be_in(
    t_utc_ns: int, period_ns: int, sectors: int
) -> None:
    sector = Timetable(period_ns, sectors).sector_at(t_utc_ns)
    assert sector.start_ns <= t_utc_ns < sector.end_ns
    assert 0 <= sector.index < sectors
    assert sector.scan == t_utc_ns // period_ns


@given(times_ns, periods_ns, sector_counts)
def test_sectors_share_their_edges_to_the_nanosecond(
    t_utc_ns: int, period_ns: int, sectors: int
) -> None:
    sector = Timetable(period_ns, sectors).sector_at(t_utc_ns)
    following = Timetable(period_ns, sectors).next_sector(sector)
    assert following.start_ns == sector.end_ns
    assert following.start_deg % 360 == sector.end_deg % 360
    assert following == Timetable(period_ns, sectors).sector_at(sector.end_ns)


@given(st.integers(0, 10**9), periods_ns, sector_counts)
def test_sectors_fill_their_scan(scan: int, period_ns: int, sectors: int) -> None:
    parts = [Timetable(period_ns, sectors).sector(scan, i) for i in range(sectors)]
    assert parts[0].start_ns == scan * period_ns
    assert parts[-1].end_ns == (scan + 1) * period_ns
    assert parts[0].start_deg == 0
    assert parts[-1].end_deg == pytest.approx(360)
    lengths = [p.end_ns - p.start_ns for p in parts]
    assert max(lengths) - min(lengths) <= 1


@given(times_ns, st.integers(0, 600), periods_ns, sector_counts)
def test_a_walk_comes_to_the_same_sectors_wherever_it_began(
    t_utc_ns: int, steps: int, period_ns: int, sectors: int
) -> None:
    sector = Timetable(period_ns, sectors).sector_at(t_utc_ns)
    for _ in range(steps):
        sector = Timetable(period_ns, sectors).next_sector(sector)
    assert sector == Timetable(period_ns, sectors).sector_at(sector.start_ns)


def passed_by(sector: Sector, first_deg: Floats, last_deg: Floats) -> tuple[Bools, Floats]:
    """Which azimuths a beam passes within a sector, and after what share of it."""
    return passes_between(
        ahead_of_beam_deg(first_deg, sector.start_deg),
        ahead_of_beam_deg(last_deg, sector.end_deg % 360),
    )


class Straight:
    """A drone on a straight line past the radar, in the plane."""

    def __init__(self, east_m: float, north_m: float, speed_m_s: float, heading_deg: float) -> None:
        self.east_m, self.north_m = east_m, north_m
        self.east_m_s = speed_m_s * math.sin(math.radians(heading_deg))
        self.north_m_s = speed_m_s * math.cos(math.radians(heading_deg))

    def azimuth_deg(self, t_s: float) -> float:
        east_m = self.east_m + self.east_m_s * t_s
        north_m = self.north_m + self.north_m_s * t_s
        return math.degrees(math.atan2(east_m, north_m)) % 360

    def nearest_m(self) -> float:
        speed = math.hypot(self.east_m_s, self.north_m_s)
        if speed == 0:
            return math.hypot(self.east_m, self.north_m)
        return abs(self.east_m * self.north_m_s - self.north_m * self.east_m_s) / speed


drones = st.builds(
    Straight, st.floats(-3000, 3000), st.floats(-3000, 3000), st.floats(0, 150), st.floats(0, 360)
)


@given(drones, st.integers(100_000_000, 12 * S), st.integers(4, 64), st.integers(0, 10**6))
def test_a_drone_is_passed_once_in_every_turn_that_the_beam_makes_over_it(
    drone: Straight, period_ns: int, sectors: int, start_ns: int
) -> None:
    turn_s = period_ns / S
    speed = math.hypot(drone.east_m_s, drone.north_m_s)
    assume(drone.nearest_m() > 10)
    # Slower than the beam turns: it neither overtakes the beam nor meets it twice in a turn.
    assume(math.degrees(speed / drone.nearest_m()) < 0.9 * 360 / turn_s)
    turns = 6
    sector = Timetable(period_ns, sectors).sector_at(start_ns)
    beginning = sector
    passes = 0
    for _ in range(turns * sectors):
        azimuths = [np.array([drone.azimuth_deg(t / S)]) for t in (sector.start_ns, sector.end_ns)]
        passes += int(passed_by(sector, *azimuths)[0][0])
        ending, sector = sector, Timetable(period_ns, sectors).next_sector(sector)
    # A straight line never turns by more than 180 degrees around the radar.
    first = drone.azimuth_deg(beginning.start_ns / S)
    last = first + float(wrap_180(drone.azimuth_deg(ending.end_ns / S) - first))
    beam = ending.end_deg + 360 * (ending.scan - beginning.scan)
    ahead_first, ahead_last = beginning.start_deg - first, beam - last
    assert passes == math.ceil(ahead_last / 360) - math.ceil(ahead_first / 360)


@given(drones, st.integers(100_000_000, 4 * S), st.sampled_from([8, 16, 32, 64]))
def test_at_the_time_of_passage_the_beam_points_at_the_drone(
    drone: Straight, period_ns: int, sectors: int
) -> None:
    speed = math.hypot(drone.east_m_s, drone.north_m_s)
    assume(drone.nearest_m() > 300)
    assume(math.degrees(speed / drone.nearest_m()) < 0.2 * 360 * S / period_ns)
    sector = Timetable(period_ns, sectors).sector_at(0)
    for _ in range(sectors):
        azimuths = [np.array([drone.azimuth_deg(t / S)]) for t in (sector.start_ns, sector.end_ns)]
        passed, share = passed_by(sector, *azimuths)
        if passed[0]:
            t = time_after_share_ns(sector.start_ns, sector.end_ns, share)
            share = share + beam_is_late_by(sector, share, np.array([drone.azimuth_deg(t[0] / S)]))
            t = time_after_share_ns(sector.start_ns, sector.end_ns, share)
            beam_deg = 360 * (t[0] % period_ns) / period_ns
            error_deg = float(wrap_180(drone.azimuth_deg(t[0] / S) - beam_deg))
            assert abs(error_deg) < 0.02
        sector = Timetable(period_ns, sectors).next_sector(sector)


def test_a_drone_at_rest_is_passed_exactly_when_the_beam_is_there() -> None:
    azimuth_deg = np.array([100.0])
    sector = Timetable(S, 32).sector_at(T0 + 280_000_000)
    passed, share = passed_by(sector, azimuth_deg, azimuth_deg)
    assert passed.all()
    assert time_after_share_ns(sector.start_ns, sector.end_ns, share)[0] == T0 + round(
        S * 100 / 360
    )
    assert beam_times_ns(sector, azimuth_deg)[0] == T0 + round(S * 100 / 360)


@pytest.mark.parametrize("azimuth_deg", [0.0, 11.25, 180.0, 348.75])
def test_a_drone_on_an_edge_belongs_to_the_sector_that_begins_there(azimuth_deg: float) -> None:
    still = np.array([azimuth_deg])
    passed_in = [
        i for i in range(32) if passed_by(Timetable(S, 32).sector(5, i), still, still)[0].all()
    ]
    assert passed_in == [round(azimuth_deg / 11.25)]


def test_nobody_is_passed_at_an_undefined_azimuth() -> None:
    nowhere = np.array([np.nan, np.nan, 5.0])
    somewhere = np.array([5.0, np.nan, np.nan])
    passed, _ = passed_by(Timetable(S, 4).sector(0, 0), nowhere, somewhere)
    assert not passed.any()


def test_a_staring_sensor_measures_at_the_end_of_its_scan() -> None:
    sector = Timetable(S, 1).sector_at(T0 + 5)
    assert beam_times_ns(sector, np.array([0.0, 200.0])).tolist() == [T0 + S, T0 + S]


@given(times_ns, periods_ns, st.integers(2, 256), st.floats(0, 1, exclude_max=True))
def test_times_of_a_beam_lie_within_its_sector(
    t_utc_ns: int, period_ns: int, sectors: int, share: float
) -> None:
    sector = Timetable(period_ns, sectors).sector_at(t_utc_ns)
    azimuth_deg = np.array([sector.start_deg + share * (sector.end_deg - sector.start_deg)])
    t = int(beam_times_ns(sector, azimuth_deg)[0])
    assert sector.start_ns <= t < sector.end_ns


def test_shares_beyond_a_sector_are_kept_within_it() -> None:
    shares = np.array([-0.5, 0.25, 1.0, 1.5])
    assert time_after_share_ns(100, 200, shares).tolist() == [100, 125, 199, 199]


@st.composite
def covers(draw: st.DrawFn) -> AzimuthCover:
    min_deg = draw(st.floats(-360, 359.9))
    return AzimuthCover(min_deg, min(min_deg + draw(st.floats(0.01, 360)), 360.0))


def pieces(cover: AzimuthCover, sectors: int) -> list[tuple[float, float]]:
    return [
        piece
        for i in range(sectors)
        for piece in cover.shares_in(Timetable(S, sectors).sector(0, i))
    ]


@given(covers(), st.integers(1, 256))
def test_the_shares_of_a_scan_make_up_the_cover(cover: AzimuthCover, sectors: int) -> None:
    shares = sorted(pieces(cover, sectors))
    assert sum(high - low for low, high in shares) == pytest.approx(1.0, abs=1e-9)
    for (_, high), (low, _) in pairwise(shares):
        assert high == pytest.approx(low, abs=1e-9)
    assert all(0 <= low < high <= 1 for low, high in shares)


@given(covers(), st.integers(1, 256), st.integers(0, 255), st.floats(0.01, 0.99))
def test_every_piece_lies_in_its_sector_and_in_the_cover(
    cover: AzimuthCover, sectors: int, index: int, share: float
) -> None:
    sector = Timetable(S, sectors).sector(0, index % sectors)
    for low, high in cover.shares_in(sector):
        azimuth_deg = cover.min_deg + (low + share * (high - low)) * cover.span_deg
        assert cover.holds(np.array([azimuth_deg])).all() or high - low < 1e-9
        into_deg = (azimuth_deg - sector.start_deg) % 360
        width_deg = sector.end_deg - sector.start_deg
        assert into_deg <= width_deg + 1e-9 or into_deg > 360 - 1e-9


def test_a_cover_through_north_holds_both_of_its_sides() -> None:
    cover = AzimuthCover(-30.0, 60.0)
    azimuths = np.array([330.0, 359.0, 0.0, 60.0, 60.1, 180.0, 329.9, -10.0, np.nan])
    assert cover.holds(azimuths).tolist() == [
        True, True, True, True, False, False, False, True, False,
    ]  # fmt: skip


@given(st.floats(-720, 720), st.floats(-360, 0))
def test_the_full_circle_holds_every_azimuth(azimuth_deg: float, min_deg: float) -> None:
    assert AzimuthCover(min_deg, min_deg + 360).holds(np.array([azimuth_deg])).all()


def test_a_sector_beside_the_cover_has_no_share() -> None:
    assert AzimuthCover(90.0, 120.0).shares_in(Timetable(S, 4).sector(0, 0)) == []


def test_a_sector_can_hold_both_ends_of_the_cover() -> None:
    shares = AzimuthCover(80.0, 370.0).shares_in(Timetable(S, 4).sector(0, 0))
    assert shares == [(pytest.approx(280 / 290), 1.0), (0.0, pytest.approx(10 / 290))]
