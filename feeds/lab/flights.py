"""The truth of a run: where its ledger says that drones were, and which sensors looked at them."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from plotfeed.feeds.lab.evidence import Evidence
from plotfeed.feeds.lab.ledger_columns import LedgerTables, ToldLooks
from plotfeed.feeds.recording.recorder import SCENE_NAME
from plotfeed.feeds.recording.session_again import recorded_scene
from plotfeed.feeds.scene.fields import frame_at, site_frame
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.frames import LocalFrame, aer_to_enu
from plotfeed.models.state import Ints
from plotfeed.models.track_metrics import FlightPath
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import DAY_NS, NS
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.recorded import WHAT_LEFT

DESCRIPTION = "/description"
LEAST_GAP_S = 6.0
"""Between places of a flight it is told where it was, if they are no further apart than this..."""
SCANS = 1.5
"""... or than so many of the longest scans."""
MAX_DRONES = 10_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Truths:
    """The flights of a run. A drone is there while any sensor looks at it: that is cover."""

    drones: Sequence[str]
    paths: Sequence[FlightPath]
    """Of the drones."""
    sensors: Sequence[str]
    looks_utc_ns: Mapping[tuple[int, int], Ints]
    """When a drone was looked at by a sensor, by their numbers; ascending."""
    site: LocalFrame | None = None
    """Of the scene."""
    scene: str = ""
    notes: Sequence[str] = field(default_factory=tuple)


class FlightsTally:
    """Takes entries of a ledger one by one, and gives the flights that they tell of."""

    def __init__(self, sensors: Mapping[str, LocalFrame], longest_scan_s: float = 1.0) -> None:
        """`sensors` says where sensors stand: looks of others cannot be placed."""
        self.entries = 0
        self.unplaced: Counter[str] = Counter()
        """Looks of sensors of which nobody says where they stand."""
        self._frames = dict(sensors)
        self._gap_ns = round(max(LEAST_GAP_S, SCANS * longest_scan_s) * NS)
        self._drones: dict[str, int] = {}
        self._rows: dict[str, list[ToldLooks]] = {}
        """Looks by sensor, with the drones' numbers in place of those of entries."""

    def add(self, told: LedgerTables) -> None:
        """Take entries."""
        self.entries += len(told)
        numbers = self._drones
        for name in dict.fromkeys(told.looks.drone):
            if name and len(numbers) < MAX_DRONES:
                numbers.setdefault(name, len(numbers))
        number = np.array([numbers.get(name, -1) for name in told.looks.drone], np.int64)
        looks = told.looks.but(sensor=told.entries.sensor[told.looks.entry], entry=number)
        for sensor in dict.fromkeys(vars(looks)["sensor"]):
            own = looks.rows(vars(looks)["sensor"] == sensor)
            if sensor in self._frames:
                self._rows.setdefault(sensor, []).append(own.rows(own.entry >= 0))
            else:
                self.unplaced[sensor] += len(own)

    def truths(
        self,
        within_utc_ns: tuple[int, int] | None = None,
        *,
        site: LocalFrame | None = None,
        scene: str = "",
        notes: Sequence[str] = (),
    ) -> Truths:
        """All flights so far; looks at times outside `within_utc_ns` are of no use."""
        order = sorted(self._drones, key=lambda name: (len(name), name))
        place = np.empty(len(order), np.int64)
        place[[self._drones[name] for name in order]] = np.arange(len(order))
        looks: dict[tuple[int, int], Ints] = {}
        parts = []
        for number, (sensor, rows) in enumerate(self._rows.items()):
            all_of = ToldLooks.joined(rows)
            aer = np.stack([all_of.azimuth_deg, all_of.elevation_deg, all_of.range_m])
            when_ns = np.where(all_of.emitted_utc_ns, all_of.emitted_utc_ns, all_of.t_utc_ns)
            usable = np.isfinite(aer).all(axis=0) & (aer[2] < 1e7)
            if within_utc_ns is not None:
                usable &= (when_ns >= within_utc_ns[0]) & (when_ns <= within_utc_ns[1])
            drone, t_ns = place[all_of.entry[usable]], when_ns[usable]
            at_m = self._frames[sensor].to_ecef(aer_to_enu(*aer[:, usable]))
            parts.append((drone, t_ns, at_m))
            for each in np.unique(drone).tolist():
                looks[each, number] = np.unique(t_ns[drone == each])
        none = (np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3)))
        drone, t_ns, at_m = (np.concatenate(p) for p in zip(*(parts or [none]), strict=True))
        by_drone = np.argsort(drone, kind="stable")
        ends = np.searchsorted(drone[by_drone], np.arange(len(order) + 1)).tolist()
        paths = [
            FlightPath.of(t_ns[by_drone[a:b]], at_m[by_drone[a:b]], self._gap_ns)
            for a, b in pairwise(ends)
        ]
        untold = [
            f"{many} looks of {sensor} have no place: where it stands is not told"
            for sensor, many in self.unplaced.items()
        ]
        return Truths(
            drones=order,
            paths=paths,
            sensors=list(self._rows),
            looks_utc_ns=looks,
            site=site,
            scene=scene,
            notes=(*notes, *untold),
        )


def scene_of(path: Path) -> Scene | None:
    """The scene that a recording has with it; None without one that can be used."""
    try:
        with McapReader(path) as log:
            if log.attachment(SCENE_NAME) is None:
                return None
            return recorded_scene(path, log)
    except PlotfeedError:
        return None


def read_truths(path: Path, scene: Scene | None = None) -> Truths:
    """The flights that the ledger in a recording tells of, live or in simulated time.

    Sensors stand where the scene says, the one given or the recording's own, or else where their
    descriptions in the recording do. Raises `PlotfeedError` if it is no MCAP, or holds no ledger,
    and `OSError`.
    """
    with Evidence.of(path) as evidence:
        scene = scene or scene_of(path)
        tally = FlightsTally(*_stands(evidence.log, scene))
        for part in evidence.parts(with_plots=False):
            tally.add(part.told)
        found = evidence.unreadable
        notes = [f"{found} entries are no ledger and are left out"] if found else []
        if damage := len(evidence.log.damage):
            notes.append(f"the recording is damaged in {damage} places, which are left out")
        summary = evidence.log.summary()
        return tally.truths(
            ((summary.start_ns or 0) - DAY_NS, (summary.end_ns or 0) + DAY_NS),
            site=None if scene is None else site_frame(scene.scene.site),
            scene="" if scene is None else scene.scene.name,
            notes=notes,
        )


def _stands(log: McapReader, scene: Scene | None) -> tuple[dict[str, LocalFrame], float]:
    """Where sensors stand, and their longest scan in seconds."""
    if scene is not None:
        site = scene.scene.site
        frames = {sensor.id: frame_at(site, sensor.position_enu_m) for sensor in scene.sensor}
        return frames, max((sensor.scan.period_s for sensor in scene.sensor), default=1.0)
    found, longest_s = {}, 1.0
    for name, frame, period_s in _described(log):
        found[name] = frame
        longest_s = max(longest_s, period_s)
    return found, longest_s


def _described(log: McapReader) -> Iterator[tuple[str, LocalFrame, float]]:
    topics = {s.topic for s in log.summary().counts if s.topic.endswith(DESCRIPTION)}
    for message in log.messages(topics=topics, stages=WHAT_LEFT):
        try:
            told = json.loads(message.payload)
            place = (float(told[n]) for n in ("latitude_deg", "longitude_deg", "height_m"))
            period_s = float(told.get("scan_period_s", 1.0))
            frame = LocalFrame(*place)
            if np.isfinite(frame.origin_ecef_m).all() and 0 < period_s < 1e4:
                yield str(told["sensor"]), frame, period_s
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            continue
