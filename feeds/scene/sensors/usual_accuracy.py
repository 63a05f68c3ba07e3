"""How accurate sensors are at best: error floors that a scene does not state, and odd ones.

Calibration, the ground, wind and the shape of beams leave errors that no signal removes. Of radars
they are the shares of a cell and of a beam that MathWorks' `radarDataGenerator` takes for lower
bounds of accuracy unless told otherwise (its properties RangeBiasFraction, AzimuthBiasFraction,
ElevationBiasFraction and RangeRateBiasFraction).
"""

from __future__ import annotations

RANGE_SHARE = 0.05
"""Of a range cell, and of a cell of bistatic range."""
ANGLE_SHARE = 0.1
"""Of a beam between its 3 dB points."""
RATE_SHARE = 0.05
"""Of a Doppler cell."""
SOUND_BEARING_DEG = 2.0
"""Of microphone arrays outdoors. Arrays of 1 to 8 m followed a vehicle within 2 to 5 degrees; small
ones in wind within 6 (X. Zhang and others, Sensors 14, 4384, 2014). The best of these is taken."""
RF_BEARING_DEG = 2.0
"""Of radio bearings: what class A promises, the best of the Radio Regulations of 1947, app. 15."""

BEYOND_BELIEF = 10.0
"""A floor that many times smaller or larger than usual is no sensor's."""
RADAR_BANDS_HZ = 3e6, 300e9
"""From the HF to the millimetre band of IEEE Std 521, letter designations of radar bands."""


def stated_or(floor: float | None, usual: float) -> float:
    """The error floor that a scene states, 0 among them, or else the usual one."""
    return usual if floor is None else floor


def odd_floor(key: str, floor: float | None, usual: float) -> list[str]:
    """A warning of a stated floor that is no sensor's."""
    if floor is None or usual / BEYOND_BELIEF <= floor <= usual * BEYOND_BELIEF:
        return []
    unit = {"deg": "degrees", "m": "m", "s": "m/s"}[key.rpartition("_")[2]]
    sense = "accurate" if floor < usual else "inaccurate"
    return [
        f"{key} is {floor:g} {unit}, more {sense} than such sensors are: some {usual:.2g} {unit} "
        "of error stay in theirs, however strong the signal"
    ]


def odd_frequency(key: str, frequency_hz: float) -> list[str]:
    """A warning of a carrier that no radar or radio sensor has: Hz for GHz, most often."""
    low_hz, high_hz = RADAR_BANDS_HZ
    if low_hz <= frequency_hz <= high_hz:
        return []
    return [
        f"{key} is {frequency_hz:g}: such sensors work from {low_hz:g} to {high_hz:g} Hz; "
        "is it in another unit?"
    ]
