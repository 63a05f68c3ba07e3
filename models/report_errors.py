"""Errors of what a tracker reported, each at its own time, and their figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plotfeed.models.state import NS, Columns, Floats, Ints
from plotfeed.models.track_metrics import lag_parts
from plotfeed.models.verdicts import FigureSamples

LEAST_SPEED_M_S = 1.0  # Below it a drone has no way along which to err
SE_95 = 1.959964  # Standard errors of which one bound of 95 % is, by the normal law


@dataclass(frozen=True, kw_only=True)
class ReportErrors(Columns):
    """Reports beside the drone that their track is of, (n,): those that are of one.

    Errors are east, north, up at the drone, (n, 3), with NaN for what the report does not tell.
    """

    t_utc_ns: Ints
    track: Ints
    drone: Ints
    report: Ints  # Row among the usable reports
    error_enu_m: Floats
    distance_m: Floats  # Over the ground, or in space where heights are scored
    velocity_error_enu_m_s: Floats
    true_velocity_enu_m_s: Floats
    covariance_m2: Floats
    nees: Floats
    latency_s: Floats
    # East and north from amid the sensors, (n, 2); NaN where nobody says where they are.
    from_sensors_m: Floats

    @property
    def known_utc_ns(self) -> Ints:
        """When reports were received, (n,); the times that they are of, where that is not known."""
        return self.t_utc_ns + np.nan_to_num(self.latency_s * NS).astype(np.int64)


def report_figures(
    errors: ReportErrors, dimensions: int
) -> tuple[dict[str, float], dict[str, FigureSamples]]:
    """Figures of the errors of reports, and what they are of; of no report that there is none."""
    if not len(errors):
        return {"reports": 0.0}, {}
    errors = errors.rows(np.lexsort((errors.t_utc_ns, errors.drone)))
    # One drone after the other, in an order that neither names nor errors have a part in.
    _, first, which = np.unique(errors.drone, return_index=True, return_inverse=True)
    errors = errors.rows(np.lexsort((which, errors.true_velocity_enu_m_s[first, 0][which])))
    distance_m, error_m, drone = errors.distance_m, errors.error_enu_m, errors.drone
    one = np.ones(len(errors))

    def mean(values: Floats, wholes: Floats = one, power: float = 1.0) -> FigureSamples:
        known = np.isfinite(values)
        return FigureSamples(values[known], wholes[known], drone[known], power)

    def rms(values: Floats) -> FigureSamples:
        return mean(values**2, power=0.5)

    def share(values: Floats, quantile: float) -> FigureSamples:
        return mean(values)._replace(quantile=quantile)

    east, north = errors.true_velocity_enu_m_s[:, 0], errors.true_velocity_enu_m_s[:, 1]
    speed = np.hypot(east, north)
    speed[speed <= LEAST_SPEED_M_S] = np.nan
    of_nees = mean(errors.nees / dimensions)
    lag = mean(*_lag_parts(errors, dimensions))
    between_s = np.append(np.diff(errors.t_utc_ns) / NS, np.nan)
    between_s[np.append(np.diff(drone) != 0, True)] = np.nan
    samples = {
        "position_mean_m": mean(distance_m),
        "position_rms_m": rms(distance_m),
        "position_p50_m": share(distance_m, 0.5),
        "position_p95_m": share(distance_m, 0.95),
        "bias_east_m": mean(error_m[:, 0]),
        "bias_north_m": mean(error_m[:, 1]),
        "bias_up_m": mean(error_m[:, 2]),
        "along_rms_m": rms((error_m[:, 0] * east + error_m[:, 1] * north) / speed),
        "across_rms_m": rms((error_m[:, 0] * north - error_m[:, 1] * east) / speed),
        "height_rms_m": rms(error_m[:, 2]),
        "velocity_rms_m_s": rms(np.hypot(*errors.velocity_error_enu_m_s[:, :2].T)),
        "nees": of_nees,
        "lag_s": lag,
        "latency_p50_s": share(errors.latency_s, 0.5),
        "latency_p95_s": share(errors.latency_s, 0.95),
        "latency_p99_s": share(errors.latency_s, 0.99),
        "update_p50_s": share(between_s, 0.5),
        "update_p95_s": share(between_s, 0.95),
    }
    found = {name: each.value for name, each in samples.items()}
    found["reports"] = float(len(errors))
    found["position_max_m"] = float(distance_m.max())
    found["latency_max_s"] = float(np.fmax.reduce(errors.latency_s))
    _, found["nees_low"], found["nees_high"] = of_nees.interval()
    tau = lag.interval()
    found["lag_se_s"] = (tau.high - tau.low) / (2 * SE_95)
    return found, samples


def _lag_parts(errors: ReportErrors, dimensions: int) -> tuple[Floats, Floats]:
    """What lag is a ratio of, where errors of azimuth and range are other things."""
    error_m = errors.error_enu_m[:, :dimensions]
    velocity_m_s = errors.true_velocity_enu_m_s[:, :dimensions]
    claimed = np.isfinite(errors.nees).all()
    covariance_m2 = errors.covariance_m2[:, :dimensions, :dimensions] if claimed else None
    others = None
    if np.isfinite(errors.from_sensors_m).all():
        east, north = errors.from_sensors_m.T
        others = np.zeros((len(errors), dimensions, 2))
        others[:, 0, 0], others[:, 1, 0] = north, -east
        others[:, :2, 1] = errors.from_sensors_m / np.maximum(np.hypot(east, north), 1.0)[:, None]
    return lag_parts(error_m, velocity_m_s, covariance_m2, others)
