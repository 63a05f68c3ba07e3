"""What a steered beam does next: when tracks are due, how far search comes, what pointing costs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

from plotfeed.models.beam import AzimuthCover
from plotfeed.models.dwell_agenda import (
    BeamGrid,
    BeamTracks,
    frame_s,
    revisit_interval_s,
    search_outcome,
)
from plotfeed.models.state import NS

GRID = BeamGrid(
    cover=AzimuthCover(-60.0, 60.0),
    elevation_min_deg=-40.0,
    elevation_max_deg=40.0,
    azimuth_beamwidth_deg=2.0,
    elevation_beamwidth_deg=6.0,
    spacing=1.0,
)


def predicted_over_measured(interval_s: float, sigma_m: float, accel: float, tau_s: float) -> float:
    """Of the steady filter of a target whose acceleration is a first-order Gauss-Markov process.

    The noise of an interval is by Van Loan's matrix exponential.
    """
    motion = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1 / tau_s]])
    noise = np.zeros((3, 3))
    noise[2, 2] = 2 * accel**2 / tau_s
    both = expm(np.block([[-motion, noise], [np.zeros((3, 3)), motion.T]]) * interval_s)
    step = both[3:, 3:].T
    of_interval = step @ both[:3, 3:]
    spread = np.diag([sigma_m**2, accel * sigma_m, accel**2])
    for _ in range(3000):
        before = spread
        spread = step @ spread @ step.T + of_interval
        gain = spread[:, :1] / (spread[0, 0] + sigma_m**2)
        predicted = spread[0, 0]
        spread = spread - gain @ spread[:1]
        if np.allclose(before, spread, rtol=1e-10):
            break
    return float(np.sqrt(predicted) / sigma_m)


@pytest.mark.parametrize("ratio", [0.3, 0.6, 1.0])
def test_revisits_are_those_of_the_filter_of_manoeuvring_targets(ratio: float) -> None:
    """Within 8 %, where an interval is short beside the manoeuvre."""
    sigma_m, accel, tau_s = 5.0, 5.0, 60.0
    of_filter_s = brentq(
        lambda t: predicted_over_measured(t, sigma_m, accel, tau_s) - ratio, 1e-3, 5.0, xtol=1e-3
    )
    ours_s = float(revisit_interval_s(np.array([sigma_m]), accel, tau_s, ratio)[0])
    assert ours_s < 0.08 * tau_s
    assert ours_s == pytest.approx(of_filter_s, rel=0.08)


def test_a_search_takes_longer_the_more_tracks_there_are() -> None:
    """800 beams of 1 ms and 20 tracks at 10 Hz: 1 s, and 1.6 s with beams 0.8 widths apart."""
    assert frame_s(800, 1e-3, 20 * 10 * 1e-3) == pytest.approx(1.0)
    assert frame_s(1250, 1e-3, 20 * 10 * 1e-3) == pytest.approx(1.5625)
    assert frame_s(800, 1e-3, 1.0) == np.inf


def test_pointing_errors_cost_what_the_mean_of_a_gaussian_beam_gives() -> None:
    """-3.006 dB at 0.3 beamwidths along both axes, by quadrature over the errors."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    across, upwards = np.meshgrid(nodes * 0.3 * 2.0, nodes * 0.3 * 6.0)
    shares = np.outer(weights, weights) / weights.sum() ** 2
    level = 1 / np.cos(np.radians(upwards.ravel()))
    gain = GRID.gain((across.ravel() * level, upwards.ravel()), (np.zeros(3600), np.zeros(3600)))
    found_db = 10 * np.log10(gain @ shares.ravel())
    assert found_db == pytest.approx(-3.0062416203051, abs=1e-3)
    assert 10 * np.log10(1 / (1 + 16 * np.log(2) * 0.3**2)) == pytest.approx(-3.0062416203051)


def test_every_direction_of_the_cover_is_in_the_beam_whose_middle_is_nearest() -> None:
    assert GRID.shape == (60, 14)
    rng = np.random.default_rng(1)
    azimuth_deg, elevation_deg = rng.uniform(-60, 60, 5000), rng.uniform(-40, 40, 5000)
    beam = GRID.beam_of(azimuth_deg % 360, elevation_deg)
    middle = GRID.middle_of(beam)
    assert np.abs(middle[0] - azimuth_deg).max() <= 1.0 + 1e-9
    assert np.abs(middle[1] - elevation_deg).max() <= 40 / 14 + 1e-9
    every = GRID.middle_of(np.arange(GRID.beams))
    np.testing.assert_array_equal(GRID.beam_of(*every), np.arange(GRID.beams))


def test_hits_take_dwells_from_search() -> None:
    hit = np.zeros(100, np.bool_)
    assert search_outcome(hit, 80).beams == 80
    hit[[3, 10, 79]] = True
    outcome = search_outcome(hit, 80)
    assert outcome.beams == 78
    assert outcome.slots[[0, 3, 4, 11, 12]].tolist() == [0, 3, 5, 13, 14]
    assert search_outcome(hit, 4).beams == 3  # the fourth's confirmation would not fit


def test_a_track_learns_its_velocity_and_forgets_what_it_misses() -> None:
    tracks = BeamTracks.begun(np.zeros((1, 3)), np.zeros(1, np.int64), np.zeros(1, np.int64))
    for k in range(1, 60):
        now = np.array([k * NS // 10])
        place_m = np.array([[1.2 * k, -0.4 * k, 0.0]])
        tracks = tracks.updated(np.array([True]), place_m, now, now)
    np.testing.assert_allclose(tracks.velocity_m_s, [[12.0, -4.0, 0.0]], atol=1e-6)
    later = np.array([7 * NS])
    missed = tracks.updated(np.array([False]), np.zeros((1, 3)), later, later)
    assert missed.misses.tolist() == [1]
    np.testing.assert_array_equal(missed.place_m, tracks.place_m)
