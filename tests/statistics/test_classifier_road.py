"""Classifiers and RF elevations through the whole road: claims and errors in what leaves.

Each test of significance fails for one seed in 10,000 (`significance.FALSE_ALARM_RATE`); the seeds
are those of the scenes.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from support.every_kind import MICROPHONES as ARRAY
from support.every_kind import RF as FINDER
from support.significance import assert_sum

from plotfeed.feeds.engine.simulation import simulate
from plotfeed.feeds.scene.sensors.effect_keys import ClassifierKeys
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.testing import START_NS, Feed, fly, held, radar, scene

CLASSIFIER = {
    "claims": ["drone", "bird"],
    "confusion": {"drone": [0.9, 0.1], "bird": [0.25, 0.75]},
    "codes": {"drone": 7, "bird": 9},
}
MICROPHONES = {name: value for name, value in ARRAY.items() if "elevation" not in name} | {
    "id": "mic", "sensitivity_db": 0.0, "range_max_m": 1000.0, "classifier": CLASSIFIER,
    "report": ["asterix-015", "plots", "sapient"],
}  # fmt: skip
RF: dict[str, Any] = FINDER | {
    "id": "rf",
    "azimuth_floor_deg": 0.0,
    "elevation_baseline_m": 0.1,
    "elevation_floor_deg": 0.0,
}
EMITTER = {"frequency_hz": 2.44e9, "bandwidth_hz": 1e6, "eirp_dbm": 20.0, "kind": "control"}


@cache
def heard() -> Feed:
    drones = [
        held(f"{name}{i}", 40.0 * i, 4.0, 120.0, sound_power_db=110.0, target_class=name)
        for i in range(4)
        for name in ("drone", "bird")
    ]
    return fly(scene([MICROPHONES], drones, seed=91), 90)


def test_plots_claim_what_the_matrix_says() -> None:
    batches = [pb.PlotBatch.FromString(p) for p in heard().payloads("mic/plots")]
    plots = [plot for batch in batches for plot in batch.plots]
    truths = [t for entry in heard().ledgers if entry.sensor == "mic" for t in entry.plots]
    assert len(plots) > 600
    for name, share in (("drone", 0.9), ("bird", 0.75)):
        said = [p.kind for p, t in zip(plots, truths, strict=True) if t.drone.startswith(name)]
        n = len(said)
        assert_sum(float(said.count(name)), n * share, n * share * (1 - share), name)
    certain = {p.kind: p.kind_probability for p in plots}
    assert certain["drone"] == pytest.approx(0.9 / 1.15)
    assert certain["bird"] == pytest.approx(0.75 / 0.85)


def test_a_claim_that_is_of_no_class_is_never_sure() -> None:
    keys = ClassifierKeys(
        claims=("drone", "bird", "plane"),
        confusion={"drone": (0.7, 0.2, 0.1), "bird": (0.1, 0.9, 0.0)},
    )
    np.testing.assert_allclose(keys.model().certainties, [7 / 8, 9 / 11, 0.0])


def test_category_015_and_sapient_say_class_and_probability() -> None:
    """And SAPIENT has registered it."""
    told = {tuple(int(record.get(f"I015/300/0/{of}")) for of in ("CLS", "PRB"))
            for record in heard().records("mic", 15)}  # fmt: skip
    assert told == {(7, 78), (9, 88)}
    messages = [SapientMessage.FromString(p) for p in heard().payloads("mic/sapient")]
    claims = {
        (c.type, round(c.confidence, 3))
        for m in messages
        for c in m.detection_report.classification
    }
    assert claims == {("drone", 0.783), ("bird", 0.882)}
    (registration,) = [m.registration for m in messages if m.HasField("registration")]
    declared = {
        c.type
        for mode in registration.mode_definition
        for detection in mode.detection_definition
        for each in detection.detection_class_definition
        for c in each.class_definition
    }
    assert {"drone", "bird"} <= declared


def test_category_205_has_elevations_and_sapient_too() -> None:
    sensor = RF | {"report": ["asterix-205", "plots", "sapient"]}
    road = fly(scene([sensor], [held("d", 30.0, 25.0, 3000.0, emitters=[EMITTER])], seed=93), 6)
    (first, *_) = road.records("rf", 205)
    assert float(first.get("I205/200")) == pytest.approx(25.0, abs=3)
    messages = [SapientMessage.FromString(p) for p in road.payloads("rf/sapient")]
    (report, *_) = [m.detection_report for m in messages if m.HasField("detection_report")]
    assert report.range_bearing.elevation == pytest.approx(25.0, abs=3)


def test_an_rf_classifier_errs_but_not_of_what_is_read() -> None:
    matrix = {"claims": ["control", "wifi"], "confusion": {"control": [0.6, 0.4]}}
    drones = [held(f"d{i}", 9.0 * i, 5.0, 3000.0, emitters=[EMITTER]) for i in range(20)]
    sensors = [
        RF | {"classifier": matrix},
        RF | {"id": "reader", "classifier": matrix, "decodes": ["control"]},
    ]
    found = simulate(scene(sensors, drones, seed=94), 40, start_utc_ns=START_NS)
    kinds = found["rf"].plots.kind
    n = len(kinds)
    assert_sum(float((kinds == "control").sum()), 0.6 * n, 0.24 * n, "controls")
    read = found["reader"].plots
    assert set(read.kind) == {"control"}
    assert read.kind_probability is not None
    assert (read.kind_probability == 1.0).all()


@pytest.mark.parametrize("held_s", [0.0, 5.0])
def test_classes_of_a_radar_err_as_often_as_stated_and_for_as_long(held_s: float) -> None:
    """Spells of five scans begin at times of each drone: the first and last are cut short."""
    drones = [
        held(f"{name}{i}", 8.0 * i + 4.0 * (name == "bird"), 4.0, 900.0, rcs_m2=1.0,
             target_class=name)
        for i in range(40)
        for name in ("drone", "bird")
    ]  # fmt: skip
    sensor = radar(classifier=CLASSIFIER | {"held_s": held_s})
    found = simulate(scene([sensor], drones, seed=95), 60, start_utc_ns=START_NS)
    plots = found["radar"].plots
    told = plots.rows(plots.drone >= 0)
    true, spell = np.array(found.drones)[told.drone], max(held_s, 1.0)
    for name, share in (("drone", 0.9), ("bird", 0.75)):
        right = told.kind[np.char.startswith(true, name)] == name
        n = len(right)
        assert_sum(float(right.sum()), n * share, n * share * (1 - share) * spell, name)
    order = np.lexsort((told.t_utc_ns, told.drone))
    kind, drone = told.kind[order], told.drone[order]
    changed = (kind[1:] != kind[:-1])[drone[1:] == drone[:-1]]
    wrong = np.array([0.1, 0.25])
    expected = len(changed) * float((2 * wrong * (1 - wrong)).mean()) / spell
    assert_sum(float(changed.sum()), expected, 3 * expected, "changes")
