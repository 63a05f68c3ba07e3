"""The keys of an RF sensor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from plotfeed.feeds.scene.fields import (
    Beamwidth,
    Decibels,
    Frequency,
    Loss,
    NotNegative,
    Positive,
    Probability,
    SceneTable,
    Site,
)
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.sensors.effect_keys import (
    RF_BEARING_DEG,
    ClassifierKeys,
    MultipathKeys,
    odd_floor,
    odd_frequency,
)
from plotfeed.feeds.scene.sensors.scan_keys import StaringScan
from plotfeed.feeds.scene.sensors.sensor_keys import AzimuthCoverKeys, Reports, SensorGeometry
from plotfeed.feeds.scene.world_keys import JammerKeys
from plotfeed.models.detection import cells_across
from plotfeed.models.effects.jamming import BandNoise, jamming_over_noise
from plotfeed.models.effects.surroundings import CITIES
from plotfeed.models.frames import distance_m
from plotfeed.models.sensors.rf import RfDirectionFinder

MAX_SAMPLES = 1e8  # Up to here the detector's probabilities are good to some 1e-11


def _band_noise(
    keys: JammerKeys, position_enu_m: tuple[float, float, float], model: RfDirectionFinder
) -> BandNoise:
    """A jammer as a receiver at the origin has it, which hears as much from everywhere."""
    over_noise = jamming_over_noise(
        eirp_w=keys.eirp_w,
        jammer_hz=keys.frequency_hz,
        jammer_width_hz=keys.bandwidth_hz,
        range_m=distance_m(np.array(position_enu_m)),
        gain_dbi=model.gain_rx_dbi,
        frequency_hz=keys.frequency_hz,
        bandwidth_hz=keys.bandwidth_hz,
        noise_w_hz=model.receiver_noise_w_hz[0],
    )
    return keys.made(BandNoise, position_enu_m=position_enu_m, over_noise=float(over_noise))


class Friis(SceneTable):
    """Free space."""

    kind: Literal["friis"] = "friis"


class LogDistance(SceneTable):
    """Free space up to a distance, then a power of distance."""

    kind: Literal["log-distance"]
    exponent: Annotated[float, Field(ge=1, le=10)]
    """2 is free space; 2.7 to 3.5 is usual over a town."""
    reference_m: Annotated[float, Field(ge=0.01, le=1e4)] = 1.0
    """Up to here the loss is that of free space."""


class CityLoss(SceneTable):
    """Free space and the loss by houses, by the drone's elevation."""

    kind: Literal["city"]
    environment: Literal["suburban", "urban", "dense-urban", "high-rise"]
    """Of the sensor, which is among the houses; whether it sees a drone is drawn once for each."""
    shadowing_db: Annotated[float, Field(ge=0, le=30)] = 0.0
    """Standard deviation of the loss from drone to drone."""


class RfKeys(AzimuthCoverKeys):
    """A receiver of what drones emit: control, video, remote identification."""

    label = "RF"
    geometry = SensorGeometry.BEARINGS
    sapient_type = "PASSIVE_RF"
    formats = ("asterix-205", "plots", "sapient")
    makes = RfDirectionFinder

    type: Literal["rf"]
    report: Reports = ()
    """Without it, plots and, if it finds directions, asterix-205, which brings 025 along."""
    scan: StaringScan
    frequency_min_hz: Frequency
    """Where the band begins."""
    frequency_max_hz: Frequency
    """The band; only what lies inside it is received."""
    channel_bandwidth_hz: Frequency
    """In which energy is detected: that of one burst or hop."""
    instantaneous_bandwidth_hz: Frequency | None = None
    """What is received at once of the band; without it, all."""
    integration_s: Positive
    """How long energy is summed."""
    duty_cycle: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Probability that an emission's next burst falls into the scan."""
    bursts_per_dwell: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    """Chances in a scan, of which one is enough."""
    gain_rx_dbi: Decibels = 0.0
    """Of the receiving antenna."""
    loss_db: Loss = 0.0
    """Of cables and filters."""
    noise_figure_db: Loss = 6.0
    """Of the receiver."""
    path_loss: Annotated[Friis | LogDistance | CityLoss, Field(discriminator="kind")] = Friis()
    """How a signal weakens with distance."""
    multipath: MultipathKeys | None = None
    """The ground's reflection; a path_loss of log-distance has it in its exponent already."""
    pfa: Probability = 1e-6
    """Probability of a false alarm in one channel and beam, in one scan."""
    range_max_m: Annotated[float, Field(gt=0, le=470_000)]
    """Further away nothing is received, however strong."""
    azimuth_beamwidth_deg: Beamwidth | None = None
    """Of beams side by side, each of which can alarm; without it, one antenna."""
    measures_azimuth: bool = True
    """False for a detector that finds no direction."""
    baseline_m: Annotated[float, Field(ge=1e-3, le=1e4)] | None = None
    """Between the antennas of the interferometer that finds the direction."""
    azimuth_floor_deg: NotNegative = RF_BEARING_DEG
    """The error that remains however strong the signal: multipath."""
    elevation_baseline_m: Annotated[float, Field(ge=1e-3, le=1e4)] | None = None
    """Between antennas above each other, for the elevation; without it, none."""
    elevation_floor_deg: NotNegative = RF_BEARING_DEG
    """As azimuth_floor_deg, in elevation."""
    classifies: bool = False
    """Whether plots carry the kind of emission."""
    classifier: ClassifierKeys | None = None
    """In its place, what each kind of emission is called, rightly or wrongly."""
    decodes: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """Kinds of emission that the sensor reads: their plots carry kind and identity."""

    @classmethod
    def usual_report(cls, keys: dict[str, Any], /) -> tuple[str, ...]:
        """The category made for bearings, if there are any, and all that was measured."""
        return ("asterix-205", "plots") if keys.get("measures_azimuth", True) else ("plots",)

    def _refusals(self) -> Iterator[str]:
        if not self.frequency_min_hz < self.frequency_max_hz:
            yield "frequency_min_hz: must be less than frequency_max_hz"
        if self._received_at_once_hz() > self.frequency_max_hz - self.frequency_min_hz:
            yield (
                "instantaneous_bandwidth_hz: must not exceed frequency_max_hz - frequency_min_hz"
            )
        if self.channel_bandwidth_hz > self._received_at_once_hz():
            yield "channel_bandwidth_hz: must not exceed what is received at once"
        if self.channel_bandwidth_hz * self.integration_s > MAX_SAMPLES:
            yield (f"integration_s: times channel_bandwidth_hz, at most {MAX_SAMPLES:g} samples")
        if self.classifier is not None and self.classifies:
            yield "classifier: leave it out, or leave out classifies"
        if self.elevation_baseline_m is not None and not self.measures_azimuth:
            yield "elevation_baseline_m: leave it out, for measures_azimuth is off"
        if self.measures_azimuth and self.baseline_m is None:
            yield "baseline_m: missing; a detector without one has measures_azimuth off"
        for name in self.report:
            if REPORT_FORMATS[name].needs_azimuth and not self.measures_azimuth:
                yield f"report: {name} carries bearings, and measures_azimuth is off"

    @property
    def band_hz(self) -> tuple[float, float]:
        """The band's ends."""
        return self.frequency_min_hz, self.frequency_max_hz

    @property
    def classes(self) -> tuple[str, ...]:
        """Kinds of emission that it reads, and what its classifier may say."""
        return tuple(dict.fromkeys([*super().classes, *filter(None, self.decodes)]))

    def _received_at_once_hz(self) -> float:
        if self.instantaneous_bandwidth_hz is not None:
            return self.instantaneous_bandwidth_hz
        return self.frequency_max_hz - self.frequency_min_hz

    def following(self, site: Site, /) -> dict[str, Any]:
        """What is received at once, the beams of its cover, and the path's loss."""
        path_loss, city = self.path_loss, None
        if isinstance(path_loss, CityLoss):
            city = replace(CITIES[path_loss.environment], shadowing_db=path_loss.shadowing_db)
        if not isinstance(path_loss, LogDistance):  # free space is log-distance with exponent 2
            path_loss = LogDistance(kind="log-distance", exponent=2.0)
        span_deg = self.azimuth_cover.span_deg
        beams = cells_across(span_deg, self.azimuth_beamwidth_deg or span_deg)
        return super().following(site) | {
            "instantaneous_bandwidth_hz": self._received_at_once_hz(),
            "city": city,
            "path_loss_exponent": path_loss.exponent,
            "path_loss_reference_m": path_loss.reference_m,
            "azimuth_beams": beams if self.measures_azimuth else 1.0,
            "baseline_m": self.baseline_m or 1.0,
            "decodes": frozenset(self.decodes),
        }

    def model(self, site: Site, /) -> Any:
        """The model among its jammers."""
        model: Any = super().model(site)
        places = [(jammer, self.offset_enu_m(site, jammer)) for jammer in self.jamming.values()]
        return replace(model, jammers=tuple(_band_noise(*each, model) for each in places))

    def warnings(self, _site: Site, /) -> Iterator[str]:
        """Energy summed for longer than a scan, odd values, and directions never measured."""
        yield from odd_frequency("frequency_min_hz", self.frequency_min_hz)
        yield from odd_frequency("frequency_max_hz", self.frequency_max_hz)
        if self.measures_azimuth:
            yield from odd_floor("azimuth_floor_deg", self.azimuth_floor_deg, RF_BEARING_DEG)
        if self.elevation_baseline_m is not None:
            yield from odd_floor("elevation_floor_deg", self.elevation_floor_deg, RF_BEARING_DEG)
        if self.integration_s > self.scan.period_s:
            yield (
                f"integration_s is {self.integration_s:g}, longer than a scan of "
                f"{self.scan.period_s:g} s: one emission would be counted in several scans"
            )
        if self.multipath is not None and isinstance(self.path_loss, LogDistance):
            yield "multipath counts the ground, which path_loss.exponent has counted already"
        unused = {"baseline_m", "azimuth_beamwidth_deg", "azimuth_floor_deg"}
        unused &= self.model_fields_set
        if unused and not self.measures_azimuth:
            yield f"{', '.join(sorted(unused))}: not used, for measures_azimuth is off"
