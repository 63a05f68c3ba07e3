"""A flight freed of the steps in which its log writes positions, with full velocities."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from plotfeed.feeds.telemetry.flights.flight import Flight
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.models.frames import WGS84_A_M
from plotfeed.models.smoothing import ACCELERATION_DENSITY_M2_S3, smooth
from plotfeed.models.state import Floats
from plotfeed.proto.utc import NS

MAX_GAP_S = 5.0  # What happened in a longer gap is not guessed, unless the whole log is that sparse
SPARSE_FACTOR = 3.0
DEGREE_DECIMALS = range(4, 10)
# Numbers of decimals in which logs write degrees and metres, the coarsest first.
METRE_DECIMALS = range(4)
WRITTEN_SHARE = 0.97  # Of the values; the others may be damaged
MIN_SIGMA_M = 1e-4
# As printed; `models.constants` has what follows from the flattening, 1 ulp less.
WGS84_E2 = 6.694379990141317e-3


def smoothed(flight: Flight) -> Flight:
    """The flight on a smooth path, east-north-up velocities filled in where the log has none.

    Each unbroken stretch is smoothed by itself. A stretch of one report is left as it was.
    """
    reports = flight.reports
    columns = np.array([(r.longitude_deg, r.latitude_deg, r.altitude_m) for r in reports]).T
    decimals = (DEGREE_DECIMALS, DEGREE_DECIMALS, METRE_DECIMALS)
    # In degrees and metres.
    quanta = np.array([quantum(c, d) for c, d in zip(columns, decimals, strict=True)])
    done: list[PositionReport] = []
    for stretch in _stretches(reports, flight.starts):
        done.extend(_smooth_stretch(stretch, quanta) if len(stretch) > 1 else stretch)
    return replace(flight, reports=tuple(done))


def quantum(values: Floats, decimals: range) -> float:
    """The step in which values (n,) are written; 0 if none shows.

    The coarsest power of ten that they are multiples of; else their smallest difference, if all
    differences are multiples of it and most values come again.
    """
    distinct = np.unique(values)
    for k in decimals:
        in_steps = distinct * 10**k
        if np.mean(np.abs(in_steps - np.round(in_steps)) < 1e-4) >= WRITTEN_SHARE:
            return float(10.0**-k)
    steps = np.diff(distinct)
    steps = steps[steps > 10.0 ** (-decimals[-1] - 1)]
    if len(steps) == 0 or 2 * (len(steps) + 1) > len(values):
        return 0.0
    in_smallest = steps / steps.min()
    return float(steps.min()) if np.all(np.abs(in_smallest - np.round(in_smallest)) < 0.01) else 0.0


def samples_per_step(values: Floats) -> float:
    """How many samples in a row show the same value, as a rule while the drone moves.

    So many have the rounding error in common: together they say no more than one.
    """
    changes = np.flatnonzero(np.diff(values)) + 1
    runs = np.diff(changes)
    return float(np.median(runs)) if len(runs) else 1.0


def _stretches(
    reports: Sequence[PositionReport], starts: Sequence[int]
) -> list[Sequence[PositionReport]]:
    """The flight cut where it starts anew, and where silent for longer than its rhythm explains."""
    intervals_s = [(b.t_utc_ns - a.t_utc_ns) / NS for a, b in pairwise(reports)]
    if not intervals_s:
        return [reports]
    longest_s = max(MAX_GAP_S, SPARSE_FACTOR * float(np.median(intervals_s)))
    cuts = {i for i, interval_s in enumerate(intervals_s, start=1) if interval_s > longest_s}
    return [reports[a:b] for a, b in pairwise(sorted({0, *starts, *cuts, len(reports)}))]


def _smooth_stretch(reports: Sequence[PositionReport], quanta: Floats) -> list[PositionReport]:
    """Smoothed in longitude, latitude and altitude, each scaled to metres at the first report."""
    t_s = np.array([(r.t_utc_ns - reports[0].t_utc_ns) / NS for r in reports])
    recorded = np.array([(r.longitude_deg, r.latitude_deg, r.altitude_m) for r in reports])
    recorded[:, 0] = np.unwrap(recorded[:, 0], period=360.0)
    scale_m = _metres_per_unit(recorded[:1, 1], recorded[:1, 2])[0]
    density = ACCELERATION_DENSITY_M2_S3 / np.array([samples_per_step(c) for c in recorded.T])
    position_m, rate_m_s = smooth(
        t_s, (recorded - recorded[0]) * scale_m, _sigma_m(reports, quanta * scale_m), density
    )
    position = recorded[0] + position_m / scale_m
    velocity_m_s = rate_m_s / scale_m * _metres_per_unit(position[:, 1], position[:, 2])
    return [_moved(*row) for row in zip(reports, position, velocity_m_s, strict=True)]


def _sigma_m(reports: Sequence[PositionReport], quanta_m: Floats) -> Floats:
    """Standard deviation east, north, up, metres: of rounding, or as stated where that is more."""
    sigma_m = np.maximum(quanta_m / math.sqrt(12), MIN_SIGMA_M)  # uniform over one step
    horizontal = [a for r in reports if not math.isnan(a := r.horizontal_accuracy_m)]
    vertical = [a for r in reports if not math.isnan(a := r.vertical_accuracy_m)]
    if horizontal:
        sigma_m[:2] = np.maximum(sigma_m[:2], np.median(horizontal))
    if vertical:
        sigma_m[2] = max(sigma_m[2], float(np.median(vertical)))
    return sigma_m


def _metres_per_unit(latitude_deg: Floats, height_m: Floats) -> Floats:
    """Metres east per degree of longitude, north per degree of latitude, and up; (n, 3).

    From the radii of curvature of the WGS-84 ellipsoid.
    """
    latitude = np.radians(latitude_deg)
    w = np.sqrt(1 - WGS84_E2 * np.sin(latitude) ** 2)
    east = (WGS84_A_M / w + height_m) * np.cos(latitude)
    north = WGS84_A_M * (1 - WGS84_E2) / w**3 + height_m
    return np.stack([np.radians(east), np.radians(north), np.ones_like(east)], axis=-1)


def _moved(report: PositionReport, position: Floats, velocity_m_s: Floats) -> PositionReport:
    """The report at longitude, latitude, altitude; velocities it has are kept."""
    longitude_deg, latitude_deg, altitude_m = (float(v) for v in position)
    east, north, up = (
        float(fitted) if math.isnan(own) else own
        for own, fitted in zip(report.velocity_enu_m_s, velocity_m_s, strict=True)
    )
    return report._replace(
        longitude_deg=(longitude_deg + 180.0) % 360.0 - 180.0,
        latitude_deg=min(90.0, max(-90.0, latitude_deg)),
        altitude_m=altitude_m,
        velocity_enu_m_s=(east, north, up),
    )
