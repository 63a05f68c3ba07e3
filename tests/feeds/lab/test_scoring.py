"""Trackers that follow straight flights in known ways, and those that send garbage.

What is wrong with all of a tracker's reports alike is named, and undone; clean ones are called
clean.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Container
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given as drawn
from hypothesis import settings
from hypothesis import strategies as st
from scipy import stats
from scipy.signal import lfilter
from support.recordings import START_NS
from support.scored_flights import (
    APART,
    NS,
    SITE,
    Flight,
    Given,
    followed_well,
    read_of,
    report_of,
    tally_of,
    truths_of,
)

from plotfeed.feeds.formats.told_tracks import ToldTrack
from plotfeed.feeds.lab.diagnosis import diagnosed
from plotfeed.feeds.lab.flights import FlightsTally, Truths
from plotfeed.feeds.lab.score import long_gap_share, update_share
from plotfeed.feeds.lab.scoring import FIGURE_NAMES, Score, ScoreSettings
from plotfeed.models.frames import LocalFrame
from plotfeed.models.verdicts import joint_fit
from plotfeed.proto.errors import PlotfeedError

TRUTHS = truths_of()
Change = Callable[[ToldTrack], dict[str, Any]]


def scored(given: Given, truths: Truths = TRUTHS, **settings: object) -> Score:
    return Score(truths, read_of(given), ScoreSettings(**settings))  # type: ignore[arg-type]


def changed(given: Given, *changes: Change) -> Given:
    """Reports of which some fields are otherwise, by one change after the other."""
    for change in changes:
        given = [(replace(told, **change(told)), received) for told, received in given]
    return given


def test_a_tracker_without_fault_has_none() -> None:
    score = scored(followed_well())
    assert score.failure == ""
    assert score.left_out == {}
    assert score.settings.dimensions == 2
    told = score.figures()
    assert tuple(told) == FIGURE_NAMES
    for name in ("gospa_m", "ospa_m", "ospa2_m", "t_gospa_m", "position_max_m", "velocity_rms_m_s"):
        assert told[name] == pytest.approx(0.0, abs=0.02), name
    assert (told["completeness"], told["ambiguity"], told["spuriousness"]) == (1.0, 1.0, 0.0)
    assert (told["breaks"], told["swaps"], told["number_changes_per_h"]) == (0.0, 0.0, 0.0)
    assert told["longest_segment"] == 1.0
    assert told["latency_p95_s"] == told["initiation_median_s"] == pytest.approx(0.2)
    assert (told["tracks"], told["false_tracks"], told["never_tracked"]) == (2, 0, 0)
    assert [(each.drone, each.cover_s) for each in score.drones] == [("a", 61.0), ("b", 61.0)]
    (radar,) = score.sensors
    assert (radar.sensor, radar.drones, radar.completeness) == ("radar", 2, 1.0)
    assert radar.longest_gap_s == 0.0


def test_reports_between_looks_and_steps_are_compared_at_their_own_time() -> None:
    """At 15 m/s, a comparison 10 ms off would show 0.15 m."""
    turns = {"a": Flight(velocity_m_s=(15.0, 0.0, 0.0))}
    given = [
        (report_of("1", turns["a"], t_s), START_NS + round((t_s + 0.1) * NS))
        for t_s in np.arange(0.37, 59.0, 0.73)
    ]
    assert scored(given, truths_of(turns)).reports.position_max_m < 1e-3


def test_errors_of_position_are_those_that_were_put_in() -> None:
    score = scored(followed_well(sigma_m=5.0, seed=3, tells_covariance=True))
    n = 2 * int(score.reports.reports)
    assert score.reports.nees == pytest.approx(1.0, abs=4 * (2 / n) ** 0.5)
    for of, axes in ((score.reports, 2), (score.in_space, 3)):
        assert of.position_rms_m == pytest.approx(5.0 * axes**0.5, rel=4 / n**0.5)
        assert of.nees_low < 1.0 < of.nees_high
    further = changed(followed_well(), lambda t: {"latitude_deg": t.latitude_deg + 1e-4})
    reports = scored(further).reports
    found = (reports.bias_north_m, reports.bias_east_m)
    assert found == pytest.approx((11.1, 0.0), abs=0.1)


def test_dimensions_never_change_in_silence() -> None:
    """Over the ground always, and in space beside it, of the reports that tell a height."""
    flat = changed(followed_well(), lambda _: {"height_m": math.nan})
    score = scored(flat)
    assert score.reports.position_max_m < 1e-3
    assert math.isnan(score.reports.bias_up_m)
    assert math.isnan(score.figures()["space_gospa_m"])
    wrong = changed(followed_well(), higher(30.0))
    one_flat = [flat[0], *wrong[1:]]
    for told, reports in ((wrong, 122), (one_flat, 121)):
        score = scored(told)
        assert score.reports.position_max_m < 1e-3
        assert score.in_space.position_rms_m == pytest.approx(30.0, abs=0.01)
        assert score.in_space.gospa_m == pytest.approx(30.0 * 2**0.5, rel=0.01)
        assert (score.reports.reports, score.in_space.reports) == (122, reports)
    assert score.notes == ["1 of 122 reports tell no height: not in space"]
    space = scored(one_flat, dimensions=3)
    assert space.left_out == {"without a height": 1}
    assert space.reports.position_rms_m == pytest.approx(30.0, abs=0.01)


def test_a_tracker_whose_clock_is_right_and_whose_places_are_old_lags() -> None:
    """Stamped now, but as it was 0.5 s ago."""
    late: Given = []
    for number, flight in enumerate(APART.values(), 1):
        for t_s in range(1, 60):
            told = report_of(str(number), flight, t_s - 0.5)
            late.append((replace(told, t_utc_ns=START_NS + t_s * NS), START_NS + t_s * NS))
    reports = scored(late).reports
    assert reports.lag_s == pytest.approx(0.5, abs=0.01)
    assert reports.along_rms_m > 5.0
    assert reports.across_rms_m < 0.1


def test_lateness_is_punished_as_known_and_not_as_stamped() -> None:
    still = changed(followed_well(late_s=2.0), lambda _: {"velocity_enu_m_s": (0.0, 0.0, 0.0)})
    score = scored(still)
    assert score.as_known is not None
    assert score.as_stamped.gospa_m < 0.1
    assert score.as_known.gospa_localisation_m > 20.0
    assert score.reports.latency_p50_s == pytest.approx(2.0)
    assert score.as_known.position_accuracy_m == pytest.approx(23.6, abs=2.0)


@pytest.mark.parametrize("untold", [{5}, range(122)])
def test_without_times_of_receipt_nothing_is_told_as_known(untold: Container[int]) -> None:
    """One report in a hundred without one takes nothing from the latency of the others."""
    given = [(told, None if n in untold else r) for n, (told, r) in enumerate(followed_well())]
    score = scored(given)
    assert score.as_known is None
    assert math.isnan(score.figures()["known_gospa_m"])
    assert score.figures()["completeness"] == 1.0
    latency_s = 0.2 if untold == {5} else math.nan
    for found in (score.reports.latency_p95_s, score.reports.latency_max_s):
        assert found == pytest.approx(latency_s, nan_ok=True)
    assert " of 122 reports have no time of receipt" in score.notes[0]


def test_a_hole_is_a_break_and_another_number_a_change() -> None:
    given = [
        (replace(told, name="9") if told.name == "1" and t_s >= 40 else told, received)
        for told, received in followed_well()
        if not (20 <= (t_s := (told.t_utc_ns - START_NS) / NS) < 30 and told.name == "1")
    ]
    score = scored(given, stale_s=2.0)
    one, other = score.drones
    assert (one.breaks, one.number_changes, one.tracks) == (1, 1, 2)
    assert (other.breaks, other.number_changes, other.tracks) == (0, 0, 1)
    assert score.as_stamped.breaks == 1.0
    assert one.completeness == pytest.approx(1 - 8 / 61, abs=0.02)
    assert one.longest_s == pytest.approx(21, abs=3)


def test_a_swap_within_the_cut_off_is_seen() -> None:
    """Two drones 30 m apart, one swap: it is no error of 29 m, and Stone Soup counts it too."""
    beside = {name: Flight((1000.0, y, 100.0), (10.0, 0.0, 0.0)) for name, y in
              (("a", 500.0), ("b", 530.0))}  # fmt: skip
    truths, good = truths_of(beside), followed_well(beside, sigma_m=2.4, seed=2)
    other, then_ns = {"1": "2", "2": "1"}, START_NS + 35 * NS
    swapped = changed(good, lambda t: {"name": other[t.name] if t.t_utc_ns > then_ns else t.name})
    right, score = scored(good, truths), scored(swapped, truths)
    assert (right.as_stamped.swaps, score.as_stamped.swaps) == (0.0, 2.0)
    assert right.as_stamped.t_gospa_switching_m == 0.0
    assert score.as_stamped.t_gospa_switching_m == pytest.approx((2 * 25.0**2 / 61) ** 0.5)
    assert score.reports.position_rms_m == pytest.approx(3.4, abs=0.3)
    assert score.as_stamped.id_correctness == pytest.approx(36 / 61)
    assert score.as_stamped.id_ambiguity == 0.0


def test_a_drone_that_is_never_seen_is_in_the_medians() -> None:
    flights = {**APART, "c": Flight((500.0, 0.0, 50.0), (0.0, 1.0, 0.0))}
    score = scored(followed_well(), truths_of(flights), protected_deg=(40.45, -3.73))
    assert score.never_tracked == 1
    unseen = score.drones[2]
    assert math.isnan(unseen.initiation_s)
    assert (unseen.completeness, unseen.tracks) == (0.0, 0)
    assert unseen.closest_m == pytest.approx(500.0, abs=0.5)
    assert score.initiation_median_s == pytest.approx(0.2)
    # Those seen, at 1118 and 2500 m, and the one that would have been seen at 500 m or nearer.
    assert score.alert_median_m == pytest.approx(1118.0, abs=5.0)
    alone = scored(followed_well({"a": APART["a"]}), truths_of(flights))
    assert alone.initiation_median_s == math.inf
    assert scored([], truths_of(flights)).alert_median_m == 0.0


def test_a_late_beginning_is_told_from_entry_into_cover() -> None:
    flights = {"a": Flight(from_s=0.0), "b": Flight((-2000.0, 0.0, 90.0), from_s=20.0)}
    given = [g for g in followed_well(flights) if g[0].t_utc_ns >= START_NS + 24 * NS]
    score = scored(given, truths_of(flights))
    assert [round(each.initiation_s, 1) for each in score.drones] == [24.2, 4.2]
    # Ten a second from 20.1 s on, each known 0.2 s later: not by the last before the next step.
    often = [g for g in followed_well(period_s=0.1) if g[0].t_utc_ns > START_NS + 20.05 * NS]
    assert [round(each.initiation_s, 1) for each in scored(often).drones] == [20.3, 20.3]


# A track of no drone.
GHOST: Given = [
    (report_of("66", Flight((6000.0, 6000.0, 100.0)), t), START_NS + t * NS) for t in range(61)
]


def test_tracks_of_no_drone_are_false_and_two_of_one_ambiguous() -> None:
    score = scored(followed_well() + GHOST)
    assert score.false_tracks == 1
    assert score.as_stamped.spuriousness == pytest.approx(1 / 3, abs=0.01)
    assert score.as_stamped.gospa_false_m == pytest.approx(50 / 2**0.5, abs=0.5)
    assert np.count_nonzero(score.nearest_m > 3000.0) == 61
    twins = changed(followed_well(), lambda t: {"name": f"{t.name}0"})
    of = scored(followed_well() + twins).as_stamped
    assert (of.ambiguity, of.spuriousness) == (2.0, 0.0)


def test_tentative_tracks_count_if_asked() -> None:
    tentative = changed(followed_well(), lambda _: {"tentative": True})
    score = scored(tentative)
    assert score.left_out == {"tentative": 122}
    assert score.failure == "none of the tracker's reports can be used"
    assert scored(tentative, counts_tentative=True).as_stamped.completeness == 1.0


def test_what_does_not_count_is_left_out_with_its_tracks() -> None:
    """By drone, by time, and by where: neither drones nor tracks of them count elsewhere."""
    given = followed_well() + GHOST
    one = scored(given, leave_out=["b"])
    assert one.drones[1].cover_s == 0.0
    assert one.left_out == {"not scored": 61}
    assert one.as_stamped.spuriousness == pytest.approx(1 / 2, abs=0.01)
    assert one.figures()["completeness"] == 1.0
    assert (one.never_tracked, one.figures()["drones"]) == (0, 1.0)
    assert one.alert_median_m == pytest.approx(1118.0, abs=5.0)
    early = scored(given, from_s=10.0, until_s=30.0)
    assert {each.cover_s for each in early.drones} == {21.0}
    assert early.reports.position_max_m < 1e-3
    south_east = scored(given, sector_deg=[45.0, 135.0], within_m=3000.0)
    assert [each.cover_s > 0 for each in south_east.drones] == [True, False]
    assert south_east.as_stamped.spuriousness == 0.0
    with pytest.raises(PlotfeedError, match="no drone 'z': expected of a, b"):
        scored(given, leave_out=["z"])


# Garbage, and trackers that fail: all is told, and nothing crashes.

ONE, RECEIVED = followed_well(sigma_m=3.0)[40]
LATER_NS = START_NS + 400 * NS
GARBAGE: Given = [
    (replace(ONE, latitude_deg=math.nan), RECEIVED),
    (replace(ONE, longitude_deg=math.inf), RECEIVED),
    (replace(ONE, latitude_deg=123.0), RECEIVED),
    (replace(ONE, height_m=1e7), RECEIVED),
    (replace(ONE, t_utc_ns=LATER_NS), RECEIVED),
    (replace(ONE, t_utc_ns=LATER_NS), LATER_NS),
    (replace(ONE, t_utc_ns=START_NS - 400 * NS), RECEIVED),
    (replace(ONE, t_utc_ns=1 << 70), RECEIVED),
    (replace(ONE, name="none", t_utc_ns=-(1 << 70)), RECEIVED),
]
OF_GARBAGE = {
    "not a place on Earth": 4,
    "of the future": 1,
    "after the run": 1,
    "before the run": 1,
    "without a time": 2,
}
# Each a little before the right one.
BEFORE: Given = [
    (replace(told, latitude_deg=told.latitude_deg + 2e-4), received - 1)
    for told, received in followed_well(sigma_m=3.0)
    if received is not None
]


@pytest.mark.parametrize(
    ("bad", "left_out"),
    [(GARBAGE, OF_GARBAGE), (BEFORE, {"repeated, of which the last counts": 122})],
    ids=["garbage", "repeated"],
)
def test_what_cannot_be_used_is_counted_and_harms_nothing(
    bad: Given, left_out: dict[str, int]
) -> None:
    good = followed_well(sigma_m=3.0)
    spoilt, clean = scored(bad + good), scored(good).figures()
    assert spoilt.left_out == left_out
    of_all = clean | {"left_out": float(sum(left_out.values()))}
    assert spoilt.figures() == pytest.approx(of_all, nan_ok=True)


def test_a_number_in_two_places_is_told_and_not_in_the_means() -> None:
    elsewhere = Flight((9000.0, 9000.0, 100.0))
    twice = [(report_of("1", elsewhere, t + 0.5), START_NS + t * NS + NS) for t in range(60)]
    score = scored(followed_well() + twice, step_s=0.5)
    assert score.left_out["in two places at once"] > 100
    assert score.reports.position_max_m < 1e-3
    assert score.as_stamped.gospa_m > 10.0
    # Nor is a leap within the cut-off: 40 m aside 0.2 s later, which is 200 m/s.
    beside = [(report_of("1", APART["a"], t + 0.2, (0.0, 40.0, 0.0)), START_NS + (t + 1) * NS)
              for t in range(60)]  # fmt: skip
    score = scored(followed_well() + beside)
    assert score.left_out["in two places at once"] == 60
    assert score.reports.position_max_m < 1e-3


def test_reports_out_of_order_are_sorted_and_counted() -> None:
    good = followed_well()
    late = [(told, (received or 0) + 3 * NS if n % 10 == 0 else received)
            for n, (told, received) in enumerate(good)]  # fmt: skip
    score = scored(late)
    assert 0 < score.left_out["out of order"] <= 13
    assert score.as_stamped == scored(good).as_stamped


def test_a_number_that_was_ended_is_another_track_when_it_comes_again() -> None:
    ended = changed(followed_well(), lambda t: {"ended": t.t_utc_ns == START_NS + 30 * NS})
    score = scored(ended)
    assert score.tracks == 4
    assert score.as_stamped.number_changes_per_h > 0


def later(by_s: float) -> Change:
    return lambda told: {"t_utc_ns": (told.t_utc_ns or 0) + round(by_s * NS)}


@pytest.mark.parametrize(
    ("given", "failure"),
    [
        ([], "the tracker reported no tracks"),
        (
            [g for g in followed_well() if g[0].t_utc_ns < START_NS + 20 * NS],
            "the tracker's last report is 41.0 s before the end",
        ),
        (changed(followed_well(), later(3600.0)), "none of the tracker's reports can be used"),
    ],
)
def test_a_tracker_that_dies_has_failed(given: Given, failure: str) -> None:
    score = scored(given)
    assert score.failure == failure
    assert score.as_stamped.completeness < 0.5
    assert score.figures().keys() == set(FIGURE_NAMES)


NUMBERS = st.floats() | st.floats(-180, 180)
ANYTHING = st.builds(
    ToldTrack,
    name=st.sampled_from("12"),
    t_utc_ns=st.integers(-(1 << 70), 1 << 70) | st.integers(START_NS, START_NS + 60 * NS),
    latitude_deg=NUMBERS,
    longitude_deg=NUMBERS,
    height_m=NUMBERS,
    velocity_enu_m_s=st.tuples(*[NUMBERS] * 3),
    covariance_m2=st.tuples(*[NUMBERS] * 6),
    ended=st.booleans(),
)
TIMES = st.none() | st.integers(-(1 << 62), 1 << 62)


@settings(max_examples=25, deadline=None)
@drawn(st.lists(st.tuples(ANYTHING, TIMES), max_size=5))
def test_whatever_reports_say_there_is_a_score(given: Given) -> None:
    with np.errstate(all="ignore"):
        score = scored(given)
    assert score.figures().keys() == set(FIGURE_NAMES)


def shifted(given: Given, by_ns: int) -> tuple[Given, Truths]:
    """All times, of tracks and flights, later by that."""
    paths = [replace(path, t_utc_ns=path.t_utc_ns + by_ns) for path in TRUTHS.paths]
    looks = {key: at + by_ns for key, at in TRUTHS.looks_utc_ns.items()}
    moved = [(told, (r or 0) + by_ns) for told, r in changed(given, later(by_ns / NS))]
    return moved, replace(TRUTHS, paths=paths, looks_utc_ns=looks)


def test_order_names_and_a_shift_of_all_times_do_not_matter() -> None:
    given = followed_well(sigma_m=8.0)
    shuffled = random.Random(1).sample(given, len(given))  # noqa: S311
    renamed = changed(given, lambda t: {"name": f"T-{90 - int(t.name)}"})
    others = truths_of({"z": APART["a"], "y": APART["b"]})
    for same in (
        (shuffled, TRUTHS),
        (renamed, others),
        shifted(given, 86_400 * NS * 37),
        shifted(given, -17 * NS),
    ):
        assert scored(*same).figures() == pytest.approx(scored(given).figures(), nan_ok=True)


# The truth.


def test_what_of_the_truth_cannot_be_used_is_told() -> None:
    with pytest.raises(PlotfeedError, match="no flight to score against"):
        Score(FlightsTally({"radar": SITE}).truths(), read_of(followed_well()))
    untold = "122 looks of radar have no place: where it stands is not told"
    assert tally_of(APART, {}).truths().notes == (untold,)
    path = truths_of({"a": Flight()}).paths[0]
    far = replace(path, t_utc_ns=path.t_utc_ns + np.array([*[0] * 60, 10**17]))
    with pytest.raises(PlotfeedError, match="too many"):
        Score(replace(TRUTHS, paths=[far], drones=["a"]), read_of([]))


def test_reports_that_are_held_back_are_missed_until_they_come() -> None:
    first_ns, last_ns = START_NS + 20 * NS, START_NS + 40 * NS
    held = [
        (told, last_ns + NS // 5 if first_ns < (told.t_utc_ns or 0) < last_ns else received)
        for told, received in followed_well()
    ]
    on_time, late = scored(followed_well()), scored(held)
    assert (update_share(on_time, 1.0).value, long_gap_share(on_time, 5.0).value) == (1.0, 0.0)
    assert update_share(late, 1.0).value == pytest.approx(41 / 60)
    assert long_gap_share(late, 5.0).value == pytest.approx(20 / 60)


# What is wrong with all reports alike.

FLIGHTS = {
    "a": Flight((-800.0, 600.0, 100.0), (10.0, -5.0, 0.0)),
    "b": Flight((1500.0, -900.0, 120.0), (-3.0, 12.0, 0.5)),
}
ABOUT = truths_of(FLIGHTS)
GOOD = followed_well(FLIGHTS, sigma_m=3.0, seed=4, late_s=None)


def higher(by_m: float) -> Change:
    return lambda told: {"height_m": told.height_m + by_m}


def turned(by_deg: float) -> Change:
    """Azimuths from the site too large by that."""
    c, s = math.cos(math.radians(by_deg)), math.sin(math.radians(by_deg))
    names = ("latitude_deg", "longitude_deg", "height_m")

    def change(told: ToldTrack) -> dict[str, Any]:
        there = LocalFrame(told.latitude_deg, told.longitude_deg, told.height_m).origin_ecef_m
        east, north, up = SITE.from_ecef(there)
        place = SITE.to_geodetic([c * east + s * north, c * north - s * east, up])
        return dict(zip(names, map(float, place), strict=True))

    return change


def exchanged(told: ToldTrack) -> dict[str, Any]:
    return {"latitude_deg": told.longitude_deg, "longitude_deg": told.latitude_deg}


def in_radians(told: ToldTrack) -> dict[str, Any]:
    return {name: math.radians(getattr(told, name)) for name in ("latitude_deg", "longitude_deg")}


@pytest.mark.parametrize(
    ("faults", "named"),
    [
        ([higher(-51.9)], ["heights are above mean sea level (52.1 m)"]),
        ([lambda t: {"height_m": t.height_m / 0.3048}], ["heights are in feet"]),
        ([exchanged], ["latitude and longitude are exchanged"]),
        (
            [lambda t: {"velocity_enu_m_s": tuple(-v for v in t.velocity_enu_m_s)}],
            ["velocities have the opposite sign"],
        ),
        ([in_radians], ["places are in radians"]),
        (
            [lambda t: {"t_utc_ns": t.t_utc_ns % (86_400 * NS)}],
            ["times are seconds of the day, without a date"],
        ),
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
def test_what_was_planted_is_named_and_undone(faults: list[Change], named: list[str]) -> None:
    found = diagnosed(ABOUT, read_of(changed(GOOD, *faults)), ScoreSettings())
    assert found is not None
    assert len(found.findings) == len(named)
    for text, begins in zip(found.findings, named, strict=True):
        assert text.startswith(begins), found.findings
    clean = scored(GOOD, ABOUT)
    assert found.without.as_stamped.gospa_m < 1.1 * clean.as_stamped.gospa_m
    assert found.without.in_space.position_rms_m < 1.1 * clean.in_space.position_rms_m


def test_an_error_of_azimuth_is_no_lag_and_few_reports_are_not_diagnosed() -> None:
    assert abs(scored(changed(GOOD, turned(1.0)), ABOUT).reports.lag_s) < 0.1
    assert diagnosed(ABOUT, read_of(changed(GOOD[:15], turned(1.0))), ScoreSettings()) is None


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
        errors = rng.standard_normal((n, 2, 2))
        errors[0] /= own
        errors = 3 * lfilter([own], [1.0, -0.9], errors, axis=0)
        false += bool(joint_fit(errors.transpose(1, 0, 2).reshape(-1, 2), effects, series))
    assert false <= stats.binom.ppf(1 - 1e-4, 200, 0.01)
    twice = effects | {"twin": effects["east"]}
    (found,) = joint_fit(30 * effects["east"] + rng.standard_normal((2 * n, 2)), twice, series)
    assert (found.name, found.others) == ("east", ("twin",))
    assert found.value == pytest.approx(30.0, abs=0.5)
