"""The third file: a line that registers the camera, and a scene that has one."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from support.road import held, scene, staring
from toy_sensor.camera_keys import CameraKeys

from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import SENSORS, register


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    register(CameraKeys)
    yield
    del SENSORS["camera"]  # of other tests


@pytest.fixture
def camera_scene() -> Scene:
    camera = {
        "id": "camera",
        "type": "camera",
        "scan": staring(),
        "range_max_m": 3000.0,
        "report": ["asterix-015", "asterix-205", "plots", "sapient"],
    }
    drones = [held("north", 10.0, 20.0, 1000.0), held("east", 80.0, 5.0, 2000.0)]
    return scene([camera], drones, seed=1)
