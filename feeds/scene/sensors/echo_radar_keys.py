"""The keys that all radars have of what becomes of their echoes, by their antennas and cells."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from plotfeed.feeds.scene.fields import Azimuth, Beamwidth, Decibels, Loss, SceneTable, Site
from plotfeed.feeds.scene.sensors.effect_keys import DopplerKeys, MergingKeys, stated_or
from plotfeed.feeds.scene.sensors.sensor_keys import TrackingSensorKeys, VolumeKeys
from plotfeed.feeds.scene.world_keys import JammerKeys, WeatherKeys
from plotfeed.models.effects.echo_effects import (
    Antenna,
    BeamCut,
    CosecantSquaredCut,
    EchoEffect,
    EchoEffects,
    GaussianCut,
    Pattern,
    Straddling,
    TableCut,
    cosecant_peak_loss_db,
)
from plotfeed.models.frames import enu_to_aer
from plotfeed.models.propagation import C_M_S, beam_gain_dbi
from plotfeed.models.sensors.active_radar import ActiveRadar
from plotfeed.models.sensors.polar_radar import EchoRadar
from plotfeed.proto.utc import NS

if TYPE_CHECKING:
    from plotfeed.models.effects.doppler import Doppler
    from plotfeed.models.effects.jamming import Jammer
    from plotfeed.models.effects.merging import Merging

PAPER_SIDELOBE_DB = 22.0  # Of the paper's passive radar
CellShape = Literal["sinc", "triangle", "hann"]


class BeamCover(NamedTuple):
    """A sensor's beamwidth at 3 dB over one angle, and the cover, for what a cut does not state."""

    beamwidth_deg: float
    min_deg: float
    max_deg: float

    @property
    def middle_deg(self) -> float:
        """The middle of the cover."""
        return (self.min_deg + self.max_deg) / 2


class _Beam(SceneTable):
    """What cuts with a boresight have in common."""

    boresight_deg: Azimuth | None = None
    """Where the peak is; without it, in the middle of the cover."""


class GaussianCutKeys(_Beam):
    """One beam of Gaussian shape."""

    kind: Literal["gaussian"]
    beamwidth_deg: Beamwidth | None = None
    """At 3 dB; without it, the sensor's."""

    def model(self, cover: BeamCover) -> BeamCut:
        """The beam of a sensor with that cover."""
        return GaussianCut(
            beamwidth_deg=self.beamwidth_deg or cover.beamwidth_deg,
            boresight_deg=stated_or(self.boresight_deg, cover.middle_deg),
        )


class BeamsCutKeys(SceneTable):
    """Gaussian beams side by side over the cover, by the nearest of which a target is seen."""

    kind: Literal["beams"]
    beamwidth_deg: Beamwidth | None = None
    """At 3 dB; without it, the sensor's."""
    spacing_deg: Beamwidth | None = None
    """Between beams at most; without it, a beamwidth."""

    def model(self, cover: BeamCover) -> BeamCut:
        """The beams of a sensor with that cover."""
        width_deg = self.beamwidth_deg or cover.beamwidth_deg
        span_deg = cover.max_deg - cover.min_deg
        beams = max(int(np.ceil(span_deg / (self.spacing_deg or width_deg) * (1 - 1e-12))), 1)
        return GaussianCut(
            beamwidth_deg=width_deg,
            boresight_deg=cover.middle_deg,
            spacing_deg=span_deg / beams,
            beams=beams,
        )


class CosecantSquaredKeys(SceneTable):
    """Equal echoes at any range of a target that keeps its height."""

    kind: Literal["cosecant-squared"]
    from_deg: Annotated[float, Field(gt=0, lt=90)]
    """Elevation of the peak, from which the gain goes as 1/sin^2."""
    to_deg: Annotated[float, Field(gt=0, lt=90)]
    """Elevation up to which it does."""
    beamwidth_deg: Beamwidth | None = None
    """At 3 dB, beyond the two; without it, the sensor's."""

    def _refusals(self) -> Iterator[str]:
        if not self.from_deg < self.to_deg:
            yield "to_deg: must be above from_deg"

    def model(self, cover: BeamCover) -> BeamCut:
        """The beam of a sensor with that cover."""
        width_deg = self.beamwidth_deg or cover.beamwidth_deg
        return self.made(CosecantSquaredCut, beamwidth_deg=width_deg)


class TableCutKeys(_Beam):
    """Gains as they were measured, or as somebody else has worked them out."""

    kind: Literal["table"]
    angle_deg: Annotated[tuple[Azimuth, ...], Field(strict=False, min_length=2, max_length=10_000)]
    """Off the boresight, rising."""
    gain_db: Annotated[tuple[Decibels, ...], Field(strict=False, min_length=2, max_length=10_000)]
    """At those, one way, beside the antenna's stated gain; linear in between."""

    def _refusals(self) -> Iterator[str]:
        if len(self.angle_deg) != len(self.gain_db):
            yield "gain_db: as many as angle_deg are needed"
        if (np.diff(self.angle_deg) <= 0).any():
            yield "angle_deg: must rise"

    def model(self, cover: BeamCover) -> BeamCut:
        """The beam of a sensor with that cover."""
        return TableCut(
            angles_deg=self.angle_deg,
            gains_db=self.gain_db,
            boresight_deg=stated_or(self.boresight_deg, cover.middle_deg),
        )


AzimuthCut = Annotated[GaussianCutKeys | BeamsCutKeys | TableCutKeys, Field(discriminator="kind")]
ElevationCut = Annotated[
    GaussianCutKeys | BeamsCutKeys | CosecantSquaredKeys | TableCutKeys, Field(discriminator="kind")
]


class PatternKeys(SceneTable):
    """Gain by direction, relative to what the sensor states."""

    azimuth: AzimuthCut | None = None
    """Without it, the same at all azimuths; a turning beam meets drones in its middle."""
    elevation: ElevationCut | None = None
    """Without it, the same at all elevations of the cover."""
    sidelobe_db: Loss = PAPER_SIDELOBE_DB
    """Nowhere is the gain further below the peak, one way."""

    def model(self, azimuth: BeamCover, elevation: BeamCover) -> Pattern:
        """The pattern of a sensor with those covers."""
        return self.made(
            Pattern,
            azimuth=self.azimuth and self.azimuth.model(azimuth),
            elevation=self.elevation and self.elevation.model(elevation),
        )


class AntennaKeys(SceneTable):
    """Gains that depend on where a target is, by the sensor's own axes."""

    transmit: PatternKeys | None = None
    """Of each transmitter; without it, the same over the cover."""
    receive: PatternKeys | None = None
    """Of the receiving antenna; without it, the same over the cover."""
    sidelobe_plots: bool = False
    """Whether side lobes report drones too: at their range, in the beam's direction, as sidelobe/ID
    in the ledger."""

    def model(self, azimuth: BeamCover, elevation: BeamCover) -> Antenna:
        """The antenna of a sensor with those covers."""
        transmit, receive = (
            None if part is None else part.model(azimuth, elevation)
            for part in (self.transmit, self.receive)
        )
        return Antenna(transmit=transmit, receive=receive, shows_sidelobes=self.sidelobe_plots)

    def _refusals(self) -> Iterator[str]:
        if self.sidelobe_plots and self.receive is None:
            yield "sidelobe_plots: needs receive, whose sidelobe_db they come by"

    @property
    def peak_loss_db(self) -> float:
        """What the shape of the receiving beam costs at its peak, by the beamwidths alone."""
        cut = None if self.receive is None else self.receive.elevation
        if not isinstance(cut, CosecantSquaredKeys):
            return 0.0
        return float(cosecant_peak_loss_db(cut.from_deg, cut.to_deg))

    @property
    def has_azimuths(self) -> bool:
        """Whether a pattern depends on the azimuth."""
        return any(part is not None and part.azimuth for part in (self.transmit, self.receive))


class StraddlingKeys(SceneTable):
    """Loss between the middles of cells, by where the target is in them."""

    range: CellShape | None = None
    """Of a range cell: sinc of a flat spectrum, triangle of a pulse, hann."""
    doppler: CellShape | None = None
    """The same of a Doppler cell; hann's noise, 1.76 dB more, belongs in loss_db."""


def weather_effects(
    weather: WeatherKeys, signals_hz: Sequence[tuple[float, float]], model: EchoRadar
) -> list[EchoEffect]:
    """What weather does to echoes of such signals."""
    frequency_hz = np.array(signals_hz)[:, 0]
    db_per_km = np.zeros(len(frequency_hz))
    from plotfeed.models.effects.weather import (
        Air,
        RainEcho,
        gases_db_per_km,
        rain_db_per_km,
        rain_reflectivity_m2_m3,
    )

    if weather.rain_mm_h:
        db_per_km += rain_db_per_km(frequency_hz, weather.rain_mm_h, weather.polarisation)
    if weather.vapour_g_m3 is not None:
        db_per_km += np.nan_to_num(gases_db_per_km(frequency_hz, weather.vapour_g_m3))
    met: list[EchoEffect] = [Air(tuple(db_per_km.tolist()))] if db_per_km.any() else []
    if weather.rain_echo and weather.rain_mm_h and isinstance(model, ActiveRadar):
        beams_deg2 = model.azimuth_beamwidth_deg * model.elevation_beamwidth_deg
        sends_back = rain_reflectivity_m2_m3(C_M_S / model.frequency_hz, weather.rain_mm_h)
        met.append(
            RainEcho.of(
                model.snr_of_unit,
                float(sends_back),
                beams_deg2 * float(np.radians(1.0)) ** 2,
                model.range_resolution_m,
                float(db_per_km[0]),
            )
        )
    return met


def jammer_seen(
    keys: JammerKeys,
    position_enu_m: tuple[float, float, float],
    signals_hz: Sequence[tuple[float, float]],
    model: EchoRadar,
) -> Jammer:
    """A jammer as a radar has it that is at the origin."""
    azimuth_deg, elevation_deg, range_m = (float(x) for x in enu_to_aer(np.array(position_enu_m)))
    frequency_hz, bandwidth_hz = np.array(signals_hz).T
    from plotfeed.models.effects.jamming import Jammer, jamming_over_noise

    over_noise = jamming_over_noise(
        eirp_w=keys.eirp_w,
        jammer_hz=keys.frequency_hz,
        jammer_width_hz=keys.bandwidth_hz,
        range_m=range_m,
        gain_dbi=model.gain_rx_dbi,
        frequency_hz=frequency_hz,
        bandwidth_hz=bandwidth_hz,
        noise_w_hz=model.receiver_noise_w_hz,
    )
    return keys.made(
        Jammer,
        position_enu_m=position_enu_m,
        azimuth_deg=float(np.nan_to_num(azimuth_deg)),
        elevation_deg=float(np.nan_to_num(elevation_deg)),
        over_noise=tuple(over_noise.tolist()),
    )


class EchoRadarKeys(TrackingSensorKeys, VolumeKeys):
    """A radar, whatever makes its echoes: what a scene may name of what they lose."""

    if TYPE_CHECKING:  # keys of every radar, which stand where each of them has them
        azimuth_beamwidth_deg: float
        elevation_beamwidth_deg: float | None
        doppler: DopplerKeys | None
        merging: MergingKeys | None
        gain_rx_dbi: float | None
        antenna_efficiency: float
        integration_s: float

    legs: ClassVar[int] = 2
    """Ways of a signal that grow as the target recedes."""

    antenna: AntennaKeys | None = None
    """Without it, the gains are the same over the whole cover."""
    straddling: StraddlingKeys | None = None
    """Without it, nothing is lost between the middles of cells."""

    def _refusals(self) -> Iterator[str]:
        if self.straddling is not None and self.straddling.doppler and self.doppler is None:
            yield "straddling.doppler: needs doppler"
        if self.antenna is None:
            return
        if self.scan.rotates and self.antenna.has_azimuths:
            yield (
                "antenna: azimuth is for radars that stare: a beam that turns meets every drone "
                "in its middle"
            )
        if self.illuminators and self.antenna.transmit is not None:
            yield "antenna.transmit: this radar transmits nothing"
        steered = getattr(self, "mount", None) is not None or self.scan.kind == "electronic"
        if self.antenna.sidelobe_plots and (self.illuminators or steered):
            yield ("antenna.sidelobe_plots: not of a passive radar, nor of a beam that is steered")

    @property
    def signals_hz(self) -> Sequence[tuple[float, float]]:
        """Carrier and bandwidth of each of its signals; one, if they share a band."""
        raise NotImplementedError

    @property
    def range_cells_m(self) -> Sequence[float]:
        """Widths of the cells of range, or bistatic range, of each."""
        raise NotImplementedError

    def following(self, site: Site, /) -> dict[str, Any]:
        """The receive gain, which may be that of the beam, and what is made of cells and beams."""
        gain_rx_dbi, doppler = self.gain_rx_dbi or 0.0, self._doppler()
        if self.gain_rx_dbi is None and self.elevation_beamwidth_deg is not None:
            widths_deg = self.azimuth_beamwidth_deg, self.elevation_beamwidth_deg
            gain_rx_dbi = float(beam_gain_dbi(*widths_deg, self.antenna_efficiency))
            gain_rx_dbi -= 0.0 if self.antenna is None else self.antenna.peak_loss_db
        made = {"gain_rx_dbi": gain_rx_dbi, "doppler": doppler, "merging": self._merging(doppler)}
        return super().following(site) | made

    def _doppler(self) -> Doppler | None:
        if self.doppler is None:
            return None
        wavelengths_m = [C_M_S / frequency_hz for frequency_hz, _ in self.signals_hz]
        return self.doppler.model(wavelengths_m, self.integration_s, self.legs)

    def _merging(self, doppler: Doppler | None) -> Merging | None:
        """Merging for the model, by its cells and beams where the keys state no widths."""
        keys, rates_m_s, rate_period = self.merging, None, 0.0
        if keys is None:
            return None
        from plotfeed.models.effects.merging import Merging

        if doppler is not None:
            rates_m_s = tuple(keys.range_rate_m_s or cell for cell in doppler.cells_m_s)
            rate_period = doppler.spans_m_s[0] / rates_m_s[0] if doppler.folds else 0.0
        elevation_deg = keys.elevation_deg or self.elevation_beamwidth_deg
        return Merging(
            range_m=tuple(keys.range_m or cell for cell in self.range_cells_m),
            azimuth_deg=keys.azimuth_deg or self.azimuth_beamwidth_deg,
            elevation_deg=elevation_deg if getattr(self, "measures_elevation", False) else None,
            range_rate_m_s=rates_m_s,
            range_rate_period=rate_period,
            longest_ns=round(self.scan.period_s * NS / 2),
        )

    def model(self, site: Site, /) -> Any:
        """The model in its weather, among its jammers."""
        model: Any = super().model(site)
        met: list[EchoEffect] = []
        if self.weather is not None:
            met += weather_effects(self.weather, self.signals_hz, model)
        if self.jamming:
            from plotfeed.models.effects.jamming import Jamming

            seen = (
                jammer_seen(jammer, self.offset_enu_m(site, jammer), self.signals_hz, model)
                for jammer in self.jamming.values()
            )
            met.append(self.made(Jamming, jammers=tuple(seen)))
        if not met:
            return model
        effects = model.echo_effects or EchoEffects()
        return replace(model, echo_effects=replace(effects, in_the_world=tuple(met)))

    @property
    def echo_effects(self) -> EchoEffects | None:
        """What becomes of echoes' powers, by the cells of signals; None if nothing is named."""
        if self.antenna is None and self.straddling is None:
            return None
        low_deg, high_deg = self.elevation_min_deg, self.elevation_max_deg
        azimuth = BeamCover(self.azimuth_beamwidth_deg, self.azimuth_min_deg, self.azimuth_max_deg)
        elevation = BeamCover(self.elevation_beamwidth_deg or high_deg - low_deg, low_deg, high_deg)
        straddling, doppler = None, self._doppler()
        if self.straddling is not None:
            straddling = Straddling(
                range_cells_m=tuple(self.range_cells_m),
                range_shape=self.straddling.range,
                doppler_cells_m_s=() if doppler is None else doppler.cells_m_s,
                doppler_shape=self.straddling.doppler,
            )
        antenna = None if self.antenna is None else self.antenna.model(azimuth, elevation)
        return EchoEffects(antenna=antenna, straddling=straddling)
