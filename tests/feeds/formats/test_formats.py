from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.every_kind import scene_of, seen

from plotfeed.feeds.formats import FORMATS, Batch, SceneFormats, carries_plots
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.sensors import SENSORS
from plotfeed.proto.asterix.categories import CATEGORIES, PLOT_ITEMS
from plotfeed.proto.errors import EncodeError
from plotfeed.proto.utc import iso_utc


def test_scenes_and_sensors_know_those_formats_that_are_made() -> None:
    assert FORMATS.keys() == REPORT_FORMATS.keys()
    assert all(row.facts is REPORT_FORMATS[name] for name, row in FORMATS.items())
    for keys in SENSORS.values():
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


def alone(formats: SceneFormats, seen: Batch) -> list[list[Message]]:
    """What each sector has if it is worked out by itself."""
    every = [seen.rows(np.array([i])) for i in range(len(seen))]
    return [messages for one in every for messages in formats.messages(one)]


def test_sensors_of_one_pass_may_report_in_other_formats() -> None:
    first, second = scene_of("rotating", 2, ["asterix-048"], drones=0).sensor
    second = second.model_copy(update={"report": ("plots", "asterix-015")})
    made = scene_of("rotating", 2, ["asterix-048"], drones=1)
    made = made.model_copy(update={"sensor": (first, second)})
    every = seen(made, scans=1)
    plots = np.diff(every.plots_by).reshape(2, 32)
    with_drone, without = (np.add([0, 32], each.argmax(axis=1)) for each in (plots, plots == 0))
    sectors = every.rows(np.concatenate([with_drone, without]))
    messages = SceneFormats(made).messages(sectors)
    assert messages == alone(SceneFormats(made), sectors)
    kinds = [[m.topic.partition("/rotating-")[2][2:] for m in each] for each in messages]
    assert kinds == [
        ["asterix/048", "asterix/034"],
        ["plots", "asterix/015"],
        ["asterix/034"],
        ["plots"],
    ]


def test_what_some_measure_and_others_do_not_is_encoded_apart() -> None:
    made = scene_of("staring", 2, ["asterix-048"], drones=2)
    found = seen(made, scans=1)
    assert found.plots_by.tolist() == [0, 2, 4]
    height_m = found.plots.height_m.copy()
    height_m[:2] = np.nan
    without = replace(found, plots=found.plots.but(height_m=height_m))
    (first,), (second,) = SceneFormats(made).messages(without)
    assert len(first.payload) == len(second.payload) - 2 * 4  # heights and their flags
    assert [second] == SceneFormats(made).messages(found)[1]
    height_m[1] = 0.0
    with pytest.raises(EncodeError, match="NaN"):
        SceneFormats(made).messages(replace(found, plots=found.plots.but(height_m=height_m)))


def test_properties_are_those_of_cloudevents_in_their_order() -> None:
    made = scene_of("rotating", 1, ["asterix-048"])
    sector = seen(made, scans=1).rows(np.array([3]))
    ((*_, crossing),) = SceneFormats(made).messages(sector)
    scan, end_ns = int(sector.sectors.scan[0]), int(sector.sectors.end_ns[0])
    expected = (
        ("id", f"asterix-034-{scan}-3-0"),
        ("type", "plotfeed.asterix.034"),
        ("specversion", "1.0"),
        ("source", "plotfeed/rotating-0"),
        ("time", iso_utc(end_ns)),
        ("sensor", "rotating-0"),
        ("scan", str(scan)),
        ("sector", "3"),
    )
    assert crossing.properties == expected


def test_no_sectors_have_no_messages() -> None:
    made = scene_of("rotating", 2, ["asterix-048", "plots"])
    none = seen(made).rows(np.zeros(0, np.int64))
    assert SceneFormats(made).messages(none) == []
