"""What a flight from a file is, before anything of it is sent: path, heights, rate, losses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from plotfeed.feeds.telemetry.flights.flight import Flight
from plotfeed.feeds.telemetry.flights.table import REFERENCE_WORDS
from plotfeed.feeds.telemetry.position_report import PositionReport
from plotfeed.models.frames import geodetic_to_ecef
from plotfeed.models.state import Floats
from plotfeed.proto.utc import NS, iso_utc

# A silence is a gap if it is longer than this, and than so many times the usual interval.
GAP_S, GAP_FACTOR = 5.0, 3.0
MOST_REASONS = 4


def summary_lines(flight: Flight) -> Iterator[str]:
    """The summary of a flight as it was recorded, a line for each thing."""
    reports = flight.reports
    first = reports[0]
    rows = np.array([(r.latitude_deg, r.longitude_deg, r.altitude_m) for r in reports])
    places_m: Floats = geodetic_to_ecef(*rows.T)
    length_km = float(np.linalg.norm(np.diff(places_m, axis=0), axis=1).sum()) / 1000
    away_km = float(np.linalg.norm(places_m - places_m[0], axis=1).max()) / 1000
    yield (
        f"path       {length_km:.3g} km, up to {away_km:.3g} km from {first.latitude_deg:.5f}, "
        f"{first.longitude_deg:.5f}, where it begins at {iso_utc(first.t_utc_ns)[:19]}Z"
    )
    heights_m = [report.altitude_m for report in reports]
    above = " and ".join(
        dict.fromkeys(REFERENCE_WORDS[report.altitude_reference] for report in reports)
    )
    yield f"heights    {min(heights_m):.1f} to {max(heights_m):.1f} m {above}"
    for stated in flight.stated:
        yield f"read as    {stated}"
    yield f"rate       {_rate(reports)}"
    dropped = sum(flight.dropped.values())
    if dropped:
        most = sorted(flight.dropped.items(), key=lambda pair: -pair[1])
        told = ", ".join(f"{why} {n}" for why, n in most[:MOST_REASONS])
        more = "" if len(most) <= MOST_REASONS else ", and others"
        yield f"dropped    {dropped} of {dropped + len(reports)} records: {told}{more}"


def _rate(reports: Sequence[PositionReport]) -> str:
    """How often it reports as a rule, and where it does not."""
    intervals_s = np.diff([report.t_utc_ns for report in reports]) / NS
    if not len(intervals_s):
        return "one report"
    usual_s = float(np.median(intervals_s))
    gaps_s = intervals_s[intervals_s > max(GAP_S, GAP_FACTOR * usual_s)]
    text = f"{1 / usual_s:.3g} Hz" if usual_s <= 1 else f"one each {usual_s:.3g} s"
    if not len(gaps_s):
        return f"{text}, without gaps"
    number = f"{len(gaps_s)} gaps" if len(gaps_s) > 1 else "1 gap"
    return f"{text}, {number}, the longest {gaps_s.max():.3g} s, not bridged"
