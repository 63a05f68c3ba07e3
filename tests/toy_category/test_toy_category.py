"""A category of one file and a line is sent, read, shown, told of, charted and tabulated."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from toy_category.asterix_250 import FORMAT

from plotfeed.feeds.formats import FORMATS, carries_plots, register
from plotfeed.feeds.lab.needs import METRICS, Run, choices_of
from plotfeed.feeds.recording.decoded_text import message_lines
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors.polar_radar_keys import ActiveRadarKeys
from plotfeed.feeds.schema import text_of
from plotfeed.proto.asterix.categories import CATEGORIES, PLOT_ITEMS
from plotfeed.proto.asterix.codec.decode import decode
from plotfeed.proto.utc import NS
from plotfeed.replay.plots_csv import PlotsCsvWriter
from plotfeed.replay.recorded import Recorded
from plotfeed.testing import Feed, fly, held, radar, scene

TOPIC = "plotfeed/radar/asterix/250"


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


@pytest.fixture
def flown(radar_scene: Scene) -> Feed:
    return fly(radar_scene, 3.0)


def test_it_is_sent_and_decoded(flown: Feed) -> None:
    records = [r for payload in flown.payloads("radar/asterix/250") for r in decode(payload)]
    plots = flown.plots()
    assert len(records) == len(plots) > 0
    columns = {"range_m": "I250/030/R", "azimuth_deg": "I250/030/AZ", "elevation_deg": "I250/040"}
    for name, path in columns.items():
        read = np.array([record.get(path) for record in records], np.float64)
        assert read == pytest.approx(getattr(plots, name), abs=0.6 if name == "range_m" else 0.01)


def test_its_plots_are_read_into_columns(flown: Feed) -> None:
    plots = flown.plots()
    (first, *_) = [m for m in flown.messages if m.topic == TOPIC]
    read = FORMATS["asterix-250"].plots_in
    assert read is not None
    found = read(first.payload, first.due_utc_ns)
    assert found.azimuth_deg[0] == pytest.approx(plots.azimuth_deg[0], abs=0.01)
    assert abs(found.t_utc_ns[0] - plots.time_utc_ns[0]) < 10**9 / 128
    assert carries_plots(TOPIC)


def test_it_is_shown_as_text_with_its_time_of_day(flown: Feed) -> None:
    payload = flown.payloads("radar/asterix/250")[0]
    line, *_ = message_lines(TOPIC, payload, None)
    assert line.startswith(f"{TOPIC}  CAT250  22:13:2")
    assert "030 R=" in line


def test_it_is_in_tables_of_plots(flown: Feed) -> None:
    file = io.BytesIO()
    writer = PlotsCsvWriter(file)
    (sent, *_) = [m for m in flown.messages if m.topic == TOPIC]
    recorded = Recorded(
        topic=sent.topic,
        payload=sent.payload,
        content_type=sent.content_type,
        log_time_ns=sent.due_utc_ns,
        publish_time_ns=sent.due_utc_ns,
    )
    assert writer.write(recorded) is None
    assert ",radar,250," in file.getvalue().decode()


def test_schemas_tell_of_it() -> None:
    api = json.loads(text_of("asyncapi"))
    assert api["channels"]["asterix-250"]["x-sensor-types"] == ["active_radar"]
    keys = json.loads(text_of("scene"))["$defs"]["ActiveRadarKeys"]["properties"]
    assert "asterix-250" in keys["report"]["items"]["enum"]


def test_the_chart_compares_it(radar_scene: Scene) -> None:
    (ours,) = [each for each in choices_of(radar_scene) if each.read_back == "asterix-250"]
    plain, read = (
        Run(each, 1, 1_767_268_800 * NS, 20.0).figures[0, list(METRICS).index("range_m")]
        for each in (replace(ours, read_back=""), ours)
    )
    assert 0 < abs(read - plain) <= 0.5  # half a step


def test_a_scene_is_warned_of_its_steps(radar_scene: Scene) -> None:
    (sensor,) = radar_scene.sensor
    fine = sensor.model_copy(update={"range_resolution_m": 0.05})
    assert "asterix-250 counts range in steps of 1 m" in "".join(
        fine.warnings(radar_scene.scene.site)
    )


def test_no_two_formats_have_one_name() -> None:
    with pytest.raises(ValueError, match="there is a format asterix-250 already"):
        register(FORMAT)
