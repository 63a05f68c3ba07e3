"""What an RF sensor receives of emissions: propagation, band, bursts and an energy detector."""

from __future__ import annotations

from abc import ABC
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np

from plotfeed.models import detection, propagation
from plotfeed.models.effects.jamming import BandNoise, behind
from plotfeed.models.emitters import Emissions, EmitterTable
from plotfeed.models.false_alarms import cells_across
from plotfeed.models.frames import enu_to_aer
from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.propagation import C_M_S
from plotfeed.models.sensors.radio_sensor import RadioSensor
from plotfeed.models.sensors.sensor_model import CellSensor, Targets
from plotfeed.models.sensors.stacking import sensor_property
from plotfeed.models.state import Floats

if TYPE_CHECKING:
    from plotfeed.models.effects.city import City
    from plotfeed.models.effects.surroundings import OnTheWay


def emissions_of(targets: Targets) -> Emissions:
    """What targets emit, a row an emitter, in the order of the targets."""
    return EmitterTable.of(targets.signatures.emitters).emissions(targets.drone)


@dataclass(frozen=True, kw_only=True)
class RfReceiver(RadioSensor, CellSensor, ABC):
    """What the equations of reception need.

    `channel_bandwidth_hz` is that in which energy is summed and noise with it, and
    `instantaneous_bandwidth_hz` how much of the band is received at once. A `path_loss_exponent`
    of 2 is free space. `azimuth_beams` are cells for false alarms: the cover over a beam. Without
    `multipath` there is no ground. Jammers are those whose noise is in emissions' channels.
    """

    frequency_min_hz: float
    frequency_max_hz: float
    instantaneous_bandwidth_hz: float
    channel_bandwidth_hz: float
    integration_s: float
    gain_rx_dbi: float
    loss_db: float
    noise_figure_db: float
    path_loss_exponent: float
    path_loss_reference_m: float
    duty_cycle: float
    bursts_per_dwell: int
    azimuth_beams: float
    jammers: tuple[BandNoise, ...] = ()
    city: City | None = None

    def with_jammers_behind(self, way: OnTheWay) -> Self:
        """The receiver with what an obstruction leaves of its jammers."""
        return replace(self, jammers=behind(self.jammers, way))

    @cached_property
    def samples(self) -> int:
        """How many independent ones the detector sums: bandwidth times time."""
        return max(round(self.channel_bandwidth_hz * self.integration_s), 1)

    @property
    def draws_by_pair(self) -> bool:
        """Whether houses hide some drones."""
        return self.city is not None

    @property
    def receiver_noise_w_hz(self) -> Floats:
        """Density of the receiver's noise, watts in a hertz; (1,)."""
        return np.array([float(propagation.noise_density_w_hz(self.noise_figure_db))])

    @sensor_property
    def noise_dbm(self) -> float:
        """Noise power in one channel: -174 dBm in one hertz, and the noise figure."""
        density_w_hz = propagation.noise_density_w_hz(self.noise_figure_db)
        return float(10 * np.log10(density_w_hz * self.channel_bandwidth_hz) + 30)

    @cached_property
    def resolution_cells(self) -> float:
        """Channels that are received at once, each in every beam."""
        channels = cells_across(self.instantaneous_bandwidth_hz, self.channel_bandwidth_hz)
        return channels * self.azimuth_beams

    @nan_without_warnings
    def width_in_band_hz(self, frequency_hz: Floats, bandwidth_hz: Floats) -> Floats:
        """How much of emissions lies in the sensor's band; negative for those beside it."""
        low_hz = np.maximum(frequency_hz - bandwidth_hz / 2, self.frequency_min_hz)
        high_hz = np.minimum(frequency_hz + bandwidth_hz / 2, self.frequency_max_hz)
        return high_hz - low_hz

    @nan_without_warnings
    def share_in_band(self, frequency_hz: Floats, bandwidth_hz: Floats) -> Floats:
        """The share of emissions' power that lies in the sensor's band; a carrier's is 0 or 1."""
        width_hz = self.width_in_band_hz(frequency_hz, bandwidth_hz)
        carrier = np.where(width_hz >= 0, 1.0, 0.0)
        return np.where(bandwidth_hz > 0, np.clip(width_hz / bandwidth_hz, 0.0, 1.0), carrier)

    def received_share(self, emissions: Emissions) -> Floats:
        """The share of each emission's power that lies in the band, as it may be known already."""
        if emissions.share is not None:
            return emissions.share
        return self.share_in_band(emissions.frequency_hz, emissions.bandwidth_hz)

    @nan_without_warnings
    def intercept_probability(self, frequency_hz: Floats, bandwidth_hz: Floats) -> Floats:
        """Probability that a burst or more falls into the dwell, where it is tuned: 1 - (1-p)^n.

        p is the duty cycle times the share of the hops in the band that are received at once.
        """
        width_hz = np.maximum(self.width_in_band_hz(frequency_hz, bandwidth_hz), 0.0)
        tuned = np.minimum(self.instantaneous_bandwidth_hz / width_hz, 1.0)
        log_missed = self.bursts_per_dwell * np.log1p(-self.duty_cycle * tuned)
        return np.asarray(-np.expm1(log_missed))

    @nan_without_warnings
    def mean_snr(self, emissions: Emissions, range_m: Floats) -> Floats:
        """Signal-to-noise ratio of one sample, linear, of emissions at those ranges; (n,)."""
        loss_db = self.loss_db + propagation.path_loss_db(
            range_m,
            C_M_S / emissions.frequency_hz,
            self.path_loss_exponent,
            self.path_loss_reference_m,
        )
        received_dbm = emissions.eirp_dbm + self.gain_rx_dbi - loss_db
        return self.received_share(emissions) * 10 ** ((received_dbm - self.noise_dbm) / 10)

    def received_snr(self, emissions: Emissions, targets: Targets, range_m: Floats) -> Floats:
        """Ratios of emissions over the ground, if it is modelled; ranges are the targets'."""
        source = emissions.target
        snr = self.mean_snr(emissions, range_m[source])
        if not self.is_in_free_space:
            wavelength_m = C_M_S / emissions.frequency_hz
            snr *= self.way_factor(targets.true_position_enu_m[source], wavelength_m)
        if self.city is not None:
            elevation_deg = enu_to_aer(targets.true_position_enu_m)[1]
            snr *= self.city.power_factor(elevation_deg, targets.pair_draws)[source]
        if self.jammers:
            noise = sum(jammer.over_noise_at(emissions.frequency_hz) for jammer in self.jammers)
            snr /= 1 + noise
        return snr

    def pd(self, emissions: Emissions, snr: Floats) -> Floats:
        """Probability that an emission comes, is listened to and crosses the threshold; (n,)."""
        intercepted = self.intercept_probability(emissions.frequency_hz, emissions.bandwidth_hz)
        crossed = detection.pd_noncoherent_swerling2(snr, self.pfa, self.samples)
        return np.where(self.received_share(emissions) > 0, intercepted * crossed, 0.0)
