"""A recording on a view: what was known at the time that a replay has reached, and is new there."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from plotfeed.feeds.desk import json_of
from plotfeed.feeds.impairment.settings import Link
from plotfeed.feeds.page.attach import model_differs, tell_settings
from plotfeed.feeds.page.recorded_plots import DroneNumbers
from plotfeed.feeds.page.recorded_sectors import RecordedSector, RecordedSectors
from plotfeed.feeds.page.recording import Recording
from plotfeed.feeds.page.seen_drones import SeenDrones
from plotfeed.feeds.page.view import View
from plotfeed.feeds.sensors import Sensor
from plotfeed.feeds.times import NS
from plotfeed.feeds.totals import Totals
from plotfeed.models.state import FALSE_ALARM, Looks, Plots, TruthState
from plotfeed.replay.log_reader import LogReader

LEAD_NS = 2 * NS
"""Plots are read from so long before those that are to be shown: the ledger tells of them later."""
MOST_READ_NS = 60 * NS
"""Of recorded time between two looks; of more, what has not faded is shown and the rest is not."""


class RecordedView:
    """Shows one recording, from wherever its replay goes."""

    def __init__(self, recording: Recording, view: View) -> None:
        self._recording = recording
        self._view = view
        self._glow_ns = round(recording.scene.page.afterglow_s * NS)
        self._drones = DroneNumbers()
        self._seen = SeenDrones(recording.scene)
        self._totals = Totals()
        self._sensors: dict[str, Sensor] = {}
        self._told_ns = recording.start_ns

    def open(self, log: LogReader) -> None:
        """Read from the beginning."""
        self._log = log
        self._sectors = self._from(self._recording.start_ns)
        self._begin(self._recording.start_ns)

    async def go_to(self, t_ns: int, thread: ThreadPoolExecutor, *, leap: bool) -> None:
        """Show what there is then; after a leap, with what has not faded from before it."""
        loop = asyncio.get_running_loop()
        found, drones = await loop.run_in_executor(thread, partial(self._read, t_ns, leap=leap))
        if leap:
            self._view.clear()
            self._begin(t_ns)
        self._tell_changes(t_ns)
        for sector in found:
            self._tell(sector, leap=leap)
        self._totals.drones = len(self._drones.names)
        self._view.truth(t_ns, drones, tuple(self._drones.names))
        self._view.totals(self._totals)

    def _read(self, t_ns: int, *, leap: bool) -> tuple[list[RecordedSector], TruthState]:
        """What is new then, and where the drones are; in a thread, as it takes a while."""
        if leap:
            self._seen = SeenDrones(self._recording.scene)
        if leap or t_ns - self._sectors.read_ns > MOST_READ_NS:
            self._sectors = self._from(t_ns - self._glow_ns - LEAD_NS)
        found = self._sectors.until(t_ns)
        for sensor in {sector.sensor for sector in found}:
            of_sensor = [sector for sector in found if sector.sensor == sensor]
            looks, plots = ([getattr(s, name) for s in of_sensor] for name in ("looks", "plots"))
            self._seen.take(sensor, Looks.joined(looks), Plots.joined(plots))
        return found, self._seen.state_at(t_ns)

    def _from(self, from_ns: int) -> RecordedSectors:
        first_ns = max(from_ns, self._recording.start_ns)
        return RecordedSectors(self._log, self._recording, self._drones, first_ns)

    def _begin(self, t_ns: int) -> None:
        """Count anew from then on."""
        self._totals = Totals()
        self._told_ns = t_ns
        self._sensors = dict(self._recording.settings.at(t_ns))
        for sensor in self._sensors.values():
            tell_settings(self._view, sensor, t_ns, new_model=True)

    def _tell(self, sector: RecordedSector, *, leap: bool) -> None:
        if leap:
            self._view.recall(sector, sector.sent)
            return
        if sector.link is not None and sector.sensor in self._sensors:
            self._tell_link(self._sensors[sector.sensor], sector)
        self._view.report(sector)
        self._view.account(sector, sector.sent)
        self._count(sector)

    def _tell_changes(self, t_ns: int) -> None:
        """Of the keys of sensors since the last look, but for links: of those the ledger tells."""
        now = self._recording.settings.at(t_ns)
        for sensor in self._recording.settings.changed_between(self._told_ns, t_ns):
            before = self._sensors[sensor]
            after = now[sensor]
            if self._recording.ledger is not None:
                after = after.model_copy(update={"link": before.link})
            self._change(before, after, t_ns)
        self._told_ns = max(self._told_ns, t_ns)

    def _tell_link(self, before: Sensor, sector: RecordedSector) -> None:
        """That of a sector, if it is another than that of the one before."""
        if sector.link == json_of(before.link):
            return
        try:
            link = Link.model_validate_json(sector.link or "{}") if sector.link else None
        except ValueError:
            return
        since_ns = min((one.due_utc_ns for one in sector.sent), default=sector.at_ns)
        self._change(before, before.model_copy(update={"link": link}), since_ns)

    def _change(self, before: Sensor, after: Sensor, since_ns: int) -> None:
        self._sensors[after.id] = after
        tell_settings(self._view, after, since_ns, new_model=model_differs(before, after))

    def _count(self, sector: RecordedSector) -> None:
        totals = self._totals
        totals.looks += len(sector.looks)
        totals.plots += len(sector.plots)
        totals.false_alarms += int((sector.plots.drone == FALSE_ALARM).sum())
        for one in sector.sent:
            late_ns = one.sent_utc_ns - (one.link_due_utc_ns or one.due_utc_ns)
            totals.settle(one.fate, one.copy, late_ns)
