"""Laws of what a right sensor reports: the means, variances and kurtoses of its plots."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from plotfeed.models.beam import Volume
from plotfeed.models.frames import aer_to_enu, enu_to_aer, wrap_180
from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.propagation import bistatic_range
from plotfeed.models.residuals import Expected, gauss, in_steps, over
from plotfeed.models.sensors.bistatic_places import HeightPrior, flat_solution
from plotfeed.models.state import Bools, Floats, Ints
from plotfeed.proto.asterix.decode_plots import steps_of
from plotfeed.proto.ledger import ToldLooks, ToldPlots
from plotfeed.proto.measured_plots import MeasuredPlots

if TYPE_CHECKING:
    from plotfeed.feeds.lab.evidence import AskedSensor

NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(7)
WEIGHTS = WEIGHTS / WEIGHTS.sum()  # Of a quadrature over a standard normal number
FEW_NODES, FEW_WEIGHTS = np.polynomial.hermite_e.hermegauss(5)
FEW_WEIGHTS = FEW_WEIGHTS / FEW_WEIGHTS.sum()
# What is compared: the column of plots, and its unit.
QUANTITIES = {
    "range": ("range_m", "m"),
    "bistatic range": ("bistatic_range_m", "m"),
    "azimuth": ("azimuth_deg", "deg"),
    "elevation": ("elevation_deg", "deg"),
    "height": ("height_m", "m"),
    "range rate": ("range_rate_m_s", "m/s"),
}
# Of which it is known how places err that several detections make, in the oracle's order.
JOINED = ("range", "azimuth", "elevation", "height")
COARSE = 20.0  # Steps below which a stated standard deviation is told too coarsely to divide by
# Standard deviations from the ends of range within which noise decides whether there is a plot.
EDGE = 7.0
WIDEST_DEG = 30.0  # Standard deviation above which an azimuth is folded too often to be compared
# Share of a range that its standard deviation is at most where it is nearly linear in noise.
MOST_BENT = 0.1
STRAIGHT = (2.5, 4.0)  # Kurtosis of what is nearly linear in noise


class Comparison(NamedTuple):
    """What was measured less what was expected, of all quantities, (n, k), and the law of that.

    NaN is of what is not measured.
    """

    error: Floats
    variance: Floats
    kurtosis: Floats
    step: Floats  # In which each is told, (k,)
    # Plots of which it is not known what they were to say, or that noise may have made none.
    left_out: int
    # Values further off than any noise leaves them, and times that are not those asked for.
    off: dict[str, int]


@nan_without_warnings
def compared(
    asked: AskedSensor | None,
    echoes: ToldLooks,
    truths: ToldPlots,
    measured: MeasuredPlots,
    joined: Floats | None,
) -> Comparison:
    """Plots of drones, (n,), of one category, beside what a sensor was asked for; None: unknown.

    `echoes` are the looks of which they are, with numbers of plots in place of those of entries.
    Of places that several detections make `joined` has the systematic error, the variance and the
    kurtosis of each of `JOINED`, (n, 3, 4); of others it is None.
    """
    category = int(measured.category[0]) if len(measured) else 0
    steps = steps_of(category)
    channel = np.where(measured.channel >= 0, measured.channel, 0)
    drones = 1 + np.fromiter(map(len, truths.merged_drones), np.int64, len(truths))
    place, is_whole = _places(asked, echoes, truths.t_utc_ns, drones, channel)
    sigmas = _sigmas(asked, measured, channel, steps)
    rate_m_s = np.where(drones == 1, truths.range_rate_m_s, np.nan)
    if asked is None or joined is None:
        expected = _expected(asked, place, rate_m_s, channel, sigmas)
        left_out = ~is_whole | _near_an_end(asked, place, channel, sigmas)
    else:
        expected = _of_joined(asked, place, joined)
        left_out = ~is_whole | np.isnan(joined[:, 1]).all(axis=1)
    # What is told in steps is the altitude above mean sea level.
    level_m: Floats | float = 0.0
    if asked is not None and np.isfinite(measured.altitude_m).any():
        level_m = asked.undulation_m(*place)
    values = _values(measured, expected, level_m)
    many = len(QUANTITIES)
    error, variance, kurtosis = np.full((3, len(measured), many), np.nan)
    found = Comparison(error, variance, kurtosis, np.zeros(many), int(left_out.sum()), {})
    model: Any = None if asked is None else asked.model
    doppler, intervals = (getattr(model, name, None) for name in ("doppler", "intervals"))
    for k, (name, (column, _)) in enumerate(QUANTITIES.items()):
        if name not in expected or not np.isfinite(values[name]).any():
            continue
        step = steps.get("altitude_m" if name == "height" else column, 0.0)
        datum = level_m if name == "height" else 0.0
        law = expected[name]
        law = in_steps(law._replace(mean=law.mean - datum), step)
        error = values[name] - (law.mean + datum)
        if name == "azimuth":
            error = wrap_180(error)
        if name == "range rate" and doppler is not None:  # what looks alike after a span
            error = doppler.folded(error, channel)
        if name == "range" and intervals is not None:
            error = intervals.nearest_m(error)
        error = np.where(left_out, np.nan, error)
        found.error[:, k], found.variance[:, k], found.kurtosis[:, k] = error, *law[1:3]
        found.step[k] = law.step
        follows = name == "height" or (name == "range" and asked is not None and asked.is_bistatic)
        if not follows and (asked is None or joined is None):
            far = 8 * np.sqrt(law.variance) + law.step + TOLERANCES.get(name, 1e-3)
            found.off[name] = int((np.abs(error) > far).sum())
    found.off["time"] = _times_off(asked, category, truths, measured)
    return found


def _times_off(
    asked: AskedSensor | None, category: int, truths: ToldPlots, measured: MeasuredPlots
) -> int:
    """How many plots are at other times than by the sensor's clock."""
    if asked is None or category == TIME_OF_SENDING:
        return 0
    most_ns = TIME_STEP_NS // 2 + 1 if category else 0
    times = zip(measured.t_utc_ns.tolist(), truths.t_utc_ns.tolist(), strict=True)
    return sum(
        t_ns is None or abs(t_ns - true_ns - asked.clock_ahead_ns) > most_ns
        for t_ns, true_ns in times
    )


# What arithmetic may leave, where that is not a millimetre.
TOLERANCES = {"azimuth": 1e-5, "elevation": 1e-5, "range rate": 1e-4}
TIME_STEP_NS = 7_812_500
TIME_OF_SENDING = 205  # The category whose times are not those of plots


class Place(NamedTuple):
    """Where plots were to be without noise, by the sensor's own axes; (n,)."""

    azimuth_deg: Floats
    elevation_deg: Floats
    range_m: Floats  # Or the bistatic range


def _places(
    asked: AskedSensor | None, echoes: ToldLooks, t_utc_ns: Ints, drones: Ints, channel: Ints
) -> tuple[Place, Bools]:
    """The places of plots as they are read, by so many drones in each, and which are known."""
    # A drone is alone in a plot by whatever channel it was looked at.
    mine = (drones == 1)[echoes.entry] | (echoes.channel == channel[echoes.entry])
    echoes, n = echoes.rows(mine), len(t_utc_ns)
    of = echoes.entry
    if not len(of):
        return Place(*np.full((3, n), np.nan)), np.zeros(n, np.bool_)
    azimuth_deg, elevation_deg, range_m = echoes.azimuth_deg, echoes.elevation_deg, echoes.range_m
    if asked is not None:
        true_enu_m = aer_to_enu(azimuth_deg, elevation_deg, range_m)
        if asked.own_axes is not None:
            azimuth_deg, elevation_deg, _ = enu_to_aer(true_enu_m @ asked.own_axes.T)
        if asked.is_bistatic:
            range_m = bistatic_range(true_enu_m, asked.from_enu_m(channel[of]))
    first = np.searchsorted(of, np.arange(n)).clip(max=len(of) - 1)
    # Of several drones the place is the mean of theirs, by the strengths of their echoes.
    weight = np.where(drones[of] == 1, 1.0, 10 ** (echoes.snr_db / 10))
    whole = np.bincount(of, weight, n)

    def mean(values: Floats, excess: Floats) -> Floats:
        return np.asarray(values[first] + np.bincount(of, weight * excess, n) / whole)

    place = Place(
        mean(azimuth_deg, wrap_180(azimuth_deg - azimuth_deg[first][of])),
        mean(elevation_deg, elevation_deg - elevation_deg[first][of]),
        mean(range_m, range_m - range_m[first][of]),
    )
    if asked is not None:  # means with what the sensor reads in place of them
        azimuth_deg, elevation_deg, range_m = asked.model.mean_place(*place)
        if asked.readings is not None:
            longer_m = range_m - place.range_m
            range_m = asked.readings.range_m(place.range_m, t_utc_ns) + longer_m
            azimuth_deg = asked.readings.azimuth_deg(azimuth_deg, t_utc_ns)
        place = Place(azimuth_deg, elevation_deg, range_m)
    is_whole = np.bincount(of, minlength=n) == drones
    return place, is_whole & np.isfinite(place.azimuth_deg)


def _sigmas(
    asked: AskedSensor | None, measured: MeasuredPlots, channel: Ints, steps: Mapping[str, float]
) -> dict[str, Floats]:
    """Standard deviations by the columns: within what is stated, if that is fine enough.

    In steps they are rounded up, and hold the rounding of their values. Those of a degraded sensor
    are as much larger as it was asked for.
    """
    by_ratio: Mapping[str, Floats] = {}
    if asked is not None and steps:
        snr_db = measured.snr_db
        if np.isnan(snr_db).all():
            snr_db = measured.amplitude_dbm - getattr(asked.model, "noise_dbm", np.nan)
        by_ratio = asked.stated_sigmas(10 ** (snr_db / 10), channel)
    found = {}
    for name in ("range_m", "bistatic_range_m", "azimuth_deg", "elevation_deg", "range_rate_m_s"):
        column = f"sigma_{name}"
        stated: Floats = getattr(measured, column, np.full(len(measured), np.nan))
        derived = by_ratio.get(column, np.full(len(measured), np.nan))
        step = steps.get(column, 0.0)
        most = np.sqrt(np.maximum(stated**2 - steps.get(name, 0.0) ** 2 / 12, 0.0))
        usual = np.where(np.isnan(derived), most - step / 2, derived)
        is_fine = stated >= COARSE * step
        found[name] = np.where(is_fine, np.clip(usual, most - step, most), derived)
        if asked is not None:
            found[name] = found[name] * asked.error_factor
    return found


def _expected(
    asked: AskedSensor | None,
    place: Place,
    rate_m_s: Floats,
    channel: Ints,
    sigmas: Mapping[str, Floats],
) -> dict[str, Expected]:
    """Every quantity as it was to be, whether or not it was measured."""
    azimuth_deg, elevation_deg, range_m = place
    sigma_azimuth_deg = sigmas["azimuth_deg"]
    known_deg = np.where(sigma_azimuth_deg <= WIDEST_DEG, sigma_azimuth_deg, np.nan)
    found = {
        "azimuth": gauss(azimuth_deg, known_deg),
        "elevation": gauss(elevation_deg, sigmas["elevation_deg"]),
        "range rate": gauss(rate_m_s, sigmas["range_rate_m_s"]),
    }
    if asked is not None and asked.is_bistatic:
        found["bistatic range"] = gauss(range_m, sigmas["bistatic_range_m"])
        found["range"] = _placed_range(asked, place, channel, sigmas)
    else:
        found["range"] = gauss(range_m, sigmas["range_m"])
    if asked is not None:
        found["height"] = _height(asked, place, sigmas)
    return found


def _of_joined(asked: AskedSensor, place: Place, joined: Floats) -> dict[str, Expected]:
    """Places that several detections make, about those of their targets."""
    azimuth_deg, elevation_deg, range_m = place
    height_m = asked.frame.heights_m(azimuth_deg, elevation_deg, range_m)
    true = np.stack([range_m, azimuth_deg, elevation_deg, height_m], axis=1)
    off, variance, kurtosis = np.moveaxis(joined, 1, 0)
    laws = zip((true + off).T, variance.T, kurtosis.T, strict=True)
    return {name: Expected(*law) for name, law in zip(JOINED, laws, strict=True)}


def _placed_range(
    asked: AskedSensor, place: Place, channel: Ints, sigmas: Mapping[str, Floats]
) -> Expected:
    """Ranges where the sensor places plots, over the noise of what is measured for them.

    Where that is far from straight, the variance is NaN: their noise is not known well enough.
    """
    n = len(channel)
    excess_m = place.range_m + sigmas["bistatic_range_m"] * FEW_NODES[:, None, None]
    azimuth_deg = place.azimuth_deg + sigmas["azimuth_deg"] * FEW_NODES[:, None]
    excess_m, azimuth_deg = np.broadcast_arrays(excess_m, azimuth_deg)
    from_enu_m = np.tile(asked.from_enu_m(channel), (len(FEW_NODES) ** 2, 1))
    model: Any = asked.model
    measured = excess_m.ravel(), azimuth_deg.ravel(), from_enu_m
    prior = HeightPrior(model.expected_height_m, model.sigma_height_m)
    range_m, _ = prior.ground_range_m(*measured)
    range_m = np.where(np.isnan(range_m), flat_solution(*measured).range_m, range_m)
    weights = np.outer(FEW_WEIGHTS, FEW_WEIGHTS).ravel()
    found = over(range_m.reshape(-1, n).T, weights)
    is_straight = (found.kurtosis > STRAIGHT[0]) & (found.kurtosis < STRAIGHT[1])
    return found._replace(variance=np.where(is_straight, found.variance, np.nan))


def _height(asked: AskedSensor, place: Place, sigmas: Mapping[str, Floats]) -> Expected:
    """Ellipsoidal heights, over the noise of elevation and range."""
    elevation_deg = place.elevation_deg[:, None] + sigmas["elevation_deg"][:, None] * NODES
    azimuth_deg = np.broadcast_to(place.azimuth_deg[:, None], elevation_deg.shape)
    range_m = np.broadcast_to(place.range_m[:, None], elevation_deg.shape)
    found = over(asked.frame.heights_m(azimuth_deg, elevation_deg, range_m), WEIGHTS)
    along_m = np.sin(np.radians(place.elevation_deg)) * sigmas["range_m"]
    variance = found.variance + along_m**2
    fourth = (
        found.kurtosis * found.variance**2 + 6 * found.variance * along_m**2 + 3 * along_m**4
    ) / variance**2
    return Expected(found.mean, variance, fourth)


def _near_an_end(
    asked: AskedSensor | None, place: Place, channel: Ints, sigmas: Mapping[str, Floats]
) -> Bools:
    """Whether noise decides if there is a plot: near the ends of range, and by the baseline."""
    near = np.zeros(len(place.range_m), np.bool_)
    if asked is None or not isinstance(asked.model, Volume):
        return near
    range_m, sigma_m = place.range_m, sigmas["range_m"]
    if asked.is_bistatic:  # it is the level solution that is to be in range
        level = flat_solution(place.range_m, place.azimuth_deg, asked.from_enu_m(channel))
        range_m = level.range_m
        sigma_m = level.sigma_m(sigmas["bistatic_range_m"], sigmas["azimuth_deg"])
        near |= ~(sigma_m <= MOST_BENT * range_m)
    for end_m in (max(asked.model.range_min_m, 0.0), asked.model.range_max_m):
        near |= np.abs(range_m - end_m) < EDGE * sigma_m
    return near


def _values(
    measured: MeasuredPlots, expected: Mapping[str, Expected], level_m: Floats | float
) -> dict[str, Floats]:
    """What was measured of each quantity, over the zenith again where noise has gone past it.

    `level_m` has heights of mean sea level above the ellipsoid, (n,), where altitudes were told.
    """
    values: dict[str, Floats] = {
        name: getattr(measured, column) for name, (column, _) in QUANTITIES.items()
    }
    if isinstance(level_m, np.ndarray):
        values["height"] = measured.altitude_m + level_m
    azimuth_deg, elevation_deg = values["azimuth"], values["elevation"]
    law = expected["elevation"]
    past = np.abs(law.mean) + EDGE * np.sqrt(law.variance) > 90
    past &= np.abs(wrap_180(azimuth_deg - expected["azimuth"].mean)) > 90
    if past.any():
        values["azimuth"] = np.where(past, azimuth_deg + 180.0, azimuth_deg)
        over_deg = np.copysign(180.0, elevation_deg) - elevation_deg
        values["elevation"] = np.where(past, over_deg, elevation_deg)
    return values
