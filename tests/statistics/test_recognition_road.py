"""Cameras and classifiers on the road: what is claimed of targets, how often, and how surely."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from scipy import stats
from support.every_kind import MICROPHONES as ARRAY
from support.every_kind import RF as FINDER
from support.significance import Array, assert_counts, assert_law, assert_sum

from plotfeed.feeds.engine.simulation import simulate
from plotfeed.feeds.scene.sensors.effect_keys import ClassifierKeys
from plotfeed.models.frames import wrap_180, wrap_360
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, Feed, fly, held, radar, rotating, scene, staring

# Cameras against closed forms, worked out here from the scene's numbers.


SIZE_M = 0.4
DETECT, RECOGNISE, IDENTIFY = 2.0, 4.0, 6.4
RANGES_M = (400.0, 700.0, 1100.0, 1500.0, 1900.0, 2300.0, 2700.0, 3300.0)
AT_EACH = 12
FRAMES = 300


def camera(**changes: Any) -> dict[str, Any]:
    """One that looks north over 60 degrees, with errors and no alarms."""
    return {
        "id": "camera", "type": "camera", "scan": staring(0.5), "range_max_m": 5000.0,
        "horizontal_fov_deg": 60.0, "pixels_across": 16_000, "pixels_down": 4000,
        "detect_cycles": DETECT, "recognise_factor": RECOGNISE / DETECT,
        "identify_factor": IDENTIFY / DETECT, "false_alarms_per_frame": 0.0,
        "pointing_error_deg": 0.01, "pixel_error": 5.0, "class_probability": 0.9,
        "tells_apart": ["drone", "bird", "kite"], "report": ["asterix-015", "asterix-205", "plots"],
    } | changes  # fmt: skip


ANGLE_RAD = 2 * np.tan(np.radians(30.0)) / 16_000


def odds(range_m: Array | float, needed: float, angle_rad: float = ANGLE_RAD) -> Array:
    x = SIZE_M / (2 * np.asarray(range_m) * angle_rad) / needed
    plain = x ** (2.7 + 0.7 * x)
    return np.asarray(plain / (1 + plain))


def rings(target_class: str = "drone", model: str = "Phantom 4") -> list[dict[str, Any]]:
    return [
        held(f"{ring}-{i}", 2.0 * i - 11.0 + 0.1 * ring, 3.0, range_m, size_m=SIZE_M,
             target_class=target_class, model=model)
        for ring, range_m in enumerate(RANGES_M) for i in range(AT_EACH)
    ]  # fmt: skip


@cache
def plain() -> Feed:
    return fly(scene([camera()], rings(), seed=81), FRAMES * 0.5)


def kinds(road: Feed) -> tuple[Array, Array]:
    batches = [pb.PlotBatch.FromString(payload) for payload in road.payloads("camera/plots")]
    told = [plot for batch in batches for plot in batch.plots]
    return np.array([p.kind for p in told]), np.array(
        [p.kind_probability if p.HasField("kind_probability") else np.nan for p in told]
    )


@pytest.mark.parametrize("ring", range(len(RANGES_M)))
def test_each_ring_is_detected_recognised_and_identified_as_often_as_it_should(ring: int) -> None:
    plots, (kind, _) = plain().plots("camera"), kinds(plain())
    seen, n = kind[np.char.startswith(plots.drone, f"{ring}-")], AT_EACH * FRAMES
    for of, found, needed, share in (
        ("detected", len(seen), DETECT, 1.0),
        ("recognised", (seen != "object").sum(), RECOGNISE, 1.0),
        ("identified", (seen == "Phantom 4").sum(), IDENTIFY, 0.9),
    ):
        p = share * float(odds(RANGES_M[ring], needed))
        assert_sum(found, n * p, max(n * p * (1 - p), 1e-3), of)


def test_claims_are_right_as_often_as_they_say_and_wrong_ones_are_any_other() -> None:
    """What the camera does not know stays an object."""
    kind, probability = kinds(plain())
    claimed = kind != "object"
    np.testing.assert_array_equal(np.isnan(probability), ~claimed)
    assert set(probability[claimed]) == {0.9}
    n, wrong = claimed.sum(), np.isin(kind, ["bird", "kite"]).sum()
    assert_sum(wrong, 0.1 * n, 0.09 * n, "wrong")
    assert_sum((kind == "bird").sum(), wrong / 2, wrong / 4, "bird among the wrong")
    unknown = fly(scene([camera()], rings("balloon"), seed=82), 10.0)
    assert set(kinds(unknown)[0]) == {"object"}


def test_false_alarms_come_as_often_as_stated_anywhere_in_the_picture() -> None:
    keys = camera(false_alarms_per_frame=3.0, pan_deg=350.0, tilt_deg=30.0, vertical_fov_deg=20.0,
                  horizontal_fov_deg=50.0)  # fmt: skip
    road = fly(scene([keys], [], seed=87), 500.0)
    plots = road.plots("camera")
    frames, counts = np.unique(plots.scan, return_counts=True)
    everyone = np.concatenate([counts, np.zeros(1000 - len(frames), int)])
    assert_counts(everyone, stats.poisson(3.0), "a frame")
    east, north = (np.cos(np.radians(plots.elevation_deg)) * of(np.radians(plots.azimuth_deg - 350))
                   for of in (np.sin, np.cos))  # fmt: skip
    up, tilt = np.sin(np.radians(plots.elevation_deg)), np.radians(30.0)
    along = north * np.cos(tilt) + up * np.sin(tilt)
    above = (up * np.cos(tilt) - north * np.sin(tilt)) / along
    half = np.tan(np.radians(25.0)), np.tan(np.radians(10.0))
    assert_law(east / along, stats.uniform(-half[0], 2 * half[0]).cdf, "across")
    assert_law(above, stats.uniform(-half[1], 2 * half[1]).cdf, "up and down")
    assert set(kinds(road)[0]) == {"object"}


def panorama(**changes: Any) -> dict[str, Any]:
    return camera(horizontal_fov_deg=360.0, vertical_fov_deg=20.0, pixels_across=20_000,
                  pixels_down=1100, scan=rotating(0.5, 16), tilt_deg=5.0) | changes  # fmt: skip


def test_a_panorama_that_turns_stamps_each_drone_when_it_looks_there() -> None:
    drones = [held(str(i), 7.0 + 30.0 * i, 5.0, 150.0) for i in range(12)]
    plots = fly(scene([panorama()], drones, seed=88), 20.0).plots("camera")
    assert len(plots) > 400
    turn = (plots.time_utc_ns % (NS // 2)) / (NS // 2)
    behind_deg = wrap_180(360 * turn - plots.true_azimuth_deg)
    assert np.abs(behind_deg).max() < 1e-3


def test_a_panorama_has_equal_angles_and_its_band_of_elevations() -> None:
    drones = [held(f"{i}", 9.0 * i, i - 15.0, 600.0, size_m=SIZE_M) for i in range(40)]
    looks = fly(scene([panorama()], drones, seed=89), 5.0).looks("camera")
    assert -5.001 < looks.elevation_deg.min() < -3.9
    assert 13.9 < looks.elevation_deg.max() < 15.001
    np.testing.assert_allclose(looks.pd, odds(looks.range_m, DETECT, 2 * np.pi / 20_000))


def test_false_alarms_of_a_panorama_are_all_around() -> None:
    keys = panorama(false_alarms_per_frame=5.0)
    plots = fly(scene([keys], [], seed=90), 150.0).plots("camera")
    assert_sum(len(plots), 1500, 1500, "alarms")
    assert_law(wrap_360(plots.azimuth_deg), stats.uniform(0, 360).cdf, "azimuth")
    assert_law(plots.elevation_deg, stats.uniform(-5, 20).cdf, "elevation")


# Classifiers, and elevations of radio, in what leaves.


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
