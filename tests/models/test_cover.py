from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.models.beam import AzimuthCover, Timetable

S = 1_000_000_000


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
