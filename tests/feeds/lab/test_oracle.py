"""The oracle beside what a session's sensors look at: two implementations of one scene."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.lab import oracle
from plotfeed.feeds.scene.examples import summaries
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.scene import Scene, example
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.models.state import Looks
from plotfeed.proto.utc import NS

START_NS = 1_800_000_000 * NS


def looked_at(scene: Scene, seconds: int) -> Iterator[tuple[Sensor, Looks, oracle.LooksGiven]]:
    """Looks of each sensor as it was then, and what a ledger and the drones' ways tell of them."""
    engine, found = Engine(scene, START_NS), dict[Any, list[Looks]]()
    keys: dict[Any, Sensor] = {}
    for second in range(1, seconds + 1):
        for batch in engine.until(START_NS + second * NS, messages=False):
            for row, i in enumerate(batch.sectors.sensor.tolist()):
                first, after = batch.of_looks[row : row + 2].tolist()
                sensor = engine.sensors.sensors[i]
                if after > first:
                    found.setdefault(id(sensor), []).append(batch.looks.between(first, after))
                    keys[id(sensor)] = sensor
    names = np.array(engine.trajectories.names, np.object_)
    for which, parts in found.items():
        sensor, looks = keys[which], Looks.joined(parts)
        t_utc_ns = looks.t_utc_ns if looks.emitted_utc_ns is None else looks.emitted_utc_ns
        flown = engine.trajectories.state_at(t_utc_ns, looks.drone)
        frame = frame_at(scene.scene.site, sensor.position_enu_m)
        yield (
            sensor,
            looks,
            oracle.LooksGiven(
                t_utc_ns=looks.t_utc_ns,
                azimuth_deg=looks.azimuth_deg,
                elevation_deg=looks.elevation_deg,
                range_m=looks.range_m,
                drone=names[looks.drone],
                channel=looks.channel,
                velocity_enu_m_s=frame.rotate_from_ecef(flown.velocity_ecef_m_s),
                emitted_utc_ns=looks.emitted_utc_ns,
            ),
        )


@pytest.mark.parametrize("name", summaries())
def test_every_shipped_scene_asks_what_its_sensors_do(name: str) -> None:
    scene = example(name)
    for sensor, looks, given in looked_at(scene, 10):
        asked = oracle.asked(scene, sensor, given)
        known = asked.known
        np.testing.assert_allclose(asked.pd[known], looks.pd[known], rtol=1e-9, atol=1e-15)
        if not np.isnan(looks.snr).all():
            told_db = 10 * np.log10(looks.snr[known])
            np.testing.assert_allclose(asked.snr_db[known], told_db, rtol=0, atol=1e-9)
