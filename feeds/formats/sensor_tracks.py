"""Tracks of a scene's sensors, made once for all formats that tell of tracks.

Which kind a sensor has its keys say: the truth, smoothed, or what a plain tracker makes of plots.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from plotfeed.feeds.messages.batch import Batch, edges
from plotfeed.feeds.scene.fields import frame_at, site_frame
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.sensor_keys import TrackingSensorKeys, TracksKeys
from plotfeed.models.accuracy import stated_covariance_m2
from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.frames import LocalFrame, aer_to_enu
from plotfeed.models.state import FALSE_ALARM, Bools, Floats, Ints, Looks, Plots, renamed
from plotfeed.models.tracks import LocalStates, SmoothedTruth, TrackerLooks, TrackRule, TrackStates
from plotfeed.proto.tracks.encode_tracks import ToldTracks

if TYPE_CHECKING:
    from plotfeed.models.plain_tracker import LocatedPlots

LEAST_SIGMA_M = 0.01  # An error of less has a plot that claims none: a filter needs some
# Of a height that is not measured: a tracker on a plane holds targets to it.
UNMEASURED_SIGMA_M = 1.0


class SceneTracks:
    """The trackers of the sensors that report in a format of tracks."""

    def __init__(self, scene: Scene) -> None:
        self._site = site_frame(scene.scene.site)
        self._trackers: dict[int, PlainTracks | _SmoothedTruth] = {}
        for i, sensor in enumerate(scene.sensor):
            if any(REPORT_FORMATS[name].tells_tracks for name in sensor.report):
                is_plain = tracks_keys_of(sensor).kind == "plain"
                kind = PlainTracks if is_plain else _SmoothedTruth
                self._trackers[i] = kind(scene, sensor, self._site)

    def end(self, i: int) -> None:
        """End all tracks of a sensor, which is switched off: it tells nothing more of them."""
        if i in self._trackers:
            self._trackers[i].tracks.end()

    def tracked(self, batch: Batch) -> Batch:
        """Add the tracks at the ends of its sectors to the batch."""
        states, lengths = [], np.zeros(len(batch), np.int64)
        for i, sensor in enumerate(batch.sectors.sensor.tolist()):
            if sensor in self._trackers:
                states.append(self._trackers[sensor].take(batch.one(i)))
                lengths[i] = len(states[-1])
        if not states:
            return batch
        t_utc_ns = np.repeat(batch.sectors.end_ns, lengths)
        tracks = self._told(TrackStates.joined(states), t_utc_ns)
        return replace(batch, tracks=tracks, tracks_by=edges(lengths))

    def _told(self, states: TrackStates, t_utc_ns: Ints) -> ToldTracks:
        """Tracks on the Earth; no height of those of a sensor that measures none."""
        latitude_deg, longitude_deg, height_m = self._site.to_geodetic(states.position_enu_m)
        climb_m_s = _along_vertical(
            self._site, states.velocity_enu_m_s, latitude_deg, longitude_deg
        )
        sigma_m, sigma_m_s = states.sigma_position_m, states.sigma_velocity_m_s

        def if_measured(column: Floats) -> Floats:
            return np.where(states.has_height, column, np.nan)

        return ToldTracks(
            track=states.track,
            t_utc_ns=t_utc_ns,
            latitude_deg=latitude_deg,
            longitude_deg=longitude_deg,
            east_m=states.position_enu_m[:, 0],
            north_m=states.position_enu_m[:, 1],
            velocity_east_m_s=states.velocity_enu_m_s[:, 0],
            velocity_north_m_s=states.velocity_enu_m_s[:, 1],
            height_m=if_measured(height_m),
            climb_m_s=if_measured(climb_m_s),
            age_s=states.age_s,
            sigma_east_m=sigma_m[:, 0],
            sigma_north_m=sigma_m[:, 1],
            sigma_up_m=if_measured(sigma_m[:, 2]),
            sigma_velocity_east_m_s=sigma_m_s[:, 0],
            sigma_velocity_north_m_s=sigma_m_s[:, 1],
            sigma_climb_m_s=if_measured(sigma_m_s[:, 2]),
            tentative=np.zeros(len(states), np.bool_),
            coasted=states.misses > 0,
            first=states.first,
            last=states.last,
        )


class _SmoothedTruth:
    """The truth with a filter's errors, of one sensor."""

    def __init__(self, scene: Scene, sensor: Sensor, site: LocalFrame) -> None:
        here = frame_at(scene.scene.site, sensor.position_enu_m)
        self._site = site
        self._to_site = site.rotation_from_ecef @ here.rotation_from_ecef.T
        self.tracks = SmoothedTruth(_rule_of(sensor), tracks_keys_of(sensor).smoothing_scans)
        self._has_height = False
        self._names: Sequence[str] = ()  # Of drones by index, when it last knew of them
        self._chance = Chance(scene.scene.seed, sensor.id)

    def take(self, batch: Batch) -> TrackStates:
        """The tracks at the end of a sector, east, north and up of the scene's site."""
        sector, ahead_ns = batch.sector, batch.clock_ahead_ns
        if batch.names is not self._names:
            others = renamed(self._names, batch.names)
            # A track whose drone is forgotten ends by itself, unless another has its row.
            reused = [row for row in others.tolist() if row < len(batch.names) and batch.names[row]]
            self.tracks.forget(np.array(reused, np.int64), len(batch.names))
            self._names = batch.names
        looks = self._looks(batch.looks, batch.plots)
        return self.tracks.take(
            looks,
            self._truth(batch, np.union1d(looks.drone, self.tracks.drones)),
            start_ns=sector.start_ns - ahead_ns,
            end_ns=sector.end_ns - ahead_ns,
            rng=self._chance.rng(Purpose.TRACKS, sector.scan, sector.index),
            has_height=self._has_height,
        )

    def _looks(self, looks: Looks, plots: Plots) -> TrackerLooks:
        """One look a drone, however many signals it was looked at by, and its best plot's error."""
        drone, at = np.unique(looks.drone, return_index=True)
        plots = plots.rows(plots.drone != FALSE_ALARM)
        self._has_height = self._has_height or bool((~np.isnan(plots.sigma_elevation_deg)).any())
        covariance_m2 = stated_covariance_m2(plots)
        order = np.lexsort((np.trace(covariance_m2, axis1=1, axis2=2), plots.drone))
        plotted, best = np.unique(plots.drone[order], return_index=True)
        # Who is plotted through a side lobe was not looked at: no track follows it.
        covariance_m2 = covariance_m2[order[best[np.isin(plotted, drone)]]]
        hit: Bools = np.isin(drone, plotted)
        errors_m2 = np.full((len(drone), 3, 3), np.nan)
        errors_m2[hit] = np.einsum("ia,nab,jb->nij", self._to_site, covariance_m2, self._to_site)
        return TrackerLooks(
            drone=drone, t_utc_ns=looks.t_utc_ns[at], hit=hit, covariance_m2=errors_m2
        )

    def _truth(self, batch: Batch, drones: Ints) -> LocalStates:
        truth = batch.truth_at(batch.sector.end_ns, drones)
        return LocalStates(
            drone=truth.drone,
            position_enu_m=self._site.from_ecef(truth.position_ecef_m),
            velocity_enu_m_s=self._site.rotate_from_ecef(truth.velocity_ecef_m_s),
        )


class PlainTracks:
    """What a plain tracker makes of the plots of one sensor, which it is given before its link."""

    def __init__(
        self, scene: Scene, sensor: Sensor, site: LocalFrame, *, by_sector: bool = True
    ) -> None:
        """Make tracks of plots that come sector by sector, or of whole scans at once."""
        # A tenth of the time that a session takes to begin, which other scenes do not pay.
        from plotfeed.models.plain_tracker import PlainMotion, PlainTracker

        self._here = frame_at(scene.scene.site, sensor.position_enu_m)
        self._site = site
        self._to_site = site.rotation_from_ecef @ self._here.rotation_from_ecef.T
        keys = tracks_keys_of(sensor)
        motion = PlainMotion(
            density_m2_s3=keys.acceleration_m_s2**2 * sensor.scan.period_s,
            initial_speed_m_s=keys.initial_speed_m_s,
            gate_probability=keys.gate_probability,
        )
        turns = by_sector and sensor.scan.sectors > 1
        self.tracks = PlainTracker(_rule_of(sensor), motion, turns=turns)

    def take(self, batch: Batch) -> TrackStates:
        """The tracks at the end of a sector, east, north and up of the scene's site."""
        return self.take_plots(batch.plots, batch.sector.start_ns, batch.sector.end_ns)

    def take_plots(self, plots: Plots, start_ns: int, end_ns: int) -> TrackStates:
        """The tracks at the end of a stretch of time that has those plots."""
        return self.tracks.take(self._located(plots), start_ns=start_ns, end_ns=end_ns)

    def _located(self, plots: Plots) -> LocatedPlots:
        """Plots as places about the site; without an elevation, on the sensor's horizontal."""
        from plotfeed.models.plain_tracker import LocatedPlots

        has_height = ~np.isnan(plots.elevation_deg)
        elevation_deg = np.where(has_height, plots.elevation_deg, 0.0)
        there_m = aer_to_enu(plots.azimuth_deg, elevation_deg, plots.range_m)
        position_m = self._site.from_ecef(self._here.to_ecef(there_m))
        covariance_m2 = stated_covariance_m2(plots) + LEAST_SIGMA_M**2 * np.eye(3)
        covariance_m2[~has_height, 2, 2] += UNMEASURED_SIGMA_M**2
        covariance_m2 = np.einsum("ia,nab,jb->nij", self._to_site, covariance_m2, self._to_site)
        located = LocatedPlots(
            t_utc_ns=plots.t_utc_ns,
            channel=plots.channel,
            position_enu_m=position_m,
            covariance_m2=covariance_m2,
            has_height=has_height,
        )
        is_place = np.isfinite(position_m).all(axis=1)
        return located.rows(is_place & np.isfinite(covariance_m2).all(axis=(1, 2)))


def tracks_keys_of(sensor: Sensor) -> TracksKeys:
    """The keys of a sensor's tracks."""
    return sensor.tracks if isinstance(sensor, TrackingSensorKeys) else TracksKeys()


def _rule_of(sensor: Sensor) -> TrackRule:
    keys, period_ns = tracks_keys_of(sensor), sensor.scan.period_ns
    first, last = keys.numbers
    return TrackRule(
        confirm_hits=keys.confirm_hits,
        confirm_window=keys.confirm_window,
        drop_misses=keys.drop_misses,
        period_ns=period_ns,
        patience_ns=period_ns // 2 if sensor.scan.rotates else 0,
        first_number=first,
        last_number=last,
    )


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
