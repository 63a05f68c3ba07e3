"""The truth of a run: where its ledger says that drones were, and which sensors looked at them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np

from plotfeed.feeds.recording.recorded_tracks import (
    TABLES,
    UNKNOWN_NS,
    is_place,
    is_table_of_tracks,
    read_tracks,
)
from plotfeed.feeds.recording.recorder import recorded_scene
from plotfeed.feeds.scene.fields import frame_at, site_frame
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.telemetry.flights import BY_SUFFIX
from plotfeed.feeds.telemetry.flights import read as read_flight
from plotfeed.feeds.telemetry.position_report import AltitudeDatum
from plotfeed.models.frames import LocalFrame, aer_to_enu, ecef_to_geodetic, geodetic_to_ecef
from plotfeed.models.state import AltitudeReference, Floats, Ints
from plotfeed.models.track_metrics import FlightPath
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.ledger import LedgerTables, ToldLooks
from plotfeed.proto.utc import NS
from plotfeed.replay.mcap import McapReader
from plotfeed.replay.recorded import SCENE_NAME, WHAT_LEFT

DESCRIPTION = "/description"
# Between places of a flight it is told where it was, if they are no further apart than this...
LEAST_GAP_S = 6.0
# ... or than so many of the longest scans.
SCANS = 1.5
MAX_DRONES = 10_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Truths:
    """The flights of a run. A drone is there while any sensor looks at it: that is cover."""

    drones: Sequence[str]
    paths: Sequence[FlightPath]  # Of the drones
    sensors: Sequence[str]
    # When a drone was looked at by a sensor, by their numbers; ascending.
    looks_utc_ns: Mapping[tuple[int, int], Ints]
    site: LocalFrame | None = None  # Of the scene
    sensors_at: LocalFrame | None = None  # Amid all sensors
    scene: str = ""
    notes: Sequence[str] = field(default_factory=tuple)
    has_height: bool = True  # Else heights are 0, and nothing is told of them

    @property
    def start_utc_ns(self) -> int:
        """When the first drone was there."""
        return min((int(p.t_utc_ns[0]) for p in self.paths if len(p.t_utc_ns)), default=0)

    @property
    def middle(self) -> LocalFrame:
        """The middle of all places of drones."""
        places_m = np.concatenate([path.position_ecef_m for path in self.paths])
        return frame_of(places_m.mean(axis=0))


def frame_of(place_ecef_m: Floats) -> LocalFrame:
    """East, north and up at a place."""
    return LocalFrame(*(float(x) for x in ecef_to_geodetic(place_ecef_m)))


class FlightsTally:
    """Takes entries of a ledger one by one, and gives the flights that they tell of."""

    def __init__(self, sensors: Mapping[str, LocalFrame], longest_scan_s: float = 1.0) -> None:
        """`sensors` says where sensors stand: looks of others cannot be placed."""
        self._frames = dict(sensors)
        self._gap_ns = round(max(LEAST_GAP_S, SCANS * longest_scan_s) * NS)
        self._drones: dict[str, None] = {}
        self._looks: dict[str, list[ToldLooks]] = {}  # By sensor

    def add(self, told: LedgerTables) -> None:
        """Take entries."""
        sensor = told.entries.sensor[told.looks.entry]
        for each in dict.fromkeys(sensor):
            self._looks.setdefault(each, []).append(told.looks.rows(sensor == each))
        self._drones |= dict.fromkeys(name for name in told.looks.drone if name)

    def truths(
        self,
        within_utc_ns: tuple[int, int] | None = None,
        *,
        site: LocalFrame | None = None,
        scene: str = "",
        notes: Sequence[str] = (),
    ) -> Truths:
        """All flights so far; looks at times outside `within_utc_ns` are of no use."""
        order = sorted(islice(self._drones, MAX_DRONES), key=lambda name: (len(name), name))
        numbers = {name: number for number, name in enumerate(order)}
        sensors = [sensor for sensor in self._looks if sensor in self._frames]
        looks: dict[tuple[int, int], Ints] = {}
        times: list[list[Ints]] = [[np.zeros(0, np.int64)] for _ in order]
        places: list[list[Floats]] = [[np.zeros((0, 3))] for _ in order]
        for number, sensor in enumerate(sensors):
            all_of = ToldLooks.joined(self._looks[sensor])
            drone = np.array([numbers.get(name, -1) for name in all_of.drone], np.int64)
            aer = np.stack([all_of.azimuth_deg, all_of.elevation_deg, all_of.range_m])
            when_ns = np.where(all_of.emitted_utc_ns, all_of.emitted_utc_ns, all_of.t_utc_ns)
            usable = (drone >= 0) & np.isfinite(aer).all(axis=0) & (aer[2] < 1e7)
            if within_utc_ns is not None:
                usable &= (when_ns >= within_utc_ns[0]) & (when_ns <= within_utc_ns[1])
            drone, t_ns = drone[usable], when_ns[usable]
            at_m = self._frames[sensor].to_ecef(aer_to_enu(*aer[:, usable]))
            for each in np.unique(drone).tolist():
                looks[each, number] = np.unique(t_ns[drone == each])
                times[each].append(t_ns[drone == each])
                places[each].append(at_m[drone == each])
        stand_m = [frame.origin_ecef_m for frame in self._frames.values()]
        paths = [
            FlightPath.of(np.concatenate(t_ns), np.concatenate(at_m), self._gap_ns)
            for t_ns, at_m in zip(times, places, strict=True)
        ]
        untold = [
            f"{sum(map(len, rows))} looks of {sensor} have no place: where it stands is not told"
            for sensor, rows in self._looks.items()
            if sensor not in self._frames
        ]
        return Truths(
            drones=order,
            paths=paths,
            sensors=sensors,
            looks_utc_ns=looks,
            site=site,
            sensors_at=frame_of(np.mean(stand_m, axis=0)) if stand_m else None,
            scene=scene,
            notes=(*notes, *untold),
        )


def read_trial(
    paths: Sequence[Path], scene: Scene | None = None, *, date_utc_ns: int = 0
) -> Truths:
    """The flights of a trial: logs of drones, a drone a file, or records of tracks, a drone each.

    `date_utc_ns` is midnight of the day on which records without dates begin. Altitudes above
    take-off count from the site's height, or from the ellipsoid. Raises `PlotfeedError` for a file
    that is none of either, and `OSError`.
    """
    site = None if scene is None else site_frame(scene.scene.site)
    drones: dict[str, FlightPath] = {}
    notes: list[str] = []
    has_height = True
    for path in paths:
        is_log = path.suffix.lower() in BY_SUFFIX
        if path.suffix.lower() in TABLES:
            with path.open(encoding="utf-8-sig", errors="replace") as file:
                delimiter = TABLES[path.suffix.lower()]
                is_log = not is_table_of_tracks(file.readline(), delimiter)
        if not is_log:
            read = read_tracks(path, scene, date_utc_ns=date_utc_ns)
            told = read.reports.rows((read.reports.t_utc_ns != UNKNOWN_NS) & is_place(read.reports))
            refused = len(read.reports) - len(told) + sum(read.unreadable.values())
            if refused:
                notes.append(f"{path.name}: {refused} places of the truth cannot be used")
            if np.isnan(told.height_m).any():
                has_height = False
                notes.append(f"{path.name} does not tell all heights: nothing is told in space")
            height_m = np.nan_to_num(told.height_m)
            place_m = geodetic_to_ecef(told.latitude_deg, told.longitude_deg, height_m)
            flights = [
                (name, told.t_utc_ns[told.track == n], place_m[told.track == n])
                for n, name in enumerate(read.names)
            ]
        else:
            flight = read_flight(path)
            notes += [f"{path.name}: {line}" for line in (*flight.stated, *flight.assumed)]
            columns = np.array([(r.latitude_deg, r.longitude_deg, r.altitude_m)
                                for r in flight.reports]).T  # fmt: skip
            references = [report.altitude_reference for report in flight.reports]
            if AltitudeReference.ABOVE_TAKEOFF in references:
                above = "the ellipsoid" if site is None else "the height of the site"
                notes.append(f"{path.name}: altitudes above take-off are taken for above {above}")
            latitude_deg, longitude_deg, altitude_m = columns
            height_m = AltitudeDatum(0.0 if site is None else site.height_m).heights_m(
                latitude_deg, longitude_deg, altitude_m, references
            )
            place_m = geodetic_to_ecef(latitude_deg, longitude_deg, height_m)
            times = np.array([report.t_utc_ns for report in flight.reports], np.int64)
            flights = [(flight.name, times, place_m)]
        for name, t_ns, place_m in flights:
            own = name
            while own in drones:
                own = f"{path.stem} {own}"
            usual_ns = float(np.median(np.diff(np.unique(t_ns)))) if len(t_ns) > 1 else 0.0
            gap_ns = round(max(LEAST_GAP_S * NS, 2 * SCANS * usual_ns))
            drones[own] = FlightPath.of(t_ns, place_m, gap_ns)
    return Truths(
        drones=list(drones), paths=list(drones.values()), sensors=(), looks_utc_ns={}, site=site,
        scene="" if scene is None else scene.scene.name, notes=notes, has_height=has_height,
    )  # fmt: skip


def scene_of(path: Path) -> Scene | None:
    """The scene that a recording has with it; None without one that can be used."""
    try:
        with McapReader(path) as log:
            if log.attachment(SCENE_NAME) is None:
                return None
            return recorded_scene(path, log)
    except PlotfeedError:
        return None


def stands_of(log: McapReader, scene: Scene | None) -> tuple[dict[str, LocalFrame], float]:
    """Where sensors stand, and their longest scan in seconds."""
    if scene is not None:
        site = scene.scene.site
        frames = {sensor.id: frame_at(site, sensor.position_enu_m) for sensor in scene.sensor}
        return frames, max((sensor.scan.period_s for sensor in scene.sensor), default=1.0)
    found, longest_s = {}, 1.0
    topics = {s.topic for s in log.counts if s.topic.endswith(DESCRIPTION)}
    for message in log.messages(topics=topics, stages=WHAT_LEFT):
        try:
            told = json.loads(message.payload)
            place = (float(told[n]) for n in ("latitude_deg", "longitude_deg", "height_m"))
            period_s = float(told.get("scan_period_s", 1.0))
            frame = LocalFrame(*place)
            if np.isfinite(frame.origin_ecef_m).all() and 0 < period_s < 1e4:
                found[str(told["sensor"])] = frame
                longest_s = max(longest_s, period_s)
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            continue
    return found, longest_s
