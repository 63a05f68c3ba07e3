"""The keys of microphone arrays, by themselves or in pairs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from plotfeed.feeds.scene.fields import (
    Azimuth,
    Beamwidth,
    Decibels,
    Location,
    Loss,
    NotNegative,
    Probability,
    SceneTable,
    Site,
)
from plotfeed.feeds.scene.sensors.effect_keys import (
    SOUND_BEARING_DEG,
    ClassifierKeys,
    odd_floor,
    refused_bias,
)
from plotfeed.feeds.scene.sensors.scan_keys import StaringScan
from plotfeed.feeds.scene.sensors.sensor_keys import AzimuthCoverKeys, Reports, SensorGeometry
from plotfeed.models.effects.microphone_layout import MicrophoneLayout
from plotfeed.models.effects.weather import wind_noise_db
from plotfeed.models.frames import wrap_360
from plotfeed.models.propagation import sound_absorption_db_per_m, speed_of_sound_m_s
from plotfeed.models.sensors.acoustic import AcousticPair, MicrophoneArray

SHORTEST_BASELINE = 0.05  # Of the furthest that two arrays hear, for bearings to cross
FEWEST_IN_A_LAYOUT = 3
# A bearing takes some revolutions of the rotors; a drone's blades pass at about 100 to 300 Hz.
SHORTEST_LISTENING_S = 0.1


class LayoutKeys(SceneTable):
    """Where the microphones lie, from which the errors of directions follow."""

    shape: Literal["line", "circle", "rectangle"]
    """A line tells neither sides nor elevations; a rectangle is nearly square."""
    spacing_m: Annotated[float, Field(ge=0.001, le=100)]
    """Between neighbours; 0.3 to 0.6 m is usual."""
    azimuth_deg: Azimuth = 0.0
    """Where the line, or the longer side of the rectangle, points."""


class MicrophoneKeys(AzimuthCoverKeys):
    """Microphone arrays. The defaults are the paper's typical values."""

    sapient_type = "ACOUSTIC"
    formats = ("asterix-015", "plots", "sapient")
    usual = ("asterix-015", "plots")
    makes = MicrophoneArray

    report: Reports = ()
    """Without it, the first two; asterix-015 brings 025 along."""
    scan: StaringScan
    noise_db: Decibels
    """Of the surroundings and the microphones, in the band; re 20 uPa."""
    windscreen_m: Annotated[float, Field(ge=0.005, le=1)] = 0.1
    """Diameter of each microphone's, by which it hears the weather's wind."""
    sensitivity_db: Decibels
    """The signal-to-noise ratio, behind the array, at which Pd is one half."""
    slope_per_db: Annotated[float, Field(ge=0.01, le=100)] = 1.0
    """Of the logit of Pd."""
    microphones: Annotated[int, Field(ge=1, le=100_000)] = 1
    """In the array; 4 to 16 are usual."""
    layout: LayoutKeys | None = None
    """How they lie; without it, errors are those of the beamwidths."""
    array_gain_db: Decibels | None = None
    """Without it, 10 log10 of the number of microphones."""
    frequency_hz: Annotated[float, Field(ge=10, le=20_000)] = 1000.0
    """The middle of the band; for the absorption of the air, and the errors by a layout."""
    temperature_c: Annotated[float, Field(ge=-60, le=60)] = 20.0
    """For the speed of sound too."""
    humidity_pct: Annotated[float, Field(ge=0, le=100)] = 70.0
    """Relative."""
    pressure_kpa: Annotated[float, Field(ge=20, le=200)] = 101.325
    """Of the air."""
    absorption_db_per_km: Loss | None = None
    """By the air; without it, by ISO 9613-1 from the four keys above."""
    directivity_db: Decibels = 3.0
    """What the drone radiates this way over its mean in all directions."""
    barrier_db: Loss = 3.0
    """What stands in the way."""
    misc_db: Loss = 3.0
    """Foliage and houses."""
    height_above_ground_m: Annotated[float, Field(ge=0, le=1000)] = 1.5
    """Of the array, over flat ground."""
    pfa: Probability = 1e-6
    """Probability of a false alarm in one beam, in one scan; beams fill the cover, in elevation too
    if they have a width there."""
    range_max_m: Annotated[float, Field(gt=0, le=10_000)]
    """Further away nothing is heard, however loud."""
    azimuth_beamwidth_deg: Beamwidth
    """Of the array, at 3 dB."""
    elevation_beamwidth_deg: Beamwidth | None = None
    """Without it, the array measures no elevation."""
    azimuth_floor_deg: NotNegative = SOUND_BEARING_DEG
    """Error that remains however loud the drone: wind, ground, and places of microphones."""
    elevation_floor_deg: NotNegative = SOUND_BEARING_DEG
    """The same in elevation; both are added in quadrature."""
    kind: str = ""
    """What the array calls everything that it hears, such as drone; "" if it does not classify."""
    classifier: ClassifierKeys | None = None
    """In its place, what each `target_class` is called, rightly or wrongly."""

    def _refusals(self) -> Iterator[str]:
        if self.classifier is not None and self.kind:
            yield "classifier: leave it out, or leave out kind"
        if self.layout is None:
            return
        if self.microphones < FEWEST_IN_A_LAYOUT:
            yield f"microphones: a layout has at least {FEWEST_IN_A_LAYOUT}"
        if self.layout.shape == "rectangle" and self.microphones % 2:
            yield "microphones: a rectangle has an even number"
        if self.layout.shape == "line" and self.elevation_beamwidth_deg is not None:
            yield "elevation_beamwidth_deg: a line of microphones tells no elevations"

    @property
    def classes(self) -> tuple[str, ...]:
        """Names that it may say: the one for everything, or the classifier's."""
        return (self.kind,) if self.kind else super().classes

    @property
    def sound_speed_m_s(self) -> float:
        """Speed of sound at the temperature of the air."""
        return float(speed_of_sound_m_s(self.temperature_c))

    @property
    def absorption_db_per_m(self) -> float:
        """Absorption by the air, as it is given or as the weather makes it."""
        if self.absorption_db_per_km is not None:
            return self.absorption_db_per_km / 1000
        return float(
            sound_absorption_db_per_m(
                self.frequency_hz, self.temperature_c, self.humidity_pct, self.pressure_kpa
            )
        )

    def following(self, site: Site, /) -> dict[str, Any]:
        """Gain of the array, noise with that of the wind, and the layout."""
        gain_db, layout, noise_db = self.array_gain_db, self.layout, self.noise_db
        if self.weather is not None and self.weather.wind_m_s:  # powers are added
            of_wind = self.weather.wind_m_s, self.frequency_hz, self.windscreen_m
            powers = 10 ** (noise_db / 10) + 10 ** (wind_noise_db(*of_wind) / 10)
            noise_db = float(10 * np.log10(powers))
        return super().following(site) | {
            "array_gain_db": float(10 * np.log10(self.microphones)) if gain_db is None else gain_db,
            "noise_db": noise_db,
            "layout": layout
            and layout.made(
                MicrophoneLayout,
                microphones=self.microphones,
                wavelength_m=self.sound_speed_m_s / self.frequency_hz,
            ),
        }

    def warnings(self, _site: Site, /) -> Iterator[str]:
        """Odd accuracies, scans too short to hear anything in, and a gain given twice."""
        yield from odd_floor("azimuth_floor_deg", self.azimuth_floor_deg, SOUND_BEARING_DEG)
        if self.elevation_beamwidth_deg is not None:
            yield from odd_floor("elevation_floor_deg", self.elevation_floor_deg, SOUND_BEARING_DEG)
        if self.scan.period_s < SHORTEST_LISTENING_S:
            yield (
                f"scan.period_s is {self.scan.period_s:g}: an array listens for at least "
                f"{SHORTEST_LISTENING_S:g} s for one bearing, so scans this short would not be "
                "independent of each other"
            )
        if self.layout is not None:
            yield from self._ambiguous(self.layout)
        elif self.array_gain_db is not None and "microphones" in self.model_fields_set:
            yield "microphones is not used: array_gain_db is given"

    def _ambiguous(self, layout: LayoutKeys) -> Iterator[str]:
        """Sides that a line cannot tell apart, and waves that are too short for the spacing."""
        wavelength_m = self.sound_speed_m_s / self.frequency_hz
        if layout.spacing_m > wavelength_m / 2:
            yield (
                f"layout.spacing_m is {layout.spacing_m:g}, more than half a wavelength at "
                f"{self.frequency_hz:g} Hz, {wavelength_m / 2:.2g} m: directions would be "
                "ambiguous, which is not modelled"
            )
        from_line_deg = np.arange(1.0, 180.0)
        sides = (layout.azimuth_deg + from_line_deg, layout.azimuth_deg - from_line_deg)
        both = np.logical_and(*(self.azimuth_cover.holds(wrap_360(side)) for side in sides))
        if layout.shape == "line" and both.any():
            yield (
                "a line of microphones cannot tell its sides apart, and the cover holds both: "
                "half of the plots there are on the wrong one"
            )


class AcousticKeys(MicrophoneKeys):
    """A microphone array, which hears bearings. The defaults are the paper's typical values."""

    label = "acoustic"
    geometry = SensorGeometry.BEARINGS

    type: Literal["acoustic"]


class AcousticPairKeys(MicrophoneKeys):
    """Two like microphone arrays whose bearings cross: plots have places, with covariances."""

    label = "acoustic pair"
    geometry = SensorGeometry.MONOSTATIC

    type: Literal["acoustic_pair"]
    second_array: Location
    """Where the other array stands; places are seen from the first."""

    def _refusals(self) -> Iterator[str]:
        yield from refused_bias(
            self.bias,
            "two arrays, which measure directions",
            ("azimuth_offset_deg", "tilt_deg", "tilt_azimuth_deg", "time_offset_s"),
        )
        if self.drift is not None and self.drift.sigma_range_m:
            yield "drift.sigma_range_m: not modelled of two arrays"

    def model(self, site: Site, /) -> AcousticPair:
        """The model of both."""
        array: Any = super().model(site)
        baseline_enu_m = self.offset_enu_m(site, self.second_array)
        return AcousticPair(
            range_max_m=self.range_max_m, array=array, baseline_enu_m=baseline_enu_m
        )

    def warnings(self, site: Site, /) -> Iterator[str]:
        """What there is of one array, and a baseline that is too short or too long."""
        apart_m = float(np.hypot(*self.offset_enu_m(site, self.second_array)[:2]))
        yield from super().warnings(site)
        if apart_m > self.range_max_m:
            yield (
                f"second_array is {apart_m:.0f} m away, and sounds carry {self.range_max_m:g} m: "
                "the two hear little in common"
            )
        elif apart_m < SHORTEST_BASELINE * self.range_max_m:
            yield (
                f"second_array is {apart_m:.3g} m away, less than a twentieth of "
                f"{self.range_max_m:g} m: bearings hardly cross, and distances are guesses"
            )
