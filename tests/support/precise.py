"""Physics in 50 digits, by mpmath: what models are judged by."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

from plotfeed.models.detection import threshold_noncoherent, threshold_noncoherent_cfar
from plotfeed.proto.errors import PlotfeedError

try:
    from mpmath import MPContext
except ImportError:
    raise PlotfeedError("charts need mpmath: pip install 'plotfeed[charts]'") from None

Number = Any  # A number of mpmath, which has no type hints, or what it makes one of
Vector = tuple[Number, Number, Number]
# A context of our own: whatever the surroundings compute with, this has 50 digits.
MP: Any = MPContext()
MP.dps = 50
SEMI_MAJOR_M = MP.mpf(6378137)  # WGS 84
FLATTENING = 1 / MP.mpf("298.257223563")  # WGS 84


def number(value: Number) -> Number:
    """A value in 50 digits; a float exactly."""
    return MP.mpf(value)


def enu_m(site: Sequence[Number], place: Sequence[Number]) -> Vector:
    """East, north and up of a place from a site, metres; each latitude, longitude and height."""
    sin_lat, cos_lat = _sin_cos_deg(site[0])
    sin_lon, cos_lon = _sin_cos_deg(site[1])
    x, y, z = (a - b for a, b in zip(_ecef_m(place), _ecef_m(site), strict=True))
    outwards = cos_lon * x + sin_lon * y
    return (
        cos_lon * y - sin_lon * x,
        cos_lat * z - sin_lat * outwards,
        cos_lat * outwards + sin_lat * z,
    )


def azimuth_elevation_range(enu: Vector) -> Vector:
    """Degrees, degrees and metres of east, north, up; NaN where an angle is undefined."""
    east, north, up = enu
    ground = MP.hypot(east, north)
    azimuth_deg = _angle_deg(east, north)
    return (
        azimuth_deg + 360 if azimuth_deg < 0 else azimuth_deg,
        _angle_deg(up, ground),
        MP.hypot(ground, up),
    )


def bistatic_range_m(enu: Vector, transmitter_enu_m: Sequence[Number]) -> Number:
    """Path transmitter-target-receiver less the baseline; the receiver is the origin."""
    offset = [a - MP.mpf(b) for a, b in zip(enu, transmitter_enu_m, strict=True)]
    return MP.norm(offset) + MP.norm(enu) - MP.norm(transmitter_enu_m)


def pd_cfar_swerling1(snr: Number, pfa: Number, n_reference: int) -> Number:
    """Equations 6 and 7."""
    alpha = MP.expm1(-MP.log(pfa) / n_reference)
    mean = 1 + MP.mpf(snr)
    return (mean / (mean + alpha)) ** n_reference


def pd_sum_cfar(snrs: Sequence[Number], pfa: Number, n_reference_total: int) -> Number:
    """The sum of looks of any ratios against the sum of reference samples."""
    ratio = _sum_threshold(pfa, len(snrs), n_reference_total)
    return _outlasting([MP.mpf(snr) for snr in snrs], ratio, n_reference_total)


def pd_energy(snr: Number, pfa: Number, n_samples: int) -> Number:
    """Equations 22 and 23 in right form: the sum of equal looks in known noise."""
    return _gamma_tail(n_samples, _energy_threshold(pfa, n_samples) / (1 + MP.mpf(snr)))


def at_least(chances: Sequence[Number], needed: int) -> Number:
    """Probability that so many of independent events come about."""
    found = [MP.mpf(1)] + [MP.mpf(0)] * len(chances)
    for chance in chances:
        for number_of in range(len(found) - 1, 0, -1):
            found[number_of] += (found[number_of - 1] - found[number_of]) * chance
        found[0] *= 1 - chance
    return sum(found[needed:])


def pd_logistic(snr_db: Number, sensitivity_db: Number, slope_per_db: Number) -> Number:
    """Equation 43, in dB throughout."""
    margin_db = MP.mpf(snr_db) - MP.mpf(sensitivity_db)
    return 1 / (1 + MP.exp(-MP.mpf(slope_per_db) * margin_db))


def _ecef_m(place: Sequence[Number]) -> Vector:
    sin_lat, cos_lat = _sin_cos_deg(place[0])
    sin_lon, cos_lon = _sin_cos_deg(place[1])
    height = MP.mpf(place[2])
    squeeze = (1 - FLATTENING) ** 2
    normal = SEMI_MAJOR_M / MP.sqrt(1 - (1 - squeeze) * sin_lat**2)
    axis = (normal + height) * cos_lat
    return axis * cos_lon, axis * sin_lon, (normal * squeeze + height) * sin_lat


def _sin_cos_deg(angle_deg: Number) -> tuple[Number, Number]:
    half_turns = MP.mpf(angle_deg) / 180
    return MP.sinpi(half_turns), MP.cospi(half_turns)


def _angle_deg(y: Number, x: Number) -> Number:
    """The angle of (x, y) in [-180, 180]."""
    return MP.degrees(MP.atan2(y, x)) if x or y else MP.nan


def _outlasting(snrs: Sequence[Number], ratio: Number, n_samples: int) -> Number:
    """The chain of `plotfeed.models.detection`, sample by sample."""
    ends = [ratio / (ratio + 1 + snr) for snr in snrs]
    chance = [MP.mpf(1)] * len(snrs)
    for _ in range(n_samples):
        following = MP.mpf(0)
        for i in range(len(snrs) - 1, -1, -1):
            following = chance[i] + ends[i] * (following - chance[i])
            chance[i] = following
    return chance[0]


def _gamma_tail(n: int, y: Number) -> Number:
    return MP.gammainc(n, y, regularized=True)


@cache
def _sum_threshold(pfa: Number, n_looks: int, n_samples: int) -> Number:
    """Where noise alone outlasts the samples with probability Pfa."""
    silence = [MP.mpf(0)] * n_looks
    near = float(threshold_noncoherent_cfar(float(pfa), n_looks, n_samples))
    return _root(lambda x: _outlasting(silence, x, n_samples) - pfa, near)


@cache
def _energy_threshold(pfa: Number, n_samples: int) -> Number:
    near = float(threshold_noncoherent(float(pfa), n_samples))
    return _root(lambda x: _gamma_tail(n_samples, x) - pfa, near)


def _root(function: Callable[[Number], Number], near: float) -> Number:
    """Where a function is zero, by secants from what float64 takes for it."""
    return MP.findroot(function, (MP.mpf(near), near * (1 + MP.mpf("1e-12"))), verify=False)
