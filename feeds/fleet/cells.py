"""Cells of the Earth by which telemetry is shared out: those of H3, in a level of the topic.

What a drone says while it is in a cell goes to {prefix}/telemetry/cell/{cell}/{drone}, and a worker
subscribes to the cells that its sensors reach into.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.session.session_part import CELL
from plotfeed.feeds.telemetry.decode_reports import decode
from plotfeed.feeds.telemetry.fast_decode import fast_decode
from plotfeed.feeds.telemetry.position_report import Refused
from plotfeed.feeds.telemetry.receiver import TRAVEL
from plotfeed.models.frames import distance_m

NOWHERE = "nowhere"
"""The cell of what cannot be read: whoever leads refuses it."""
USUAL_RESOLUTION = 6
"""Of H3: edges of 3.7 km on average."""
MARGIN_M = 2000.0
"""Further than its sensors reach a worker listens: so far a drone flies between two reports, and
before what it sends is heard."""
UNEVEN = 1.5
"""By which an edge may be longer or shorter than the average; edges differ by a third."""


def filters_of(
    scene: Scene, sensors: Iterable[str], leads: bool, resolution: int | None
) -> tuple[str, ...] | None:
    """Topic filters of the telemetry that sensors need; None without cells, for all of it."""
    if resolution is None:
        return None
    wanted = frozenset(sensors)
    cells = set[str]()
    for sensor in scene.sensor:
        if sensor.id in wanted:
            cells |= cells_of(scene, sensor, resolution)
    found = sorted(cells) + ([NOWHERE] if leads else [])
    return tuple(f"{scene.mqtt.prefix}/{CELL}/{cell}/+" for cell in found)


def cells_of(scene: Scene, sensor: Sensor, resolution: int) -> set[str]:
    """All cells that a sensor reaches into, and maybe some beside them."""
    need_extra("h3", "sharing telemetry out by cells", "fleet")
    import h3

    frame = frame_at(scene.scene.site, sensor.position_enu_m)
    here = frame.latitude_deg, frame.longitude_deg
    reach_m = reach_of(scene, sensor) + MARGIN_M
    edge_m = h3.average_hexagon_edge_length(resolution, unit="m")
    rings = math.ceil((reach_m + edge_m * UNEVEN) / (1.5 * edge_m / UNEVEN))
    around = h3.grid_disk(h3.latlng_to_cell(*here, resolution), rings)
    within_m = reach_m + edge_m * UNEVEN
    return {
        cell
        for cell in around
        if h3.great_circle_distance(here, h3.cell_to_latlng(cell), unit="m") <= within_m
    }


def reach_of(scene: Scene, sensor: Sensor) -> float:
    """How far from a sensor drones are that it may sense, metres."""
    model = sensor.model(scene.scene.site)
    ends_enu_m = [end.position_enu_m for end in getattr(model, "transmitters", ())]
    baselines_m = distance_m(np.array(ends_enu_m).reshape(-1, 3))
    travels = TRAVEL if model.signal_speed_m_s is not None else 1.0
    return float(model.range_max_m * travels + baselines_m.max(initial=0.0))


def cell_at(latitude_deg: float, longitude_deg: float, resolution: int) -> str:
    """The cell of a place."""
    import h3

    return str(h3.latlng_to_cell(latitude_deg, longitude_deg, resolution))


def cell_of(payload: bytes, content_type: str | None, now_utc_ns: int, resolution: int) -> str:
    """The cell that a drone says it is in, or `NOWHERE` where it says nothing that is taken."""
    try:
        row = fast_decode(payload, content_type)
        report = row or decode(payload, content_type, now_utc_ns=now_utc_ns)
    except Refused:
        return NOWHERE
    return cell_at(report.latitude_deg, report.longitude_deg, resolution)
