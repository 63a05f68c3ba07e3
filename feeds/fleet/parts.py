"""Parts of a scene for different processes, and part K/N as the command line asks for it.

Sensors that need each other stay in one part, and neighbours too, so that a process needs the
telemetry of one area.
"""

from __future__ import annotations

import re
import time

import numpy as np

from plotfeed.feeds.scene.presets.system import MEMBERS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.mount_keys import mount_of
from plotfeed.feeds.session.part import SessionPart
from plotfeed.feeds.timing.clock import Clock, InstantClock, WallClock
from plotfeed.feeds.transport.brokers import NO_BROKER
from plotfeed.models.numerics import joined_by_pairs
from plotfeed.models.state import Floats, Ints
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS, iso_utc, utc_ns, whole_second_ns

LEAD_NS = 5 * NS  # In which processes are up
FASTEST = "max"  # In place of a speed
ALARMS_A_SECTOR = 50.0  # False alarms that cost as much as a sector, about


def partition(scene: Scene, parts: int) -> list[tuple[str, ...]]:
    """Ids of the sensors of each part, in the order of the scene; of every sensor in just one.

    There are fewer parts than asked for where sensors that need each other leave no more. The same
    scene and number give the same parts.
    """
    number = together(scene)
    groups = int(number.max()) + 1
    loads = [load_of(scene, sensor) for sensor in scene.sensor]
    load = np.bincount(number, loads).astype(np.float64)
    _, first = np.unique(number, return_index=True)
    places_m = np.array([scene.sensor[i].position_enu_m for i in first.tolist()])
    found = _bisected(np.arange(groups), min(max(parts, 1), groups), places_m, load)
    ids = np.array([sensor.id for sensor in scene.sensor])
    return [tuple(ids[np.isin(number, part)].tolist()) for part in found]


def together(scene: Scene) -> Ints:
    """The number of the group of each sensor that need each other, (n,): of cues, of a system."""
    index = {sensor.id: i for i, sensor in enumerate(scene.sensor)}
    mounts = [(i, mount_of(sensor)) for i, sensor in enumerate(scene.sensor)]
    pairs = [
        (i, index[cuer])
        for i, mount in mounts
        if mount is not None
        for cuer in mount.cuers
        if cuer in index
    ]
    for system in scene.system:
        members = [f"{system.id}-{member}" for member in MEMBERS]
        there = [index[name] for name in members if name in index]
        pairs += [(there[0], other) for other in there[1:]]
    rows, columns = np.array(pairs, np.int64).reshape(-1, 2).T
    return joined_by_pairs(rows, columns, len(scene.sensor))[1]


def load_of(scene: Scene, sensor: Sensor) -> float:
    """Sectors a second of a sensor, and what its false alarms add to their cost."""
    alarms = sensor.model(scene.scene.site).false_alarms_per_scan / ALARMS_A_SECTOR
    return float((sensor.scan.sectors + alarms) / sensor.scan.period_s)


def _bisected(which: Ints, parts: int, places_m: Floats, load: Floats) -> list[Ints]:
    """Groups in so many parts of about the same load, cut where they are spread most."""
    if parts == 1:
        return [which]
    across = places_m[which]
    axis = int(np.argmax(np.ptp(across, axis=0)))
    order = which[np.lexsort((which, across[:, axis]))]
    left = parts // 2
    share = np.cumsum(load[order]) / load[order].sum()
    most = len(order) - (parts - left)
    cut = left + int(np.argmin(np.abs(share[left - 1 : most] - left / parts)))
    return [
        *_bisected(order[:cut], left, places_m, load),
        *_bisected(order[cut:], parts - left, places_m, load),
    ]


def check_scene(scene: Scene, broker: str | None) -> None:
    """Raise `PlotfeedError` for a scene that several processes cannot run."""
    if broker is None:
        raise PlotfeedError(
            "the parts of a fleet need a broker that all of them reach: "
            "--broker mqtt://HOST:PORT, or none"
        )
    if scene.outgoing.sources:
        raise PlotfeedError(
            "telemetry.source: the parts of a fleet listen to brokers alone; "
            "let plotfeed inject publish what the source says"
        )
    if scene.outgoing.websocket or scene.outgoing.remote_id_service:
        raise PlotfeedError(
            "websocket, remote_id_service: parts cannot all listen on one port; leave them out"
        )


def start_of(text: str | None) -> str:
    """A start as it is given to all parts: the one asked for, else in `LEAD_NS`, a whole second.

    Raises `PlotfeedError`.
    """
    if text is None:
        return iso_utc(whole_second_ns(time.time_ns() + LEAD_NS))
    if utc_ns(text) is None:
        raise PlotfeedError(f"--start: expected a time as 2026-01-01T12:00:00Z, not {text!r}")
    return text


def part_asked(
    scene: Scene, text: str, *, start: str | None, broker: str | None, speed: str
) -> tuple[SessionPart, Clock]:
    """The part, and the clock of its session; raises `PlotfeedError`.

    `start` is when the scene begins, by the world's time.
    """
    found = re.fullmatch(r"([0-9]{1,5})/([0-9]{1,5})", text)
    number, parts = map(int, found.groups()) if found else (0, 0)
    if not 1 <= number <= parts:
        raise PlotfeedError(f"--part: expected K/N, such as 2/3 for the second of three: {text!r}")
    broker = broker or scene.outgoing.mqtt.broker
    check_scene(scene, broker)
    is_simulated = speed == FASTEST and broker == NO_BROKER
    if speed != "1" and not is_simulated:
        raise PlotfeedError("--part: parts run in real time, or by --speed max with --broker none")
    began_ns = scene.scene.start_utc_ns
    if start is None and not (is_simulated and began_ns):
        raise PlotfeedError(
            "--part needs --start TIME, the same for all parts, such as "
            f"--start {start_of(None)}: then all agree on the scene's time"
        )
    start_ns = (utc_ns(start_of(start)) or 0) if start else 0
    began_ns = began_ns or start_ns
    sensors = partition(scene, parts)
    if len(sensors) < parts:
        raise PlotfeedError(
            f"--part: the scene's sensors make {len(sensors)} parts at most, not {parts}: "
            "those that cue each other, or belong to a system, stay together"
        )
    part = SessionPart(
        number=number, parts=parts, sensors=sensors[number - 1], began_utc_ns=began_ns
    )
    if is_simulated:
        return part, InstantClock(began_ns)
    if began_ns == start_ns:
        return part, WallClock()
    clock = WallClock(began_ns + time.time_ns() - start_ns)
    clock.start()
    return part, clock
