"""The same physics in 50 digits, by which the methods of a chart are judged.

Decimal numbers of the standard library, one target at a time: slow, and good to some 45 digits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from decimal import Context, Decimal, localcontext
from functools import cache, wraps
from typing import ParamSpec, TypeVar

from plotfeed.models.detection import threshold_noncoherent, threshold_noncoherent_cfar

Vector = tuple[Decimal, Decimal, Decimal]
_P = ParamSpec("_P")
_R = TypeVar("_R")

DIGITS = 50
PI = Decimal("3.14159265358979323846264338327950288419716939937510582097494459")
SEMI_MAJOR_M = Decimal(6378137)  # WGS 84
INVERSE_FLATTENING = Decimal("298.257223563")  # WGS 84
_NEGLIGIBLE = Decimal(10) ** -DIGITS


def in_many_digits(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compute with 50 digits whatever the surroundings do."""

    @wraps(function)
    def computed(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        with localcontext(Context(prec=DIGITS)):
            return function(*args, **kwargs)

    return computed


@in_many_digits
def enu_m(site: Sequence[float], place: Sequence[float]) -> Vector:
    """East, north and up of a place from a site, metres; each latitude, longitude and height."""
    latitude_deg, longitude_deg, _ = (Decimal(x) for x in site)
    sin_lat, cos_lat = _sin_cos_deg(latitude_deg)
    sin_lon, cos_lon = _sin_cos_deg(longitude_deg)
    x, y, z = (a - b for a, b in zip(_ecef_m(place), _ecef_m(site), strict=True))
    outwards = cos_lon * x + sin_lon * y
    return (
        cos_lon * y - sin_lon * x,
        cos_lat * z - sin_lat * outwards,
        cos_lat * outwards + sin_lat * z,
    )


@in_many_digits
def azimuth_elevation_range(enu: Vector) -> Vector:
    """Degrees, degrees and metres of east, north, up; NaN where an angle is undefined."""
    east, north, up = enu
    ground = (east * east + north * north).sqrt()
    azimuth_deg = _angle_deg(east, north)
    return (
        azimuth_deg + 360 if azimuth_deg.is_signed() and azimuth_deg else azimuth_deg,
        _angle_deg(up, ground),
        (ground * ground + up * up).sqrt(),
    )


@in_many_digits
def bistatic_range_m(enu: Vector, transmitter_enu_m: Sequence[float]) -> Decimal:
    """Path transmitter-target-receiver less the baseline; the receiver is the origin."""
    transmitter = [Decimal(x) for x in transmitter_enu_m]
    offset = [a - b for a, b in zip(enu, transmitter, strict=True)]
    return _length(offset) + _length(enu) - _length(transmitter)


@in_many_digits
def pd_cfar_swerling1(snr: float, pfa: float, n_reference: int) -> Decimal:
    """Equations 6 and 7."""
    alpha = (-Decimal(pfa).ln() / n_reference).exp() - 1
    mean = 1 + Decimal(snr)
    return (mean / (mean + alpha)) ** n_reference


@in_many_digits
def pd_sum_cfar(snrs: Sequence[float], pfa: float, n_reference_total: int) -> Decimal:
    """The sum of looks of any ratios against the sum of reference samples."""
    ratio = _sum_threshold(pfa, len(snrs), n_reference_total)
    return _outlasting([Decimal(s) for s in snrs], ratio, n_reference_total)


@in_many_digits
def pd_energy(snr: float, pfa: float, n_samples: int) -> Decimal:
    """Equations 22 and 23 in right form: the sum of equal looks in known noise."""
    return _gamma_tail(n_samples, _energy_threshold(pfa, n_samples) / (1 + Decimal(snr)))


@in_many_digits
def pd_logistic(snr_db: float, sensitivity_db: float, slope_per_db: float) -> Decimal:
    """Equation 43, in dB throughout."""
    margin_db = Decimal(snr_db) - Decimal(sensitivity_db)
    return 1 / (1 + (-Decimal(slope_per_db) * margin_db).exp())


def _ecef_m(place: Sequence[float]) -> Vector:
    latitude_deg, longitude_deg, height = (Decimal(x) for x in place)
    sin_lat, cos_lat = _sin_cos_deg(latitude_deg)
    sin_lon, cos_lon = _sin_cos_deg(longitude_deg)
    squeeze = (1 - 1 / INVERSE_FLATTENING) ** 2
    normal = SEMI_MAJOR_M / (1 - (1 - squeeze) * sin_lat * sin_lat).sqrt()
    axis = (normal + height) * cos_lat
    return axis * cos_lon, axis * sin_lon, (normal * squeeze + height) * sin_lat


def _sin_cos_deg(angle_deg: Decimal) -> tuple[Decimal, Decimal]:
    """By their series, an angle within an eighth of a turn, and the symmetries of the circle."""
    quarters = (angle_deg / 90).to_integral_value()
    x = (angle_deg - 90 * quarters) * PI / 180
    sine, cosine, term, n = x, Decimal(1), x, 1
    while abs(term) > _NEGLIGIBLE:
        n += 1
        term = term * x / n
        sign = -1 if n % 4 in {2, 3} else 1
        if n % 2:
            sine += sign * term
        else:
            cosine += sign * term
    for _ in range(int(quarters) % 4):
        sine, cosine = cosine, -sine
    return sine, cosine


def _angle_deg(y: Decimal, x: Decimal) -> Decimal:
    """The angle of (x, y) in [-180, 180]: float64's, and what a rotation by it leaves over."""
    length = _length((x, y))
    if not length:
        return Decimal("nan")
    near_deg = Decimal(math.degrees(math.atan2(y / length, x / length)))
    sine, cosine = _sin_cos_deg(near_deg)
    rest = (y * cosine - x * sine) / length  # the sine of an angle below 1e-15
    return near_deg + rest * 180 / PI


def _length(vector: Sequence[Decimal]) -> Decimal:
    return sum((x * x for x in vector), Decimal(0)).sqrt()


def _outlasting(snrs: Sequence[Decimal], ratio: Decimal, n_samples: int) -> Decimal:
    """The chain of `plotfeed.models.looks_chain`, sample by sample."""
    ends = [ratio / (ratio + 1 + s) for s in snrs]
    chance = [Decimal(1)] * len(snrs)
    for _ in range(n_samples):
        following = Decimal(0)
        for i in range(len(snrs) - 1, -1, -1):
            following = (1 - ends[i]) * chance[i] + ends[i] * following
            chance[i] = following
    return chance[0]


@cache
def _sum_threshold(pfa: float, n_looks: int, n_samples: int) -> Decimal:
    """Where noise alone outlasts the samples with probability Pfa."""
    silence = [Decimal(0)] * n_looks
    near = Decimal(float(threshold_noncoherent_cfar(pfa, n_looks, n_samples)))
    return _root(lambda x: _outlasting(silence, x, n_samples), Decimal(pfa), near)


@cache
def _energy_threshold(pfa: float, n_samples: int) -> Decimal:
    near = Decimal(float(threshold_noncoherent(pfa, n_samples)))
    return _root(lambda x: _gamma_tail(n_samples, x), Decimal(pfa), near)


def _root(function: Callable[[Decimal], Decimal], goal: Decimal, near: Decimal) -> Decimal:
    """Where a function has that value, by secants from what float64 takes for it."""
    before, x = near, near * (1 + Decimal("1e-12"))
    value_before, value = function(before), function(x)
    for _ in range(20):
        if value == value_before or abs(x - before) < _NEGLIGIBLE * 1000 * x:
            break
        following = x + (goal - value) * (x - before) / (value - value_before)
        before, value_before, x = x, value, following
        value = function(x)
    return x


def _gamma_tail(n: int, y: Decimal) -> Decimal:
    """Q(n, y), the share that k below n have of the terms y^k / k!, counted from the n-th.

    Terms stop to count once they are negligible, and so does either sum beside the other.
    """
    below, above = Decimal(0), Decimal(0)
    down, up = Decimal(1), y / n
    k_down, k_up = n - 1, n
    while k_down >= 0 and down > _NEGLIGIBLE * below and below * _NEGLIGIBLE <= above + 1:
        below += down
        down, k_down = down * k_down / y, k_down - 1
    while (up > _NEGLIGIBLE * above or k_up < y) and above * _NEGLIGIBLE <= below:
        above += up
        k_up += 1
        up = up * y / k_up
    return below / (below + above)
