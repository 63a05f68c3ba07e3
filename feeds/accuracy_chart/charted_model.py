"""The model of a sensor as a chart takes it, of thousands of places at once: each by itself.

A steered beam is charted by a dwell that points at each target, and several receivers by places of
which it is known what detections are of one target. What the whole makes of a scan, search and
revisits, ghosts and sets, grows with the company, and no one's place has a precise law of it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import singledispatch
from typing import Any

import numpy as np

from plotfeed.models import detection
from plotfeed.models.effects.degradation import Degradation
from plotfeed.models.effects.multipath import Multipath
from plotfeed.models.frames import enu_to_aer
from plotfeed.models.joined_sets import OUTSIDE, JoinedSets
from plotfeed.models.multilateration import Sightings, range_sums_m, solved
from plotfeed.models.sensors.electronic_radar import ElectronicRadar
from plotfeed.models.sensors.multistatic import MultistaticRadar
from plotfeed.models.sensors.sensor_model import NO_PLOTS, SensorModel, Targets
from plotfeed.models.state import Bools, Floats, Looks, Plots

MEASURED_BY_PAIRS = ("sum_m", "azimuth_deg", "elevation_deg")


@dataclass(frozen=True, kw_only=True)
class PlacesApart(MultistaticRadar):
    """Several receivers that know whose detections are whose; a look is at a target by all pairs.

    Its plots are least squares from where the target is: what a tracker would see without ghosts.
    """

    @property
    def multipath(self) -> Multipath | None:
        """The ground that all receivers are over; None for free space."""
        return self.receivers[0].signals.multipath

    def over(self, ground: Multipath | None) -> PlacesApart:
        """Receivers as they are, over that ground."""
        receivers = tuple(
            replace(each, signals=replace(each.signals, multipath=ground))
            for each in self.receivers
        )
        return replace(self, receivers=receivers)

    def observe(self, targets: Targets, rng: np.random.Generator) -> tuple[Looks, Plots]:
        """Look once at each target within cover, and place those that enough pairs detect."""
        geometry = azimuth_deg, elevation_deg, range_m = enu_to_aer(targets.position_enu_m)
        rows = np.flatnonzero(self.in_cover(range_m, azimuth_deg, elevation_deg))
        place_m = targets.true_position_enu_m[rows]
        snrs, pds = self.odds(place_m, targets.rcs_m2(rows))
        hit = rng.random(snrs.shape) < pds
        detected = (hit.sum(axis=1) >= self.fewest_pairs) & (rng.random(len(rows)) >= OUTSIDE)
        looks = targets.looks(
            rows, geometry, snr=snrs.max(axis=1), pd=self.place_pd(pds), detected=detected
        )
        if not detected.any():
            return looks, NO_PLOTS
        seen, snr = self._sightings(place_m[detected], snrs[detected], hit[detected], rng)
        fit = solved(place_m[detected], seen)
        joined = JoinedSets(fit, np.nanmean(snr, axis=1), targets.drone[rows[detected]])
        return looks, self._with_truth(self._plots(joined, int(targets.t_utc_ns[0])), targets)

    def _sightings(
        self, place_m: Floats, snrs: Floats, hit: Bools, rng: np.random.Generator
    ) -> tuple[Sightings, Floats]:
        """What pairs measure of targets, a row each, NaN where they missed; and the ratios."""
        sums_m = range_sums_m(place_m, *self.stations_m)
        names = [f"{sigma}{name}" for name in MEASURED_BY_PAIRS for sigma in ("", "sigma_")]
        columns = {name: np.full(snrs.shape, np.nan) for name in (*names, "snr")}
        for p, (m, _) in enumerate(self.pairs):
            each, mine = self.receivers[m], np.flatnonzero(hit[:, p])
            signals, mean = each.signals, snrs[mine, p]
            azimuth_deg, elevation_deg, _ = enu_to_aer(place_m[mine] - np.array(each.place_enu_m))
            snr, _ = detection.draw_detected_snr_swerling1(
                mean, signals.pfa, signals.n_reference, rng
            )
            found = self._measured(p, snr, (sums_m[mine, p], azimuth_deg, elevation_deg), rng)
            for name, column in columns.items():
                column[mine, p] = getattr(found, name)
        seen = Sightings(
            transmitters_m=self.stations_m[0],
            receivers_m=self.stations_m[1],
            height_m=self.expected_height_m,
            sigma_height_m=self.sigma_height_m,
            **{name: columns[name] for name in names},
        )
        return seen, columns["snr"]


@singledispatch
def charted_model(model: SensorModel) -> SensorModel:
    """A model whose observations of thousands of places at once are those of each alone."""
    changed: Any = model
    if getattr(model, "merging", None) is not None:
        changed = replace(changed, merging=None)  # their echoes would melt into one
    return changed  # type: ignore[no-any-return]


@charted_model.register
def _(model: ElectronicRadar) -> SensorModel:
    radar = model.radar
    # A false alarm takes a dwell, and is not confirmed.
    silent = replace(radar.degradation or Degradation(), false_alarm_factor=0.0)
    return charted_model(replace(radar, degradation=silent))


@charted_model.register
def _(model: MultistaticRadar) -> SensorModel:
    held = {field.name: getattr(model, field.name) for field in fields(model)}
    return PlacesApart(**held | {"degradation": None})  # its pairs have it already
