"""What is wrong with all tracks alike is named, and undone; clean ones are called clean."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter
from support.scored_flights import NS, SITE, Flight, Given, followed_well, read_of, truths_of

from plotfeed.feeds.formats.told_tracks import ToldTrack
from plotfeed.feeds.lab.diagnosis import diagnosed
from plotfeed.feeds.lab.scoring import Score, ScoreSettings
from plotfeed.models.frames import LocalFrame
from plotfeed.models.verdicts import joint_fit

FLIGHTS = {
    "a": Flight((-800.0, 600.0, 100.0), (10.0, -5.0, 0.0)),
    "b": Flight((1500.0, -900.0, 120.0), (-3.0, 12.0, 0.5)),
}
TRUTHS = truths_of(FLIGHTS)
Fault = Callable[[ToldTrack], ToldTrack]


def later(by_s: float) -> Fault:
    return lambda told: replace(told, t_utc_ns=told.t_utc_ns + round(by_s * NS))


def higher(by_m: float) -> Fault:
    return lambda told: replace(told, height_m=told.height_m + by_m)


def turned(by_deg: float) -> Fault:
    """Azimuths from the site too large by that."""

    def fault(told: ToldTrack) -> ToldTrack:
        there = LocalFrame(told.latitude_deg, told.longitude_deg, told.height_m).origin_ecef_m
        east, north, up = SITE.from_ecef(there)
        c, s = math.cos(math.radians(by_deg)), math.sin(math.radians(by_deg))
        place = SITE.to_geodetic([c * east + s * north, c * north - s * east, up])
        latitude_deg, longitude_deg, height_m = map(float, place)
        return replace(
            told, latitude_deg=latitude_deg, longitude_deg=longitude_deg, height_m=height_m
        )

    return fault


def exchanged(told: ToldTrack) -> ToldTrack:
    return replace(told, latitude_deg=told.longitude_deg, longitude_deg=told.latitude_deg)


def backwards(told: ToldTrack) -> ToldTrack:
    return replace(told, velocity_enu_m_s=tuple(-v for v in told.velocity_enu_m_s))


def in_radians(told: ToldTrack) -> ToldTrack:
    latitude, longitude = math.radians(told.latitude_deg), math.radians(told.longitude_deg)
    return replace(told, latitude_deg=latitude, longitude_deg=longitude)


def of_the_day(told: ToldTrack) -> ToldTrack:
    return replace(told, t_utc_ns=told.t_utc_ns % (86_400 * NS))


def in_feet(told: ToldTrack) -> ToldTrack:
    return replace(told, height_m=told.height_m / 0.3048)


@pytest.mark.parametrize(
    ("faults", "named"),
    [
        ([higher(-51.9)], ["heights are above mean sea level (52.1 m)"]),
        ([in_feet], ["heights are in feet"]),
        ([exchanged], ["latitude and longitude are exchanged"]),
        ([backwards], ["velocities have the opposite sign"]),
        ([in_radians], ["places are in radians"]),
        ([of_the_day], ["times are seconds of the day, without a date"]),
        ([later(3600.0)], ["times are of a zone, UTC+1:00"]),
        ([later(-19_800.0)], ["times are of a zone, UTC-5:30"]),
        ([later(18.0)], ["times are of GPS, leap seconds not taken off (18 s ahead)"]),
        ([later(37.0)], ["times are of TAI (37 s ahead)"]),
        ([later(0.48)], ["times are 0.5"]),
        ([later(-7.3)], ["times are 7.29 s early"]),
        ([turned(1.0)], ["azimuths from the sensors are 1.00 deg too large"]),
        (
            [turned(1.0), higher(-51.9), later(0.48)],
            ["heights are above mean sea level", "azimuths from the sensors are 1.0", "times are"],
        ),
    ],
)
def test_what_was_planted_is_named_and_undone(faults: list[Fault], named: list[str]) -> None:
    given: Given = []
    for told, _ in followed_well(FLIGHTS, sigma_m=3.0, seed=4):
        for fault in faults:
            told = fault(told)  # noqa: PLW2901 - one fault after the other
        given.append((told, None))
    found = diagnosed(TRUTHS, read_of(given), ScoreSettings())
    assert found is not None
    assert len(found.findings) == len(named)
    for text, begins in zip(found.findings, named, strict=True):
        assert text.startswith(begins), found.findings
    clean = Score(TRUTHS, read_of(followed_well(FLIGHTS, sigma_m=3.0, seed=4)))
    assert found.without.as_stamped.gospa_m < 1.1 * clean.as_stamped.gospa_m
    assert found.without.in_space.position_rms_m < 1.1 * clean.in_space.position_rms_m


def test_an_error_of_azimuth_is_no_lag() -> None:
    given = [(turned(1.0)(told), r) for told, r in followed_well(FLIGHTS, sigma_m=3.0, seed=4)]
    reports = Score(TRUTHS, read_of(given)).reports
    assert abs(reports.lag_s) < 0.1


def test_few_reports_are_not_diagnosed() -> None:
    assert diagnosed(TRUTHS, read_of(followed_well(FLIGHTS)[:15]), ScoreSettings()) is None


def test_effects_are_named_of_clean_errors_as_seldom_as_stated() -> None:
    """At most one in a hundred, of errors that hang together by 0.9; and what is the same twice."""
    rng, false, n = np.random.default_rng(1), 0, 200
    series = np.repeat([0, 1], n)
    course = np.cumsum(rng.normal(0, 0.2, (n, 2)), axis=0).T.ravel()
    effects = {
        "clock": 10.0 * np.stack([np.sin(course), np.cos(course)], axis=1),
        "east": np.tile([1.0, 0.0], (2 * n, 1)),
        "north": np.tile([0.0, 1.0], (2 * n, 1)),
    }
    own = (1 - 0.9**2) ** 0.5
    for _ in range(200):
        drawn = rng.standard_normal((n, 2, 2))
        drawn[0] /= own
        errors = 3 * lfilter([own], [1.0, -0.9], drawn, axis=0)
        false += bool(joint_fit(errors.transpose(1, 0, 2).reshape(-1, 2), effects, series))
    assert false <= stats.binom.ppf(1 - 1e-4, 200, 0.01)
    twice = effects | {"twin": effects["east"]}
    (found,) = joint_fit(30 * effects["east"] + rng.standard_normal((2 * n, 2)), twice, series)
    assert (found.name, found.others) == ("east", ("twin",))
    assert found.value == pytest.approx(30.0, abs=0.5)
