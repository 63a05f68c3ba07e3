"""Microphone layouts: places, and errors of directions against signals and against the bound."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.significance import assert_sum

from plotfeed.models.effects.microphone_layout import MicrophoneLayout
from plotfeed.models.frames import wrap_180
from plotfeed.models.state import Bools, Floats

WAVELENGTH_M = 1.4
SHAPES = ("line", "circle", "rectangle")


def layout(shape: Any = "circle", microphones: int = 8, **changes: Any) -> MicrophoneLayout:
    given: dict[str, Any] = {"spacing_m": 0.5, "azimuth_deg": 20.0, "wavelength_m": WAVELENGTH_M}
    return MicrophoneLayout(shape=shape, microphones=microphones, **given | changes)


def everywhere(azimuth_deg: Floats) -> Bools:
    return np.ones(azimuth_deg.shape, np.bool_)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("microphones", [4, 6, 10, 12, 16])
def test_neighbours_are_as_far_apart_as_stated(shape: str, microphones: int) -> None:
    places_m = layout(shape, microphones).places_m
    apart_m = np.linalg.norm(places_m[:, None] - places_m, axis=-1)
    np.fill_diagonal(apart_m, np.inf)
    np.testing.assert_allclose(apart_m.min(axis=1), 0.5)
    np.testing.assert_allclose(places_m.mean(axis=0), 0.0, atol=1e-12)
    assert len(places_m) == microphones


def test_a_line_points_where_it_says_and_a_rectangle_along_its_longer_side() -> None:
    places_m = layout("line", 4, azimuth_deg=90.0).places_m
    np.testing.assert_allclose(places_m, [[-0.75, 0], [-0.25, 0], [0.25, 0], [0.75, 0]], atol=1e-12)
    spread_m = np.ptp(layout("rectangle", 12, azimuth_deg=0.0).places_m, axis=0)
    np.testing.assert_allclose(spread_m, [1.0, 1.5])


@pytest.mark.parametrize("shape", ["circle", "rectangle"])
def test_directions_err_as_those_found_in_signals(shape: str) -> None:
    """The most likely direction by phases of signals with noise, by Newton's steps from the truth.

    By linear theory both have the bound's variance; signals here are 26 dB over the noise.
    """
    array, n, snr = layout(shape, 6), 20_000, 400.0
    azimuth_deg, elevation_deg = np.full(n, 73.0), np.full(n, 40.0)
    rng = np.random.default_rng(5)
    azimuth, elevation = np.radians(73.0), np.radians(40.0)
    w = np.cos(elevation) * np.array([np.sin(azimuth), np.cos(azimuth)])
    k_places = 2 * np.pi / WAVELENGTH_M * array.places_m
    noise = (rng.standard_normal((n, 6)) + 1j * rng.standard_normal((n, 6))) / np.sqrt(2)
    residual = 1 + noise * np.exp(-1j * (k_places @ w)) / np.sqrt(snr / 6)
    found = np.zeros((n, 2))
    for _ in range(4):
        turned = residual * np.exp(-1j * found @ k_places.T)
        of_all = turned.sum(axis=1, keepdims=True)
        slope = np.imag(np.conj(of_all) * turned) @ k_places / np.abs(of_all[:, 0])[:, None] ** 2
        found += slope @ np.linalg.inv(k_places.T @ k_places / 6)
    east, north = (w + found).T
    signals_deg = wrap_180(np.degrees(np.arctan2(east, north)) - azimuth_deg)
    measured = array.measured(azimuth_deg, elevation_deg, np.full(n, snr), everywhere, rng)
    ours_deg = wrap_180(measured[0] - azimuth_deg)
    sigma_deg = array.sigmas_deg(azimuth_deg[:1], elevation_deg[:1], np.array([snr]))[0][0]
    for errors_deg, excess in ((ours_deg, 0.02), (signals_deg, 0.03)):
        assert np.std(errors_deg) == pytest.approx(sigma_deg, rel=excess)
    assert_sum(float(np.sum((ours_deg / sigma_deg) ** 2)), n, 2.1 * n, "variance of ours")


def test_a_line_takes_either_side_unless_its_cover_has_one() -> None:
    array, n = layout("line"), 20_000
    azimuth_deg = np.full(n, 20.0 + 50.0)
    draw = (azimuth_deg, np.zeros(n), np.full(n, 1e4))
    rng = np.random.default_rng(7)
    off_deg = wrap_180(array.measured(*draw, everywhere, rng)[0] - 20.0)
    assert_sum(float((off_deg > 0).sum()), n / 2, n / 4, "plots on the right side")
    np.testing.assert_allclose(np.abs(off_deg), 50.0, atol=3.0)

    def right_of_it(found_deg: Floats) -> Bools:
        return np.asarray(wrap_180(found_deg - 20.0) > 0)

    assert (wrap_180(array.measured(*draw, right_of_it, rng)[0] - 20.0) > 0).all()


def test_what_is_high_up_seems_further_off_a_lines_end() -> None:
    """A line measures the angle to itself: 60 degrees up, ahead is 60 degrees to a side."""
    found_deg = layout("line").measured(
        np.array([20.0]), np.array([60.0]), np.array([1e9]), everywhere, np.random.default_rng(8)
    )[0]
    assert np.abs(wrap_180(found_deg - 20.0)) == pytest.approx(60.0, abs=0.01)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(("azimuth_deg", "elevation_deg"), [(20.0, 0.0), (0.0, 90.0), (110.0, 0.0)])
def test_errors_are_finite_in_every_direction(
    shape: str, azimuth_deg: float, elevation_deg: float
) -> None:
    snr = np.array([1e-6, 1.0, 1e12])
    place = np.full(3, azimuth_deg), np.full(3, elevation_deg)
    sigmas = layout(shape).sigmas_deg(*place, snr)
    rng = np.random.default_rng(9)
    measured = layout(shape).measured(*place, snr, everywhere, rng)
    for column in (*sigmas, *measured)[:: 2 if shape == "line" else 1]:
        assert np.isfinite(column).all()
