"""Sensors of a scene beside the oracle: what they look at and report, and what was to be."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.engine.terrain_files import horizons_of
from plotfeed.feeds.lab import oracle
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.world_keys import HORIZONS
from plotfeed.models.state import Looks, Plots
from plotfeed.proto.utc import NS

START_NS = 1_800_000_000 * NS
# What the oracle may leave open of scenes: what sensors draw or do by themselves.
NOT_KNOWN = {
    "how fast a target was while it turned, or when it was seen once",
    "merging with another target",
    "where a steered beam pointed",
    "whether houses hide a drone",
    "the zoom of a mount",
}


def sensors_of(scene: Scene, seconds: int) -> Iterator[tuple[Sensor, Looks, Plots, Any]]:
    """Looks and plots of each sensor as it was then, and what is known of looks from outside."""
    engine = Engine(scene, START_NS)
    keys: dict[int, Sensor] = {}
    found: dict[int, tuple[list[Looks], list[Plots]]] = {}
    for second in range(1, seconds + 1):
        for batch in engine.until(START_NS + second * NS, messages=False):
            for row, i in enumerate(batch.sectors.sensor.tolist()):
                sensor = keys.setdefault(id(engine.sensors.sensors[i]), engine.sensors.sensors[i])
                looks, plots = found.setdefault(id(sensor), ([], []))
                looks.append(batch.looks.between(*batch.looks_by[row : row + 2].tolist()))
                plots.append(batch.plots.between(*batch.plots_by[row : row + 2].tolist()))
    names = np.array(engine.trajectories.names, np.object_)
    for which, (parts, reported) in found.items():
        sensor, looks = keys[which], Looks.joined(parts)
        if not len(looks):
            continue
        flown = engine.trajectories.state_at(looks.t_utc_ns, looks.drone)
        velocity_ecef_m_s = flown.velocity_ecef_m_s
        if looks.emitted_utc_ns is not None:  # while the sound was on its way
            then_m = engine.trajectories.position_at(looks.emitted_utc_ns, looks.drone)
            lasted_s = (looks.t_utc_ns - looks.emitted_utc_ns)[:, None] / NS
            velocity_ecef_m_s = (flown.position_ecef_m - then_m) / lasted_s
        frame = frame_at(scene.scene.site, sensor.position_enu_m)
        given = oracle.LooksGiven(
            t_utc_ns=looks.t_utc_ns,
            azimuth_deg=looks.azimuth_deg,
            elevation_deg=looks.elevation_deg,
            range_m=looks.range_m,
            drone=names[looks.drone],
            channel=looks.channel,
            velocity_enu_m_s=frame.rotate_from_ecef(velocity_ecef_m_s),
            emitted_utc_ns=looks.emitted_utc_ns,
        )
        yield sensor, looks, Plots.joined(reported), given


def check(scene: Scene, folder: Path, seconds: int) -> dict[str, int]:
    """Fail where a sensor's looks have other odds than the oracle has, or plots other errors.

    How many looks of each sensor were compared is returned.
    """
    recorded, compared = scene, {sensor.id: 0 for sensor in scene.sensor}
    if scene.terrain is not None:
        (folder / HORIZONS).write_bytes(horizons_of(scene))
        recorded = scene.enclosed({HORIZONS: folder / HORIZONS})
    for sensor, looks, plots, given in sensors_of(scene, seconds):
        asked = oracle.asked(recorded, sensor, given)
        assert set(filter(None, asked.why_not.split("; "))) <= NOT_KNOWN, sensor.id
        known = asked.known
        if getattr(sensor, "decorrelation_s", None) is not None or sensor.scan.kind == "electronic":
            known = known & False  # looks are at targets as strong as they were drawn
        compared[sensor.id] += int(known.sum())
        asked_pd, pd = asked.pd[known], looks.pd[known]
        np.testing.assert_allclose(asked_pd, pd, rtol=1e-6, atol=1e-12, err_msg=sensor.id)
        known = known & ~np.isnan(looks.snr)
        told_db = 10 * np.log10(looks.snr[known])
        np.testing.assert_allclose(
            asked.snr_db[known], told_db, rtol=0, atol=1e-5, err_msg=sensor.id
        )
        stated_as_asked(sensor, plots)
        expected, why = oracle.false_alarms_per_scan(recorded, sensor)
        if not why:
            told = sensor.model(scene.scene.site).false_alarms_per_scan
            assert expected == pytest.approx(told, rel=1e-6), sensor.id
    return compared


def stated_as_asked(sensor: Sensor, plots: Plots) -> None:
    """Fail where radars state other errors than follow from each plot's own ratio."""
    is_steered = getattr(sensor, "mount", None) is not None
    if sensor.type not in {"active_radar", "mimo_radar", "passive_radar"} or is_steered:
        return
    stated = oracle.stated_sigmas(sensor, plots.snr, plots.channel)
    names = dict.fromkeys(oracle.SIGMAS, "") | {"sigma_range_m": "sigma_range_m"}
    if sensor.type == "passive_radar":
        names["sigma_range_m"] = "sigma_bistatic_range_m"
    for name, expected in stated.items():
        told = getattr(plots, names[name] or name)
        if told is not None and not np.isnan(told).all():
            np.testing.assert_allclose(expected, told, rtol=1e-9, err_msg=sensor.id)
