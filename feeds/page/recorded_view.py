"""A recording on a view: what was known at the time that a replay has reached, and is new there."""

from __future__ import annotations

import asyncio
from bisect import insort
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from plotfeed.feeds.delivery.counters import SessionCounters
from plotfeed.feeds.page.page_observer import model_differs, tell_settings
from plotfeed.feeds.page.recorded_sectors import DroneNumbers, RecordedSector, RecordedSectors
from plotfeed.feeds.page.view import View
from plotfeed.feeds.recording.recorded_session import RecordedSession
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.session.sensor_task import json_of
from plotfeed.models.frames import aer_to_enu
from plotfeed.models.state import FALSE_ALARM, Floats, Ints, Looks, Plots, TruthState
from plotfeed.models.truth import fit_velocity
from plotfeed.proto.utc import NS
from plotfeed.replay.mcap.mcap_reader import McapReader

KEPT = 12
"""Places of a drone, the latest ones."""
SIGMA_M = 0.1
"""A velocity is fitted to places as if they were known so well, so that it is that of now."""
SCANS = 2.5
"""A drone that no sensor has looked at for so many of the longest scans is not there."""


class _Seen(NamedTuple):
    t_ns: int
    position_ecef_m: Floats
    velocity_ecef_m_s: Floats


class SeenDrones:
    """Positions by sensors that stand straight; of one that does not, the ledger's looks err."""

    def __init__(self, scene: Scene) -> None:
        self._frames = {s.id: frame_at(scene.scene.site, s.position_enu_m) for s in scene.sensor}
        self._straight = {s.id for s in scene.sensor if _is_straight(s)}
        longest_s = max(sensor.scan.period_s for sensor in scene.sensor)
        self._alive_ns = round(max(scene.telemetry.stale_after_s, SCANS * longest_s) * NS)
        self._places: dict[int, list[tuple[int, Floats]]] = {}
        self._latest: dict[int, _Seen] = {}
        self._changed: set[int] = set()
        """Drones that were seen since the last were worked out."""

    def take(self, sensor: str, looks: Looks, plots: Plots) -> None:
        """What a sensor looked at, or else what its plots truly were."""
        if sensor not in self._frames:
            return
        if sensor in self._straight:
            geometry = (looks.azimuth_deg, looks.elevation_deg, looks.range_m)
            self._take(sensor, looks.drone, looks.t_utc_ns, geometry)
        else:
            true = (plots.true_azimuth_deg, plots.true_elevation_deg, plots.true_range_m)
            self._take(sensor, plots.drone, plots.t_utc_ns, true)

    def state_at(self, t_utc_ns: int) -> TruthState:
        """Drones that are there then, moved on from where they were seen last."""
        for drone in self._changed:
            times, positions = zip(*self._places[drone], strict=True)
            velocity_m_s = fit_velocity(times, positions, SIGMA_M)
            self._latest[drone] = _Seen(times[-1], positions[-1], velocity_m_s)
        self._changed.clear()
        there = [(k, v) for k, v in self._latest.items() if t_utc_ns - v.t_ns <= self._alive_ns]
        since_s = np.array([(t_utc_ns - seen.t_ns) / NS for _, seen in there])
        position_m = np.array([seen.position_ecef_m for _, seen in there]).reshape(-1, 3)
        velocity_m_s = np.array([seen.velocity_ecef_m_s for _, seen in there]).reshape(-1, 3)
        return TruthState(
            drone=np.array([drone for drone, _ in there], np.int64),
            t_utc_ns=np.full(len(there), t_utc_ns),
            position_ecef_m=position_m + since_s[:, None] * velocity_m_s,
            velocity_ecef_m_s=velocity_m_s,
        )

    def _take(
        self, sensor: str, drones: Ints, t_utc_ns: Ints, geometry: tuple[Floats, Floats, Floats]
    ) -> None:
        there = (drones >= 0) & np.isfinite(geometry).all(axis=0)
        place_m = self._frames[sensor].to_ecef(aer_to_enu(*(part[there] for part in geometry)))
        times = t_utc_ns[there].tolist()
        for drone, t_ns, position in zip(drones[there].tolist(), times, place_m, strict=True):
            self._note(drone, t_ns, position)

    def _note(self, drone: int, t_ns: int, position_ecef_m: Floats) -> None:
        """Sensors tell of the same time, and of earlier ones, too."""
        places = self._places.setdefault(drone, [])
        if any(t_ns == other_ns for other_ns, _ in places):
            return
        insort(places, (t_ns, position_ecef_m), key=itemgetter(0))
        del places[:-KEPT]
        self._changed.add(drone)


def _is_straight(sensor: Sensor) -> bool:
    return sensor.bias is None and sensor.drift is None


LEAD_NS = 2 * NS
"""Plots are read from so long before those that are to be shown: the ledger tells of them later."""
MOST_READ_NS = 60 * NS
"""Of recorded time between two looks; of more, what has not faded is shown and the rest is not."""


class RecordedView:
    """Shows one recording, from wherever its replay goes."""

    def __init__(self, recording: RecordedSession, view: View) -> None:
        self._recording = recording
        self._view = view
        self._glow_ns = round(recording.scene.page.afterglow_s * NS)
        self._drones = DroneNumbers()
        self._seen = SeenDrones(recording.scene)
        self._totals = SessionCounters()
        self._sensors: dict[str, Sensor] = {}
        self._told_ns = recording.start_ns

    def open(self, log: McapReader) -> None:
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
        self._totals = SessionCounters()
        self._told_ns = t_ns
        self._sensors = self._recording.settings.told_at(t_ns)
        for sensor in self._sensors.values():
            tell_settings(self._view, sensor, t_ns, new_model=True)

    def _tell(self, sector: RecordedSector, *, leap: bool) -> None:
        if leap:
            self._view.recall(sector, sector.sent)
            return
        if sector.link is not None and sector.sensor in self._sensors:
            self._tell_link(self._sensors[sector.sensor], sector)
        self._view.report(sector)
        self._view.settled(sector, sector.sent)
        self._count(sector)

    def _tell_changes(self, t_ns: int) -> None:
        """Show keys of sensors that changed, but for links: of those the ledger tells."""
        now = self._recording.settings.told_at(t_ns)
        for sensor in self._recording.settings.told_between(self._told_ns, t_ns):
            before = self._sensors[sensor]
            after = now[sensor]
            if self._recording.ledger is not None:
                after = after.model_copy(update={"link": before.link})
            self._change(before, after, t_ns)
        self._told_ns = max(self._told_ns, t_ns)

    def _tell_link(self, before: Sensor, sector: RecordedSector) -> None:
        """Show a sector's link, if it is another than that of the one before."""
        if sector.link == json_of(before.link):
            return
        try:
            link = LinkSettings.model_validate_json(sector.link or "{}") if sector.link else None
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
