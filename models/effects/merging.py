"""Echoes that are too close to be told apart: which merge into one, and what that one is.

Two targets are not resolved with probability exp(-ln 2 sum (d_i/width_i)^2) over range, azimuth,
elevation and range rate: one half at a distance of one width (Koch and van Keuk 1997). Of more than
two, those merge that are linked by such pairs. The echo of all has the sum of their mean
powers, and lies at the centroid that these weigh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plotfeed.models.frames import wrap_180, wrap_360
from plotfeed.models.numerics import joined_by_pairs
from plotfeed.models.state import Floats, Ints, Looks, Texts

# Widths, beyond which two targets are unresolved with a probability below 2^-36, 1.5e-11.
REACH = 6.0
# How many nearest ones a target is compared with. More are in a thicket, all merged.
NEIGHBOURS = 8
FEW = 1000  # Looks that may all be in one place without costing much
ELSEWHERE = 1e6  # Widths between the channels of a sensor, which never merge


@dataclass(frozen=True, slots=True)
class MergedGroups:
    """Groups of looks: `group` of each look (n,), `leader` the strongest look of each (m,)."""

    group: Ints
    leader: Ints

    def echoes(
        self, looks: Looks, columns: dict[str, NDArray[Any]]
    ) -> tuple[Looks, dict[str, NDArray[Any]]]:
        """Echoes in the place of looks, and of what is told of these: at centroids, of leaders."""
        powers = looks.snr
        echoes = looks.rows(self.leader).but(
            range_m=self.centroid(looks.range_m, powers),
            azimuth_deg=wrap_360(self.centroid_deg(looks.azimuth_deg, powers)),
            elevation_deg=self.centroid(looks.elevation_deg, powers),
        )
        of_leaders = {name: column[self.leader] for name, column in columns.items()}
        if "range_rate_m_s" in columns:
            of_leaders["range_rate_m_s"] = self.centroid(columns["range_rate_m_s"], powers)
        return echoes, of_leaders | {"merged_drones": self.others(looks.drone)}

    def total(self, powers: Floats) -> Floats:
        """Sums by group; (n, ...) in, (m, ...) out."""
        sums = np.zeros((len(self.leader), *powers.shape[1:]))
        np.add.at(sums, self.group, powers)
        return sums

    def centroid(self, values: Floats, powers: Floats) -> Floats:
        """Means weighed by power; (n,) in, (m,) out."""
        of_leader = values[self.leader]
        return of_leader + self._mean_excess(values - of_leader[self.group], powers)

    def centroid_deg(self, azimuth_deg: Floats, powers: Floats) -> Floats:
        """Means of angles weighed by power, also over north, not folded; (n,) in, (m,) out."""
        of_leader = azimuth_deg[self.leader]
        return of_leader + self._mean_excess(wrap_180(azimuth_deg - of_leader[self.group]), powers)

    def _mean_excess(self, excess: Floats, powers: Floats) -> Floats:
        m = len(self.leader)
        whole = np.bincount(self.group, powers, m)
        with np.errstate(invalid="ignore"):
            mean = np.bincount(self.group, powers * excess, m) / whole
        return np.where(whole > 0, mean, 0.0)

    def others(self, drone: Ints) -> Texts:
        """The drones of each group beside its leader's, in tuples; (n,) in, (m,) out."""
        found = np.empty(len(self.leader), np.object_)
        members: list[list[int]] = [[] for _ in self.leader]
        for group, look in zip(self.group.tolist(), range(len(drone)), strict=True):
            if look != self.leader[group]:
                members[group].append(int(drone[look]))
        found[:] = [tuple(others) for others in members]
        return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Merging:
    """Widths of resolution, in range and range rate by channel; None for what is not resolved in.

    Range rates are alike by multiples of `range_rate_period` widths, unless it is 0. Looks further
    apart than `longest_ns` are of different scans.
    """

    range_m: tuple[float, ...]
    azimuth_deg: float
    elevation_deg: float | None = None
    range_rate_m_s: tuple[float, ...] | None = None
    range_rate_period: float = 0.0
    longest_ns: int = 1 << 62

    def merged_groups(
        self, looks: Looks, uniforms: Floats, range_rate_m_s: Floats | None = None
    ) -> MergedGroups | None:
        """What merges of looks, (n,), and their rates; None if nothing does, as nearly always.

        `uniforms`, one a look, decide: a pair takes the fraction of the sum of its two, which is
        uniform again, and independent from pair to pair of any three looks.
        """
        if len(looks) < 2:
            return None
        channel, t_utc_ns = looks.channel, looks.t_utc_ns
        axes: list[tuple[Floats, float]] = [
            (looks.range_m / np.array(self.range_m)[channel], 0.0),
            (looks.azimuth_deg / self.azimuth_deg, 360.0 / self.azimuth_deg),
            (channel.astype(np.float64) * ELSEWHERE, 0.0),
        ]
        if self.elevation_deg is not None:
            axes.append((looks.elevation_deg / self.elevation_deg, 0.0))
        if self.range_rate_m_s is not None and range_rate_m_s is not None:
            rates = range_rate_m_s / np.array(self.range_rate_m_s)[channel]
            axes.append((rates, self.range_rate_period))
        first, second, distance = near_pairs(axes)
        unresolved = np.mod(uniforms[first] + uniforms[second], 1.0) < np.exp2(-(distance**2))
        unresolved &= np.abs(t_utc_ns[first] - t_utc_ns[second]) <= self.longest_ns
        if not unresolved.any():
            return None
        return _groups(first[unresolved], second[unresolved], looks.snr)


def near_pairs(axes: Sequence[tuple[Floats, float]]) -> tuple[Ints, Ints, Floats]:
    """Pairs of looks that are near each other, once each, and their distances.

    Each axis is places along it, (n,), in widths, and the period after which it is the same again.
    """
    n = len(axes[0][0])
    places = np.empty((n, len(axes)))
    for column, (place, period) in zip(places.T, axes, strict=True):
        column[:] = np.mod(place, period) if period else place
        if period:
            column[column == period] = 0.0  # the remainder of -1e-17 rounds to it
    periods = [period for _, period in axes]
    if n <= FEW:
        return _pairs_of(places, periods)
    # A tree cannot split what is in one place: of many, one look there stands for all.
    places, at, of_all = np.unique(places, axis=0, return_index=True, return_inverse=True)
    first, second, distance = _pairs_of(places, periods)
    same = np.flatnonzero(at[of_all] != np.arange(n))
    return (
        np.concatenate([at[first], at[of_all[same]]]),
        np.concatenate([at[second], same]),
        np.concatenate([distance, np.zeros(len(same))]),
    )


def _pairs_of(places: Floats, periods: list[float]) -> tuple[Ints, Ints, Floats]:
    from scipy.spatial import KDTree  # as long to load as NumPy

    n = len(places)
    tree = KDTree(places, boxsize=periods)
    distance, other = tree.query(places, min(n, NEIGHBOURS) + 1, distance_upper_bound=REACH)
    one = np.broadcast_to(np.arange(n)[:, None], other.shape)
    near = (other < n) & (other != one)
    pairs = np.sort(np.column_stack([one[near], other[near]]), axis=1)
    pairs, at = np.unique(pairs, axis=0, return_index=True)
    return pairs[:, 0], pairs[:, 1], distance[near][at]


def _groups(first: Ints, second: Ints, powers: Floats) -> MergedGroups:
    """Groups of all looks, of which these pairs are linked, in the order of their leaders."""
    m, label = joined_by_pairs(first, second, len(powers))
    by_power: NDArray[Any] = np.lexsort((-powers, label))
    leader = by_power[np.searchsorted(label[by_power], np.arange(m))]
    order = np.argsort(leader)
    number = np.empty(m, np.int64)
    number[order] = np.arange(m)
    return MergedGroups(number[label], leader[order])
