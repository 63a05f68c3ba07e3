"""Detection where a radar models more than usual: range rates, and echoes that melt into one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from plotfeed.models import detection
from plotfeed.models.beam.scan_draws import of_rows
from plotfeed.models.effects.doppler import Doppler
from plotfeed.models.frames import wrap_360
from plotfeed.models.state import Columns, Floats, Ints, Looks, Texts, rows_where

if TYPE_CHECKING:
    from plotfeed.models.effects.merging import Melted, Merging


@dataclass(frozen=True, kw_only=True)
class Aside(Columns):
    """What is known beside looks: true places, how fast echoes recede, and with whom they melt."""

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
    """Echoes that were detected: of each a look's columns, its powers, and columns of its plot."""

    echoes: Looks
    powers: Floats
    columns: dict[str, NDArray[Any]]
    rng: np.random.Generator


@dataclass(frozen=True, slots=True, kw_only=True)
class Finer:
    """What of a radar's detector only few model.

    `odds` gives the mean ratio and Pd of echoes of those powers, (n, ...), by their channels.
    """

    doppler: Doppler | None
    merging: Merging | None
    odds: Callable[[Floats, Ints], tuple[Floats, Floats]]

    def detect(
        self,
        looks: Looks,
        powers: Floats,
        aside: Aside,
        range_m: Floats,
        rng: np.random.Generator,
    ) -> tuple[Looks, Hits]:
        """Looks with their odds and what came of them, and the echoes that were detected.

        `range_m` is what is measured of ranges. Looks whose echoes melt share odds and outcome.
        """
        of_looks: Ints | slice = slice(None)
        echoes = looks.but(range_m=range_m)
        if self.merging is not None:
            melted = self._melted(self.merging, echoes, aside, rng)
            if melted is not None:
                echoes, aside = melt(melted, echoes, aside)
                powers, of_looks = melted.total(powers), melted.group
                rng = of_rows(rng, melted.leader)
        snr, pd = self.odds(powers, echoes.channel)
        if self.doppler is not None and aside.range_rate_m_s is not None:
            pd = pd * self.doppler.share_passed(aside.range_rate_m_s, echoes.channel)
        detected = detection.draw_hits(pd, rng)
        hits = rows_where(detected)
        return (
            looks.but(pd=pd[of_looks], detected=detected[of_looks]),
            Hits(
                echoes.but(snr=snr, pd=pd, detected=detected).rows(detected),
                powers[hits],
                aside.rows(detected).columns(),
                of_rows(rng, hits),
            ),
        )

    def _melted(
        self, merging: Merging, looks: Looks, aside: Aside, rng: np.random.Generator
    ) -> Melted | None:
        rate_m_s = aside.range_rate_m_s
        if self.doppler is not None and rate_m_s is not None:
            rate_m_s = self.doppler.folded(rate_m_s, looks.channel)
        return merging.melted(
            range_m=looks.range_m,
            azimuth_deg=looks.azimuth_deg,
            elevation_deg=looks.elevation_deg,
            range_rate_m_s=rate_m_s,
            t_utc_ns=looks.t_utc_ns,
            powers=looks.snr,
            uniforms=rng.random((len(looks),)),
            channel=looks.channel,
        )


def melt(melted: Melted, looks: Looks, aside: Aside) -> tuple[Looks, Aside]:
    """The echoes of each group in the place of its looks: at their centroid, the leader's truth."""
    powers = looks.snr
    echoes = looks.rows(melted.leader).but(
        range_m=melted.centroid(looks.range_m, powers),
        azimuth_deg=wrap_360(melted.centroid_deg(looks.azimuth_deg, powers)),
        elevation_deg=melted.centroid(looks.elevation_deg, powers),
    )
    of_leaders = aside.rows(melted.leader).but(merged_drones=melted.others(looks.drone))
    if aside.range_rate_m_s is not None:
        rate_m_s = melted.centroid(aside.range_rate_m_s, powers)
        of_leaders = of_leaders.but(range_rate_m_s=rate_m_s)
    return echoes, of_leaders
