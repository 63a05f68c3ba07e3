"""Where a plain form of floats fails, and what ours does there: rows of docs/stability.md."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import special

from plotfeed.models import detection, propagation
from plotfeed.models.frames import LocalFrame


def test_a_pd_of_a_trillionth_keeps_its_digits() -> None:
    looks, pfa, snr = 3, 1e-12, 1e-3
    threshold = detection.threshold_noncoherent(pfa, looks) / (1 + snr)
    exact = math.exp(-threshold) * (1 + threshold + threshold**2 / 2)  # order 3, by hand
    plain = 1 - special.gammainc(looks, threshold)
    ours = detection.pd_noncoherent_swerling2(snr, pfa, looks)
    assert abs(plain / exact - 1) > 1e-7
    assert ours == pytest.approx(exact, rel=1e-13)


def test_a_threshold_for_a_pfa_below_the_rounding_of_one() -> None:
    assert special.gammaincinv(3, 1 - 1e-17) == math.inf
    y = float(detection.threshold_noncoherent(1e-17, 3))
    assert math.exp(-y) * (1 + y + y**2 / 2) == pytest.approx(1e-17, rel=1e-13)


def test_a_place_next_to_the_baseline_comes_back() -> None:
    baseline_m, along_m, off_m = 20_000.0, 7000.0, 1e-5
    detour_m = off_m**2 / 2 * (1 / along_m + 1 / (baseline_m - along_m))
    angle_rad = math.atan2(off_m, along_m)
    depth_m = baseline_m * (1 - math.cos(angle_rad))
    plain_m = detour_m * (detour_m + 2 * baseline_m) / (2 * (detour_m + depth_m))
    assert abs(plain_m - along_m) > 1000
    found_m = propagation.range_from_bistatic(detour_m, baseline_m, math.degrees(angle_rad))[0]
    assert found_m == pytest.approx(along_m, rel=1e-12)


def test_a_position_of_single_precision_loses_metres_and_ours_does_not() -> None:
    frame = LocalFrame(40.45, -3.73, 650.0)
    ecef_m = frame.to_ecef(np.array([1234.5678, -987.6543, 55.5]))
    rounded = frame.from_ecef(ecef_m.astype(np.float32))
    assert np.abs(rounded - [1234.5678, -987.6543, 55.5]).max() > 0.05
    assert np.abs(frame.from_ecef(ecef_m) - [1234.5678, -987.6543, 55.5]).max() < 5e-9
