"""All sensors of a scene at work: a stretch of time in, their looks, plots and messages out.

Nothing here waits or sends. Sensors of a kind are worked out together, each as if it were alone:
what comes out depends neither on how long the stretches are nor on who else is in the scene.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

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
from plotfeed.feeds.scene.sensors.mount_keys import cue_order, mount_of
from plotfeed.feeds.scene.sensors.sensor_keys import SensorGeometry
from plotfeed.models.beam import Borders, Sector, Sectors, Timetable, Timetables, meetings
from plotfeed.models.chance import NO_SCAN, Chance, DrawsBySensor, PairDraws, Purpose, ScanDraws
from plotfeed.models.dwell_agenda import Agenda, PointedBeams
from plotfeed.models.effects.classification import ClaimDraws, HeldClaims
from plotfeed.models.frames import Axes, LocalFrame, aer_to_enu, enu_to_aer, rows_about
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
    from plotfeed.feeds.engine.steered_sensors import Cueing
    from plotfeed.models.clutter import ClutterMap
    from plotfeed.models.cueing import CuedState
    from plotfeed.models.effects.target_echoes import TargetStrengths


OfSensor = tuple[int, Plots]
NONE_DUE_NS = np.iinfo(np.int64).max


class FalseAlarmsDue:
    """Draws false alarms, and keeps those that are not due yet, by the index of the sensor."""

    def __init__(
        self, chances: Sequence[Chance], timetables: Sequence[Timetable], draws_in: Ints
    ) -> None:
        """A rotating sensor draws those of its next turn in that of its sectors, (n,)."""
        self._chances = chances
        self._timetables = timetables
        # The last one of each sensor whose alarms are drawn.
        self._scan = np.full(len(chances), NO_SCAN, np.int64)
        self._draws_in = draws_in
        self._next_ns = np.full(len(chances), NONE_DUE_NS, np.int64)
        self._due: dict[int, Plots] = {}
        # Maps of clutter that sensors see, whose plots come as false alarms do.
        self._clutter: list[Sequence[ClutterMap]] = [()] * len(chances)

    def begin_anew(self, sensor: int, clutter: Sequence[ClutterMap]) -> None:
        """Draw those of the scan under way anew, and with them what that clutter adds."""
        self._clutter[sensor] = clutter
        self._scan[sensor] = NO_SCAN
        self._keep(sensor, NO_PLOTS)

    def of_scans(self, sectors: Sectors, models: Mapping[int, SensorModel]) -> list[OfSensor]:
        """False alarms of scans of sensors that stare, by sensor."""
        return [
            (sensor, alarms)
            for row, sensor in enumerate(sectors.sensor.tolist())
            if len(alarms := self._drawn(sensor, sectors.one(row), models[sensor]))
        ]

    def of_turns(self, sectors: Sectors, models: Mapping[int, SensorModel]) -> list[OfSensor]:
        """False alarms within sectors of rotating sensors, of which each one's are in order."""
        # The scan up to which those of each sensor are drawn by the end of its sector.
        drawn = sectors.scan + (sectors.index >= self._draws_in[sectors.sensor])
        for row in np.flatnonzero(drawn > self._scan[sectors.sensor]).tolist():
            sensor = int(sectors.sensor[row])
            first = max(int(sectors.scan[row]), int(self._scan[sensor]) + 1)
            for scan in range(first, int(drawn[row]) + 1):
                turn = self._timetables[sensor].turn(scan)
                alarms = self._drawn(sensor, turn, models[sensor])
                self._scan[sensor] = scan
                if len(alarms):
                    self._keep(sensor, Plots.joined([self._due.get(sensor, NO_PLOTS), alarms]))
        is_due = self._next_ns[sectors.sensor] < sectors.end_ns
        if not is_due.any():
            return []
        found = []
        for sensor in np.unique(sectors.sensor[is_due]).tolist():
            alarms, of_sensor = self._due[sensor], np.flatnonzero(sectors.sensor == sensor)
            limits_ns = sectors.start_ns[of_sensor[0]], sectors.end_ns[of_sensor[-1]]
            first, end = np.searchsorted(alarms.t_utc_ns, limits_ns).tolist()
            self._keep(sensor, alarms.between(end, len(alarms)))
            found.append((sensor, alarms.between(first, end)))
        return found

    def _drawn(self, sensor: int, sector: Sector, model: SensorModel) -> Plots:
        """False alarms of a scan, and what clutter adds to them."""
        chance, clutter = self._chances[sensor], self._clutter[sensor]
        alarms = model.draw_false_alarms(sector, chance.rng(Purpose.FALSE_ALARMS, sector.scan))
        if not (clutter and isinstance(model, PolarRadar)):
            return alarms
        rng = chance.rng(Purpose.CLUTTER, sector.scan)
        return Plots.joined([alarms, *(each.plots(model, sector, rng) for each in clutter)])

    def _keep(self, sensor: int, alarms: Plots) -> None:
        if len(alarms):
            self._due[sensor] = alarms = alarms.in_order_of_time()
            self._next_ns[sensor] = alarms.t_utc_ns[0]
        else:
            self._due.pop(sensor, None)
            self._next_ns[sensor] = NONE_DUE_NS


class SensorSite:
    """Where a sensor stands among the drones, and what it reads in place of what it finds."""

    def __init__(
        self, sensor: Sensor, frame: LocalFrame, trajectories: Trajectories, chance: Chance
    ) -> None:
        """`frame` is that of its place; it errs, stands askew and tells heights as its keys say."""
        self.frame = frame
        self._trajectories = trajectories
        # Its own axes: another frame than that of its place only if it stands askew.
        self.axes = frame if sensor.bias is None else sensor.bias.axes(frame)
        # Rotation from true east, north and up to its own, (3, 3); None if it stands right.
        self.own_axes: Floats | None = None
        if self.axes is not frame:
            self.own_axes = np.asarray(self.axes.rotation_from_ecef @ frame.rotation_from_ecef.T)
        # What it reads in place of what it finds; None if that is the same.
        self.readings = readings_of(sensor.bias, sensor.drift, chance, sensor.scan.period_ns)
        # How strong targets are, where they stay so from scan to scan.
        self.strengths: TargetStrengths | None = None
        tau_s: float | None = getattr(sensor, "decorrelation_s", None)
        if tau_s is not None:
            from plotfeed.models.effects.target_echoes import TargetStrengths

            step_ns, constant_ns = sensor.scan.period_ns, tau_s * NS
            self.strengths = TargetStrengths(chance, step_ns=step_ns, time_constant_ns=constant_ns)
        self.clock_ahead_ns = sensor.clock_ahead_ns
        self.errs = sensor.bias is not None or sensor.drift is not None
        self._reads_bistatic_ranges = sensor.geometry is SensorGeometry.BISTATIC
        # Whether any of its formats has heights.
        self.tells_heights = any(REPORT_FORMATS[name].tells_heights for name in sensor.report)
        self.is_steered = mount_of(sensor) is not None  # Whether a mount turns it

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
        truth = self._trajectories.state_at(t_utc_ns - self.clock_ahead_ns, drones)
        place_enu_m = self.axes.from_ecef(truth.position_ecef_m)
        if self.readings is not None:
            azimuth_deg, elevation_deg, range_m = enu_to_aer(place_enu_m)
            azimuth_deg = self.readings.azimuth_deg(azimuth_deg, truth.t_utc_ns)
            if not self._reads_bistatic_ranges:
                range_m = self.readings.range_m(range_m, truth.t_utc_ns)
            place_enu_m = aer_to_enu(np.nan_to_num(azimuth_deg), elevation_deg, range_m)
        velocity_enu_m_s = self.axes.rotate_from_ecef(truth.velocity_ecef_m_s)
        return replace(
            truth,
            position_ecef_m=self.frame.to_ecef(place_enu_m),
            velocity_ecef_m_s=self.frame.rotate_to_ecef(velocity_enu_m_s),
        )


# Of the fixed point for when a sound left: they leave 3 cm at 60 m/s and 1 km.
TRAVEL_TIME_STEPS = 5
# By which a drone may be further away when its sound arrives: at half the speed of that.
WHILE_IT_TRAVELS = 1.5

C = TypeVar("C", bound=Columns)


class SensorsAtWork:
    """What all sensors of a scene have in common, each thing by the index of the sensor."""

    def __init__(self, scene: Scene, sensors: Sequence[Sensor], trajectories: Trajectories) -> None:
        self.names = [sensor.id for sensor in sensors]
        self.trajectories = trajectories
        self.chances = [Chance(scene.scene.seed, name) for name in self.names]
        self.timetables = [
            Timetable(s.scan.period_ns, s.scan.sectors, s.scan.jitter_ms * NS_IN_MS, chance)
            for s, chance in zip(sensors, self.chances, strict=True)
        ]
        self.places = [frame_at(scene.scene.site, s.position_enu_m) for s in sensors]
        self.frames = Axes.of(self.places)
        # In which sector a rotating sensor draws what its next scan needs: sensors take turns, so
        # that those which begin a scan together are not late together.
        turns = [i % each.sectors for i, each in enumerate(self.timetables)]
        self.draws_in = np.array(turns, np.int64)
        self.draws = ScanDraws(self.chances, Purpose.DETECTION)
        self.pairs = PairDraws(self.chances)
        self.claims = ClaimDraws(self.chances)
        self.borders = Borders(len(sensors))
        self.false_alarms = FalseAlarmsDue(self.chances, self.timetables, self.draws_in)
        # How many cues stand behind each sensor: those with fewer are worked out first.
        self.rank = cue_order(sensors)
        self.cueing: Cueing | None = None  # Of scenes with mounts
        if any(mount_of(sensor) is not None for sensor in sensors):
            from plotfeed.feeds.engine.steered_sensors import Cueing

            self.cueing = Cueing(scene.scene.site, sensors, self.places)
        self.drones: Sequence[str] = ()  # Names of the drones that it last knew of, by row

    def know(self, drones: Sequence[str]) -> None:
        """Forget drones that are gone, or whose rows are others' now."""
        self.borders.forget(renamed(self.drones, drones), len(drones))
        self.draws.trim(len(drones))
        self.claims.trim(len(drones))
        self.drones = drones


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
        self.rank = at_work.rank[sensors[0]]
        self._at_work = at_work
        # Of one sensor, its own, which stand for all rows; else by the index of the sensor.
        is_one = len(sensors) == 1
        self._frames: Axes = self.site.frame if is_one else at_work.frames
        self._axes: Axes = self.site.axes if is_one else at_work.frames
        # A sensor that errs is alone, and its clock and axes are its own.
        self._truth_at: Callable[[int, Ints], TruthState] = (
            self.site.apparent_at if self.site.errs else at_work.trajectories.state_at
        )
        self._model = stacked(models)
        # A kind of which each sensor is alone knows of no columns that say whose a row is.
        self._shares = self._model.alike is not None
        self._travels = self._model.signal_speed_m_s is not None
        self._merges = getattr(self._model, "merging", None) is not None
        self._agenda = Agenda.empty()
        # Radars that report what comes by their side lobes, and the row of that among drones.
        self._sidelobes: dict[int, tuple[PolarRadar, int]] = {}
        for i, model in self.models.items():
            if isinstance(model, PolarRadar) and model.shows_sidelobes:
                from plotfeed.models.clutter import SIDELOBE
                from plotfeed.models.movers import other_name

                name = other_name(SIDELOBE, at_work.names[i])
                self._sidelobes[i] = model, at_work.trajectories.add_other(name)
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
            return self._turn(sectors)
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
        if self._at_work.cueing is not None and self.site.is_steered:
            aims = self._at_work.cueing.at(sectors)
            row, truth = row[aims.sees[row]], truth.rows(aims.sees[row])
        trajectories = self._at_work.trajectories
        if self._shares and trajectories.has_others:  # what is no drone comes last
            order = np.argsort(trajectories.are_others(truth.drone), kind="stable")
            row, truth = row[order], truth.rows(order)
        targets, row = self._targets(truth, row, sectors.sensor)
        if aims is not None:
            targets = aims.by_mount(targets, row)
        rng: Any = self._generators(sectors, Purpose.DETECTION)[0]
        if isinstance(self._model, DwellingSensor):
            looks, plots, self._agenda = self._model.observe_period(
                self._agenda, targets, sectors.one(0), rng
            )
        elif isinstance(self._model, JointSensor):
            looks, plots = self._model.observe_scan(targets, sectors.one(0), rng)
        else:
            if self._shares:  # else it may draw as it likes
                rng = self._draws(sectors, targets.drone, row)
            model = self._model.rows(self._place[sectors.sensor[row]])
            looks, plots = model.observe(targets, rng)
        alarms = self._at_work.false_alarms.of_scans(sectors, self.models)
        if self._sidelobes:
            alarms += self._by_sidelobes(sectors)
        if aims is not None:
            looks, plots = aims.back(looks), aims.back(plots)
            alarms = [
                (sensor, aims.of_alarms(found, sensor, self.models[sensor]))
                for sensor, found in alarms
                if aims.sees[np.searchsorted(sectors.sensor, sensor)]
            ]
        return self._batch(sectors, looks, plots, alarms)

    def _draws(self, sectors: Sectors, drone: Ints, row: Ints) -> DrawsBySensor:
        """Draws for looks of scans, by their row: for drones the same whatever else there is."""
        generators = self._generators(sectors, Purpose.DETECTION)
        if self._at_work.trajectories.has_others:
            generators += self._generators(sectors, Purpose.OTHERS)
            row = row + len(sectors) * self._at_work.trajectories.are_others(drone)
        return DrawsBySensor(generators, row)

    def _generators(self, sectors: Sectors, purpose: Purpose) -> list[np.random.Generator]:
        """Generators of each sensor's scan for that purpose."""
        which = zip(sectors.sensor.tolist(), sectors.scan.tolist(), strict=True)
        return [self._at_work.chances[sensor].rng(purpose, scan) for sensor, scan in which]

    def _turn(self, sectors: Sectors) -> Batch:
        """Looks at the drones that beams pass in their sectors."""
        at_work = self._at_work
        truth, row = meetings(
            sectors, self._axes, at_work.trajectories, at_work.borders, self._reach_m
        )
        looks, plots = NO_LOOKS, NO_PLOTS
        if self._merges and len(truth):
            looks, plots = self._observed_among_neighbours(sectors, truth, row)
        elif len(truth):
            looks, plots = self._observed(sectors, truth, row)
        alarms = at_work.false_alarms.of_turns(sectors, self.models)
        draws_now = sectors.index == at_work.draws_in[sectors.sensor]
        if draws_now.any():
            at_work.draws.draw_next(sectors.sensor[draws_now], sectors.scan[draws_now])
        if self._sidelobes:
            alarms += self._by_sidelobes(sectors)
        return self._batch(sectors, looks, plots, alarms)

    def _observed(self, sectors: Sectors, truth: TruthState, row: Ints) -> tuple[Looks, Plots]:
        """What the model makes of drones, each met within a sector, by its row."""
        targets, row = self._targets(truth, row, sectors.sensor)
        sensor = sectors.sensor[row]
        draws: Any = self._at_work.draws.of(sensor, sectors.scan[row], targets.drone)
        return self._model.rows(self._place[sensor]).observe(targets, draws)

    def _by_sidelobes(self, sectors: Sectors) -> Iterator[OfSensor]:
        """Plots of sectors by side lobes, of targets as they are at the end of each, by sensor."""
        from plotfeed.models.clutter import sidelobe_plots

        for k, sensor in enumerate(sectors.sensor.tolist()):
            if sensor in self._sidelobes:
                (radar, whose), one = self._sidelobes[sensor], sectors.between(k, k + 1)
                sector = one.one(0)
                row, truth = self._there_at_the_end(one)
                targets, _ = self._targets(truth, row, one.sensor)
                chance = self._at_work.chances[sensor]
                rng = chance.rng(Purpose.SIDELOBES, sector.scan, sector.index)
                yield sensor, sidelobe_plots(radar, targets, sector, whose, rng)

    def _observed_among_neighbours(
        self, sectors: Sectors, truth: TruthState, row: Ints
    ) -> tuple[Looks, Plots]:
        """Looks and plots where echoes merge, each sector's beside those of the next ones.

        These are looked at for each sector by itself, so that it matters to none how many others
        are worked out with it.
        """
        at_work, sensor = self._at_work, int(sectors.sensor[0])
        timetable = at_work.timetables[sensor]
        before = Sectors.of([timetable.sector_at(int(sectors.start_ns[0]) - 1)], sensor)
        after = Sectors.of([timetable.next_sector(sectors.one(len(sectors) - 1))], sensor)
        met_before, met_after = (
            meetings(sector, self._axes, at_work.trajectories, reach_m=self._reach_m)[0]
            for sector in (before, after)
        )
        of = np.concatenate(
            [
                np.zeros(len(met_before), np.int64),
                row + 1,
                np.full(len(met_after), len(sectors) + 1),
            ]
        )
        everybody = TruthState.joined([met_before, truth, met_after])
        all_sectors = Sectors.joined([before, sectors, after])
        found = []
        for sector in np.unique(row + 1).tolist():
            own = of == sector
            beside = (np.abs(of - sector) == 1) & ~np.isin(everybody.drone, everybody.drone[own])
            who = np.flatnonzero(own | beside)
            seen = self._observed(all_sectors, everybody.rows(who), of[who])
            within = (
                (all_sectors.start_ns[sector] <= each.t_utc_ns)
                & (each.t_utc_ns < all_sectors.end_ns[sector])
                for each in seen
            )
            found.append([each.rows(which) for each, which in zip(seen, within, strict=True)])
        looks, plots = zip(*found, strict=True)
        return Looks.joined(looks), Plots.joined(plots)

    @property
    def _needs_velocities(self) -> bool:
        """Whether what is seen of drones depends on how they fly."""
        echoes = self._at_work.trajectories.signatures.echoes
        return self._model.measures_range_rate or (echoes is not None and echoes.has_aspects)

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
        if self.site.own_axes is not None:
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
        held_ns = self._model.claims_held_ns
        if held_ns:
            held = HeldClaims(self._at_work.claims, int(self.sensors[0]), held_ns)
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
            speed_m_s = self._model.rows(self._place[sensor[there]]).signal_speed_m_s
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

    def _batch(
        self, sectors: Sectors, looks: Looks, plots: Plots, alarms: Sequence[OfSensor]
    ) -> Batch:
        """Looks and plots by sector, with false alarms, and with heights if any format tells them.

        Looks are along the sensors' own axes.
        """
        if alarms:
            parts = [plots]
            for sensor, found in alarms:
                whose = np.full(len(found), sensor) if self._shares else None
                parts.append(found if whose is None else found.but(sensor=whose))
            plots = Plots.joined(parts)
        if self.site.own_axes is not None and len(looks):
            looks = self.site.as_they_truly_were(looks)
        looks, looks_by = self._by_sector(sectors, looks)
        plots, plots_by = self._by_sector(sectors, plots)
        has_place = plots.measures("elevation_deg") and plots.measures("range_m")
        if self.site.tells_heights and has_place and len(plots):
            frames = self._frames.rows(np.repeat(sectors.sensor, np.diff(plots_by)))
            height_m = frames.heights_m(plots.azimuth_deg, plots.elevation_deg, plots.range_m)
            plots = plots.but(height_m=height_m)
        return Batch(
            sectors,
            plots,
            plots_by,
            looks,
            looks_by,
            sensors=self._at_work.names,
            names=self._at_work.trajectories.names,
            truth_at=self._truth_at,
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
        self._controlled: list[Mapping[str, Any]] = [{} for _ in self.sensors]
        self._formats = SceneFormats(scene.model_copy(update={"sensor": self.sensors}))
        self._at_work = SensorsAtWork(scene, self.sensors, trajectories)
        self.cueing = self._at_work.cueing
        self.upcoming = Timetables(self._at_work.timetables)  # The next sector of each
        self._enabled = np.array([s.enabled for s in self.sensors], np.bool_)
        self.world = World(scene)
        self.sites: dict[int, SensorSite] = {}
        self.models: dict[int, SensorModel] = {}
        for i, sensor in enumerate(self.sensors):
            self._put(i, sensor)
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
        self.upcoming.start(start_utc_ns)
        if self.cueing is not None:
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
                if sector.start_ns > self.upcoming.sector(i).start_ns:
                    self.upcoming.go_on_with(i, sector)
        while (end_ns := self.next_end_ns) is not None and end_ns <= until_utc_ns:
            for batch in self.seen(min(end_ns + NS, until_utc_ns + 1)):
                self.messages(batch)  # of which formats remember some
                yield

    @property
    def next_end_ns(self) -> int | None:
        """When the next sector of any of them ends; None if there is no sensor."""
        return int(self.upcoming.next_end_ns.min()) if self.sensors else None

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
        return np.flatnonzero(now_ns - self.upcoming.next_end_ns > self.upcoming.period_ns).tolist()

    def skip(self, i: int, now_ns: int) -> MissedScans:
        """Leave out what a sensor is late with: what it has missed.

        The next sector is then the last one that has ended: nothing is made up for in a burst.
        """
        sector = self.upcoming.sector(i)
        last = self._at_work.timetables[i].sector_at(now_ns - (sector.end_ns - sector.start_ns))
        self.upcoming.go_on_with(i, last)
        return MissedScans(last.scan - sector.scan, sector.end_ns, last.start_ns)

    def skip_scan(self, i: int) -> MissedScans:
        """Leave out the scan that a sensor is in or begins next, to its end: what it has missed."""
        sector = self.upcoming.sector(i)
        following = self._at_work.timetables[i].sector(sector.scan + 1, 0)
        self.upcoming.go_on_with(i, following)
        return MissedScans(1, sector.end_ns, following.start_ns)

    @property
    def sectors_per_ns(self) -> Floats:
        """How many sectors each has to work out in a nanosecond; none that is not enabled; (n,)."""
        return np.where(self._enabled, self.upcoming.sectors / self.upcoming.period_ns, 0.0)

    def begins_before(self, before_ns: int) -> Bools:
        """Which begin a scan next, of which the first sector ends before that time; (n,)."""
        return self.upcoming.begins_scan & (self.upcoming.next_end_ns < before_ns) & self._enabled

    @property
    def amid_scans(self) -> Bools:
        """Which have begun a scan that is not over; (n,)."""
        return ~self.upcoming.begins_scan & self._enabled

    def mount(self, i: int) -> CuedState | None:
        """Where a sensor's mount pointed in the last scan; None without one."""
        return None if self.cueing is None else self.cueing.state_of(i)

    def pointed(self, i: int) -> CuedState | PointedBeams | None:
        """Where a sensor's mount or beams pointed in the last scan; None where nothing turns."""
        return self.mount(i) or self._groups[int(self._group_of[i])].beams()

    def remembers(self, i: int) -> bool:
        """Whether what a sensor reports, or one that it cues, depends on all that was before."""
        cues = self.cueing is not None and i in self.cueing.cued_by
        return cues or keeps_state(self.sensors[i])

    def seen(self, before_ns: int) -> Iterator[Batch]:
        """What is seen in all sectors that are next and end before that time, a group at a time.

        The script's changes come meanwhile.
        """
        if self._at_work.drones is not self._at_work.trajectories.names:
            self._at_work.know(self._at_work.trajectories.names)
        while len(sectors := self.upcoming.ending_before(before_ns)):
            later = None
            if self._script:
                known_ns = np.maximum(sectors.end_ns - AHEAD_NS, sectors.start_ns)
                later = known_ns >= self._script[-1][0]
                sectors = sectors.rows(~later)
            self.upcoming.take(sectors)
            sectors = sectors.rows(self._enabled[sectors.sensor])
            of_group = self._group_of[sectors.sensor]
            numbers = np.unique(of_group).tolist()
            if len(numbers) > 1:  # those that cue before those that are cued
                numbers.sort(key=lambda number: self._groups[number].rank)
            for number in numbers:
                mine = sectors if len(numbers) == 1 else sectors.rows(of_group == number)
                batch = self._groups[number].look(mine)
                if self.cueing is not None:
                    self.cueing.take(batch)
                yield batch
            if later is None or not later.any():
                return
            self._follow_script_until(self._script[-1][0])

    def messages(self, batch: Batch) -> list[list[Message]]:
        """What sensors say of each of their sectors, which were seen just now."""
        # A sensor whose clock is ahead errs, and is alone.
        ahead_ns = self.sites[int(batch.sectors.sensor[0])].clock_ahead_ns
        return self._formats.messages(batch.by_clock(ahead_ns) if ahead_ns else batch)

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
            if self._enabled[i] and not sensor.enabled:
                self._formats.switched_off(i)
            self._put(i, sensor)
            if self.cueing is not None:
                self.cueing.change(i, sensor)
        self._group(sensors)

    def _put(self, i: int, sensor: Sensor) -> None:
        """Let the sensor of that index be this one."""
        at_work, trajectories = self._at_work, self._at_work.trajectories
        site = SensorSite(sensor, at_work.places[i], trajectories, at_work.chances[i])
        model = self.world.model_of(sensor)
        clutter = self.world.clutter_of(model, site.axes, trajectories)
        at_work.false_alarms.begin_anew(i, clutter)
        self.sensors[i], self.sites[i], self.models[i] = sensor, site, model
        self._enabled[i] = sensor.enabled

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
            self._at_work.rank[i],
        )
