"""One sensor of a scene as the stages see it: where its targets are, and how well it measures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal

import numpy as np

from plotfeed.feeds.accuracy_chart import precise
from plotfeed.feeds.accuracy_chart.laws import error_law
from plotfeed.feeds.accuracy_chart.sample import Flown, Places, Viewpoint, places, targets_at
from plotfeed.feeds.accuracy_chart.stage import FALSE_ALARMS, PD, Effort, rms
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.models.frames import LocalFrame, enu_to_aer, wrap_180
from plotfeed.models.propagation import bistatic_range
from plotfeed.models.sensors.passive_radar import PassiveRadar
from plotfeed.models.sensors.sensor_model import SensorModel, Targets
from plotfeed.models.state import Floats, Ints

FEWEST_SEEN = 1e-6
"""Of a sensor that detects less than this share of its looks, there is nothing to chart."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """The sensor, `seen` places drawn as its detections come, and `anywhere` as its looks come.

    `own` has the sensor's own errors by quantity, rms: of what it measures over its detections, of
    the number of detections a look, and of that of false alarms a scan.
    """

    scene: Scene
    sensor: Sensor
    model: SensorModel
    frame: LocalFrame
    effort: Effort
    flown: Flown
    seen: Places
    anywhere: Places
    pd_anywhere: Floats
    best_channel: Ints
    own: Mapping[str, float]
    seed: int = 1

    def seen_targets(self, n: int | None = None) -> Targets:
        """The first of the places that are detected, or all of them."""
        return targets_at(_first(self.seen, n), self.frame, self.flown.signatures)

    def anywhere_targets(self, n: int | None = None) -> Targets:
        """The first of the places that are looked at, or all of them."""
        return targets_at(_first(self.anywhere, n), self.frame, self.flown.signatures)

    @property
    def rng(self) -> np.random.Generator:
        """The same at every call."""
        return np.random.default_rng(self.seed)

    def measured(self, enu_m: Floats, rows: Ints | None = None) -> dict[str, Floats]:
        """What the sensor measures of those places, (n, 3), without its errors; by quantity.

        `rows` are theirs among `seen`, if they are not all of them.
        """
        azimuth_deg, elevation_deg, range_m = enu_to_aer(enu_m)
        found = {
            "range_m": range_m,
            "azimuth_deg": azimuth_deg,
            "elevation_deg": elevation_deg,
        }
        if isinstance(self.model, PassiveRadar):
            channel = self.best_channel if rows is None else self.best_channel[rows]
            transmitters_enu_m = self.model.positions_enu_m[channel]
            found["bistatic_range_m"] = bistatic_range(enu_m, transmitters_enu_m)
        return {name: value for name, value in found.items() if name in self.own}

    def precisely(self, row: int) -> dict[str, Decimal]:
        """The same of one of the seen places, in 50 digits, from its latitude and longitude."""
        here = (self.frame.latitude_deg, self.frame.longitude_deg, self.frame.height_m)
        enu = precise.enu_m(here, self.seen.geodetic(row))
        names = ("azimuth_deg", "elevation_deg", "range_m")
        found = dict(zip(names, precise.azimuth_elevation_range(enu), strict=True))
        if isinstance(self.model, PassiveRadar):
            transmitter_enu_m = self.model.positions_enu_m[self.best_channel[row]].tolist()
            found["bistatic_range_m"] = precise.bistatic_range_m(enu, transmitter_enu_m)
        return {name: value for name, value in found.items() if name in self.own}

    def errors(
        self, enu_m: Floats, true_enu_m: Floats, rows: Ints | None = None
    ) -> dict[str, float]:
        """Rms errors of what is measured of places, (n, 3), that truly are elsewhere."""
        return errors_between(self.measured(enu_m, rows), self.measured(true_enu_m, rows))

    @property
    def velocity_enu_m_s(self) -> Floats:
        """Of the seen targets; (n, 3)."""
        return self.frame.rotate_from_ecef(self.seen.velocity_ecef_m_s)


def _first(found: Places, n: int | None) -> Places:
    return found if n is None else found.drawn(np.arange(min(n, len(found))))


def errors_between(measured: Mapping[str, Floats], true: Mapping[str, Floats]) -> dict[str, float]:
    """Rms differences by quantity, angles the short way round."""
    return {
        name: rms(
            wrap_180(measured[name] - value) if name.endswith("_deg") else measured[name] - value
        )
        for name, value in true.items()
    }


def case_of(
    scene: Scene, sensor: Sensor, flown: Flown, effort: Effort, rng: np.random.Generator
) -> Case | None:
    """What there is to measure of a sensor; None if it hardly ever detects any of the drones."""
    watcher = Viewpoint.of(scene, sensor)
    model, frame = watcher.model, watcher.frame
    found, pd = places(scene, watcher, flown, effort.pool, rng)
    if not len(found) or pd.mean() < FEWEST_SEEN:
        return None
    seen = found.drawn(rng.choice(len(found), effort.targets, p=pd / pd.sum()))
    some = rng.permutation(len(found))[: max(effort.targets, effort.references)]
    targets = targets_at(seen, frame, flown.signatures)
    return Case(
        scene=scene,
        sensor=sensor,
        model=model,
        frame=frame,
        effort=effort,
        flown=flown,
        seen=seen,
        anywhere=found.rows(some),
        pd_anywhere=pd[some],
        best_channel=_best_channel(model, targets),
        own=_own(model, targets, pd[some]),
    )


def _best_channel(model: SensorModel, targets: Targets) -> Ints:
    if not isinstance(model, PassiveRadar):
        return np.zeros(len(targets), np.int64)
    power_w = model.target_power_w(targets.position_enu_m, targets.rcs_m2())
    return np.asarray(model.mean_snr(power_w).argmax(axis=1))


def _own(model: SensorModel, targets: Targets, pd: Floats) -> dict[str, float]:
    own = _own_sigmas(model, targets)
    own[PD] = float(np.sqrt(np.mean(pd * (1 - pd))))
    cells, pfa = getattr(model, "resolution_cells", None), getattr(model, "pfa", 0.0)
    if cells is not None:
        own[FALSE_ALARMS] = float(np.sqrt(np.sum(cells) * pfa * (1 - pfa)))
    return own


def _own_sigmas(model: SensorModel, targets: Targets) -> dict[str, float]:
    """Of what it measures: by the law of its errors, or else by what it predicts."""
    law = error_law(model, targets)
    if law is not None:
        return {name: rms(sigma) for name, sigma in law.sigmas(1 / law.inverse).items()}
    predicted = model.predict(targets)
    sigmas = {
        "range_m": predicted.sigma_range_m,
        "azimuth_deg": predicted.sigma_azimuth_deg,
        "elevation_deg": predicted.sigma_elevation_deg,
    }
    return {name: rms(sigma) for name, sigma in sigmas.items() if np.isfinite(sigma).any()}
