"""The keys of what a sensor models only if its scene names it: errors, classes, Doppler, merging.

What is not named costs nothing. Error floors that a scene does not state are those of real sensors:
calibration, the ground, wind and the shape of beams leave errors that no signal removes. Of radars
they are the shares of a cell and of a beam that MathWorks' `radarDataGenerator` takes for lower
bounds of accuracy unless told otherwise (its properties RangeBiasFraction, AzimuthBiasFraction,
ElevationBiasFraction and RangeRateBiasFraction).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from plotfeed.feeds.scene.fields import (
    Azimuth,
    Beamwidth,
    ModelTable,
    Name,
    NotNegative,
    Offset,
    Positive,
    Resolution,
    SceneTable,
)
from plotfeed.models.chance import Chance
from plotfeed.models.frames import LocalFrame
from plotfeed.proto.utc import NS

if TYPE_CHECKING:
    from plotfeed.models.effects.classification import Confusion
    from plotfeed.models.effects.doppler import Doppler
    from plotfeed.models.effects.readings import Readings

RANGE_SHARE = 0.05  # Of a range cell, and of a cell of bistatic range
ANGLE_SHARE = 0.1  # Of a beam between its 3 dB points
RATE_SHARE = 0.05  # Of a Doppler cell
# Of microphone arrays outdoors. Arrays of 1 to 8 m followed a vehicle within 2 to 5 degrees; small
# ones in wind within 6 (X. Zhang and others, Sensors 14, 4384, 2014). The best of these is taken.
SOUND_BEARING_DEG = 2.0
# Of radio bearings: what class A promises, the best of the Radio Regulations of 1947, app. 15.
RF_BEARING_DEG = 2.0

BEYOND_BELIEF = 10.0  # A floor that many times smaller or larger than usual is no sensor's
# From the HF to the millimetre band of IEEE Std 521, letter designations of radar bands.
RADAR_BANDS_HZ = 3e6, 300e9


def stated_or(floor: float | None, usual: float) -> float:
    """The error floor that a scene states, 0 among them, or else the usual one."""
    return usual if floor is None else floor


def odd_floor(key: str, floor: float | None, usual: float) -> Iterator[str]:
    """A warning of a stated floor that is no sensor's."""
    if floor is None or usual / BEYOND_BELIEF <= floor <= usual * BEYOND_BELIEF:
        return
    unit = {"deg": "degrees", "m": "m", "s": "m/s"}[key.rpartition("_")[2]]
    sense = "accurate" if floor < usual else "inaccurate"
    yield (
        f"{key} is {floor:g} {unit}, more {sense} than such sensors are: some {usual:.2g} {unit} "
        "of error stay in theirs, however strong the signal"
    )


def odd_frequency(key: str, frequency_hz: float) -> Iterator[str]:
    """A warning of a carrier that no radar or radio sensor has: Hz for GHz, most often."""
    low_hz, high_hz = RADAR_BANDS_HZ
    if not low_hz <= frequency_hz <= high_hz:
        yield (
            f"{key} is {frequency_hz:g}: such sensors work from {low_hz:g} to {high_hz:g} Hz; "
            "is it in another unit?"
        )


class BiasKeys(SceneTable):
    """Systematic errors of a sensor: they are the same in every plot."""

    range_offset_m: Offset = 0.0
    """Added to ranges, and to the bistatic ranges of a passive radar."""
    range_scale: Annotated[float, Field(ge=-0.1, le=0.1)] = 0.0
    """A range r reads r (1 + range_scale), and a bistatic range too."""
    azimuth_offset_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    """By which azimuths read too high: the sensor's north is off by as much the other way."""
    tilt_deg: Annotated[float, Field(ge=0, le=45)] = 0.0
    """By which the sensor's vertical leans."""
    tilt_azimuth_deg: Azimuth = 0.0
    """Direction in which it leans: readings there are too high by the tilt."""
    time_offset_s: Annotated[float, Field(ge=-60, le=60)] = 0.0
    """By which the sensor's clock, and all times that it sends, are ahead."""

    def axes(self, frame: LocalFrame) -> LocalFrame:
        """The sensor's own, at the place of that frame; the frame itself if it stands right."""
        if not self.azimuth_offset_deg and not self.tilt_deg:
            return frame
        from plotfeed.models.effects.readings import SkewFrame

        return SkewFrame.at(
            frame,
            azimuth_offset_deg=self.azimuth_offset_deg,
            tilt_deg=self.tilt_deg,
            tilt_azimuth_deg=self.tilt_azimuth_deg,
        )


def refused_bias(bias: BiasKeys | None, of: str, modelled: Sequence[str]) -> Iterator[str]:
    """Systematic errors that would change nothing."""
    for name in BiasKeys.model_fields:
        if bias is not None and getattr(bias, name) and name not in modelled:
            yield f"bias.{name}: not modelled of {of}"


class DriftKeys(SceneTable):
    """Errors that come and go slowly: first-order Gauss-Markov processes, new in every scan."""

    time_constant_s: Annotated[float, Field(ge=1e-3, le=1e9)]
    """After which 1/e of an error is left, on average."""
    sigma_range_m: NotNegative = 0.0
    """Standard deviation of the drift in range, or in bistatic range."""
    sigma_azimuth_deg: NotNegative = 0.0
    """Standard deviation of the drift in azimuth."""


class DegradationKeys(ModelTable):
    """What a sensor does worse than it claims; for events above all."""

    makes = "sensors.sensor_model:Degradation"

    pd_factor: Annotated[float, Field(ge=0, le=1)] = 1.0
    """Factor on each look's probability of detection."""
    false_alarm_factor: Annotated[float, Field(ge=0, le=1e6)] = 1.0
    """So many times the false alarms, at the same threshold and Pd."""
    error_factor: Annotated[float, Field(ge=0, le=1000)] = 1.0
    """So many times the errors by noise, while plots claim the same."""


class MultipathKeys(ModelTable):
    """Two rays: straight, and by way of a flat ground."""

    makes = "effects.surroundings:Multipath"

    reflection: Annotated[float, Field(ge=-1, le=1)] = -0.9
    """Reflection coefficient of the ground; at grazing it is near -1 for either polarisation."""
    antenna_height_m: Annotated[float, Field(ge=0, le=10_000)]
    """Of the sensor's antenna above that ground."""


class DopplerKeys(SceneTable):
    """Range rates are measured, of a passive radar those of its bistatic ranges."""

    notch_m_s: NotNegative = 0.0
    """Width of the clutter filter's notch: Pd is less by exp(-(rate/notch)^2) of itself."""
    rate_max_m_s: Positive = 100.0
    """Rates are measured up to this, either way; faster is not detected."""
    floor_m_s: NotNegative | None = None
    """Error that remains however strong the echo; without it, a twentieth of the Doppler cell."""

    def model(self, wavelengths_m: Sequence[float], integration_s: float, legs: int) -> Doppler:
        """Cells of range rate for a model, a channel a wavelength; an echo's `legs` are 1 or 2."""
        cells_m_s = tuple(w / (legs * integration_s) for w in wavelengths_m)
        from plotfeed.models.effects.doppler import Doppler

        return self.made(
            Doppler,
            cells_m_s=cells_m_s,
            spans_m_s=tuple(2 * self.rate_max_m_s for _ in wavelengths_m),
            folds=False,
            floors_m_s=tuple(stated_or(self.floor_m_s, RATE_SHARE * cell) for cell in cells_m_s),
        )

    def odd_floor(self, cell_m_s: float) -> Iterator[str]:
        """A warning of a floor that no radar with that Doppler cell has."""
        return odd_floor("doppler.floor_m_s", self.floor_m_s, RATE_SHARE * cell_m_s)


class PulsedDopplerKeys(DopplerKeys):
    """Range rates are measured, by pulses or sweeps if their frequency is given."""

    prf_hz: Positive | None = None
    """Of pulses or sweeps; rates fold at wavelength times this over 2."""

    def model(self, wavelengths_m: Sequence[float], integration_s: float, legs: int) -> Doppler:
        """Cells of range rate that fold, if a frequency of pulses is given."""
        plain = super().model(wavelengths_m, integration_s, legs)
        if self.prf_hz is None:
            return plain
        spans_m_s = tuple(w * self.prf_hz / legs for w in wavelengths_m)
        return replace(plain, spans_m_s=spans_m_s, folds=True)


class MergingKeys(SceneTable):
    """Drones that are too close to be told apart make one plot."""

    range_m: Resolution | None = None
    """Distance at which two drones are told apart half of the time; without it, the range cell."""
    azimuth_deg: Beamwidth | None = None
    """The same in azimuth; without it, the beamwidth."""
    elevation_deg: Beamwidth | None = None
    """The same in elevation, where it is measured; without it, the beamwidth."""
    range_rate_m_s: Positive | None = None
    """The same in range rate, where it is measured; without it, the Doppler cell."""


def readings_of(
    bias: BiasKeys | None, drift: DriftKeys | None, chance: Chance, period_ns: int
) -> Readings | None:
    """What such a sensor reads in place of what it finds; None if it reads just that."""
    bias = bias or BiasKeys()
    if drift is None and not bias.range_offset_m and not bias.range_scale:
        return None
    from plotfeed.models.effects.readings import Drift, Readings

    if drift is None:
        return bias.made(Readings)
    process = Drift(chance, step_ns=period_ns, time_constant_ns=drift.time_constant_s * NS, n=2)
    fixed = {"range_scale": bias.range_scale, "range_offset_m": bias.range_offset_m}
    return drift.made(Readings, drift=process, **fixed)


# Keys of what a sensor or a scene models only if it is named.
EFFECTS = frozenset(
    {
        *("bias", "drift", "degradation", "multipath", "doppler", "merging", "antenna"),
        *("straddling", "pulses", "weather", "jamming", "terrain"),
    }
)


def effects_named(keys: SceneTable) -> dict[str, dict[str, Any]]:
    """Effects that a sensor or a scene names for all the time, with the keys that are given.

    A scene's spells of weather are events of its sensors.
    """
    told = keys.model_dump(include=set(EFFECTS), exclude_none=True)
    return {
        name: part for name, part in told.items() if isinstance(part, dict) and getattr(keys, name)
    }


ROUNDING = 1e-6  # By which a row may miss one
Share = Annotated[float, Field(ge=0, le=1)]
Row = Annotated[tuple[Share, ...], Field(strict=False, min_length=1, max_length=64)]


class ClassifierKeys(ModelTable):
    """What the sensor calls what it finds, by a confusion matrix."""

    claims: Annotated[tuple[Name, ...], Field(strict=False, min_length=1, max_length=64)]
    """What it may say; SAPIENT's Registration declares them."""
    confusion: Annotated[dict[str, Row], Field(min_length=1, max_length=64)]
    """By true class, the probability of each claim, in their order; a row adds up to one."""
    otherwise: Row | None = None
    """The same of other classes and of false alarms; without it, nothing."""
    held_s: Annotated[float, Field(ge=0, le=3600)] = 0.0
    """How long a drone is called the same, rightly or wrongly, in all plots; 0 for each plot anew.
    """
    codes: dict[str, Annotated[int, Field(ge=1, le=511)]] | None = None
    """By claim, the class in I015/300, as receiver and sensor agree; 0 for none."""

    def _refusals(self) -> Iterator[str]:
        if len(set(self.claims)) < len(self.claims):
            yield "claims: one is there twice"
        rows = {f"confusion.{name}": row for name, row in self.confusion.items()}
        if self.otherwise is not None:
            rows["otherwise"] = self.otherwise
        for name, row in rows.items():
            if len(row) != len(self.claims):
                yield f"{name}: {len(row)} numbers for {len(self.claims)} claims"
            if abs(sum(row) - 1) > ROUNDING:
                yield f"{name}: must add up to 1, not {sum(row):.7g}"
        if self.codes is not None and set(self.codes) != set(self.claims):
            yield "codes: one for each claim"

    def model(self) -> Confusion:
        """The matrix for a model."""
        from plotfeed.models.effects.classification import Confusion

        return self.made(
            Confusion,
            true_classes=tuple(self.confusion),
            rows=tuple(self.confusion.values()),
            held_ns=round(self.held_s * NS),
        )
