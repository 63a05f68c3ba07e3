"""How a sensor looks at the drones: everywhere at once as a scan ends, or as its beam turns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from plotfeed.feeds.sensing.sensor_site import SensorSite
from plotfeed.models.beam import Border, Sector, Timetable, meetings
from plotfeed.models.chance import Purpose, ScanDraws
from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.sensors.sensor_model import NO_LOOKS, NO_PLOTS, SensorModel
from plotfeed.models.state import Ints, Looks, Plots, TruthState

MOST_TURNS, MOST_SECTORS = 4, 128
"""Worked out at once: beyond, a sector hardly costs less any more."""


class Beam(Protocol):
    """What looks at the drones in a sector: everywhere at once, or as it turns."""

    model: SensorModel
    """May be changed: it counts from the next look on."""
    site: SensorSite
    """May be changed as the model."""

    def look(self, sector: Sector) -> tuple[Looks, Plots]:
        """Whom it looked at, and what it measured in the order of time, with heights."""


class StaringBeam:
    """Everywhere at once, when a scan ends."""

    def __init__(self, model: SensorModel, site: SensorSite) -> None:
        self.model = model
        self.site = site

    @nan_without_warnings
    def look(self, sector: Sector) -> tuple[Looks, Plots]:
        """Looks at all drones that are there, and what is measured of them."""
        truth, chance = self.site.states_at(self.model, sector.end_ns), self.site.chance
        looks, detections = self.model.observe(
            self.site.targets(truth, self.model),
            chance.rng(Purpose.DETECTION, sector.scan),
        )
        alarms = self.model.draw_false_alarms(sector, chance.rng(Purpose.FALSE_ALARMS, sector.scan))
        plots = Plots.joined([detections, alarms]).in_order_of_time()
        return looks, self.site.with_heights(plots)


@dataclass(frozen=True, slots=True)
class _Stretch:
    """What came of several sectors: rows in the order of time, and how many end with each."""

    model: SensorModel
    version: int
    """Of the trajectories."""
    places: dict[int, int]
    """Of each sector among them, by its beginning."""
    borders: Sequence[Border]
    looks: Looks
    looks_by: Sequence[int]
    plots: Plots
    plots_by: Sequence[int]

    def of(self, i: int) -> tuple[Looks, Plots]:
        """What came of the i-th."""
        a, b = (self.looks_by[i - 1] if i else 0), self.looks_by[i]
        c, d = (self.plots_by[i - 1] if i else 0), self.plots_by[i]
        return (
            self.looks.between(a, b) if b > a else NO_LOOKS,
            self.plots.between(c, d) if d > c else NO_PLOTS,
        )


class RotatingBeam:
    """A rotating sensor.

    While there is no news of the drones, some turns are worked out at once, which costs
    little more than a sector does. What is seen does not depend on how many sectors that is.
    """

    def __init__(self, model: SensorModel, site: SensorSite, timetable: Timetable) -> None:
        self.model = model
        self.site = site
        self._timetable = timetable
        self._draws = ScanDraws(site.chance, Purpose.DETECTION)
        self._alarms: dict[int, Plots] = {}
        self._stretch: _Stretch | None = None
        self._border: Border | None = None
        # Each sensor begins elsewhere, lest all of them work out turns at the same time.
        self._at_once = 1 + site.chance.key % timetable.sectors

    def look(self, sector: Sector) -> tuple[Looks, Plots]:
        """Looks at the drones that the beam passes, and what is measured of them."""
        stretch = self._stretch
        if (
            stretch is None
            or not self._still_holds(stretch)
            or sector.start_ns not in stretch.places
        ):
            self._stretch = stretch = self._worked_out(self._sectors_from(sector))
        i = stretch.places[sector.start_ns]
        self._border = stretch.borders[i]
        return stretch.of(i)

    def _still_holds(self, stretch: _Stretch) -> bool:
        current = (self.model, self.site.trajectories.version)
        return stretch.model is current[0] and stretch.version == current[1]

    def _sectors_from(self, sector: Sector) -> list[Sector]:
        """Sectors to work out at once: turns without news, one where there is much of it."""
        if self._stretch is not None:
            turn = self._timetable.sectors
            most = max(turn, min(MOST_TURNS * turn, MOST_SECTORS))
            # A stretch that was skipped out of says nothing: whoever is late should not do more.
            if not self._still_holds(self._stretch):
                self._at_once = max(self._at_once // 2, 1)
            elif self._stretch.borders[-1].t_utc_ns == sector.start_ns:
                self._at_once = min(2 * self._at_once, most)
        sectors = [sector]
        for _ in range(self._at_once - 1):
            sectors.append(self._timetable.next_sector(sectors[-1]))
        return sectors

    @nan_without_warnings
    def _worked_out(self, sectors: Sequence[Sector]) -> _Stretch:
        """What comes of them, as far as is known now."""
        site = self.site
        met = meetings(sectors, site.axes, site.trajectories, self._border, self.model.range_max_m)
        looks, detections = (
            self._observed_among_neighbours(sectors, met.truth)
            if getattr(self.model, "merging", None) is not None
            else self._observed(sectors, met.truth)
        )
        plots = Plots.joined([detections, *self._false_alarms(sectors)]).in_order_of_time()
        ends_ns = np.array([s.end_ns for s in sectors], np.int64)
        return _Stretch(
            model=self.model,
            version=site.trajectories.version,
            places={sector.start_ns: i for i, sector in enumerate(sectors)},
            borders=met.borders,
            looks=looks,
            looks_by=np.searchsorted(looks.t_utc_ns, ends_ns).tolist(),
            plots=site.with_heights(plots),
            plots_by=np.searchsorted(plots.t_utc_ns, ends_ns).tolist(),
        )

    def _observed(self, sectors: Sequence[Sector], truth: TruthState) -> tuple[Looks, Plots]:
        """What the model makes of drones, each met within one of the sectors."""
        targets = self.site.targets(truth, self.model)  # without those that are out of reach
        draws = self._draws.of(self._scans_at(sectors, targets.t_utc_ns), targets.drone)
        return self.model.observe(targets, draws)  # type: ignore[arg-type]

    def _observed_among_neighbours(
        self, sectors: Sequence[Sector], truth: TruthState
    ) -> tuple[Looks, Plots]:
        """Looks and plots where echoes merge, also across the borders of these sectors."""
        start_ns, end_ns = sectors[0].start_ns, sectors[-1].end_ns
        before = self._timetable.sector_at(start_ns - 1)
        after = self._timetable.next_sector(sectors[-1])

        def others_of(sector: Sector) -> TruthState:
            axes, reach_m = self.site.axes, self.model.range_max_m
            met = meetings([sector], axes, self.site.trajectories, reach_m=reach_m).truth
            near = np.abs(truth.t_utc_ns - sector.start_ns) < self._timetable.period_ns // 2
            return met.rows(~np.isin(met.drone, truth.drone[near]))

        everybody = TruthState.joined([others_of(before), truth, others_of(after)])
        looks, plots = self._observed([before, *sectors, after], everybody)
        of_looks, of_plots = (
            (found.t_utc_ns >= start_ns) & (found.t_utc_ns < end_ns) for found in (looks, plots)
        )
        return looks.rows(of_looks), plots.rows(of_plots)

    def _scans_at(self, sectors: Sequence[Sector], t_utc_ns: Ints) -> Ints:
        """The scan of each time within the sectors."""
        which = np.searchsorted(np.array([s.end_ns for s in sectors]), t_utc_ns, side="right")
        return np.array([s.scan for s in sectors], np.int64)[which]

    def _false_alarms(self, sectors: Sequence[Sector]) -> list[Plots]:
        """False alarms of their scans that fall within the sectors."""
        start_ns, end_ns = sectors[0].start_ns, sectors[-1].end_ns
        found = []
        for scan in range(sectors[0].scan, sectors[-1].scan + 1):
            alarms = self._false_alarms_of(scan)
            a, b = np.searchsorted(alarms.t_utc_ns, (start_ns, end_ns)).tolist()
            if b > a:
                found.append(alarms.between(a, b))
        return found

    def _false_alarms_of(self, scan: int) -> Plots:
        """All those of a scan, in the order of time."""
        if self._stretch is None or self._stretch.model is not self.model:
            self._alarms.clear()
        if scan not in self._alarms:
            rng = self.site.chance.rng(Purpose.FALSE_ALARMS, scan)
            turn = self._timetable.turn(scan)
            self._alarms[scan] = self.model.draw_false_alarms(turn, rng).in_order_of_time()
            for past in [s for s in self._alarms if s < scan - MOST_TURNS]:
                del self._alarms[past]
        return self._alarms[scan]
