"""Echoes by themselves: beams and cells, range rates, pulses and merging, beside exact values."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from support.given_files import values_of

from plotfeed.models.effects.doppler import Doppler, range_rate_m_s
from plotfeed.models.effects.echo_effects import (
    CELL_SHAPES,
    CosecantSquaredCut,
    GaussianCut,
    TableCut,
    cell_factor,
    cosecant_peak_loss_db,
)
from plotfeed.models.effects.merging import NEIGHBOURS, REACH, Merging
from plotfeed.models.effects.pulse_intervals import (
    CANCELLERS,
    PassingBeam,
    PulseIntervals,
    at_least,
    chosen,
    filter_factor,
    first_successes,
    folded_range_m,
)
from plotfeed.models.propagation import C_M_S, bistatic_range
from plotfeed.models.state import Floats, Looks

# Gains by direction, and what is lost between cells, beside values of sixty digits.


def test_between_beams_side_by_side_the_loss_averages_what_their_spacing_leaves() -> None:
    for args, mean_db in values_of("beams_mean_loss_twoway_db"):
        spacing_deg = 2 * float(args["spacing_beamwidths"])
        beams = 9
        cut = GaussianCut(
            beamwidth_deg=2.0, boresight_deg=40.0, spacing_deg=spacing_deg, beams=beams
        )
        angle_deg = 40 + spacing_deg * beams * (np.linspace(0, 1, 90_001)[1:] - 0.5)
        gain = 10 ** (-2 * cut.loss_db(angle_deg) / 10)
        assert -10 * np.log10(gain.mean()) == pytest.approx(mean_db, abs=1e-3)


@given(st.floats(-720, 720), st.integers(2, 90))
def test_beams_that_close_the_circle_have_no_seam(azimuth_deg: float, beams: int) -> None:
    width_deg = 360.0 / beams
    cut = GaussianCut(
        beamwidth_deg=width_deg, boresight_deg=0.0, spacing_deg=width_deg, beams=beams
    )
    here, next_to_it = cut.loss_db(np.array([azimuth_deg, azimuth_deg + width_deg]))
    assert here <= 3.0103 * (1 + 1e-9)
    assert next_to_it == pytest.approx(here, abs=1e-9)


def test_a_cosecant_squared_beam_has_an_edge_where_the_sine_is_lost() -> None:
    """On the horizon and below it: a Gaussian edge, of which 4 of 3 degrees leave 2^(-64/9)."""
    cut = CosecantSquaredCut(from_deg=4.0, to_deg=30.0, beamwidth_deg=3.0)
    loss_db = cut.loss_db(np.array([0.0, -1e-300, -4.0]))
    expected = 10 * np.log10(2) * 4 * np.array([4 / 3, 4 / 3, 8 / 3]) ** 2
    np.testing.assert_allclose(loss_db, expected, rtol=1e-13)


def test_what_a_cosecant_squared_beam_has_less_at_its_peak() -> None:
    for args, loss_db in values_of("cosecant_peak_loss_db"):
        found = cosecant_peak_loss_db(float(args["from_deg"]), float(args["to_deg"]))
        assert found == pytest.approx(loss_db, rel=1e-13)


def test_a_table_is_linear_in_decibels_and_holds_at_its_ends() -> None:
    cut = TableCut(angles_deg=(-10.0, 0.0, 20.0), gains_db=(-20.0, 0.0, -6.0), boresight_deg=350.0)
    found = cut.loss_db(np.array([335.0, 345.0, 350.0, 0.0, 10.0, 90.0]))
    np.testing.assert_allclose(found, [20.0, 10.0, 0.0, 3.0, 6.0, 6.0], atol=1e-12)


@pytest.mark.parametrize("shape", CELL_SHAPES)
def test_cells_lose_on_average_and_at_worst_what_their_shape_says(shape: str) -> None:
    cells = np.linspace(-3, 3, 600_001)
    factor = cell_factor(cells, shape)
    ((_, mean_db),) = values_of(f"straddle_{shape}_mean_power_db")[:1]
    ((_, worst_db),) = values_of(f"straddle_{shape}_worst_db")[:1]
    assert -10 * np.log10(factor[:-1].mean()) == pytest.approx(mean_db, abs=1e-4)
    assert -10 * np.log10(factor.min()) == pytest.approx(worst_db, rel=1e-4)
    assert cell_factor(np.array([4.0]), shape) == 1.0


# Doppler by itself: rates of ranges, what looks alike, and what passes the notch.


CHANNEL = np.zeros(1, np.int64)
metres = st.floats(-20e3, 20e3)
speeds = st.floats(-60.0, 60.0)
triples = st.tuples(metres, metres, metres)
velocities = st.tuples(speeds, speeds, speeds)


def doppler(**changes) -> Doppler:
    keys = {"cells_m_s": (0.25,), "spans_m_s": (40.0,), "floors_m_s": (0.0,), "folds": True}
    return Doppler(**(keys | {"notch_m_s": 1.0} | changes))


@given(triples, velocities, triples)
def test_the_rate_of_a_bistatic_range_is_its_derivative(place, velocity, transmitter):
    place, velocity, transmitter = map(np.array, (place, velocity, transmitter))
    near = min(np.linalg.norm(place), np.linalg.norm(place - transmitter))
    if near < 100.0 or np.linalg.norm(transmitter) < 100.0:
        return
    step_s = 1e-3
    ahead, behind = (bistatic_range(place + s * velocity, transmitter) for s in (step_s, -step_s))
    rate = range_rate_m_s(place, velocity) + range_rate_m_s(place, velocity, transmitter)
    assert rate == pytest.approx((ahead - behind) / (2 * step_s), abs=1e-4)


@given(st.floats(-1e4, 1e4))
def test_a_folded_rate_is_the_nearest_to_zero_of_those_that_look_alike(rate):
    seen = doppler().folded(np.array([rate]), CHANNEL)[0]
    assert abs(seen) <= 20.0 * (1 + 1e-12)
    turns = (rate - seen) / 40.0
    assert turns == pytest.approx(round(turns), abs=1e-9)
    if abs(rate) <= 20.0:
        assert seen == rate


@given(st.floats(-1e4, 1e4), st.floats(0.01, 30.0), st.booleans())
def test_a_share_is_a_share_and_standing_still_has_none(rate, notch, folds):
    case = doppler(notch_m_s=notch, folds=folds)
    share = case.share_passed(np.array([rate]), CHANNEL)[0]
    assert 0 <= share <= 1
    assert case.share_passed(np.zeros(1), CHANNEL)[0] == 0
    assert share == case.share_passed(np.array([-rate]), CHANNEL)[0]


def test_a_rate_a_millionth_of_the_notch_passes_a_trillionth():
    """The plain form, one less an exponential near one, keeps four digits of it."""
    share = doppler().share_passed(np.array([1e-6]), CHANNEL)[0]
    assert share == pytest.approx(1e-12, rel=1e-11)
    assert abs((1 - np.exp(-1e-12)) / 1e-12 - 1) > 1e-5


# Folds, eclipses, blind speeds and M of N, beside closed forms and plain draws.


WAVELENGTH_M = 0.03


def intervals(**more: object) -> PulseIntervals:
    keys = {"prfs_hz": (5000.0,), "needed": 1, "interval_s": 1e-3, "pulse_s": 0.0}
    return PulseIntervals(**(keys | {"wavelength_m": WAVELENGTH_M} | more))  # type: ignore[arg-type]


@given(st.floats(0, 1e6), st.floats(10, 1e6))
def test_ranges_fold_below_what_is_unambiguous_by_whole_folds(
    range_m: float, prf_hz: float
) -> None:
    folds_at_m = C_M_S / (2 * prf_hz)
    told_m = float(folded_range_m(range_m, prf_hz))
    assert 0 <= told_m <= folds_at_m
    folds = (range_m - told_m) / folds_at_m
    assert folds == pytest.approx(round(folds), abs=1e-6 * max(folds, 1))


@pytest.mark.parametrize("canceller", CANCELLERS)
def test_cancellers_leave_the_power_of_noise(canceller: str) -> None:
    rate_m_s = WAVELENGTH_M * 5000.0 / 2 * (np.arange(10_000) + 0.5) / 10_000
    gain = filter_factor(rate_m_s, 5000.0, WAVELENGTH_M, canceller)
    assert gain.mean() == pytest.approx(1.0, rel=1e-12)


def test_close_to_a_blind_speed_no_digit_of_the_gain_is_lost() -> None:
    for args, value in values_of("canceller_gain"):
        prf_hz, off = float(args["prf_hz"]), float(args["off_m_s"])
        blind_m_s = WAVELENGTH_M * prf_hz / 2
        found = filter_factor(off, prf_hz, WAVELENGTH_M, args["kind"])
        assert found == pytest.approx(value, rel=1e-12)
        far = filter_factor(1024 * blind_m_s + off, prf_hz, WAVELENGTH_M, args["kind"])
        assert far == pytest.approx(value, rel=1e-4)


def test_staggered_frequencies_leave_no_speed_of_drones_blind() -> None:
    """Blind at 17, 19 and 23 m/s with notches of 2: nowhere all at once from 2 to 40 m/s."""
    blind_m_s = np.array([17.0, 19.0, 23.0])
    stagger = intervals(prfs_hz=tuple(2 * blind_m_s / WAVELENGTH_M), notch_m_s=2.0)
    rate_m_s = np.linspace(2.0, 40.0, 4000)
    far = np.full(len(rate_m_s), 100.0)
    factor = stagger.power_factor(far, rate_m_s, None)
    assert (factor.max(axis=1) >= 1 - np.exp(-1) - 1e-12).all()
    assert (factor.min(axis=0) < 1e-3).all()
    assert stagger.folds_at_m is None
    assert intervals().folds_at_m == pytest.approx(29_979.2458)


def test_so_many_of_equal_trials_are_binomial_and_of_others_and_the_first_as_counted() -> None:
    p = np.linspace(1e-9, 1 - 1e-9, 50)
    for n, needed in ((1, 1), (3, 2), (8, 3), (8, 8)):
        found = at_least(np.repeat(p[:, None], n, axis=1), needed)
        np.testing.assert_allclose(found, stats.binom.sf(needed - 1, n, p), rtol=1e-12)
        made = intervals(prfs_hz=(5000.0,) * n, needed=needed)
        expected = stats.binom.sf(needed - 1, n, 1e-6)
        assert made.false_alarm_probability(1e-6) == pytest.approx(expected, rel=1e-12)
    chances = np.array([0.9, 0.2, 0.5, 0.05])
    hits = np.array(list(product([False, True], repeat=4)))
    odds = np.where(hits, chances, 1 - chances).prod(axis=1)
    for needed in (1, 2, 3, 4):
        enough = hits.sum(axis=1) >= needed
        assert at_least(chances[None], needed) == pytest.approx(odds[enough].sum(), rel=1e-12)
        first, of_first = first_successes(chances[None], needed)[0], hits[enough].argmax(axis=1)
        expected = np.bincount(of_first, odds[enough], minlength=4) / odds[enough].sum()
        assert first == pytest.approx(expected, abs=1e-12)
    drawn = np.array([0.0, 0.299, 0.301, 0.999])
    assert chosen(np.tile([[0.3, 0.0, 0.7]], (4, 1)), drawn).tolist() == [0, 0, 2, 2]


def test_intervals_lie_about_the_time_at_which_the_beam_meets_a_target() -> None:
    """Wherever in one that time is, they are that far apart, and one of them holds it."""
    beam = PassingBeam(beamwidth_deg=2.0, step_deg=0.5)
    made = intervals(prfs_hz=(5000.0,) * 4, beam=beam)
    for into_ns in (0, 250_000, 999_999):
        off = made._offsets_deg(beam, np.array([into_ns]))[0]
        np.testing.assert_allclose(np.diff(off), 0.5)
        assert np.abs(off).min() <= 0.25 + 1e-12


# Merging by itself: who merges with whom, and where and how strong the echo of all is.


MERGING = Merging(range_m=(10.0,), azimuth_deg=2.0, elevation_deg=6.0)


def merged(range_m, azimuth_deg, *more, powers=None, uniforms=None, merging=MERGING, **columns):
    """Groups of looks at those places; with an elevation each if there are."""
    n = len(range_m)
    usual = {
        "range_m": range_m, "azimuth_deg": azimuth_deg,
        "elevation_deg": more[0] if more else np.zeros(n),
        "snr": np.ones(n) if powers is None else powers,
        "t_utc_ns": np.zeros(n, np.int64), "channel": np.zeros(n, np.int64),
    }  # fmt: skip
    rate_m_s = columns.pop("range_rate_m_s", None)
    looks = Looks.holding({name: np.asarray(each) for name, each in (usual | columns).items()})
    uniforms = np.zeros(n) if uniforms is None else uniforms
    return merging.merged_groups(looks, uniforms, rate_m_s)


def plain_groups(places: Floats, uniforms: Floats) -> list[int]:
    """By all pairs, one after the other."""
    n = len(places)
    group = list(range(n))
    for i in range(n):
        for j in range(i + 1, n):
            gap = places[i] - places[j]
            gap[1] = (gap[1] + 180.0) % 360.0 - 180.0
            distance2 = float(((gap / [10.0, 2.0, 6.0]) ** 2).sum())
            if distance2 < REACH**2 and (uniforms[i] + uniforms[j]) % 1 < 2.0**-distance2:
                a, b = sorted((group[i], group[j]))
                group = [a if g == b else g for g in group]
    order = {g: k for k, g in enumerate(dict.fromkeys(group))}
    return [order[g] for g in group]


coordinates = st.tuples(st.floats(0, 60), st.floats(-8, 8), st.floats(0, 20), st.floats(0, 1))


@settings(max_examples=100)
@given(st.lists(coordinates, min_size=1, max_size=NEIGHBOURS + 1))
def test_groups_are_those_that_all_pairs_link(rows):
    values = np.array(rows)
    places = values[:, :3].copy()
    places[:, 1] = np.mod(places[:, 1], 360.0)
    uniforms = np.minimum(values[:, 3], 0.999)
    found = merged(*places.T, uniforms=uniforms)
    partition = plain_groups(places, uniforms)
    seen = list(range(len(rows))) if found is None else found.group.tolist()
    pairs = {(a, b) for a, b in zip(seen, partition, strict=True)}
    assert len(pairs) == len(set(seen)) == len(set(partition))


def test_a_hundred_thousand_in_one_place_make_one_echo_and_little_work():
    found = merged(np.zeros(100_000), np.zeros(100_000))
    assert found.group.tolist() == [0] * 100_000


def test_many_looks_merge_as_few_do():
    """A thousand pairs among as many that stand alone, each pair twice: in one place and beside."""
    at = 1000.0 * np.arange(3000)
    range_m = np.concatenate([at, at[:1000], at[1000:2000] + 1.0])
    found = merged(range_m, np.zeros(5000))
    assert found.group.max() == 2999
    assert (found.group[3000:] == found.group[:2000]).all()


def test_the_echo_lies_at_the_centroid_of_powers_over_north():
    found = merged([100.0, 104.0], [359.5, 0.5], [1.0, 2.0], powers=[3.0, 1.0])
    powers = np.array([3.0, 1.0])
    assert found.leader.tolist() == [0]
    assert found.centroid(np.array([100.0, 104.0]), powers) == pytest.approx([101.0])
    azimuth_deg = found.centroid_deg(np.array([359.5, 0.5]), powers)
    assert np.mod(azimuth_deg, 360.0) == pytest.approx([359.75])
    assert found.total(np.array([[3.0, 1.0], [1.0, 5.0]])).tolist() == [[4.0, 6.0]]
    assert found.others(np.array([7, 9])).tolist() == [(9,)]


def test_who_stands_alone_stays_as_it_is_and_echoes_without_power_have_a_place():
    at_m, powers = np.array([0.0, 500.0, 1.0]), np.array([1.0, 5.0, 2.0])
    found = merged(at_m, np.zeros(3), powers=powers)
    assert found.leader.tolist() == [1, 2]
    assert found.group.tolist() == [1, 0, 1]
    assert found.others(np.array([4, 5, 6])).tolist() == [(), (4,)]
    assert found.centroid(at_m, powers) == pytest.approx([500.0, 2 / 3])
    assert np.isfinite(found.centroid(at_m, np.zeros(3))).all()


def test_channels_scans_and_range_rates_keep_apart():
    several = replace(MERGING, range_m=(10.0, 10.0))
    later, rates = {"t_utc_ns": [0, 900_000_000]}, {"range_rate_m_s": np.array([0.0, 9.9])}
    by_rate = replace(MERGING, range_rate_m_s=(0.25,))
    for columns, merging, merge in (
        ({}, MERGING, True),
        ({"channel": [0, 1]}, several, False),
        (later, replace(MERGING, longest_ns=10**9), True),
        (later, replace(MERGING, longest_ns=10**8), False),
        (rates, by_rate, False),
        (rates, replace(by_rate, range_rate_period=10.0 / 0.25), True),
    ):
        found = merged([0.0, 0.0], [0.0, 0.0], merging=merging, **columns)
        assert (found is not None) == merge
