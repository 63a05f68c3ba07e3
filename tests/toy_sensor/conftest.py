"""A scene that has a lookout, which is there for these tests alone."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib import import_module

import pytest

from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import SENSORS
from plotfeed.testing import held, scene, staring


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    keys = import_module("toy_sensor.lookout_keys").__name__
    yield
    del SENSORS["lookout"], sys.modules[keys]  # of other tests


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
