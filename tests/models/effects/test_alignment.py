"""Own axes of a sensor that stands askew: one rotation, and where it puts things."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.models.effects.readings import SkewFrame, own_axes
from plotfeed.models.frames import LocalFrame, aer_to_enu

FRAME = LocalFrame(40.45, -3.73, 650.0)
offsets = st.floats(-180.0, 180.0)
tilts = st.floats(0.0, 45.0)
azimuths = st.floats(0.0, 360.0)
elevations = st.floats(-80.0, 80.0)


@given(offsets, tilts, azimuths)
def test_it_is_a_rotation(offset_deg, tilt_deg, towards_deg):
    axes = own_axes(offset_deg, tilt_deg, towards_deg)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), rtol=0, atol=3e-15)
    assert np.linalg.det(axes) == pytest.approx(1.0, abs=1e-14)


@given(tilts, azimuths, azimuths, elevations)
def test_a_tilt_raises_what_is_where_it_leans_to(tilt_deg, towards_deg, azimuth_deg, elevation_deg):
    """Spherical trigonometry: sine of the elevation over the leaning horizon."""
    seen = own_axes(0.0, tilt_deg, towards_deg) @ aer_to_enu(azimuth_deg, elevation_deg, 1.0)
    tilt, el = np.radians(tilt_deg), np.radians(elevation_deg)
    away = np.radians(azimuth_deg - towards_deg)
    sine = np.sin(el) * np.cos(tilt) + np.cos(el) * np.sin(tilt) * np.cos(away)
    assert seen[2] == pytest.approx(sine, abs=1e-14)


@given(offsets, tilts, azimuths, st.tuples(azimuths, elevations, st.floats(10.0, 20_000.0)))
def test_a_skew_frame_is_the_rotation_of_the_level_one(offset_deg, tilt_deg, towards_deg, place):
    skew = SkewFrame.at(
        FRAME, azimuth_offset_deg=offset_deg, tilt_deg=tilt_deg, tilt_azimuth_deg=towards_deg
    )
    place_ecef_m = FRAME.to_ecef(aer_to_enu(*place))
    seen = skew.from_ecef(place_ecef_m)
    axes = own_axes(offset_deg, tilt_deg, towards_deg)
    np.testing.assert_allclose(seen, axes @ FRAME.from_ecef(place_ecef_m), atol=1e-8)
    np.testing.assert_allclose(skew.to_ecef(seen), place_ecef_m, atol=5e-9)
