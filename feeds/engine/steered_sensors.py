"""The mounts of a scene at work: what sensors see cues others, and where these point at a time.

A cue counts `latency_ms` after the end of the sector whose plots it is of, so that what a sensor
points at follows from sectors that ended before, however many are worked out at once.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from heapq import heappop, heappush
from itertools import count
from typing import Any

import numpy as np

from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.scene.fields import Site
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.mount_keys import Cue, MountKeys, home_of, mount_of
from plotfeed.models.beam import Sectors
from plotfeed.models.cueing import (
    HOME,
    Aim,
    CueBatch,
    CuedState,
    CueRule,
    advanced,
    after_dwell,
    after_plots,
    at_rest,
    from_mount,
    to_mount,
    turned_to,
)
from plotfeed.models.frames import LocalFrame, aer_to_enu, enu_to_aer
from plotfeed.models.sensors.sensor_model import SensorModel, Targets
from plotfeed.models.state import Bools, Columns, Floats, Ints, Looks, Plots
from plotfeed.proto.utc import NS, NS_IN_MS

TOPIC, LOOK_AT = "cue", "look_at"  # What a mount says that it is cued by, if not by a sensor


@dataclass(frozen=True, kw_only=True)
class Aims(Columns):
    """Where steered sensors point at the ends of scans, (m,), and whether they see then."""

    sensor: Ints
    pan_deg: Floats
    tilt_deg: Floats
    field_deg: Floats
    sees: Bools

    def by_mount(self, targets: Targets, row: Ints) -> Targets:
        """Targets by the axes of the mounts, each of the scan of that row; (n,)."""
        return replace(
            targets,
            position_enu_m=to_mount(targets.position_enu_m, self.pan_deg[row], self.tilt_deg[row]),
            field_deg=self.field_deg[row],
        )

    def back(self, found: Any) -> Any:
        """Looks or plots by the axes of the mounts, by those of their sensors."""
        if not len(found):
            return found
        row = self._row(found)
        pan_deg, tilt_deg = self.pan_deg[row], self.tilt_deg[row]
        level = not found.elevation_deg.size or np.isnan(found.elevation_deg).all()
        own_deg = np.zeros(len(found)) if level else found.elevation_deg
        azimuth_deg, elevation_deg = from_mount(found.azimuth_deg, own_deg, pan_deg, tilt_deg)
        turned = {"azimuth_deg": azimuth_deg}
        if not level:
            turned["elevation_deg"] = elevation_deg
        if vars(found).get("sigma_azimuth_deg") is not None:
            narrower = np.cos(np.radians(own_deg)) / np.cos(np.radians(elevation_deg))
            turned["sigma_azimuth_deg"] = found.sigma_azimuth_deg * narrower
        return found.but(**turned)

    def of_alarms(self, alarms: Plots, sensor: int, model: SensorModel) -> Plots:
        """False alarms of one sensor by its mount's axes, as its lens and its mount have them."""
        row = np.searchsorted(self.sensor, [sensor])
        zoomed = model.zoomed_alarms(alarms, float(self.field_deg[row[0]]))
        turned: Plots = self.rows(row).back(zoomed)
        return turned

    def _row(self, found: Looks | Plots) -> Ints:
        if len(self.sensor) == 1 or found.sensor is None:
            return np.zeros(len(found), np.int64)
        return np.searchsorted(self.sensor, found.sensor)


@dataclass(slots=True)
class _Steered:
    """One mount: its keys, its state, and the cues that it does not know of yet."""

    keys: MountKeys
    rule: CueRule
    look_at: Aim | None
    state: CuedState
    pending: list[tuple[int, int, CueBatch | tuple[Aim, int]]] = field(default_factory=list)
    recent: deque[CueBatch] = field(default_factory=deque)


class Cueing:
    """The mounts of sensors, by the index of the sensor; those without one are in no table."""

    def __init__(self, site: Site, sensors: Sequence[Sensor], frames: Sequence[LocalFrame]) -> None:
        self._site, self._frames = site, frames
        self._names = [sensor.id for sensor in sensors]
        self._steered = {
            i: self._made(sensor, mount)
            for i, sensor in enumerate(sensors)
            if (mount := mount_of(sensor)) is not None
        }
        # Sensors whose plots cue others, and which these are.
        self.cued_by: dict[int, list[int]] = {}
        for i, steered in self._steered.items():
            for name in steered.keys.cuers:
                if name in self._names:
                    self.cued_by.setdefault(self._names.index(name), []).append(i)
        self._number = count()

    def start(self, start_utc_ns: int) -> None:
        """Let all mounts be at rest then, where they look without cues."""
        for steered in self._steered.values():
            aim = steered.rule.mount.reachable(steered.look_at or steered.rule.home)
            source = HOME if steered.look_at is None else LOOK_AT
            steered.state = CuedState(
                pointing=at_rest(aim, start_utc_ns), aim=aim, source=source, firm=bool(source)
            )

    def change(self, i: int, sensor: Sensor) -> None:
        """Let a sensor's mount be as its keys have it now; it goes on from where it points."""
        keys, before = mount_of(sensor), self._steered.get(i)
        if keys is None or before is None:
            return
        made = self._made(sensor, keys)
        before.keys, before.rule = keys, made.rule
        state = before.state
        if made.look_at is not None and made.look_at != before.look_at:
            before.state = turned_to(state, made.rule, made.look_at, LOOK_AT, None, firm=True)
        elif made.look_at is None and state.source in {HOME, LOOK_AT}:
            before.state = turned_to(state, made.rule, made.rule.home, HOME, None)
        before.look_at = made.look_at

    def cue(self, i: int, cue: Cue, position_enu_m: Any, as_of_ns: int) -> None:
        """Let a mount look as somebody asks, once it knows of it."""
        steered = self._steered[i]
        aim = cue.aim(self._site, position_enu_m, steered.rule.home.field_deg)
        dwell_s = steered.keys.dwell_s if cue.dwell_s is None else cue.dwell_s
        self._put(steered, as_of_ns, (aim, round(dwell_s * NS)))

    def take(self, batch: Batch) -> None:
        """Hand the plots of sensors to the mounts that they cue."""
        for row, i in enumerate(batch.sectors.sensor.tolist()):
            if i not in self.cued_by:
                continue
            plots = batch.one(row).plots
            plots = plots.rows(~np.isnan(plots.azimuth_deg))
            if not len(plots):
                continue
            for other in self.cued_by[i]:
                steered = self._steered[other]
                end_ns = int(batch.sectors.end_ns[row])
                self._put(steered, end_ns, self._batch(i, other, steered, plots))

    def at(self, sectors: Sectors) -> Aims:
        """Where steered sensors point when their scans end; one scan of each."""
        ends_ns, sensors = sectors.end_ns.tolist(), sectors.sensor.tolist()
        states = [self._state_at(i, t) for i, t in zip(sensors, ends_ns, strict=True)]
        return Aims(
            sensor=sectors.sensor,
            pan_deg=np.array([s.pointing.pan_deg for s in states]),
            tilt_deg=np.array([s.pointing.tilt_deg for s in states]),
            field_deg=np.array([s.pointing.field_deg for s in states]),
            sees=np.array([s.sees(t) for s, t in zip(states, ends_ns, strict=True)], np.bool_),
        )

    def state_of(self, i: int) -> CuedState | None:
        """Where a mount pointed in the last scan that was worked out; None without a mount."""
        return self._steered[i].state if i in self._steered else None

    def _made(self, sensor: Sensor, keys: MountKeys) -> _Steered:
        home = home_of(sensor)
        look_at = None
        if keys.look_at is not None:
            look_at = keys.look_at.aim(self._site, sensor.position_enu_m, home.field_deg)
        rule = keys.rule(home)
        state = CuedState(pointing=at_rest(rule.home, 0), aim=rule.home)
        return _Steered(keys, rule, look_at, state)

    def _put(self, steered: _Steered, known_ns: int, what: CueBatch | tuple[Aim, int]) -> None:
        at_ns = known_ns + round(steered.keys.latency_ms * NS_IN_MS)
        if isinstance(what, CueBatch):
            what = replace(what, t_utc_ns=at_ns)
        heappush(steered.pending, (at_ns, next(self._number), what))

    def _batch(self, cuer: int, cued: int, steered: _Steered, plots: Plots) -> CueBatch:
        """Plots of one sensor as another sees their places; of bearings, as their directions.

        What has no elevation is looked for where the sensor looks at home.
        """
        azimuth_deg, elevation_deg, range_m = plots.azimuth_deg, plots.elevation_deg, plots.range_m
        tilts = ~np.isnan(elevation_deg)
        places = ~np.isnan(range_m)
        home = steered.rule.home
        pan_deg, tilt_deg = azimuth_deg.copy(), np.where(tilts, elevation_deg, home.tilt_deg)
        if places.any():
            enu_m = aer_to_enu(
                azimuth_deg[places], np.nan_to_num(elevation_deg[places]), range_m[places]
            )
            seen_enu_m = self._frames[cued].from_ecef(self._frames[cuer].to_ecef(enu_m))
            seen_pan_deg, seen_tilt_deg, _ = enu_to_aer(seen_enu_m)
            pan_deg[places] = np.nan_to_num(seen_pan_deg)
            tilt_deg[places] = np.where(tilts[places], seen_tilt_deg, home.tilt_deg)
        wide_deg = steered.rule.mount.field_max_deg
        sigma_deg = np.fmax(plots.sigma_azimuth_deg, plots.sigma_elevation_deg)
        asked_deg = np.where(tilts, sigma_deg * steered.keys.fov_sigmas, wide_deg)
        return CueBatch(
            t_utc_ns=0,
            source=self._names[cuer],
            pan_deg=pan_deg,
            tilt_deg=tilt_deg,
            field_deg=np.where(np.isnan(asked_deg), wide_deg, np.maximum(asked_deg, 0.01)),
        )

    def _state_at(self, i: int, t_utc_ns: int) -> CuedState:
        """What cues and dwells until then have made of a mount."""
        steered = self._steered[i]
        state, rule, pending = steered.state, steered.rule, steered.pending
        while True:
            comes_ns = pending[0][0] if pending and pending[0][0] <= t_utc_ns else None
            over_ns = state.until_ns
            if (
                over_ns is not None
                and over_ns <= t_utc_ns
                and not (comes_ns is not None and comes_ns <= over_ns)
            ):
                state = advanced(state, rule, over_ns)
                state = after_dwell(state, rule, _joined(steered.recent, over_ns - rule.max_age_ns))
            elif comes_ns is not None:
                what = heappop(pending)[2]
                state = advanced(state, rule, comes_ns)
                if isinstance(what, CueBatch):
                    steered.recent.append(what)
                    state = after_plots(state, rule, what)
                elif state.source != LOOK_AT:
                    state = turned_to(state, rule, what[0], TOPIC, what[1], firm=True)
            else:
                break
        steered.state = advanced(state, rule, t_utc_ns)
        return steered.state


def _joined(recent: deque[CueBatch], since_ns: int) -> CueBatch | None:
    """All directions that are not too old as one batch, of the time of the newest."""
    while recent and recent[0].t_utc_ns < since_ns:
        recent.popleft()
    if not recent:
        return None
    return CueBatch(
        t_utc_ns=recent[-1].t_utc_ns,
        source=recent[-1].source,
        pan_deg=np.concatenate([batch.pan_deg for batch in recent]),
        tilt_deg=np.concatenate([batch.tilt_deg for batch in recent]),
        field_deg=np.concatenate([batch.field_deg for batch in recent]),
    )
