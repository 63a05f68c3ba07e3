"""One sensor of a scene as the stages see it: where its targets are, and how well it measures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import singledispatch
from typing import Any

import numpy as np

from plotfeed.feeds.accuracy_chart import precise
from plotfeed.feeds.accuracy_chart.sample import Flown, Places, Viewpoint, places, targets_at
from plotfeed.feeds.accuracy_chart.stage import FALSE_ALARMS, PD, Effort, rms
from plotfeed.feeds.scene.fields import enu_from
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.models import detection
from plotfeed.models.emitters import Emissions
from plotfeed.models.fluctuation import FluctuatingCfar
from plotfeed.models.frames import LocalFrame, enu_to_aer, wrap_180
from plotfeed.models.propagation import bistatic_range
from plotfeed.models.sensors.acoustic import MicrophoneArray
from plotfeed.models.sensors.joint_sensor import JointSensor
from plotfeed.models.sensors.passive_radar import PassiveRadar
from plotfeed.models.sensors.polar_radar import PolarRadar
from plotfeed.models.sensors.rf import RfDirectionFinder
from plotfeed.models.sensors.rf_receiver import emissions_of
from plotfeed.models.sensors.sensor_model import SensorModel, Targets
from plotfeed.models.state import Floats, Ints, Signatures

FEWEST_SEEN = 1e-6
"""Of a sensor that detects less than this share of its looks, there is nothing to chart."""
Rng = np.random.Generator
Sigmas = Callable[[Floats], Mapping[str, Floats]]
"""From signal-to-noise ratios of detections, linear, (n,): standard deviations by quantity."""


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
    signatures: Signatures
    seen: Places
    anywhere: Places
    pd_anywhere: Floats
    transmitter_enu_m: Floats | None
    """Of a bistatic sensor that whose echo of each seen target is the strongest; (n, 3)."""
    own: Mapping[str, float]
    seed: int = 1

    def seen_targets(self, n: int | None = None) -> Targets:
        """The first of the places that are detected, or all of them."""
        return targets_at(self.seen.first(n), self.frame, self.signatures)

    def anywhere_targets(self, n: int | None = None) -> Targets:
        """The first of the places that are looked at, or all of them."""
        return targets_at(self.anywhere.first(n), self.frame, self.signatures)

    @property
    def rng(self) -> Rng:
        """A generator that draws the same whenever it is asked for."""
        return np.random.default_rng(self.seed)

    @property
    def velocity_enu_m_s(self) -> Floats:
        """Velocities of the seen targets; (n, 3)."""
        return self.frame.rotate_from_ecef(self.seen.velocity_ecef_m_s)

    def measured(self, enu_m: Floats, rows: Ints | None = None) -> dict[str, Floats]:
        """What the sensor measures of those places, (n, 3), without its errors; by quantity.

        `rows` are theirs among `seen`, if they are not all of them.
        """
        azimuth_deg, elevation_deg, range_m = enu_to_aer(enu_m)
        found = {"range_m": range_m, "azimuth_deg": azimuth_deg, "elevation_deg": elevation_deg}
        if self.transmitter_enu_m is not None:
            there_m = self.transmitter_enu_m if rows is None else self.transmitter_enu_m[rows]
            found["bistatic_range_m"] = bistatic_range(enu_m, there_m)
        return {name: value for name, value in found.items() if name in self.own}

    def measured_precisely(self, row: int) -> dict[str, Any]:
        """Measurements of one of the seen places, in 50 digits, from its latitude and longitude."""
        site, place = self.frame, self.seen
        enu = precise.enu_m(
            (site.latitude_deg, site.longitude_deg, site.height_m),
            [float(x[row]) for x in (place.latitude_deg, place.longitude_deg, place.height_m)],
        )
        azimuth_deg, elevation_deg, range_m = precise.azimuth_elevation_range(enu)
        found = {"range_m": range_m, "azimuth_deg": azimuth_deg, "elevation_deg": elevation_deg}
        if self.transmitter_enu_m is not None:
            there_m = self.transmitter_enu_m[row].tolist()
            found["bistatic_range_m"] = precise.bistatic_range_m(enu, there_m)
        return {name: value for name, value in found.items() if name in self.own}


def wrapped(name: str, difference: Floats) -> Floats:
    """Differences of a quantity, angles the short way round."""
    return wrap_180(difference) if name.endswith("_deg") else difference


def case_of(scene: Scene, sensor: Sensor, flights: Flown, effort: Effort, rng: Rng) -> Case | None:
    """What there is to measure of a sensor; None if it hardly ever detects any of the drones."""
    viewpoint = Viewpoint.of(scene, sensor)
    model, frame = viewpoint.model, viewpoint.frame
    found, pd = places(scene, viewpoint, flights, effort.pool, rng)
    if not len(found) or pd.mean() < FEWEST_SEEN:
        return None
    seen = found.drawn(rng.choice(len(found), effort.targets, p=pd / pd.sum()))
    some = rng.permutation(len(found))[: max(effort.targets, effort.references)]
    targets = targets_at(seen, frame, flights.signatures)
    own = _own_sigmas(model, targets)
    own[PD] = float(np.sqrt(np.mean(pd[some] * (1 - pd[some]))))
    mean, variance = alarm_moments(model)
    if mean > 0:
        own[FALSE_ALARMS] = float(np.sqrt(variance))
    return Case(
        scene=scene,
        sensor=sensor,
        model=model,
        frame=frame,
        effort=effort,
        signatures=flights.signatures,
        seen=seen,
        anywhere=found.drawn(some),
        pd_anywhere=pd[some],
        transmitter_enu_m=_transmitters(scene, viewpoint, targets),
        own=own,
    )


def alarm_moments(model: SensorModel) -> tuple[float, float]:
    """Mean and variance of the number of false alarms a scan: binomial where cells are known.

    None of a sensor that joins detections: they are no plots by themselves.
    """
    if isinstance(model, JointSensor):
        return 0.0, 0.0
    cells, pfa = (getattr(model, name, None) for name in ("alarm_cells", "alarm_pfa"))
    if cells is None or pfa is None:
        return model.false_alarms_per_scan, model.false_alarms_per_scan
    mean = float(np.sum(cells) * pfa)
    return mean, mean * (1 - pfa)


def _transmitters(scene: Scene, viewpoint: Viewpoint, targets: Targets) -> Floats | None:
    """Where the transmitter of each target's strongest look stands; None without such."""
    site, illuminators = scene.scene.site, viewpoint.sensor.illuminators
    if not illuminators:
        return None
    stand_enu_m = np.array([enu_from(viewpoint.frame, site, part.place) for part in illuminators])
    looks, _ = viewpoint.model.observe(targets, np.random.default_rng(1))
    order = np.lexsort((-looks.snr, looks.drone))
    drones, first = np.unique(looks.drone[order], return_index=True)
    channel = np.zeros(len(targets), np.int64)
    channel[drones] = looks.channel[order][first]
    return np.asarray(stand_enu_m[channel])


def _own_sigmas(model: SensorModel, targets: Targets) -> dict[str, float]:
    """Errors of what it measures: by their law, or else by what it predicts."""
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


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorLaw:
    """How the errors of a sensor's plots of targets are distributed.

    `draw` gives ratios of detections, None where they do not fluctuate; one over `inverse` is the
    ratio whose errors are the rms of theirs. `printed` has the paper's own constants.
    """

    mean_snr: Floats
    sigmas: Sigmas
    printed: Sigmas | None
    draw: Callable[[Rng], Floats] | None
    inverse: Floats


def error_law(model: SensorModel, targets: Targets) -> ErrorLaw | None:
    """The law of a sensor; None if it is not known, and the stage of errors left out."""
    law, factor = _law_of_kind(model, targets), model.error_factor
    if law is None or model.degradation is None:
        return law

    def larger(sigmas: Sigmas) -> Sigmas:
        return lambda snr: {name: sigma * factor for name, sigma in sigmas(snr).items()}

    printed = None if law.printed is None else larger(law.printed)
    return replace(law, sigmas=larger(law.sigmas), printed=printed)


@singledispatch
def _law_of_kind(_model: SensorModel, _targets: Targets) -> ErrorLaw | None:
    """The law of a kind of sensor that is not degraded."""
    return None


@_law_of_kind.register
def _(model: PolarRadar, targets: Targets) -> ErrorLaw:
    snrs, order = model.look_snrs(targets), model.orders(targets)
    names = ("range_m", "azimuth_deg", "elevation_deg")[: 3 if model.measures_elevation else 2]

    def sigmas(snr: Floats) -> dict[str, Floats]:
        return dict(zip(names, model.sigmas(snr), strict=False))

    beams = {
        "azimuth_deg": (model.azimuth_beamwidth_deg, model.azimuth_floor_deg),
        "elevation_deg": (model.elevation_beamwidth_deg, model.elevation_floor_deg),
    }
    return ErrorLaw(
        mean_snr=snrs.mean(axis=1),
        sigmas=sigmas,
        printed=_printed(sigmas, beams),
        draw=lambda rng: model.draw_detected(snrs, rng, order)[0],
        inverse=model.inverse_detected(snrs, order),
    )


@_law_of_kind.register
def _(model: PassiveRadar, targets: Targets) -> ErrorLaw:
    snrs = passive_snrs(model, targets)
    snr, best = snrs.max(axis=1), snrs.argmax(axis=1)
    resolution_m, floor_m = model.range_resolution_m[best], model.range_floors_m[best]

    def sigmas(ratio: Floats) -> dict[str, Floats]:
        names = ("bistatic_range_m", "azimuth_deg")
        return dict(zip(names, model.sigmas(ratio, resolution_m, floor_m), strict=True))

    beams = {"azimuth_deg": (model.azimuth_beamwidth_deg, model.azimuth_floor_deg)}
    cfar, order = FluctuatingCfar(model.pfa, 1, model.n_reference), model.orders(targets)

    def draw(rng: Rng) -> Floats:
        if order is not None:
            return cfar.draw_detected(snr, order, rng)[0]
        return detection.draw_detected_snr_swerling1(snr, model.pfa, model.n_reference, rng)[0]

    return ErrorLaw(
        mean_snr=snr,
        sigmas=sigmas,
        printed=_printed(sigmas, beams),
        draw=draw,
        inverse=model.inverse_detected(snr, order),
    )


@_law_of_kind.register
def _(model: MicrophoneArray, targets: Targets) -> ErrorLaw:
    snr = 10 ** (model.snr_db(targets.sound_power_db(), targets.position_enu_m) / 10)
    azimuth_deg, elevation_deg, _ = enu_to_aer(targets.position_enu_m)
    beams = {"azimuth_deg": (model.azimuth_beamwidth_deg, model.azimuth_floor_deg)}
    if model.elevation_beamwidth_deg is not None:
        beams["elevation_deg"] = (model.elevation_beamwidth_deg, model.elevation_floor_deg)

    def sigmas(ratio: Floats) -> dict[str, Floats]:
        found = model.sigmas_towards(ratio, azimuth_deg, elevation_deg)
        return dict(zip(beams, found, strict=False))

    return ErrorLaw(
        mean_snr=snr, sigmas=sigmas, printed=_printed(sigmas, beams), draw=None, inverse=1 / snr
    )


@_law_of_kind.register
def _(model: RfDirectionFinder, targets: Targets) -> ErrorLaw | None:
    if not model.measures_azimuth:
        return None
    emissions, snr = strongest_emissions(model, targets)

    def draw(rng: Rng) -> Floats:
        detected = detection.draw_detected_energy(snr, model.pfa, model.samples, rng)
        return detection.estimated_snr(detected, model.samples)

    def sigmas(ratio: Floats) -> dict[str, Floats]:
        return {"azimuth_deg": model.sigma_azimuth_deg(emissions.frequency_hz, ratio)}

    return ErrorLaw(
        mean_snr=snr,
        sigmas=sigmas,
        printed=None,
        draw=draw,
        inverse=1 / model.effective_snr(snr),
    )


def _printed(sigmas: Sigmas, beams: Mapping[str, tuple[float, float]]) -> Sigmas:
    """Equations 14 and 15 as printed, beamwidth over 2 sqrt(S), for angles; range as it is."""

    def found(snr: Floats) -> dict[str, Floats]:
        angles = {
            name: np.hypot(width_deg / (2 * np.sqrt(snr)), floor_deg)
            for name, (width_deg, floor_deg) in beams.items()
        }
        return {name: angles.get(name, sigma) for name, sigma in sigmas(snr).items()}

    return found


def passive_snrs(model: PassiveRadar, targets: Targets) -> Floats:
    """Mean ratios by channel; (n, channels)."""
    return model.mean_snr(model.look_powers_w(targets))


def strongest_emissions(model: RfDirectionFinder, targets: Targets) -> tuple[Emissions, Floats]:
    """The emission with the highest ratio of each target that emits, and that ratio."""
    emissions = emissions_of(targets)
    snr = model.received_snr(emissions, targets, enu_to_aer(targets.position_enu_m)[2])
    order = np.lexsort((-snr, emissions.target))
    _, first = np.unique(emissions.target[order], return_index=True)
    rows = order[first]
    return emissions.rows(rows), snr[rows]
