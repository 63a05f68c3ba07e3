"""Parts of a scene for different workers: sensors that need each other stay in one.

Neighbours stay together too, so that a worker needs the telemetry of one area.
"""

from __future__ import annotations

import numpy as np

from plotfeed.feeds.scene.presets.system import MEMBERS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.mount_keys import mount_of
from plotfeed.models.numerics import joined_by_pairs
from plotfeed.models.state import Floats, Ints

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
