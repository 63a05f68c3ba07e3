"""Tracks of sensors, drawn at random: what formats of tracks are given."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from plotfeed.proto.tracks.encode_tracks import ToldTracks, TrackOrigin

T_NS = 1_700_000_000_123_456_789
NS = 1_000_000_000
RADAR = TrackOrigin(sensor="radar", kind="plain", stale_after_s=6.0)


def told_tracks(n: int, rng: np.random.Generator, *, has_height: bool = True) -> ToldTracks:
    """So many tracks anywhere on the Earth, at one time."""

    def sigma(scale: float) -> np.ndarray:
        return scale * rng.random(n)

    def if_measured(column: np.ndarray) -> np.ndarray:
        return column if has_height else np.full(n, np.nan)

    return ToldTracks(
        track=rng.integers(1, 65_000) + 7 * np.arange(n),
        t_utc_ns=np.full(n, T_NS),
        latitude_deg=rng.uniform(-89, 89, n),
        longitude_deg=rng.uniform(-180, 180, n),
        east_m=rng.uniform(-9000, 9000, n),
        north_m=rng.uniform(-9000, 9000, n),
        velocity_east_m_s=rng.uniform(-60, 60, n),
        velocity_north_m_s=rng.uniform(-60, 60, n),
        height_m=if_measured(rng.uniform(-100, 5000, n)),
        climb_m_s=if_measured(rng.uniform(-80, 80, n)),
        age_s=rng.uniform(0, 9, n),
        sigma_east_m=sigma(100.0),
        sigma_north_m=sigma(100.0),
        sigma_up_m=if_measured(sigma(100.0)),
        sigma_velocity_east_m_s=sigma(9.0),
        sigma_velocity_north_m_s=sigma(9.0),
        sigma_climb_m_s=if_measured(sigma(9.0)),
        tentative=np.zeros(n, np.bool_),
        coasted=rng.random(n) < 0.5,
        first=rng.random(n) < 0.2,
        last=rng.random(n) < 0.2,
    )


@st.composite
def any_tracks(draw: st.DrawFn) -> ToldTracks:
    """Tracks with heights or without."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    return told_tracks(draw(st.integers(1, 6)), rng, has_height=draw(st.booleans()))
