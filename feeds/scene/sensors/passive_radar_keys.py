"""The keys of a passive radar."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from plotfeed.feeds.scene.fields import (
    Beamwidth,
    Elevation,
    Loss,
    NotNegative,
    Positive,
    Probability,
    Site,
)
from plotfeed.feeds.scene.report_formats import TRACK_FORMATS
from plotfeed.feeds.scene.sensors.echo_radar_keys import EchoRadarKeys
from plotfeed.feeds.scene.sensors.effect_keys import (
    ANGLE_SHARE,
    RANGE_SHARE,
    DopplerKeys,
    MergingKeys,
    MultipathKeys,
    odd_floor,
    odd_frequency,
    stated_or,
)
from plotfeed.feeds.scene.sensors.illuminator_keys import IlluminatorKeys
from plotfeed.feeds.scene.sensors.scan_keys import StaringScan
from plotfeed.feeds.scene.sensors.sensor_keys import Reports, SensorGeometry, long_integration
from plotfeed.models.frames import enu_to_aer
from plotfeed.models.propagation import C_M_S, MAN_MADE, external_noise_db
from plotfeed.models.sensors.passive_radar import Illuminator, PassiveRadar

NotPositive = Annotated[float, Field(le=0)]
# Closer to the baseline, an error of bistatic range is over ten times larger in short range.
BLURRED_DEG = 26.0


class PassiveRadarKeys(EchoRadarKeys):
    """A radar without a transmitter. The defaults are the paper's typical values."""

    label = "passive radar"
    geometry = SensorGeometry.BISTATIC
    sapient_type = "RADAR"
    formats = ("asterix-015", *TRACK_FORMATS, "plots", "sapient")
    usual = ("asterix-015", "plots")
    makes = PassiveRadar
    legs = 1

    type: Literal["passive_radar"]
    report: Reports = ()
    """Without it, the first two; asterix-015 brings 025 along, and 016; asterix-062 brings 063."""
    scan: StaringScan
    transmitters: Annotated[
        tuple[IlluminatorKeys, ...], Field(strict=False, min_length=1, max_length=256)
    ]
    """Those whose signals it uses."""
    gain_rx_dbi: float | None = None
    """Without it, 41253 times efficiency over both beamwidths in degrees."""
    antenna_efficiency: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Of the receiving antenna: its gain over that of a lossless one."""
    azimuth_beamwidth_deg: Beamwidth
    """Of the receive beam, at 3 dB."""
    elevation_beamwidth_deg: Beamwidth | None = None
    """For the gain alone: elevation is not measured."""
    integration_s: Positive
    """Coherent."""
    loss_db: Loss = 4.0
    """Of the correlator's window and clutter filter, without the CFAR loss."""
    sidelobe_db: NotPositive = -22.0
    """By which the receive antenna hears the transmitters themselves; below its gain, negative."""
    cancellation_db: NotPositive = -60.0
    """What the canceller leaves of the direct signal; negative."""
    line_loss_db: Loss = 0.5
    """From antenna to receiver."""
    antenna_loss_db: Loss = 0.5
    """By the antenna's resistance."""
    receiver_noise_figure_db: Loss = 4.0
    """Of the receiver alone."""
    external_noise_db: float | None = None
    """What the antenna collects, F_a over k T0 B: man-made, galactic and atmospheric noise."""
    noise_environment: Literal["city", "residential", "rural", "quiet-rural"] | None = None
    """In its place, by Recommendation ITU-R P.372; to 250 MHz, quiet-rural to 100 MHz."""
    pfa: Probability = 1e-6
    """Probability of a false alarm in one resolution cell."""
    n_reference: Annotated[int, Field(ge=1, le=1_000_000)] = 16
    """Reference cells of the CA-CFAR."""
    elevation_min_deg: Elevation = -90.0
    """Where cover begins, above the sensor's horizontal."""
    elevation_max_deg: Elevation = 90.0
    """Where cover ends."""
    doppler_cells: Annotated[int, Field(ge=1)] = 1
    """Cells of velocity for each of range: each can give a false alarm."""
    bistatic_range_floor_m: NotNegative | None = None
    """Error that remains however strong the echo; without it, a twentieth of each channel's cell, c
    over the bandwidth."""
    azimuth_floor_deg: NotNegative | None = None
    """The same in azimuth; without it, a tenth of the beam."""
    expected_height_m: Annotated[float, Field(ge=-10_000, le=50_000)] = 60.0
    """Of drones above the sensor, by which plots are placed on the ground."""
    sigma_height_m: Annotated[float, Field(ge=0, le=50_000)] = 35.0
    """Standard deviation of such heights, of which the errors of places hold a part."""
    multipath: MultipathKeys | None = None
    """The ground's reflection, of echoes and of the transmitters themselves; without it, none."""
    doppler: DopplerKeys | None = None
    """Without it, no range rates."""
    merging: MergingKeys | None = None
    """Without it, every drone is seen by itself; its elevation_deg is not used."""

    @model_validator(mode="before")
    @classmethod
    def _has_no_pulses(cls, keys: Any) -> Any:
        if isinstance(keys, dict) and "pulses" in keys:
            raise ValueError(
                "pulses: broadcasts have none: no range folds, no echo is eclipsed and no speed is "
                "blind; doppler.notch_m_s filters clutter"
            )
        return keys

    def _refusals(self) -> Iterator[str]:
        if self.gain_rx_dbi is None and self.elevation_beamwidth_deg is None:
            yield ("gain_rx_dbi: needed, or elevation_beamwidth_deg from which it follows")
        if self.external_noise_db is not None and self.noise_environment is not None:
            yield "noise_environment: leave it out, or leave out external_noise_db"
        ids = [t.id for t in self.transmitters]
        twice = {name for name in ids if ids.count(name) > 1}
        if twice:
            yield f"transmitters: the id {min(twice)!r} is used twice"
        for transmitter in self.transmitters:
            self._noise_db(transmitter)

    def _noise_db(self, transmitter: IlluminatorKeys) -> float:
        """External noise in a transmitter's channel; raises ValueError where none is known."""
        for stated_db in (transmitter.external_noise_db, self.external_noise_db):
            if stated_db is not None:
                return stated_db
        if self.noise_environment is None:
            raise ValueError("external_noise_db: needed, or noise_environment")
        noise_db = float(external_noise_db(self.noise_environment, transmitter.frequency_hz))
        if np.isnan(noise_db):
            line = MAN_MADE[self.noise_environment]
            raise ValueError(
                f"noise_environment: ITU-R P.372 gives {self.noise_environment} noise from "
                f"{line.min_mhz:g} to {line.max_mhz:g} MHz, not at the "
                f"{transmitter.frequency_hz / 1e6:g} MHz of {transmitter.id}: "
                "give external_noise_db"
            )
        return noise_db

    @property
    def illuminators(self) -> tuple[IlluminatorKeys, ...]:
        """All of its transmitters."""
        return self.transmitters

    def following(self, site: Site, /) -> dict[str, Any]:
        """What of any radar, the transmitters as the receiver sees them, and the error floor."""
        return super().following(site) | {
            "transmitters": tuple(self._transmitter(t, site) for t in self.transmitters),
            "azimuth_floor_deg": stated_or(self.azimuth_floor_deg, self._usual_azimuth_deg()),
        }

    @property
    def signals_hz(self) -> Sequence[tuple[float, float]]:
        """Carriers and bandwidths of its transmitters."""
        return [(t.frequency_hz, t.bandwidth_hz) for t in self.transmitters]

    @property
    def range_cells_m(self) -> Sequence[float]:
        """Cells of bistatic range of its channels."""
        return [C_M_S / t.bandwidth_hz for t in self.transmitters]

    def _usual_azimuth_deg(self) -> float:
        return ANGLE_SHARE * self.azimuth_beamwidth_deg

    def _transmitter(self, part: IlluminatorKeys, site: Site) -> Illuminator:
        return part.made(
            Illuminator,
            position_enu_m=self.offset_enu_m(site, part.place),
            external_noise_db=self._noise_db(part),
            range_floor_m=stated_or(
                self.bistatic_range_floor_m, RANGE_SHARE * C_M_S / part.bandwidth_hz
            ),
        )

    def warnings(self, site: Site, /) -> Iterator[str]:
        """An integration longer than a scan, odd accuracies, and what lies near a baseline."""
        model: PassiveRadar = self.model(site)
        azimuths_deg, _, baselines_m = enu_to_aer(model.positions_enu_m)
        yield from long_integration(self.integration_s, self.scan)
        yield from self._odd_values()
        for part, azimuth_deg, baseline_m in zip(
            self.transmitters, azimuths_deg, baselines_m, strict=True
        ):
            yield from self._blurred(model, part.id, float(azimuth_deg), float(baseline_m))

    def _odd_values(self) -> Iterator[str]:
        """Floors that no such radar has by its finest channel, and carriers that none has."""
        for part in self.transmitters:
            yield from odd_frequency(f"frequency_hz of {part.id}", part.frequency_hz)
        finest_m = C_M_S / max(part.bandwidth_hz for part in self.transmitters)
        usual_m = RANGE_SHARE * finest_m
        yield from odd_floor("bistatic_range_floor_m", self.bistatic_range_floor_m, usual_m)
        usual_deg = self._usual_azimuth_deg()
        yield from odd_floor("azimuth_floor_deg", self.azimuth_floor_deg, usual_deg)
        if self.doppler is not None:
            highest_hz = max(part.frequency_hz for part in self.transmitters)
            yield from self.doppler.odd_floor(C_M_S / highest_hz / self.integration_s)

    @staticmethod
    def _blurred(
        model: PassiveRadar, name: str, azimuth_deg: float, baseline_m: float
    ) -> Iterator[str]:
        """Whether the cover has directions in which a bistatic range says little of the range."""
        if not baseline_m >= 1.0:
            yield f"transmitter {name} stands where the receiver does: nothing is heard beside it"
            return
        near_deg = azimuth_deg + np.linspace(-BLURRED_DEG, BLURRED_DEG, 105)
        if model.azimuth_cover.holds(near_deg).any():
            yield (
                f"within {BLURRED_DEG:g} degrees of transmitter {name}, at azimuth "
                f"{azimuth_deg:.1f}, errors of bistatic range become ten times larger in range and "
                "more; on the line to it there are no plots"
            )
