"""A sensor of two files is right in every format, on the page and in the chart."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from importlib import import_module
from typing import Any, Literal

import numpy as np
import pytest
from sapient_msg.bsi_flex_335_v2_0.registration_pb2 import Registration
from support.asterix_readers import read_blocks
from support.sapient_rules import checked

from plotfeed.feeds.lab.needs import choices_of
from plotfeed.feeds.page.scene_outline import Placements, outline
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import SENSORS, register
from plotfeed.feeds.scene.sensors.sensor_keys import Reports, SensorGeometry, SensorKeys
from plotfeed.feeds.schema import text_of
from plotfeed.feeds.schema.asyncapi import types_that_report
from plotfeed.models.frames import aer_to_enu
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.cat015 import Geometry
from plotfeed.testing import Feed, fly, held, scene, staring

TRUE_DEG = [(10.0, 20.0), (80.0, 5.0)]
WITHIN_DEG = 1.0
RADAR = {
    "geometry": SensorGeometry.MONOSTATIC, "sapient_type": "RADAR", "formats": ("asterix-015",)
}  # fmt: skip


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


@pytest.fixture
def flown(lookout_scene: Scene) -> Feed:
    return fly(lookout_scene, 3.0)


def directions_are_right(found_deg: list[tuple[float, float]]) -> None:
    assert len(found_deg) >= 4
    for direction in found_deg:
        off = [np.abs(np.subtract(direction, true)).max() for true in TRUE_DEG]
        assert min(off) < WITHIN_DEG, direction


def test_category_015_has_its_bearings_and_calls_it_no_radar(flown: Feed) -> None:
    records = flown.records("lookout", 15)
    directions_are_right([(r.get("I015/627/AZ"), r.get("I015/628/EL")) for r in records])
    assert {r.get("I015/020/MOMU") for r in records} == {Geometry.OTHER}
    assert {r.get("I015/625/R") for r in records} == {None}
    assert flown.records("lookout", 25) == []  # comes up every ten seconds
    assert flown.records("lookout", 16) == []
    theirs = [r for block in read_blocks(flown.payloads("lookout/asterix/015")) for r in block]
    assert len(theirs) == len(records)


def test_category_205_has_its_bearings(flown: Feed) -> None:
    records = flown.records("lookout", 205)
    directions_are_right([(r.get("I205/070"), r.get("I205/200")) for r in records])
    theirs = [r for block in read_blocks(flown.payloads("lookout/asterix/205")) for r in block]
    assert len(theirs) == len(records)


def test_protobuf_has_its_bearings_and_no_range(flown: Feed) -> None:
    batches = [pb.PlotBatch.FromString(payload) for payload in flown.payloads("lookout/plots")]
    plots = [plot for batch in batches for plot in batch.plots]
    directions_are_right([(plot.azimuth_deg, plot.elevation_deg) for plot in plots])
    assert not any(plot.HasField("range_m") or plot.HasField("height_m") for plot in plots)


def test_sapient_has_a_lookout_and_its_bearings(flown: Feed) -> None:
    messages = [checked(payload) for payload in flown.payloads("lookout/sapient")]
    (definition,) = messages[0].registration.node_definition
    assert definition.node_type == Registration.NODE_TYPE_OTHER
    assert list(definition.node_sub_type) == ["lookout"]
    found = [m.detection_report.range_bearing for m in messages if m.HasField("detection_report")]
    directions_are_right([(place.azimuth, place.elevation) for place in found])
    assert not any(place.HasField("range") for place in found)


def test_the_page_shows_it_and_places_its_plots_at_the_end_of_its_reach(
    lookout_scene: Scene,
) -> None:
    placements = Placements(lookout_scene.scene.site, lookout_scene.sensor)
    (shown,) = outline(lookout_scene, placements, None)["sensors"]
    assert (shown["type"], shown["label"], shown["range_max_m"]) == ("lookout", "lookout", 3000.0)
    assert (shown["rotates"], shown["transmitters"]) == (False, [])
    unknown = np.array([np.nan])
    east_m, north_m = placements.places_m(np.zeros(1, np.int64), np.array([80.0]), unknown, unknown)
    there_m = aer_to_enu(np.array([80.0]), np.array([0.0]), np.array([3000.0]))[0]
    assert (east_m[0], north_m[0]) == pytest.approx((there_m[0], there_m[1]))


def test_the_chart_has_every_format_that_it_can_report_in(lookout_scene: Scene) -> None:
    alone = {each.read_back for each in choices_of(lookout_scene)}
    assert alone >= {"asterix-015", "asterix-205", "plots", "sapient"}


def test_schemas_have_it() -> None:
    assert "LookoutKeys" in json.loads(text_of("scene"))["$defs"]
    assert "lookout" in types_that_report("asterix-205")


@pytest.mark.parametrize(
    ("traits", "says"),
    [
        ({"formats": ("plots",)}, "lacks the traits geometry, sapient_type"),
        (RADAR | {"formats": ("asterix-062",)}, "reports tracks"),
        (RADAR | {"geometry": SensorGeometry.BISTATIC}, "bistatic sensors have illuminators"),
    ],
)
def test_a_sensor_that_lacks_what_its_traits_need_is_refused_where_it_is_defined(
    traits: dict[str, Any], says: str
) -> None:
    keys = {"type": Literal["some_radar"], "report": Reports}
    with pytest.raises(TypeError, match=says):
        type("_Radar", (SensorKeys,), {"label": "some radar", "__annotations__": keys, **traits})


def test_no_two_sensors_have_one_type() -> None:
    with pytest.raises(ValueError, match="there is a sensor of type lookout already"):
        register(SENSORS["lookout"])
