"""Sensors of a kind at work together: whom they look at in several sectors, and what they measure.

A group is worked out in one pass, whatever it holds: draws belong to sensors, scans and drones, and
arithmetic goes row by row, so that no sensor's plots depend on the company or on how many sectors
are worked out at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.sensing.false_alarms_due import FalseAlarmsDue, OfSensor
from plotfeed.feeds.sensing.sensor_site import SensorSite, with_heights
from plotfeed.models.beam import Sectors, Timetable
from plotfeed.models.beam_meetings import CULLED_FROM, Borders, meetings
from plotfeed.models.chance import Chance, DrawsBySensor, PairDraws, Purpose, ScanDraws
from plotfeed.models.frames import Axes, frames_at, rows_about
from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.sensors.sensor_model import (
    NO_LOOKS,
    NO_PLOTS,
    DwellingSensor,
    JointSensor,
    SensorModel,
    Targets,
)
from plotfeed.models.sensors.stacking import stacked
from plotfeed.models.state import Columns, Floats, Ints, Looks, PlaceState, Plots, TruthState
from plotfeed.models.truth import Trajectories
from plotfeed.proto.utc import NS

if TYPE_CHECKING:
    from plotfeed.feeds.sensing.sidelobe_looks import SidelobeLooks
    from plotfeed.feeds.sensing.steered_sensors import Aims, Cueing
    from plotfeed.models.dwell_agenda import PointedBeams
    from plotfeed.models.effects.classification import ClaimDraws

TRAVEL_TIME_STEPS = 5
"""Of the fixed point for when a sound left: they leave 3 cm at 60 m/s and 1 km."""
WHILE_IT_TRAVELS = 1.5
"""By which a drone may be further away when its sound arrives: at half the speed of that."""

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
        self._is_alone = len(sensors) == 1
        self._frames = self.site.frame if self._is_alone else at_work.frames
        self._model = stacked(models)
        self._merges = getattr(self._model, "merging", None) is not None
        from plotfeed.models.dwell_agenda import Agenda

        self._agenda = Agenda.empty()
        self._sidelobes: SidelobeLooks | None = None
        if any(model.shows_sidelobes for model in models):
            from plotfeed.feeds.sensing.sidelobe_looks import SidelobeLooks

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
        rng: Any = generators[0] if self._is_alone else DrawsBySensor(generators, row)
        if isinstance(self._model, DwellingSensor):
            looks, detections, self._agenda = self._model.observe_period(
                self._agenda, targets, sectors.one(0), rng
            )
            looks = self._as_they_were(looks)
        elif isinstance(self._model, JointSensor):
            looks, detections = self._model.observe_scan(targets, sectors.one(0), rng)
            looks = self._as_they_were(looks)
        else:
            looks, detections = self._observed(targets, rng, aims)
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
        return self._observed(targets, draws)

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
        return self._model.measures_range_rate or (echoes is not None and echoes.has_aspects)

    @property
    def _axes(self) -> Axes:
        return self.site.axes if self._is_alone else self._frames

    def _there_at_the_end(self, sectors: Sectors) -> tuple[Ints, PlaceState]:
        """Drones within reach at the ends of scans: the row of each, and its state."""
        trajectories = self._at_work.trajectories
        if self._is_alone:
            truth = self.site.states_at(self._needs_velocities, int(sectors.end_ns[0]))
            if len(truth) >= CULLED_FROM:
                reach_m = self._reach(sectors.sensor[0])
                truth = truth.rows(self.site.frame.has_within(truth.position_ecef_m, reach_m))
            return np.zeros(len(truth), np.int64), truth
        ends_ns, at = np.unique(sectors.end_ns, return_inverse=True)
        positions_ecef_m = trajectories.positions_at(ends_ns)
        frames = frames_at(self._frames, sectors.sensor[:, None])
        reach_m = self._reach(sectors.sensor)
        about = rows_about(frames_at(self._frames, sectors.sensor), positions_ecef_m, reach_m)
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
        travels = self._model.signal_speed_m_s is not None
        return self._reach_m[sensor] * (WHILE_IT_TRAVELS if travels else 1.0)

    def _targets(self, truth: PlaceState, row: Ints, sensors: Ints) -> tuple[Targets, Ints]:
        """Drones as they are and as they are sensed, and the row of each; `sensors` are by row."""
        frames = frames_at(self._frames, sensors[row])
        true_position_enu_m = frames.from_ecef(truth.position_ecef_m)
        sensed, t_utc_ns, position_enu_m = truth, truth.t_utc_ns, true_position_enu_m
        if self._model.signal_speed_m_s is not None:
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
            emitted_utc_ns=None if sensed is truth else sensed.t_utc_ns,
            sensor=None if self._is_alone else sensors[row],
        )
        if held_ns := self._model.claims_held_ns:
            from plotfeed.models.effects.classification import HeldClaims

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
            position_enu_m = frames_at(self._frames, sensor[there]).from_ecef(position_ecef_m)
        sensed = PlaceState(
            drone=truth.drone[there], t_utc_ns=departure_ns, position_ecef_m=position_ecef_m
        )
        return sensed, position_enu_m, there

    def _model_of(self, sensor: Ints) -> SensorModel:
        return self._model if self._is_alone else self._model.rows(self._place[sensor])

    def _observed(
        self, targets: Targets, rng: Any, aims: Aims | None = None
    ) -> tuple[Looks, Plots]:
        model = self._model if targets.sensor is None else self._model_of(targets.sensor)
        looks, plots = model.observe(targets, rng)
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
            plots = Plots.joined([plots, *(self._told(sensor, found) for sensor, found in alarms)])
        looks, looks_by = self._by_sector(sectors, looks)
        plots, plots_by = self._by_sector(sectors, plots)
        if self.site.tells_heights and len(plots):
            sensor = np.repeat(sectors.sensor, np.diff(plots_by))
            plots = with_heights(plots, frames_at(self._frames, sensor))
        names = self._at_work.trajectories.names
        return Batch(
            sectors, plots, plots_by, looks, looks_by, sensors=self._at_work.names, names=names
        )

    def _told(self, sensor: int, plots: Plots) -> Plots:
        """Plots of a sensor that say whose they are, where that is not known without."""
        return plots if self._is_alone else plots.but(sensor=np.full(len(plots), sensor))

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
