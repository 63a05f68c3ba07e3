"""The one line that lets active radars report in category 250, and a scene in which one does."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from toy_category.asterix_250 import FORMAT

from plotfeed.feeds.formats import FORMATS, register
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors.polar_radar_keys import ActiveRadarKeys
from plotfeed.proto.asterix.categories import CATEGORIES, PLOT_ITEMS
from plotfeed.testing import held, radar, scene


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(ActiveRadarKeys, "formats", ActiveRadarKeys.formats)  # put back afterwards
    register(FORMAT, ActiveRadarKeys)
    yield
    del FORMATS["asterix-250"], REPORT_FORMATS["asterix-250"], CATEGORIES[250], PLOT_ITEMS[250]


@pytest.fixture
def radar_scene() -> Scene:
    return scene(
        [radar(report=["asterix-250", "plots"])], [held("drone", 40.0, 10.0, 2000.0)], seed=1
    )
