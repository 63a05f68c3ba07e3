"""Beam timing: when a rotating radar looks at each drone, and where the drone is then."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from plotfeed.feeds.accuracy_chart.case import Case, wrapped
from plotfeed.feeds.accuracy_chart.stage import ChartStage, rms
from plotfeed.models.beam.scan import Sector, Timetable
from plotfeed.models.beam.sweep import meetings
from plotfeed.models.frames import enu_to_aer, wrap_180
from plotfeed.models.state import Bools, Floats, Ints, Signature, TruthState
from plotfeed.models.truth import Trajectories
from plotfeed.proto.utc import NS

OURS = "beam passage, a turn at once"
SOME_SCAN = 1000
BISECTIONS = 70
"""They halve a scan down to the last bit of a float."""
Found = tuple[Ints, Floats]
"""Which drones the beam meets, and where they are then, (n, 3)."""


@dataclass(frozen=True, slots=True)
class ScannedFlights:
    """The seen drones flying straight on through one scan, so that they are there in its middle."""

    case: Case
    trajectories: Trajectories
    sectors: list[Sector]

    @property
    def start_ns(self) -> int:
        """When the beam is at north."""
        return self.sectors[0].start_ns

    @property
    def period_ns(self) -> int:
        """How long a turn lasts."""
        return self.sectors[-1].end_ns - self.start_ns

    @property
    def drones(self) -> Ints:
        """Every drone."""
        return np.arange(len(self.case.seen))

    def enu_m(self, t_ns: Ints | int) -> Floats:
        """Where each is at a time of its own, or of all; (n, 3)."""
        t_ns = np.broadcast_to(t_ns, len(self.drones))
        state = self.trajectories.state_at(t_ns, self.drones)
        return self.case.frame.from_ecef(state.position_ecef_m)

    def azimuths_deg(self, t_ns: Ints | int) -> Floats:
        """Azimuths of those places; (n,)."""
        return enu_to_aer(self.enu_m(t_ns))[0]


def beam_stage(case: Case) -> ChartStage | None:
    """Against the instant at which the beam meets each drone; None for a sensor that stares."""
    if not case.sensor.scan.rotates:
        return None
    flights = _flights(case)
    passed, true_enu_m = crossings(flights)
    calls: dict[str, Callable[[], Found]] = {
        "instant of the scan": partial(_at_the_end, flights),
        "instant of the sector": partial(_at_sector_ends, flights),
        "one step from north": partial(_from_north, flights, 1),
        "three steps from north": partial(_from_north, flights, 3),
        "beam passage, sector by sector": partial(_sector_by_sector, flights),
        OURS: partial(_passages, flights),
    }
    return ChartStage.of(
        "beam timing",
        "How to find where drones are when the beam is there",
        [(name, call, _errors(case, call(), passed, true_enu_m)) for name, call in calls.items()],
        units=len(case.seen),
        ours=OURS,
    )


def crossings(flights: ScannedFlights) -> tuple[Bools, Floats]:
    """Which drones the beam meets once within the scan, and where they are then, by bisection."""
    period_s = flights.period_ns / NS
    start_enu_m = flights.enu_m(flights.start_ns)
    velocity_m_s = flights.case.velocity_enu_m_s
    start_deg = enu_to_aer(start_enu_m)[0]

    def ahead_deg(t_s: Floats) -> Floats:
        azimuth_deg = enu_to_aer(start_enu_m + t_s[:, None] * velocity_m_s)[0]
        return start_deg + wrap_180(azimuth_deg - start_deg) - 360 * t_s / period_s

    low, high = np.zeros(len(start_deg)), np.full(len(start_deg), period_s)
    passed = (ahead_deg(low) >= 0) & (ahead_deg(high) < 0)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        later = ahead_deg(middle) > 0
        low, high = np.where(later, middle, low), np.where(later, high, middle)
    return passed, start_enu_m + low[:, None] * velocity_m_s


def _flights(case: Case) -> ScannedFlights:
    period_ns, n = case.sensor.scan.period_ns, case.sensor.scan.sectors
    sectors = [Timetable(period_ns, n).sector(SOME_SCAN, i) for i in range(n)]
    middle_ns = sectors[0].start_ns + period_ns // 2
    reach_m = case.seen.velocity_ecef_m_s * (2 * period_ns / NS)
    times_ns = [middle_ns - 2 * period_ns, middle_ns + 2 * period_ns]
    trajectories = Trajectories(stale_after_s=1.0)
    for row, (place_m, far_m) in enumerate(zip(case.seen.ecef_m, reach_m, strict=True)):
        knots_m = np.stack([place_m - far_m, place_m + far_m])
        trajectories.add_path(f"drone-{row}", times_ns, knots_m, signature=Signature(rcs_m2=1.0))
    return ScannedFlights(case, trajectories, sectors)


def _errors(case: Case, found: Found, passed: Bools, true_enu_m: Floats) -> dict[str, float]:
    drone, first = np.unique(found[0], return_index=True)
    rows = drone[passed[drone]]
    measured = case.measured(found[1][first][passed[drone]], rows)
    true = case.measured(true_enu_m[rows], rows)
    return {name: rms(wrapped(name, measured[name] - value)) for name, value in true.items()}


def _at_the_end(flights: ScannedFlights) -> Found:
    """All at the end of the scan."""
    return flights.drones, flights.enu_m(flights.start_ns + flights.period_ns)


def _at_sector_ends(flights: ScannedFlights) -> Found:
    """Each at the end of the sector that it was in when the scan began."""
    n = len(flights.sectors)
    index = np.nan_to_num(flights.azimuths_deg(flights.start_ns) * n / 360).astype(np.int64) % n
    ends_ns = np.array([sector.end_ns for sector in flights.sectors])
    return flights.drones, flights.enu_m(ends_ns[index])


def _from_north(flights: ScannedFlights, steps: int) -> Found:
    """Each when the beam is where the drone was a step before, first of all at the scan's start."""
    t_ns = np.full(len(flights.drones), flights.start_ns)
    for _ in range(steps):
        share = np.nan_to_num(flights.azimuths_deg(t_ns)) / 360
        t_ns = flights.start_ns + np.rint(share * flights.period_ns).astype(np.int64)
    return flights.drones, flights.enu_m(t_ns)


def _sector_by_sector(flights: ScannedFlights) -> Found:
    """The engine's search where telemetry comes in between."""
    found, border = [], None
    for sector in flights.sectors:
        met = meetings([sector], flights.case.frame, flights.trajectories, border)
        border = met.borders[-1]
        found.append(met.truth)
    return _places(flights, TruthState.joined(found))


def _passages(flights: ScannedFlights) -> Found:
    """The engine's search while nothing new comes in about the drones: a turn at once."""
    met = meetings(flights.sectors, flights.case.frame, flights.trajectories)
    return _places(flights, met.truth)


def _places(flights: ScannedFlights, truth: TruthState) -> Found:
    return truth.drone, flights.case.frame.from_ecef(truth.position_ecef_m)
