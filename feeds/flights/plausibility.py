"""Fixes that no drone can have flown to."""

from __future__ import annotations

import math
from collections.abc import Sequence

from plotfeed.feeds.report import NS, Report

MAX_SPEED_M_S = 150.0
MAX_CLIMB_M_S = 60.0
JITTER_M = 30.0
"""A fix may be off by this without being taken for wrong: receivers jump, coarse logs step."""
MAX_CHAINS = 16
EARTH_RADIUS_M = 6_371_000.0


def implausible(reports: Sequence[Report]) -> dict[int, str]:
    """Index of each report that cannot belong to the flight, and why; times must increase.

    Reports are strung into chains in which every step could have been flown, each report to the
    longest chain that it can follow. The longest chain is the flight: this finds the wrong ones
    also where they come first, or several in a row, as long as most are right.
    """
    chains: list[list[int]] = []
    for i, report in enumerate(reports):
        able = [c for c in chains if _reachable(reports[c[-1]], report)]
        if able:
            max(able, key=len).append(i)
        else:
            chains.append([i])
            if len(chains) > MAX_CHAINS:
                chains.remove(min(chains[:-1], key=len))
    flown = max(chains, key=len, default=[])
    rest = set(range(len(reports))).difference(flown)
    return {i: _why(reports, flown, i) for i in rest}


def _reachable(a: Report, b: Report) -> bool:
    dt_s = (b.t_utc_ns - a.t_utc_ns) / NS
    if abs(b.altitude_m - a.altitude_m) > JITTER_M + MAX_CLIMB_M_S * dt_s:
        return False
    return distance_m(a, b) <= JITTER_M + MAX_SPEED_M_S * dt_s


def distance_m(a: Report, b: Report) -> float:
    """Along the ground, on a sphere: good to half a percent."""
    north, south = math.radians(a.latitude_deg), math.radians(b.latitude_deg)
    east = math.radians(b.longitude_deg - a.longitude_deg)
    chord = math.hypot(
        math.sin((north - south) / 2),
        math.sqrt(math.cos(north) * math.cos(south)) * math.sin(east / 2),
    )
    return 2 * EARTH_RADIUS_M * math.asin(min(1.0, chord))


def _why(reports: Sequence[Report], flown: Sequence[int], i: int) -> str:
    """What it would have taken to fly here from the nearest report in time that is kept."""
    near = reports[min(flown, key=lambda j: abs(reports[j].t_utc_ns - reports[i].t_utc_ns))]
    dt_s = abs(near.t_utc_ns - reports[i].t_utc_ns) / NS
    climb_m = abs(near.altitude_m - reports[i].altitude_m)
    ground_m = distance_m(near, reports[i])
    return f"implausible: {ground_m:.0f} m away and {climb_m:.0f} m of height in {dt_s:.3g} s"
