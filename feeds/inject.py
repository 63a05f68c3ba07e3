"""When to send each report of a recorded flight: the half of `inject` without sockets."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from plotfeed.feeds.flights import Flight
from plotfeed.feeds.report import Report
from plotfeed.proto.errors import PlotfeedError

MAX_SPEED = 1000.0
"""Times as fast as it was flown: beyond it, reports would fall on the same nanosecond."""


def schedule(
    flight: Flight, *, speed: float = 1.0, start_utc_ns: int | None = None
) -> Iterator[tuple[int, Report]]:
    """Each report with the time at which it is due, which is also the time that it then bears.

    The flight starts at `start_utc_ns`, or when it was flown. At speed 2 reports follow each
    other in half the time and their velocities are doubled, so that positions, times and
    velocities agree for whoever tracks them.
    """
    if not 0 < speed <= MAX_SPEED:
        raise PlotfeedError(f"speed is {speed:g}; expected more than 0 and at most {MAX_SPEED:g}")
    return (_shifted(report, flight, speed, start_utc_ns) for report in flight.reports)


def _shifted(
    report: Report, flight: Flight, speed: float, start_utc_ns: int | None
) -> tuple[int, Report]:
    recorded_start_ns = flight.reports[0].t_utc_ns
    start_ns = recorded_start_ns if start_utc_ns is None else start_utc_ns
    since_ns = report.t_utc_ns - recorded_start_ns
    due_utc_ns = start_ns + (since_ns if speed == 1 else round(since_ns / speed))
    return due_utc_ns, _hastened(replace(report, t_utc_ns=due_utc_ns), speed)


def _hastened(report: Report, speed: float) -> Report:
    """The report of a drone that flies that many times as fast."""
    if speed == 1:
        return report
    velocity, accuracy = report.velocity_enu_m_s, report.velocity_accuracy_m_s
    if velocity is not None:
        east, north, up = velocity
        velocity = east * speed, north * speed, up * speed
    return replace(
        report,
        velocity_enu_m_s=velocity,
        velocity_accuracy_m_s=None if accuracy is None else accuracy * speed,
    )
