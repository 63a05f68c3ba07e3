"""Cameras' messages against closed forms, worked out here from the scene's numbers."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import stats
from support.significance import Array, assert_counts, assert_law, assert_sum

from plotfeed.models.frames import wrap_180, wrap_360
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS
from plotfeed.testing import Feed, fly, held, rotating, scene, staring

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
