"""The third file: a line that registers the lookout, and a scene that has one."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from support.road import held, scene, staring
from toy_sensor.lookout_keys import LookoutKeys

from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import SENSORS, register


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    register(LookoutKeys)
    yield
    del SENSORS["lookout"]  # of other tests


@pytest.fixture
def lookout_scene() -> Scene:
    lookout = {
        "id": "lookout",
        "type": "lookout",
        "scan": staring(),
        "range_max_m": 3000.0,
        "report": ["asterix-015", "asterix-205", "plots", "sapient"],
    }
    drones = [held("north", 10.0, 20.0, 1000.0), held("east", 80.0, 5.0, 2000.0)]
    return scene([lookout], drones, seed=1)
