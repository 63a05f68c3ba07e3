"""Figures of tracks beside drones: of sets over time, and of reports, each at its own time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from plotfeed.models.state import NS, Bools, Columns, Floats, Ints
from plotfeed.models.track_metrics import (
    Segments,
    Walked,
    followed,
    lag_parts,
    right_identities,
    swaps_of,
)
from plotfeed.models.verdicts import FigureSamples

LEAST_SPEED_M_S = 1.0  # Below it a drone has no way along which to err
SE_95 = 1.959964  # Standard errors of which one bound of 95 % is, by the normal law


def set_figures(  # noqa: PLR0917
    walked: Walked,
    segments: Segments,
    there: Bools,
    velocity_error_m_s: Floats,
    order: float,
    step_ns: int,
) -> tuple[dict[str, float], dict[str, FigureSamples]]:
    """Figures of sets over steps at which there was any drone or track, and what they are of.

    `there` (steps, drones) says which drones were, and velocities err by so much in the rows of
    what is assigned, (n, 3).
    """
    steps, assigned = walked.steps, walked.assigned
    some = np.flatnonzero((steps.drones > 0) | (steps.tracks > 0))
    count, every, power = len(some), len(there), 1.0 / order
    windows = walked.window_parts

    def of(parts: Any, wholes: Any, power: float = 1.0, **how: Any) -> FigureSamples:
        rows = np.asarray(parts, np.float64), np.asarray(wholes, np.float64)
        return FigureSamples(*rows, np.zeros(len(parts), np.int64), power, **how)

    def mean(values: Floats) -> FigureSamples:
        return of(values[some], np.ones(count), power)

    def by_window(values: Floats, of_all: float) -> FigureSamples:
        return of(values, np.full(len(values), of_all / max(len(values), 1)), power)

    def at_steps(values: Floats) -> FigureSamples:
        known = np.isfinite(values)
        sums = np.bincount(assigned.step[known], values[known], every)
        return of(sums, np.bincount(assigned.step[known], minlength=every))

    followings = [
        followed(segments.rows(segments.drone == drone), np.flatnonzero(there[:, drone]))
        for drone in range(there.shape[1])
    ]
    longest = np.array([each.longest_steps for each in followings], np.float64)
    right, both = right_identities(assigned.track, assigned.drone, assigned.step)
    seen = np.ones(len(right))
    samples = {
        "gospa_m": mean(steps.localisation + steps.missed + steps.false),
        "gospa_localisation_m": mean(steps.localisation),
        "gospa_missed_m": mean(steps.missed),
        "gospa_false_m": mean(steps.false),
        "ospa_m": mean(steps.ospa_m**order),
        "ospa2_m": by_window(walked.ospa2_m**order, len(windows)),
        "t_gospa_m": by_window(windows.sum(axis=1), count),
        "t_gospa_switching_m": by_window(windows[:, 3], count),
        "completeness": of(steps.tracked, steps.drones, is_share=True),
        "ambiguity": of(steps.assigned, steps.tracked),
        "spuriousness": of(steps.tracks - steps.assigned, steps.tracks, is_share=True),
        "id_correctness": of(right, seen, is_share=True),
        "id_ambiguity": of(both, seen, is_share=True),
        "position_accuracy_m": at_steps(assigned.distance_m),
        "velocity_accuracy_m_s": at_steps(np.hypot(*velocity_error_m_s[:, :2].T)),
        "longest_segment": of(longest, there.sum(axis=0)),
    }
    tracked_h = int(steps.tracked.sum()) * step_ns / NS / 3600
    changes = sum(each.number_changes for each in followings)
    found = {name: each.value for name, each in samples.items()}
    found["number_changes_per_h"] = changes / tracked_h if tracked_h else np.nan
    found["breaks"] = float(sum(each.breaks for each in followings))
    found["swaps"] = float(swaps_of(segments))
    return found, samples


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
