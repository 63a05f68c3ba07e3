"""Merging by itself: who merges with whom, and where and how strong the echo of all is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plotfeed.models.effects.merging import NEIGHBOURS, REACH, Merging
from plotfeed.models.state import Floats, Looks

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
