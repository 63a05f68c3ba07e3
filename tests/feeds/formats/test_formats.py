from __future__ import annotations

import pytest

from plotfeed.feeds.formats import FORMATS, carries_plots
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.sensors import SENSORS, SensorKeys
from plotfeed.proto.asterix.categories import CATEGORIES, PLOT_ITEMS


def test_every_format_that_scenes_know_is_made_and_the_other_way_round() -> None:
    assert FORMATS.keys() == REPORT_FORMATS.keys()
    assert all(row.facts is REPORT_FORMATS[name] for name, row in FORMATS.items())


@pytest.mark.parametrize("keys", SENSORS.values(), ids=SENSORS)
def test_every_format_of_a_sensor_is_in_the_table(keys: type[SensorKeys]) -> None:
    assert set(keys.formats) <= FORMATS.keys()
    assert len(set(keys.formats)) == len(keys.formats)


@pytest.mark.parametrize("name", FORMATS)
def test_what_a_format_brings_is_read_back(name: str) -> None:
    row = FORMATS[name]
    assert (row.plots_in is None) == row.facts.tells_tracks
    assert row.facts.categories.keys() <= CATEGORIES.keys()
    if row.facts.categories and not row.facts.tells_tracks:
        assert next(iter(row.facts.categories)) in PLOT_ITEMS
    assert carries_plots(f"some/prefix/radar/{row.facts.topic}")


@pytest.mark.parametrize("end", ["status", "asterix/034", "asterix/025", "settings", "truth"])
def test_topics_of_other_messages_carry_no_plots(end: str) -> None:
    assert not carries_plots(f"some/prefix/radar/{end}")
