"""ASTERIX as sensors speak it that track on board: categories 062 and 063."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from plotfeed.feeds.formats.message_format import (
    SERVICE_PERIOD_NS,
    Blocks,
    Sensors,
    Topics,
    max_block_octets,
    numbers_of,
    periods_in,
)
from plotfeed.feeds.formats.seen import Seen, SeenSector
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.fields import frame_at, site_frame
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.sensor_keys import TrackingSensorKeys, TracksKeys
from plotfeed.models.accuracy import stated_covariance_m2
from plotfeed.models.beam import Sectors
from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.frames import LocalFrame
from plotfeed.models.state import FALSE_ALARM, Bools, Floats, Ints, Looks, Plots, renamed
from plotfeed.models.tracks import LocalStates, SmoothedTruth, TrackerLooks, TrackRule, TrackStates
from plotfeed.proto.asterix.cat062 import TrackEncoder062, Tracks
from plotfeed.proto.asterix.cat063 import SensorStatus, SensorStatusEncoder063
from plotfeed.proto.asterix.codec.reports import Parts


class Asterix062:
    """Tracks of category 062 after each sector, and every ten seconds the sensor in 063.

    The system's reference point is the scene's site.
    """

    def __init__(self, scene: Scene, sensors: Sensors) -> None:
        self._site = site_frame(scene.scene.site)
        self._numbers = numbers_of(sensors)
        self._topics = {i: Topics(scene, sensor) for i, sensor in sensors.items()}
        self._trackers = {i: _Tracker(scene, s, self._site) for i, s in sensors.items()}
        source = [s.sac for s in sensors.values()], [s.sic for s in sensors.values()]
        self._statuses = {i: SensorStatus(sac=s.sac, sic=s.sic) for i, s in sensors.items()}
        most = [max_block_octets(scene, sensor) for sensor in sensors.values()]
        self._encoder = TrackEncoder062(*source, max_octets=most)
        self._service = SensorStatusEncoder063(*source, max_octets=most)

    def messages(self, seen: Seen) -> list[list[Message]]:
        """Blocks of category 062, then 063 where it is due."""
        sensors = seen.sectors.sensor.tolist()
        tracked = [self._trackers[sensor].take(seen.one(i)) for i, sensor in enumerate(sensors)]
        found: list[Blocks] = [[] for _ in tracked]
        # Heights are sent, or not, for all tracks of a sensor.
        for has_height in (False, True):
            which = [i for i, (_, their) in enumerate(tracked) if their is has_height]
            if which:
                tracks = [tracked[i][0] for i in which]
                sectors = seen.sectors.rows(np.array(which))
                for i, blocks in zip(which, self._blocks(tracks, sectors, has_height), strict=True):
                    found[i].extend((62, block) for block in blocks)
        self._add_service(found, seen.sectors)
        every = zip(sensors, seen.stamps, found, strict=True)
        return [self._topics[sensor].asterix(stamp, blocks) for sensor, stamp, blocks in every]

    def _add_service(self, found: list[Blocks], sectors: Sectors) -> None:
        due = np.flatnonzero(periods_in(SERVICE_PERIOD_NS, sectors.start_ns, sectors.end_ns))
        sensors = sectors.sensor[due]
        statuses = [self._statuses[sensor] for sensor in sensors.tolist()]
        parts = Parts(np.arange(len(due) + 1), self._numbers[sensors])
        if len(due):
            service = self._service.blocks_by(sectors.end_ns[due], statuses, parts)
            for i, blocks in zip(due.tolist(), service, strict=True):
                found[i].extend((63, block) for block in blocks)

    def _blocks(
        self, tracks: Sequence[TrackStates], sectors: Sectors, has_height: bool
    ) -> list[list[bytes]]:
        """Blocks of category 062 of each sector, at whose end its tracks are."""
        by = np.cumsum([0, *map(len, tracks)])
        parts = Parts(by, self._numbers[sectors.sensor])
        states = TrackStates.joined(tracks)
        t_utc_ns = np.repeat(sectors.end_ns, parts.lengths())
        return self._encoder.blocks_by(self._columns(states, t_utc_ns, has_height), parts)

    def _columns(self, states: TrackStates, t_utc_ns: Ints, has_height: bool) -> Tracks:
        latitude_deg, longitude_deg, height_m = self._site.to_geodetic(states.position_enu_m)
        climb_m_s = _along_vertical(
            self._site, states.velocity_enu_m_s, latitude_deg, longitude_deg
        )
        if not has_height:
            height_m, climb_m_s = (np.full(len(states), np.nan) for _ in range(2))
        return Tracks(
            track=states.track,
            t_utc_ns=t_utc_ns,
            latitude_deg=latitude_deg,
            longitude_deg=longitude_deg,
            east_m=states.position_enu_m[:, 0],
            north_m=states.position_enu_m[:, 1],
            velocity_east_m_s=states.velocity_enu_m_s[:, 0],
            velocity_north_m_s=states.velocity_enu_m_s[:, 1],
            height_m=height_m,
            climb_m_s=climb_m_s,
            age_s=states.age_s,
            sigma_east_m=states.sigma_position_m[:, 0],
            sigma_north_m=states.sigma_position_m[:, 1],
            tentative=np.zeros(len(states), np.bool_),
            coasted=states.misses > 0,
            first=states.first,
            last=states.last,
        )


class _Tracker:
    """The tracks of one sensor, fed sector by sector."""

    def __init__(self, scene: Scene, sensor: Sensor, site: LocalFrame) -> None:
        here = frame_at(scene.scene.site, sensor.position_enu_m)
        self._site = site
        self._to_site = site.rotation_from_ecef @ here.rotation_from_ecef.T
        self._tracks = _smoothed_truth(sensor)
        self._has_height = False
        self._names: Sequence[str] = ()
        """Of drones by index, when it last knew of them."""
        self._chance = Chance(scene.scene.seed, sensor.id)

    def take(self, seen: SeenSector) -> tuple[TrackStates, bool]:
        """The tracks at the end of a sector, and whether they have heights."""
        sector, ahead_ns = seen.sector, seen.clock_ahead_ns
        if seen.names is not self._names:
            others = renamed(self._names, seen.names)
            # A track whose drone is forgotten ends by itself, unless another has its row.
            reused = [row for row in others.tolist() if row < len(seen.names) and seen.names[row]]
            self._tracks.forget(np.array(reused, np.int64), len(seen.names))
            self._names = seen.names
        looks = self._looks(seen.looks, seen.plots)
        states = self._tracks.take(
            looks,
            self._truth(seen, np.union1d(looks.drone, self._tracks.drones)),
            start_ns=sector.start_ns - ahead_ns,
            end_ns=sector.end_ns - ahead_ns,
            rng=self._chance.rng(Purpose.TRACKS, sector.scan, sector.index),
        )
        return states, self._has_height

    def _looks(self, looks: Looks, plots: Plots) -> TrackerLooks:
        """One look a drone, however many signals it was looked at by, and its best plot's error."""
        drone, at = np.unique(looks.drone, return_index=True)
        plots = plots.rows(plots.drone != FALSE_ALARM)
        self._has_height = self._has_height or bool((~np.isnan(plots.sigma_elevation_deg)).any())
        covariance_m2 = stated_covariance_m2(plots)
        order = np.lexsort((np.trace(covariance_m2, axis1=1, axis2=2), plots.drone))
        plotted, best = np.unique(plots.drone[order], return_index=True)
        covariance_m2 = covariance_m2[order[best]]
        hit: Bools = np.isin(drone, plotted)
        errors_m2 = np.full((len(drone), 3, 3), np.nan)
        errors_m2[hit] = np.einsum("ia,nab,jb->nij", self._to_site, covariance_m2, self._to_site)
        return TrackerLooks(
            drone=drone, t_utc_ns=looks.t_utc_ns[at], hit=hit, covariance_m2=errors_m2
        )

    def _truth(self, seen: SeenSector, drones: Ints) -> LocalStates:
        truth = seen.truth_at(seen.sector.end_ns, drones)
        return LocalStates(
            drone=truth.drone,
            position_enu_m=self._site.from_ecef(truth.position_ecef_m),
            velocity_enu_m_s=self._site.rotate_from_ecef(truth.velocity_ecef_m_s),
        )


def _smoothed_truth(sensor: Sensor) -> SmoothedTruth:
    part = sensor.tracks if isinstance(sensor, TrackingSensorKeys) else TracksKeys()
    period_ns = sensor.scan.period_ns
    rule = TrackRule(
        confirm_hits=part.confirm_hits,
        confirm_window=part.confirm_window,
        drop_misses=part.drop_misses,
        period_ns=period_ns,
        patience_ns=period_ns // 2 if sensor.scan.rotates else 0,
    )
    return SmoothedTruth(rule, part.smoothing_scans)


def _along_vertical(
    frame: LocalFrame, velocity_enu_m_s: Floats, latitude_deg: Floats, longitude_deg: Floats
) -> Floats:
    """The part of velocities in a frame that is upward where each is; (n,)."""
    latitude, longitude = np.radians(latitude_deg), np.radians(longitude_deg)
    up = np.stack(
        [
            np.cos(latitude) * np.cos(longitude),
            np.cos(latitude) * np.sin(longitude),
            np.sin(latitude),
        ],
        axis=-1,
    )
    climb_m_s: Floats = (frame.rotate_to_ecef(velocity_enu_m_s) * up).sum(axis=-1)
    return climb_m_s
