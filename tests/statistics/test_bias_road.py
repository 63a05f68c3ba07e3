"""Systematic errors and drift, as they leave in plots and tracks, beside what the ledger says."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from support.every_kind import RADAR, SENSORS, drones
from support.significance import Array, assert_standard_normal, assert_uncorrelated

from plotfeed.models.frames import aer_to_enu, geodetic_to_ecef, wrap_180
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS
from plotfeed.testing import SITE, Feed, FeedTable, fly, held, scene

SCANS = 60
BIAS = {
    "range_offset_m": 12.0,
    "range_scale": 2e-3,
    "azimuth_offset_deg": 1.5,
    "tilt_deg": 0.8,
    "tilt_azimuth_deg": 60.0,
    "time_offset_s": 0.25,
}
KINDS = pytest.mark.parametrize("kind", SENSORS)


@cache
def road(kind: str, **effects: Any) -> Feed:
    named = {name: dict(keys) for name, keys in effects.items()}
    return fly(scene([SENSORS[kind] | named], drones(kind), seed=81), SCANS)


def measured(flight: Feed) -> tuple[list[pb.Plot], list[pb.PlotTruth]]:
    """Detections as sent, and the truth of each."""
    batches = [pb.PlotBatch.FromString(p) for p in flight.payloads("radar/plots")]
    plots = [plot for batch in batches for plot in batch.plots]
    truths = [truth for entry in flight.ledgers for truth in entry.plots]
    both = [(p, t) for p, t in zip(plots, truths, strict=True) if t.drone]
    return [p for p, _ in both], [t for _, t in both]


def column(rows: list[Any], name: str) -> Array:
    return np.array([getattr(row, name) if row.HasField(name) else np.nan for row in rows])


def own_place(azimuth_deg: Array, elevation_deg: Array) -> tuple[Array, Array]:
    """Azimuth and elevation by axes that stand askew as BIAS says, by spherical trigonometry."""
    tilt, el = np.radians(BIAS["tilt_deg"]), np.radians(elevation_deg)
    away = np.radians(azimuth_deg - BIAS["tilt_azimuth_deg"])
    sine = np.sin(el) * np.cos(tilt) + np.cos(el) * np.sin(tilt) * np.cos(away)
    forward = np.cos(el) * np.cos(away) * np.cos(tilt) - np.sin(el) * np.sin(tilt)
    side = np.cos(el) * np.sin(away)
    azimuth = BIAS["tilt_azimuth_deg"] + np.degrees(np.arctan2(side, forward))
    return azimuth + BIAS["azimuth_offset_deg"], np.degrees(np.arcsin(sine))


@KINDS
def test_a_clock_that_is_ahead_puts_late_times_on_plots(kind: str) -> None:
    plots, truths = measured(road(kind, bias=tuple(BIAS.items())))
    off_ns = np.array([p.time_utc_ns - t.time_utc_ns for p, t in zip(plots, truths, strict=True)])
    assert (off_ns == 250_000_000).all()


@KINDS
def test_errors_change_neither_what_is_true_nor_the_odds(kind: str) -> None:
    """The ledger of the same scene without them: the same drones, places and draws."""
    with_bias, without = road(kind, bias=tuple(BIAS.items())), road(kind)
    _, truths = measured(with_bias)
    places = {t.drone: (t.azimuth_deg, t.elevation_deg, t.range_m) for t in measured(without)[1]}
    for truth in truths[:200]:
        assert (truth.azimuth_deg, truth.elevation_deg, truth.range_m) == pytest.approx(
            places[truth.drone], abs=0.02
        )
    names = ("azimuth_deg", "elevation_deg", "range_m")
    looked, expected = (
        {look[0]: look[1:] for look in zip(each.drone, *map(each.__getattr__, names), strict=True)}
        for each in (with_bias.looks(), without.looks())
    )
    for drone in looked.keys() & expected.keys():
        assert looked[drone] == pytest.approx(expected[drone], abs=0.02)
    assert (with_bias.looks().emitted_utc_ns != 0).all() == (kind == "microphones")
    assert np.mean(with_bias.looks().pd) == pytest.approx(np.mean(without.looks().pd), abs=2e-3)


@pytest.mark.parametrize("kind", ["active", "passive", "rf"])
def test_drift_is_gauss_markov_and_the_same_for_all_drones_of_a_scan(kind: str) -> None:
    constant_s, sigma = 8.0, {"active": 0.5, "passive": 4.0, "rf": 20.0}[kind]
    drift = {"sigma_azimuth_deg": sigma, "sigma_range_m": 300.0, "time_constant_s": constant_s}
    sensor = SENSORS[kind] | {"drift": drift}
    plots, truths = measured(fly(scene([sensor], drones(kind)[:3], seed=820), 1100))
    off = wrap_180(column(plots, "azimuth_deg") - column(truths, "azimuth_deg"))
    scans = np.array([truth.time_utc_ns // NS for truth in truths])
    each = np.bincount(scans - scans.min())
    mean = np.bincount(scans - scans.min(), off) / np.maximum(each, 1)
    noise = off - mean[scans - scans.min()]
    assert np.abs(noise).mean() < 0.2 * sigma
    series = mean[each > 0][1:] / sigma
    kept = np.exp(-1 / constant_s)
    new = (series[1:] - kept * series[:-1]) / np.sqrt(1 - kept**2)
    assert_standard_normal(new, "what is new")
    assert_uncorrelated(new, series[:-1], "with what was")


def positions(flight: Feed) -> FeedTable:
    """Of tracks in category 062: places from the site and times of day."""
    records = flight.records("radar", 62)
    names = {"latitude_deg": "I062/105/LAT", "longitude_deg": "I062/105/LON", "t_s": "I062/070"}
    return FeedTable({n: np.array([r.get(path) for r in records]) for n, path in names.items()})


def test_tracks_are_where_the_sensor_believes_the_drones_to_be() -> None:
    sensor = RADAR | {"report": ["asterix-062"], "bias": BIAS}
    where = [held("a", 60.0, 0.5, 4000.0, rcs_m2=1.0)]
    tracks = positions(fly(scene([sensor], where, seed=84), 30))
    assert len(tracks) > 20
    azimuth_deg, elevation_deg = own_place(np.array(60.0), np.array(0.5))
    range_m = 4000.0 * (1 + BIAS["range_scale"]) + BIAS["range_offset_m"]
    believed = aer_to_enu(azimuth_deg, elevation_deg, range_m)
    ecef_m = geodetic_to_ecef(tracks.latitude_deg, tracks.longitude_deg, SITE.height_m)
    seen = SITE.from_ecef(ecef_m)
    assert np.abs(seen[:, :2] - believed[:2]).max() < 2.0
    assert np.linalg.norm(aer_to_enu(60.0, 0.5, 4000.0)[:2] - believed[:2]) > 50.0
