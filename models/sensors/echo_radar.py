"""What radars share, whatever they measure of echoes: the way from looks to plots."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from plotfeed.models import detection
from plotfeed.models.chance import of_rows
from plotfeed.models.sensors.sensor_model import NO_PLOTS, RadioSensor, Targets
from plotfeed.models.sensors.stacking import EVERY_ROW
from plotfeed.models.state import UNDECIDED, Floats, Ints, Looks, Plots, rows_where

if TYPE_CHECKING:
    from plotfeed.models.effects.detailed_detection import DetailedDetector, Hits
    from plotfeed.models.effects.doppler import Doppler
    from plotfeed.models.effects.echo_effects import EchoEffects, EchoPaths
    from plotfeed.models.effects.merging import Merging
    from plotfeed.models.effects.surroundings import OnTheWay

MEASURED_OF = (
    *("drone", "channel", "t_utc_ns", "range_m", "azimuth_deg", "elevation_deg", "snr"),
    "sensor",
)
"""Columns of looks from which plots are made."""


FEW_SIGNALS = 8
"""Below, one addition after the other is what NumPy's sum along a row does, many times as fast."""


def mean_over_signals(snrs: Floats) -> Floats:
    """The mean ratio of each look (eq 18); (n, K) in, (n,) out."""
    n_signals = snrs.shape[1]
    if n_signals == 1:
        return snrs[:, 0]
    if n_signals >= FEW_SIGNALS:
        return np.asarray(snrs.mean(axis=-1))
    total = snrs[:, 0] + snrs[:, 1]
    for k in range(2, n_signals):
        total += snrs[:, k]
    return np.asarray(total / n_signals)


@dataclass(frozen=True, kw_only=True)
class EchoRadar(RadioSensor, ABC):
    """A radar, of which what is None is not modelled. The powers of its looks are (n, ...)."""

    gain_rx_dbi: float
    doppler: Doppler | None = None
    merging: Merging | None = None
    echo_effects: EchoEffects | None = None

    alike: ClassVar[frozenset[str]] = frozenset(
        {"pfa", "surroundings", "multipath", "doppler", "merging", "echo_effects"}
    )

    @property
    def measures_range_rate(self) -> bool:
        """Whether its Doppler cells are modelled."""
        return self.doppler is not None

    @abstractmethod
    def _echo_paths(self, targets: Targets, rows: Ints | slice) -> EchoPaths:
        """How echoes of those rows of targets, the model's own, come to it."""

    def with_jammers_behind(self, way: OnTheWay) -> Self:
        """The radar with what an obstruction leaves of its jammers."""
        if self.echo_effects is None:
            return self
        from plotfeed.models.effects.jamming import Jamming, behind

        met = tuple(
            replace(effect, jammers=behind(effect.jammers, way))
            if isinstance(effect, Jamming)
            else effect
            for effect in self.echo_effects.in_the_world
        )
        return replace(self, echo_effects=replace(self.echo_effects, in_the_world=met))

    @property
    def usual_case(self) -> int:
        """Swerling's case of a target that states none: by one look, from scan to scan."""
        return 1

    @property
    def n_looks(self) -> int:
        """Looks whose powers are summed."""
        return 1

    def orders(self, targets: Targets, rows: Ints | slice = EVERY_ROW) -> Floats | None:
        """Orders by which those rows of targets fluctuate, (n,); None if none states anything."""
        echoes = targets.signatures.echoes
        if echoes is None:
            return None
        found: Floats = echoes.orders(targets.drone[rows], self.usual_case, self.n_looks)
        return found

    def _with_effects(self, powers: Floats, targets: Targets, rows: Ints | slice) -> Floats:
        """Mean powers of echoes, or their ratios, (n, K), as the effects leave them."""
        echoes = targets.signatures.echoes
        if self.echo_effects is None and echoes is None:
            return powers
        paths = self._echo_paths(targets, rows)
        if self.echo_effects is not None:
            powers = powers * self.echo_effects.power_factor(paths)
        if echoes is not None and echoes.has_aspects and targets.velocity_enu_m_s is not None:
            powers = powers * echoes.rcs_factor(
                targets.drone[rows],
                paths.place_enu_m,
                targets.velocity_enu_m_s[rows],
                paths.transmitters_enu_m,
            )
        return powers

    @abstractmethod
    def _odds(self, powers: Floats, channel: Ints, order: Floats | None) -> tuple[Floats, Floats]:
        """Mean signal-to-noise ratio and Pd of echoes; (n, ...) and (n,) in, each (n,) out."""

    @abstractmethod
    def _range_rates(self, targets: Targets, rows: Ints | slice, channel: Ints) -> Floats | None:
        """How fast what it measures of ranges grows, if that is modelled and known; (n,)."""

    @abstractmethod
    def _with_range(self, looks: Looks, targets: Targets, *rows: Ints | slice) -> Looks:
        """Looks with the ranges that it measures; of these rows of targets, of them these."""

    @abstractmethod
    def _measure(self, hits: Hits, targets: Targets) -> Plots:
        """The plots of echoes, at least one, of which ranges are what it measures."""

    @cached_property
    def _detailed(self) -> DetailedDetector | None:
        """The detector of a radar that models more than the usual; None for any other."""
        if self.doppler is None and self.merging is None:
            return None
        from plotfeed.models.effects.detailed_detection import DetailedDetector

        return DetailedDetector(
            doppler=self.doppler,
            merging=self.merging,
            odds=self._odds,
            pd_factor=self.pd_factor,
        )

    def _looks_and_plots(
        self,
        targets: Targets,
        rows: Ints | slice,
        geometry: tuple[Floats, Floats, Floats],
        rng: np.random.Generator,
        *,
        powers: Floats,
        snr: Floats,
        pd: Floats,
        channel: Ints | None = None,
        order: Floats | None = None,
    ) -> tuple[Looks, Plots]:
        """Looks at those rows of targets, the model's own, and the plots of those detected."""
        if self.degradation is not None:
            pd = pd * self.degradation.pd_factor
        detected = UNDECIDED[: len(pd)] if self._detailed else detection.draw_hits(pd, rng)  # eq 8
        looks = targets.looks(rows, geometry, snr=snr, pd=pd, detected=detected, channel=channel)
        from plotfeed.models.effects.detailed_detection import Hits, LookDetails

        if self._detailed is None:
            if not detected.any():
                return looks, NO_PLOTS
            which = rows_where(detected)
            echoes = looks.picked(which, MEASURED_OF)
            columns = targets.true_geometry(echoes, rows, which)
            of_hits = self.rows(which)
            echoes = of_hits._with_range(echoes, targets, rows, which)
            of_which = None if order is None else order[which]
            hits = Hits(echoes, powers[which], columns, of_rows(rng, which), which, of_which)
            return looks, of_hits._measure(hits, targets)
        rate_m_s = self._range_rates(targets, rows, looks.channel)
        details = LookDetails(
            **targets.true_geometry(looks, rows),
            range_rate_m_s=rate_m_s,
            true_range_rate_m_s=rate_m_s,
        )
        echoes = self._with_range(looks, targets, rows)
        looks, hits = self._detailed.detect(looks, echoes, powers, details, rng, order)
        if not len(hits.echoes):
            return looks, NO_PLOTS
        return looks, self.rows(hits.rows)._measure(hits, targets)
