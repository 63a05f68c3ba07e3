"""Detection where a radar models more than usual: range rates, and echoes that merge into one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from plotfeed.models import detection
from plotfeed.models.chance import of_rows
from plotfeed.models.effects.doppler import Doppler
from plotfeed.models.frames import wrap_360
from plotfeed.models.state import Columns, Floats, Ints, Looks, Texts, rows_where

if TYPE_CHECKING:
    from plotfeed.models.effects.merging import MergedGroups, Merging


@dataclass(frozen=True, kw_only=True)
class LookDetails(Columns):
    """What is known beside looks: true places, how fast echoes recede, and with whom they merge."""

    true_azimuth_deg: Floats
    true_elevation_deg: Floats
    true_range_m: Floats
    range_rate_m_s: Floats | None = None
    true_range_rate_m_s: Floats | None = None
    merged_drones: Texts | None = None

    def columns(self) -> dict[str, NDArray[Any]]:
        """Columns that are there, by the names that they have in plots."""
        return {name: column for name, column in vars(self).items() if column is not None}


@dataclass(frozen=True, slots=True)
class Hits:
    """Echoes that were detected: of each a look's columns, its powers, and columns of its plot.

    `rows` are those of the echoes among all that might have been.
    """

    echoes: Looks
    powers: Floats
    columns: dict[str, NDArray[Any]]
    rng: np.random.Generator
    rows: Ints | slice
    order: Floats | None = None
    """By which each target fluctuates, if any states it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DetailedDetector:
    """What of a radar's detector only few model.

    `odds` gives the mean ratio and Pd of echoes of those powers, (n, ...), by their channels and
    the orders of targets, of which a degraded sensor has `pd_factor`, (n,) of several sensors.
    """

    doppler: Doppler | None
    merging: Merging | None
    odds: Callable[[Floats, Ints, Floats | None], tuple[Floats, Floats]]
    pd_factor: float | Floats = 1.0

    def detect(  # noqa: PLR0917
        self,
        looks: Looks,
        echoes: Looks,
        powers: Floats,
        details: LookDetails,
        rng: np.random.Generator,
        order: Floats | None = None,
    ) -> tuple[Looks, Hits]:
        """Looks with their odds and what came of them, and the echoes that were detected.

        `echoes` are the looks with the ranges that are measured. Looks whose echoes merge share
        odds and outcome.
        """
        of_looks: Ints | slice = slice(None)
        if self.merging is not None:
            groups = self._merged_groups(self.merging, echoes, details, rng)
            if groups is not None:
                echoes, details = merged_echoes(groups, echoes, details)
                powers, of_looks = groups.total(powers), groups.group
                rng = of_rows(rng, groups.leader)
                order = None if order is None else order[groups.leader]
        snr, pd = self.odds(powers, echoes.channel, order)
        pd = pd * self.pd_factor
        if self.doppler is not None and details.range_rate_m_s is not None:
            pd = pd * self.doppler.share_passed(details.range_rate_m_s, echoes.channel)
        detected = detection.draw_hits(pd, rng)
        hits = rows_where(detected)
        return (
            looks.but(pd=pd[of_looks], detected=detected[of_looks]),
            Hits(
                echoes.but(snr=snr, pd=pd, detected=detected).rows(detected),
                powers[hits],
                details.rows(detected).columns(),
                of_rows(rng, hits),
                hits,
                None if order is None else order[hits],
            ),
        )

    def _merged_groups(
        self, merging: Merging, looks: Looks, details: LookDetails, rng: np.random.Generator
    ) -> MergedGroups | None:
        rate_m_s = details.range_rate_m_s
        if self.doppler is not None and rate_m_s is not None:
            rate_m_s = self.doppler.folded(rate_m_s, looks.channel)
        return merging.merged_groups(
            range_m=looks.range_m,
            azimuth_deg=looks.azimuth_deg,
            elevation_deg=looks.elevation_deg,
            range_rate_m_s=rate_m_s,
            t_utc_ns=looks.t_utc_ns,
            powers=looks.snr,
            uniforms=rng.random((len(looks),)),
            channel=looks.channel,
        )


def merged_echoes(
    groups: MergedGroups, looks: Looks, details: LookDetails
) -> tuple[Looks, LookDetails]:
    """The echoes of each group in the place of its looks: at their centroid, the leader's truth."""
    powers = looks.snr
    echoes = looks.rows(groups.leader).but(
        range_m=groups.centroid(looks.range_m, powers),
        azimuth_deg=wrap_360(groups.centroid_deg(looks.azimuth_deg, powers)),
        elevation_deg=groups.centroid(looks.elevation_deg, powers),
    )
    of_leaders = details.rows(groups.leader).but(merged_drones=groups.others(looks.drone))
    if details.range_rate_m_s is not None:
        rate_m_s = groups.centroid(details.range_rate_m_s, powers)
        of_leaders = of_leaders.but(range_rate_m_s=rate_m_s)
    return echoes, of_leaders
