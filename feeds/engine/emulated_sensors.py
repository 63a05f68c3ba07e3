"""All sensors of a scene at work: a stretch of time in, their looks, plots and messages out.

Nothing here waits or sends. Sensors of a kind are worked out together, each as if it were alone:
what comes out depends neither on how long the stretches are nor on who else is in the scene.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from plotfeed.feeds.engine.steered_sensors import Cueing
from plotfeed.feeds.engine.world import World
from plotfeed.feeds.formats import SceneFormats
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.changes import changed, in_force, instants_ns
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.effect_keys import readings_of
from plotfeed.feeds.scene.sensors.mount_keys import mount_of
from plotfeed.feeds.scene.sensors.sensor_keys import SensorGeometry
from plotfeed.models.beam import Borders, Sector, Sectors, Timetable, Timetables, meetings
from plotfeed.models.chance import NO_SCAN, Chance, DrawsBySensor, PairDraws, Purpose, ScanDraws
from plotfeed.models.effects.classification import ClaimDraws
from plotfeed.models.frames import Axes, LocalFrame, LocalFrames, aer_to_enu, enu_to_aer, rows_about
from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.sensors.polar_radar import PolarRadar
from plotfeed.models.sensors.sensor_model import (
    NO_LOOKS,
    NO_PLOTS,
    DwellingSensor,
    JointSensor,
    SensorModel,
    Targets,
    grouping_key,
    stacked,
)
from plotfeed.models.state import (
    Bools,
    Columns,
    Floats,
    Ints,
    Looks,
    PlaceState,
    Plots,
    TruthState,
    renamed,
)
from plotfeed.models.truth import Trajectories
from plotfeed.proto.utc import NS, NS_IN_MS

if TYPE_CHECKING:
    from plotfeed.feeds.engine.steered_sensors import Aims, Cueing
    from plotfeed.models.clutter import ClutterMap
    from plotfeed.models.cueing import CuedState
    from plotfeed.models.dwell_agenda import PointedBeams
    from plotfeed.models.effects.classification import ClaimDraws
    from plotfeed.models.effects.decorrelation import TargetStrengths
    from plotfeed.models.effects.readings import Readings


OfSensor = tuple[int, Plots]
NONE_DUE_NS = np.iinfo(np.int64).max


class FalseAlarmsDue:
    """Draws false alarms, and keeps those that are not due yet, by the index of the sensor."""

    def __init__(self, chances: Sequence[Chance], timetables: Sequence[Timetable]) -> None:
        self._chances = chances
        self._timetables = timetables
        # The last one of each sensor whose alarms are drawn.
        self._scan = np.full(len(chances), NO_SCAN, np.int64)
        self._next_ns = np.full(len(chances), NONE_DUE_NS, np.int64)
        self._due: dict[int, Plots] = {}
        # Maps of sensors that see any, whose plots come as false alarms do.
        self.clutter: dict[int, Sequence[ClutterMap]] = {}

    def forget(self, sensor: int) -> None:
        """Draw those of the scan under way anew: the sensor's model is another one now."""
        self._scan[sensor] = NO_SCAN
        self._next_ns[sensor] = NONE_DUE_NS
        self._due.pop(sensor, None)

    def of_scans(self, sectors: Sectors, models: Mapping[int, SensorModel]) -> list[OfSensor]:
        """False alarms of scans of sensors that stare, by sensor."""
        found = []
        for row, sensor in enumerate(sectors.sensor.tolist()):
            alarms = self._drawn(sensor, int(sectors.scan[row]), sectors.one(row), models[sensor])
            if len(alarms):
                found.append((sensor, alarms))
        return found

    def of_turns(self, sectors: Sectors, models: Mapping[int, SensorModel]) -> list[OfSensor]:
        """False alarms within sectors of rotating sensors, of which each one's are in order."""
        begun = sectors.scan != self._scan[sectors.sensor]
        if begun.any():
            which = zip(sectors.sensor[begun].tolist(), sectors.scan[begun].tolist(), strict=True)
            for sensor, scan in dict.fromkeys(which):
                if scan != self._scan[sensor]:
                    turn = self._timetables[sensor].turn(scan)
                    alarms = self._drawn(sensor, scan, turn, models[sensor])
                    self._scan[sensor] = scan
                    if len(alarms):
                        kept = [self._due.get(sensor, NO_PLOTS), alarms]
                        self._keep(sensor, Plots.joined(kept))
        is_due = self._next_ns[sectors.sensor] < sectors.end_ns
        if not is_due.any():
            return []
        due = np.unique(sectors.sensor[is_due])
        return [
            (sensor, alarms)
            for sensor in due.tolist()
            if len(alarms := self._taken(sensor, sectors))
        ]

    def _drawn(self, sensor: int, scan: int, sector: Sector, model: SensorModel) -> Plots:
        """False alarms of a scan, and what clutter adds to them."""
        chance = self._chances[sensor]
        alarms = model.draw_false_alarms(sector, chance.rng(Purpose.FALSE_ALARMS, scan))
        if sensor not in self.clutter or not isinstance(model, PolarRadar):
            return alarms
        rng = chance.rng(Purpose.CLUTTER, scan)
        found = [each.plots(model, sector, rng) for each in self.clutter[sensor]]
        return Plots.joined([alarms, *found])

    def _taken(self, sensor: int, sectors: Sectors) -> Plots:
        of_sensor = sectors.sensor == sensor
        alarms, start_ns = self._due[sensor], sectors.start_ns[of_sensor][0]
        a, b = np.searchsorted(alarms.t_utc_ns, (start_ns, sectors.end_ns[of_sensor][-1]))
        self._keep(sensor, alarms.between(int(b), len(alarms)))
        return alarms.between(int(a), int(b))

    def _keep(self, sensor: int, alarms: Plots) -> None:
        if len(alarms):
            self._due[sensor] = alarms = alarms.in_order_of_time()
            self._next_ns[sensor] = alarms.t_utc_ns[0]
        else:
            self._due.pop(sensor, None)
            self._next_ns[sensor] = NONE_DUE_NS


class SidelobeLooks:
    """Sensors that report what comes by their side lobes, by their index; at least one."""

    def __init__(
        self, radars: Mapping[int, PolarRadar], whose: Mapping[int, int], chances: Sequence[Chance]
    ) -> None:
        """`whose` are rows among drones in which the plots of each stand."""
        self._radars, self._whose, self._chances = radars, whose, chances

    @classmethod
    def of(
        cls,
        models: Mapping[int, SensorModel],
        names: Sequence[str],
        trajectories: Trajectories,
        chances: Sequence[Chance],
    ) -> Self | None:
        """Looks of such sensors; None if there are none. Each gets a name among the drones."""
        radars = {
            i: model
            for i, model in models.items()
            if isinstance(model, PolarRadar) and model.shows_sidelobes
        }
        if not radars:
            return None
        from plotfeed.models.movers import other_name
        from plotfeed.models.sidelobe_echoes import SIDELOBE

        whose = {i: trajectories.add_other(other_name(SIDELOBE, names[i])) for i in radars}
        return cls(radars, whose, chances)

    def plots(self, sectors: Sectors, targets_of: Callable[[Sectors], Targets]) -> list[OfSensor]:
        """Plots of sectors, by sensor; `targets_of` gives targets at the end of one of them."""
        from plotfeed.models.sidelobe_echoes import sidelobe_plots

        found = []
        for k, sensor in enumerate(sectors.sensor.tolist()):
            if sensor not in self._radars:
                continue
            one = sectors.rows(np.array([k]))
            sector = one.one(0)
            rng = self._chances[sensor].rng(Purpose.SIDELOBES, sector.scan, sector.index)
            plots = sidelobe_plots(
                self._radars[sensor], targets_of(one), sector, self._whose[sensor], rng
            )
            if len(plots):
                found.append((sensor, plots))
        return found


@dataclass(frozen=True, slots=True)
class SensorSite:
    """Where a sensor stands among the drones.

    `axes` are its own: another frame than `frame` only if it stands askew. `readings` are what it
    reads in place of what it finds, None if that is the same, `strengths` those of targets where
    they last from scan to scan. Its clock may be ahead. `errs` says
    whether there is any of this; `tells_heights`, whether any of its formats has heights.
    """

    frame: LocalFrame
    axes: LocalFrame
    readings: Readings | None
    strengths: TargetStrengths | None
    clock_ahead_ns: int
    reads_bistatic_ranges: bool
    errs: bool
    tells_heights: bool
    is_steered: bool  # Whether a mount turns it
    trajectories: Trajectories

    @classmethod
    def of(
        cls, sensor: Sensor, frame: LocalFrame, trajectories: Trajectories, chance: Chance
    ) -> Self:
        """The site of a sensor that stands at a frame's place, with its systematic errors."""
        return cls(
            frame=frame,
            axes=frame if sensor.bias is None else sensor.bias.axes(frame),
            readings=readings_of(sensor.bias, sensor.drift, chance, sensor.scan.period_ns),
            strengths=strengths_of(sensor, chance),
            reads_bistatic_ranges=sensor.geometry is SensorGeometry.BISTATIC,
            clock_ahead_ns=sensor.clock_ahead_ns,
            errs=sensor.bias is not None or sensor.drift is not None,
            tells_heights=any(REPORT_FORMATS[name].tells_heights for name in sensor.report),
            is_steered=mount_of(sensor) is not None,
            trajectories=trajectories,
        )

    @property
    def own_axes(self) -> Floats | None:
        """Rotation from true east, north and up to its own, (3, 3); None if it stands right."""
        if self.axes is self.frame:
            return None
        return np.asarray(self.axes.rotation_from_ecef @ self.frame.rotation_from_ecef.T)

    def as_they_truly_were(self, looks: Looks) -> Looks:
        """Looks along the sensor's own axes, by true east, north and up."""
        own_enu_m = aer_to_enu(looks.azimuth_deg, looks.elevation_deg, looks.range_m)
        true_enu_m = self.frame.rotate_from_ecef(self.axes.rotate_to_ecef(own_enu_m))
        azimuth_deg, elevation_deg, _ = enu_to_aer(true_enu_m)
        return looks.but(azimuth_deg=azimuth_deg, elevation_deg=elevation_deg)

    def apparent_at(self, t_utc_ns: int, drones: Ints) -> TruthState:
        """Where drones are at a time of the sensor's clock, by its own axes and readings.

        Errors of bistatic ranges are left out: the sensor's tracks take the place as it is.
        """
        truth = self.trajectories.state_at(t_utc_ns - self.clock_ahead_ns, drones)
        place_enu_m = self.axes.from_ecef(truth.position_ecef_m)
        if self.readings is not None:
            azimuth_deg, elevation_deg, range_m = enu_to_aer(place_enu_m)
            azimuth_deg = self.readings.azimuth_deg(azimuth_deg, truth.t_utc_ns)
            if not self.reads_bistatic_ranges:
                range_m = self.readings.range_m(range_m, truth.t_utc_ns)
            place_enu_m = aer_to_enu(np.nan_to_num(azimuth_deg), elevation_deg, range_m)
        velocity_enu_m_s = self.axes.rotate_from_ecef(truth.velocity_ecef_m_s)
        return replace(
            truth,
            position_ecef_m=self.frame.to_ecef(place_enu_m),
            velocity_ecef_m_s=self.frame.rotate_to_ecef(velocity_enu_m_s),
        )


def strengths_of(sensor: Sensor, chance: Chance) -> TargetStrengths | None:
    """How strong targets are to a sensor for which they stay so for a while; None to others."""
    tau_s: float | None = getattr(sensor, "decorrelation_s", None)
    if tau_s is None:
        return None
    from plotfeed.models.effects.decorrelation import TargetStrengths

    return TargetStrengths(chance, step_ns=sensor.scan.period_ns, time_constant_ns=tau_s * NS)


def with_heights(plots: Plots, frames: Axes) -> Plots:
    """Heights of plots of sensors in those frames, if they have a place in three dimensions."""
    if not (plots.measures("elevation_deg") and plots.measures("range_m")):
        return plots
    height_m = frames.heights_m(plots.azimuth_deg, plots.elevation_deg, plots.range_m)
    return plots.but(height_m=height_m)


# Of the fixed point for when a sound left: they leave 3 cm at 60 m/s and 1 km.
TRAVEL_TIME_STEPS = 5
# By which a drone may be further away when its sound arrives: at half the speed of that.
WHILE_IT_TRAVELS = 1.5

C = TypeVar("C", bound=Columns)


@dataclass(frozen=True, slots=True)
class SensorsAtWork:
    """What all sensors of a scene have in common, each thing by the index of the sensor."""

    names: Sequence[str]
    frames: Axes
    trajectories: Trajectories
    chances: Sequence[Chance]
    timetables: Sequence[Timetable]
    draws: ScanDraws
    pairs: PairDraws
    claims: ClaimDraws
    borders: Borders
    false_alarms: FalseAlarmsDue
    cueing: Cueing


class SensorGroup:
    """Sensors that share a pass: those of one kind, with the same effects."""

    def __init__(
        self,
        at_work: SensorsAtWork,
        sensors: Sequence[int],
        models: Sequence[SensorModel],
        sites: Sequence[SensorSite],
    ) -> None:
        """`sensors` are their indices; one that errs in what it reads is alone."""
        self.sensors = np.array(sensors, np.int64)
        self.models = dict(zip(sensors, models, strict=True))
        self.site = sites[0]
        self._at_work = at_work
        # Of one sensor, its own, which stand for all rows; else by the index of the sensor.
        is_one = len(sensors) == 1
        self._frames: Axes = self.site.frame if is_one else at_work.frames
        self._axes: Axes = self.site.axes if is_one else at_work.frames
        self._model = stacked(models)
        # A kind of which each sensor is alone knows of no columns that say whose a row is.
        self._shares = self._model.alike is not None
        self._measures_rates = self._model.measures_range_rate
        self._travels = self._model.signal_speed_m_s is not None
        self._held_ns = self._model.claims_held_ns
        self._merges = getattr(self._model, "merging", None) is not None
        from plotfeed.models.dwell_agenda import Agenda

        self._agenda = Agenda.empty()
        self._sidelobes: SidelobeLooks | None = None
        if any(model.shows_sidelobes for model in models):
            of_scene = at_work.names, at_work.trajectories, at_work.chances
            self._sidelobes = SidelobeLooks.of(self.models, *of_scene)
        self._place = np.zeros(max(sensors) + 1, np.int64)
        self._place[self.sensors] = np.arange(len(sensors))
        self._reach_m = np.zeros(max(sensors) + 1)
        self._reach_m[self.sensors] = [model.range_max_m for model in models]

    def beams(self) -> PointedBeams | None:
        """Where the beams of the last period pointed; None where none is steered."""
        model = self._model
        return model.pointed(self._agenda) if isinstance(model, DwellingSensor) else None

    @nan_without_warnings
    def look(self, sectors: Sectors) -> Batch:
        """What comes of sectors of these sensors, as far as is known now."""
        if not sectors.stares[0]:
            if not self._merges:
                return self._turn(sectors)
            # A look is compared with its nearest neighbours: those of other turns are none.
            n = self._at_work.timetables[int(sectors.sensor[0])].sectors
            turns = [
                sectors.rows(np.arange(i, min(i + n, len(sectors))))
                for i in range(0, len(sectors), n)
            ]
            return Batch.joined([self._turn(turn) for turn in turns])
        scans = []
        while len(sectors):  # one scan of each sensor after the other
            first = sectors.first_of_sensors()
            scans.append(self._stare(sectors.rows(first)))
            sectors = sectors.rows(~first)
        return Batch.joined(scans)

    def _stare(self, sectors: Sectors) -> Batch:
        """Looks at all drones that are there when a scan ends; one scan of each sensor."""
        row, truth = self._there_at_the_end(sectors)
        aims = None
        if self.site.is_steered:
            aims = self._at_work.cueing.at(sectors)
            row, truth = row[aims.sees[row]], truth.rows(aims.sees[row])
        chances, scans = self._at_work.chances, sectors.scan.tolist()
        generators = [
            chances[sensor].rng(Purpose.DETECTION, scan)
            for sensor, scan in zip(sectors.sensor.tolist(), scans, strict=True)
        ]
        targets, row = self._targets(truth, row, sectors.sensor)
        if aims is not None:
            targets = aims.by_mount(targets, row)
        rng: Any = generators[0]
        if isinstance(self._model, DwellingSensor):
            looks, detections, self._agenda = self._model.observe_period(
                self._agenda, targets, sectors.one(0), rng
            )
            looks = self._as_they_were(looks)
        elif isinstance(self._model, JointSensor):
            looks, detections = self._model.observe_scan(targets, sectors.one(0), rng)
            looks = self._as_they_were(looks)
        else:
            if self._shares:  # else it may draw as it likes
                rng = DrawsBySensor(generators, row)
            looks, detections = self._observed(targets, sectors.sensor[row], rng, aims)
        alarms = self._at_work.false_alarms.of_scans(sectors, self.models)
        alarms += self._by_sidelobes(sectors)
        if aims is not None:
            alarms = [
                (sensor, aims.of_alarms(found, sensor, self.models[sensor]))
                for sensor, found in alarms
                if aims.sees[np.searchsorted(sectors.sensor, sensor)]
            ]
        return self._batch(sectors, looks, detections, alarms)

    def _turn(self, sectors: Sectors) -> Batch:
        """Looks at the drones that beams pass in their sectors."""
        at_work = self._at_work
        met = meetings(sectors, self._axes, at_work.trajectories, at_work.borders, self._reach_m)
        alarms = at_work.false_alarms.of_turns(sectors, self.models) + self._by_sidelobes(sectors)
        if not len(met.truth):
            looks, detections = NO_LOOKS, NO_PLOTS
        elif self._merges:
            looks, detections = self._observed_among_neighbours(sectors, met.truth)
        else:
            looks, detections = self._met(sectors, met.truth, met.row)
        return self._batch(sectors, looks, detections, alarms)

    def _met(self, sectors: Sectors, truth: TruthState, row: Ints) -> tuple[Looks, Plots]:
        """What the model makes of drones, each met within a sector, by its row."""
        targets, row = self._targets(truth, row, sectors.sensor)
        draws = self._at_work.draws.of(sectors.sensor[row], sectors.scan[row], targets.drone)
        return self._observed(targets, sectors.sensor[row], draws)

    def _by_sidelobes(self, sectors: Sectors) -> list[OfSensor]:
        return self._sidelobes.plots(sectors, self._all_at_the_end) if self._sidelobes else []

    def _all_at_the_end(self, sectors: Sectors) -> Targets:
        row, truth = self._there_at_the_end(sectors)
        return self._targets(truth, row, sectors.sensor)[0]

    def _observed_among_neighbours(
        self, sectors: Sectors, truth: TruthState
    ) -> tuple[Looks, Plots]:
        """Looks and plots where echoes merge, also across the borders of sectors of a sensor."""
        sensor = int(sectors.sensor[0])
        timetable = self._at_work.timetables[sensor]
        start_ns, end_ns = int(sectors.start_ns[0]), int(sectors.end_ns[-1])
        before = Sectors.of([timetable.sector_at(start_ns - 1)], sensor)
        after = Sectors.of([timetable.next_sector(sectors.one(len(sectors) - 1))], sensor)

        def others_of(sector: Sectors) -> TruthState:
            met = meetings(
                sector, self._axes, self._at_work.trajectories, reach_m=self._reach_m
            ).truth
            near = np.abs(truth.t_utc_ns - sector.start_ns[0]) < timetable.period_ns // 2
            return met.rows(~np.isin(met.drone, truth.drone[near]))

        everybody = TruthState.joined([others_of(before), truth, others_of(after)])
        all_sectors = Sectors.joined([before, sectors, after])
        row = np.searchsorted(all_sectors.end_ns, everybody.t_utc_ns, side="right")
        looks, plots = self._met(all_sectors, everybody, row)
        of_looks, of_plots = (
            (found.t_utc_ns >= start_ns) & (found.t_utc_ns < end_ns) for found in (looks, plots)
        )
        return looks.rows(of_looks), plots.rows(of_plots)

    @property
    def _needs_velocities(self) -> bool:
        """Whether what is seen of drones depends on how they fly."""
        echoes = self._at_work.trajectories.signatures.echoes
        return self._measures_rates or (echoes is not None and echoes.has_aspects)

    def _there_at_the_end(self, sectors: Sectors) -> tuple[Ints, PlaceState]:
        """Drones within reach at the ends of scans: the row of each, and its state."""
        trajectories = self._at_work.trajectories
        ends_ns, at = np.unique(sectors.end_ns, return_inverse=True)
        positions_ecef_m = trajectories.positions_at(ends_ns)
        frames = self._frames.rows(sectors.sensor[:, None])
        reach_m = self._reach(sectors.sensor)
        about = rows_about(self._frames.rows(sectors.sensor), positions_ecef_m, reach_m)
        near = frames.has_within(positions_ecef_m[:, about][at], reach_m[:, None])
        row, column = np.nonzero(near)
        drone = about[column]
        t_utc_ns = sectors.end_ns[row]
        if self._needs_velocities:
            return row, trajectories.state_at(t_utc_ns, drone)
        position_ecef_m = positions_ecef_m[at[row], drone]
        return row, PlaceState(drone=drone, t_utc_ns=t_utc_ns, position_ecef_m=position_ecef_m)

    def _reach(self, sensor: Ints) -> Floats:
        """Beyond this a sensor senses nothing, metres."""
        return self._reach_m[sensor] * (WHILE_IT_TRAVELS if self._travels else 1.0)

    def _targets(self, truth: PlaceState, row: Ints, sensors: Ints) -> tuple[Targets, Ints]:
        """Drones as they are and as they are sensed, and the row of each; `sensors` are by row."""
        frames = self._frames.rows(sensors[row])
        true_position_enu_m = frames.from_ecef(truth.position_ecef_m)
        sensed, t_utc_ns, position_enu_m = truth, truth.t_utc_ns, true_position_enu_m
        if self._travels:
            sensed, position_enu_m, there = self._when_it_left(truth, position_enu_m, sensors[row])
            t_utc_ns, true_position_enu_m = t_utc_ns[there], true_position_enu_m[there]
            row = row[there]
        if self.site.axes is not self.site.frame:
            position_enu_m = self.site.axes.from_ecef(sensed.position_ecef_m)
        velocity_enu_m_s = None
        if self._needs_velocities and isinstance(sensed, TruthState):
            velocity_enu_m_s = frames.rotate_from_ecef(sensed.velocity_ecef_m_s)
        targets = Targets(
            drone=sensed.drone,
            t_utc_ns=t_utc_ns,
            position_enu_m=position_enu_m,
            true_position_enu_m=true_position_enu_m,
            signatures=self._at_work.trajectories.signatures,
            velocity_enu_m_s=velocity_enu_m_s,
            readings=self.site.readings,
            strengths=self.site.strengths,
            own_axes=self.site.own_axes,
            emitted_utc_ns=None if sensed is truth else sensed.t_utc_ns,
            sensor=sensors[row] if self._shares else None,
        )
        if self._held_ns:
            from plotfeed.models.effects.classification import HeldClaims

            held = HeldClaims(self._at_work.claims, int(self.sensors[0]), self._held_ns)
            targets = replace(targets, claims=held)
        if self._model.draws_by_pair:
            pairs, names = self._at_work.pairs, self._at_work.trajectories.names
            targets = replace(targets, pair_draws=pairs.of(sensors[row], sensed.drone, names))
        return targets, row

    def _when_it_left(
        self, truth: PlaceState, position_enu_m: Floats, sensor: Ints
    ) -> tuple[PlaceState, Floats, Ints]:
        """The drones when what arrives now left them, if they were there, and which these are.

        At t - d/c, where d is the distance then. Each step shrinks the error by the drone's speed
        over that of the signal.
        """
        there = np.arange(len(truth))
        departure_ns, position_ecef_m = truth.t_utc_ns, truth.position_ecef_m
        for _ in range(TRAVEL_TIME_STEPS):
            speed_m_s = self._model_of(sensor[there]).signal_speed_m_s
            travel_ns = np.linalg.norm(position_enu_m, axis=1) / speed_m_s * NS
            departure_ns = truth.t_utc_ns[there] - np.rint(travel_ns).astype(np.int64)
            position_ecef_m = self._at_work.trajectories.position_at(
                departure_ns, truth.drone[there]
            )
            alive = ~np.isnan(position_ecef_m[:, 0])
            if not alive.all():
                there, departure_ns = there[alive], departure_ns[alive]
                position_ecef_m = position_ecef_m[alive]
            position_enu_m = self._frames.rows(sensor[there]).from_ecef(position_ecef_m)
        sensed = PlaceState(
            drone=truth.drone[there], t_utc_ns=departure_ns, position_ecef_m=position_ecef_m
        )
        return sensed, position_enu_m, there

    def _model_of(self, sensor: Ints) -> SensorModel:
        return self._model.rows(self._place[sensor])

    def _observed(
        self, targets: Targets, sensor: Ints, rng: Any, aims: Aims | None = None
    ) -> tuple[Looks, Plots]:
        looks, plots = self._model_of(sensor).observe(targets, rng)
        if aims is not None:
            looks, plots = aims.back(looks), aims.back(plots)
        return self._as_they_were(looks), plots

    def _as_they_were(self, looks: Looks) -> Looks:
        skew = self.site.axes is not self.site.frame
        return self.site.as_they_truly_were(looks) if skew else looks

    def _batch(
        self, sectors: Sectors, looks: Looks, plots: Plots, alarms: Sequence[OfSensor]
    ) -> Batch:
        """Looks and plots by sector, plots with heights if any format tells them."""
        if alarms:
            if self._shares:
                alarms = [
                    (sensor, found.but(sensor=np.full(len(found), sensor)))
                    for sensor, found in alarms
                ]
            plots = Plots.joined([plots, *(found for _, found in alarms)])
        looks, looks_by = self._by_sector(sectors, looks)
        plots, plots_by = self._by_sector(sectors, plots)
        if self.site.tells_heights and len(plots):
            sensor = np.repeat(sectors.sensor, np.diff(plots_by))
            plots = with_heights(plots, self._frames.rows(sensor))
        names = self._at_work.trajectories.names
        return Batch(
            sectors, plots, plots_by, looks, looks_by, sensors=self._at_work.names, names=names
        )

    def _by_sector(self, sectors: Sectors, columns: C) -> tuple[C, Ints]:
        """Rows by sensor and in the order of time, and where those of each sector begin."""
        if not len(columns):
            return columns, np.zeros(len(sectors) + 1, np.int64)
        held: dict[str, NDArray[Any]] = vars(columns)
        t_utc_ns, sensor = held["t_utc_ns"], held.get("sensor")
        if sensor is None:
            sensor = np.broadcast_to(sectors.sensor[0], len(t_utc_ns))
        place = sectors.places(sensor, t_utc_ns)
        if (place[1:] < place[:-1]).any():
            order = np.argsort(place, kind="stable")
            columns, place = columns.rows(order), place[order]
        return columns, sectors.offsets(place)


# A sector is worked out this long before its messages are due, so that only sending is left.
#
# So scripted changes count in sectors that end this much later, or begin no earlier.
AHEAD_NS = 10_000_000

# Of a sensor that keeps no state: a beam must have been at the border of the sector before.
SCANS_AGAIN = 2
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
        self.sensors = list(scene.sensor if sensors is None else sensors)  # As they are now
        self._scripted = tuple(self.sensors)
        self._names = [sensor.id for sensor in self.sensors]
        self._controlled: list[Mapping[str, Any]] = [{} for _ in self.sensors]
        self._scene_site = scene.scene.site
        self._trajectories = trajectories
        self._drones: Sequence[str] = ()  # Names of the drones that it last knew of, by row
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
        self._numbers: dict[Any, int] = {}  # Of groups, by what their sensors have in common
        self._keys: list[Any] = [None] * len(self.sensors)
        self._free_numbers = count()
        self._groups: dict[int, SensorGroup] = {}
        self._group(range(len(self.sensors)))
        self.start_ns = 0
        # When the script changes which sensor, UTC; the next one last.
        self._script: list[tuple[int, int]] = []
        self._followed_ns = 0  # Up to when it has been followed

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

    def skip_scan(self, i: int) -> MissedScans:
        """Leave out the scan that a sensor is in or begins next, to its end: what it has missed."""
        sector = self._next.sector(i)
        following = self._at_work.timetables[i].sector(sector.scan + 1, 0)
        self._next.go_on_with(i, following)
        return MissedScans(1, sector.end_ns, following.start_ns)

    @property
    def period_ns(self) -> Ints:
        """Period of each; (n,)."""
        return self._next.period_ns

    @property
    def sectors_per_ns(self) -> Floats:
        """How many sectors each has to work out in a nanosecond; none that is not enabled; (n,)."""
        return np.where(self._enabled, self._next.sectors / self._next.period_ns, 0.0)

    def begins_before(self, before_ns: int) -> Bools:
        """Which begin a scan next, of which the first sector ends before that time; (n,)."""
        return self._next.begins_scan & (self._next.next_end_ns < before_ns) & self._enabled

    @property
    def amid_scans(self) -> Bools:
        """Which have begun a scan that is not over; (n,)."""
        return ~self._next.begins_scan & self._enabled

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
        names = self._trajectories.names
        if names is not self._drones:  # some were forgotten, or their rows are others' now
            self._at_work.borders.forget(renamed(self._drones, names), len(names))
            self._at_work.draws.trim(len(names))
            self._at_work.claims.trim(len(names))
            self._drones = names
        while len(sectors := self._next.ending_before(before_ns)):
            later = None
            if self._script:
                known_ns = np.maximum(sectors.end_ns - AHEAD_NS, sectors.start_ns)
                later = known_ns >= self._script[-1][0]
                sectors = sectors.rows(~later)
            self._next.take(sectors)
            yield from self._seen(sectors.rows(self._enabled[sectors.sensor]))
            if later is None or not later.any():
                return
            self._follow_script_until(self._script[-1][0])

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
            if self._enabled[i] and not sensor.enabled:
                self._formats.switched_off(i)
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
