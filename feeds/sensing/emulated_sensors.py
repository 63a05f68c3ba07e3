"""All sensors of a scene at work: a stretch of time in, their looks, plots and messages out.

Nothing here waits or sends. Sensors of a kind are worked out together, each as if it were alone:
what comes out depends neither on how long the stretches are nor on who else is in the scene.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np

from plotfeed.feeds.formats import SceneFormats
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.changes import changed, in_force, instants_ns
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.mount_keys import mount_of
from plotfeed.feeds.sensing.false_alarms_due import FalseAlarmsDue
from plotfeed.feeds.sensing.sensor_group import SensorGroup, SensorsAtWork
from plotfeed.feeds.sensing.sensor_site import SensorSite
from plotfeed.feeds.sensing.steered_sensors import Cueing
from plotfeed.feeds.sensing.world import World
from plotfeed.models.beam import Sector, Sectors, Timetable, Timetables
from plotfeed.models.beam_meetings import Borders
from plotfeed.models.chance import Chance, PairDraws, Purpose, ScanDraws
from plotfeed.models.effects.classification import ClaimDraws
from plotfeed.models.frames import LocalFrames
from plotfeed.models.known_rows import renamed
from plotfeed.models.sensors.stacking import grouping_key
from plotfeed.models.state import Bools
from plotfeed.models.truth import Trajectories
from plotfeed.proto.utc import NS, NS_IN_MS

if TYPE_CHECKING:
    from plotfeed.models.cueing import CuedState
    from plotfeed.models.dwell_agenda import PointedBeams

AHEAD_NS = 10_000_000
"""A sector is worked out this long before its messages are due, so that only sending is left.

So scripted changes count in sectors that end this much later, or begin no earlier.
"""

SCANS_AGAIN = 2
"""Of a sensor that keeps no state: a beam must have been at the border of the sector before."""
NO_GROUP = -1


def keeps_state(sensor: Sensor) -> bool:
    """Whether what a sensor reports depends on more than the scans just before: on all of them."""
    tells_tracks = any(REPORT_FORMATS[name].tells_tracks for name in sensor.report)
    is_steered = mount_of(sensor) is not None
    return tells_tracks or is_steered or sensor.scan.kind == "electronic"


@dataclass(frozen=True, slots=True)
class MissedScans:
    """What a sensor has left out, being late: how many scans, and when its sectors ended, UTC."""

    scans: int
    first_end_ns: int
    last_end_ns: int


class EmulatedSensors:
    """Sensors by their index, where they stand, and what they report."""

    def __init__(
        self, scene: Scene, trajectories: Trajectories, sensors: Sequence[Sensor] | None = None
    ) -> None:
        """Put the sensors of the scene to work, or some of them; raises `PlotfeedError`."""
        self.sensors = list(scene.sensor if sensors is None else sensors)
        """As they are now."""
        self._scripted = tuple(self.sensors)
        self._names = [sensor.id for sensor in self.sensors]
        self._controlled: list[Mapping[str, Any]] = [{} for _ in self.sensors]
        self._scene_site = scene.scene.site
        self._trajectories = trajectories
        self._drones: Sequence[str] = ()
        """Names of the drones that it last knew of, by row."""
        self._formats = SceneFormats(scene.model_copy(update={"sensor": self.sensors}))
        chances = [Chance(scene.scene.seed, sensor.id) for sensor in self.sensors]
        timetables = [
            Timetable(s.scan.period_ns, s.scan.sectors, s.scan.jitter_ms * NS_IN_MS, chance)
            for s, chance in zip(self.sensors, chances, strict=True)
        ]
        frames = [frame_at(self._scene_site, s.position_enu_m) for s in self.sensors]
        self._frames = frames
        self.cueing = Cueing(self._scene_site, self.sensors, frames)
        self._at_work = SensorsAtWork(
            names=self._names,
            frames=LocalFrames.of(frames),
            trajectories=trajectories,
            chances=chances,
            timetables=timetables,
            draws=ScanDraws(chances, Purpose.DETECTION),
            pairs=PairDraws(chances),
            claims=ClaimDraws(chances),
            borders=Borders(len(frames)),
            false_alarms=FalseAlarmsDue(chances, timetables),
            cueing=self.cueing,
        )
        self._next = Timetables(timetables)
        self._enabled = np.array([s.enabled for s in self.sensors], np.bool_)
        self.sites = [self._site_of(i) for i in range(len(self.sensors))]
        self.world = World(scene)
        self.models = [self.world.model_of(sensor) for sensor in self.sensors]
        for i in range(len(self.sensors)):
            self._see_clutter(i)
        self._group_of = np.full(len(self.sensors), NO_GROUP, np.int64)
        self._numbers: dict[Any, int] = {}
        """Of groups, by what their sensors have in common."""
        self._keys: list[Any] = [None] * len(self.sensors)
        self._free_numbers = count()
        self._groups: dict[int, SensorGroup] = {}
        self._group(range(len(self.sensors)))
        self.start_ns = 0
        self._script: list[tuple[int, int]] = []
        """When the script changes which sensor, UTC; the next one last."""
        self._followed_ns = 0
        """Up to when it has been followed."""

    def start(self, start_utc_ns: int) -> None:
        """Begin each with its first whole sector after that time."""
        self.start_ns = start_utc_ns
        self._next.start(start_utc_ns)
        self.cueing.start(start_utc_ns)
        self._script = sorted(
            (
                (start_utc_ns + after_ns, i)
                for i, sensor in enumerate(self._scripted)
                for after_ns in instants_ns(sensor.event)
            ),
            reverse=True,
        )
        self._follow_script_until(start_utc_ns)

    def caught_up(self, until_utc_ns: int) -> Iterator[None]:
        """Work out, a stretch at a time, what others have sent: sectors that end by then.

        Of what keeps no state the last scans are enough; else all since it was started.
        """
        for i, sensor in enumerate(self.sensors):
            if not self.remembers(i):
                from_ns = until_utc_ns - SCANS_AGAIN * sensor.scan.period_ns
                sector = self._at_work.timetables[i].sector_at(from_ns)
                if sector.start_ns > self._next.sector(i).start_ns:
                    self._next.go_on_with(i, sector)
        while (end_ns := self.next_end_ns) is not None and end_ns <= until_utc_ns:
            for batch in self.seen(min(end_ns + NS, until_utc_ns + 1)):
                self.messages(batch)  # of which formats remember some
                yield

    @property
    def next_end_ns(self) -> int | None:
        """When the next sector of any of them ends; None if there is no sensor."""
        return int(self._next.next_end_ns.min()) if self.sensors else None

    def next_sector(self, i: int) -> Sector:
        """The next one of a sensor."""
        return self._next.sector(i)

    def go_on_with(self, i: int, sector: Sector) -> None:
        """Let that be the next one of a sensor, whatever was worked out before."""
        self._next.go_on_with(i, sector)

    def control(self, i: int, controlled: Mapping[str, Any], at_utc_ns: int) -> None:
        """Let a sensor have those keys, over its script, in all sectors not worked out yet.

        Raises `ChangeError`, and nothing has changed.
        """
        sensor = self.as_of(i, controlled, max(at_utc_ns, self._followed_ns))
        self._controlled[i] = controlled
        self._change({i: sensor})

    def as_of(self, i: int, controlled: Mapping[str, Any], at_utc_ns: int) -> Sensor:
        """A sensor as its script has it then, and those keys over that; raises `ChangeError`."""
        scripted = self._scripted[i]
        return changed(scripted, *in_force(scripted.event, at_utc_ns - self.start_ns), controlled)

    def late(self, now_ns: int) -> list[int]:
        """Sensors whose next sector is late by more than a period."""
        return np.flatnonzero(now_ns - self._next.next_end_ns > self._next.period_ns).tolist()

    def skip(self, i: int, now_ns: int) -> MissedScans:
        """Leave out what a sensor is late with: what it has missed.

        The next sector is then the last one that has ended: nothing is made up for in a burst.
        """
        sector = self._next.sector(i)
        last = self._at_work.timetables[i].sector_at(now_ns - (sector.end_ns - sector.start_ns))
        self._next.go_on_with(i, last)
        return MissedScans(last.scan - sector.scan, sector.end_ns, last.start_ns)

    def pointed(self, i: int) -> CuedState | PointedBeams | None:
        """Where a sensor's mount or beams pointed in the last scan; None where nothing turns."""
        return self.cueing.state_of(i) or self._groups[int(self._group_of[i])].beams()

    def remembers(self, i: int) -> bool:
        """Whether what a sensor reports, or one that it cues, depends on all that was before."""
        return keeps_state(self.sensors[i]) or self.cueing.cues(i)

    def seen(self, before_ns: int) -> Iterator[Batch]:
        """What is seen in all sectors that are next and end before that time, a group at a time.

        The script's changes come meanwhile.
        """
        self._forget_gone()
        while len(sectors := self._next.ending_before(before_ns)):
            later = self._later_than_script(sectors)
            if later.any():
                sectors = sectors.rows(~later)
            self._next.take(sectors)
            yield from self._seen(sectors.rows(self._enabled[sectors.sensor]))
            if not later.any():
                return
            self._follow_script_until(self._script[-1][0])

    def _forget_gone(self) -> None:
        """Keep nothing of drones that were forgotten, or whose rows are others' now."""
        names = self._trajectories.names
        if names is not self._drones:
            self._at_work.borders.forget(renamed(self._drones, names), len(names))
            self._at_work.draws.trim(len(names))
            self._at_work.claims.trim(len(names))
            self._drones = names

    def _later_than_script(self, sectors: Sectors) -> Bools:
        """Which sectors are worked out after the next change of the script."""
        if not self._script:
            return np.zeros(len(sectors), np.bool_)
        known_ns = np.maximum(sectors.end_ns - AHEAD_NS, sectors.start_ns)
        return known_ns >= self._script[-1][0]

    def _seen(self, sectors: Sectors) -> Iterator[Batch]:
        if not len(sectors):
            return
        if len(self._groups) == 1:
            (group,) = self._groups.values()
            yield group.look(sectors)
            return
        of_group = self._group_of[sectors.sensor]
        numbers = np.unique(of_group).tolist()
        if len(self.cueing):  # those that cue before those that are cued
            numbers.sort(key=lambda number: self.cueing.rank[self._groups[number].sensors[0]])
        for number in numbers:
            mine = of_group == number
            seen = self._groups[number].look(sectors if mine.all() else sectors.rows(mine))
            if len(self.cueing):
                self.cueing.take(seen)
            yield seen

    def messages(self, batch: Batch) -> list[list[Message]]:
        """What sensors say of each of their sectors, which were seen just now."""
        site = self.sites[batch.sectors.sensor[0]]
        # A sensor that errs is alone, and its clock and axes are its own.
        truth_at = site.apparent_at if site.errs else self._trajectories.state_at
        return self._formats.messages(batch.by_clock(site.clock_ahead_ns, truth_at))

    def _follow_script_until(self, t_utc_ns: int) -> None:
        """Change what the script changes by then."""
        self._followed_ns = t_utc_ns
        found = {}
        while self._script and self._script[-1][0] <= t_utc_ns:
            at_utc_ns, i = self._script.pop()
            found[i] = self.as_of(i, self._controlled[i], at_utc_ns)
        self._change({i: sensor for i, sensor in found.items() if sensor != self.sensors[i]})

    def _change(self, sensors: Mapping[int, Sensor]) -> None:
        """Let those be so from the next sector on."""
        for i, sensor in sensors.items():
            self.sensors[i] = sensor
            self._enabled[i] = sensor.enabled
            self.sites[i] = self._site_of(i)
            self.models[i] = self.world.model_of(sensor)
            self._see_clutter(i)
            self._at_work.false_alarms.forget(i)
            self.cueing.change(i, sensor)
        self._group(sensors)

    def _see_clutter(self, i: int) -> None:
        maps = self.world.clutter_of(self.models[i], self.sites[i].axes, self._trajectories)
        self._at_work.false_alarms.clutter[i] = maps
        if not maps:
            del self._at_work.false_alarms.clutter[i]

    def _site_of(self, i: int) -> SensorSite:
        chance = self._at_work.chances[i]
        return SensorSite.of(self.sensors[i], self._frames[i], self._trajectories, chance)

    def _group(self, which: Iterable[int]) -> None:
        """Put sensors with those of their kind; groups that they leave and join are made anew."""
        anew = {}
        for i in which:
            key = self._key_of(i)
            number = self._numbers.setdefault(key, next(self._free_numbers))
            anew[number], anew[int(self._group_of[i])] = key, self._keys[i]
            self._group_of[i], self._keys[i] = number, key
        anew.pop(NO_GROUP, None)
        for number, key in anew.items():
            of_group = np.flatnonzero(self._group_of == number).tolist()
            self._groups.pop(number, None)
            if not of_group:
                del self._numbers[key]
            else:
                models = [self.models[i] for i in of_group]
                sites = [self.sites[i] for i in of_group]
                self._groups[number] = SensorGroup(self._at_work, of_group, models, sites)

    def _key_of(self, i: int) -> Any:
        """What sensors that share a pass have in common; one that cannot share has its own."""
        model = self.models[i]
        alone = (
            self.sites[i].errs
            or self.sites[i].strengths is not None
            or getattr(model, "merging", None) is not None
            or type(model).alike is None
        )
        return (
            i if alone else None,
            grouping_key(model),
            self.sensors[i].scan.rotates,
            self.sites[i].tells_heights,
            self.sites[i].is_steered,
            self.cueing.rank[i],
        )
