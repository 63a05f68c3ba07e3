"""The oracle beside what sensors of scenes look at and report.

Two implementations that share no line have one answer for each look. Where they part one is wrong;
where they agree both are exact, as tests/models holds sensors against exact values.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.given_files import reference_rows
from support.hills import write_ridge
from support.random_scenes import PLAIN_M, SENSOR_MAKERS, tables_of, tree_with, written_scene

from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.engine.terrain_files import horizons_of
from plotfeed.feeds.lab import oracle
from plotfeed.feeds.scene.examples import summaries
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.scene import Scene, example, from_tree, load
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.effect_keys import DopplerKeys
from plotfeed.feeds.scene.sensors.scan_keys import ElectronicScan
from plotfeed.feeds.scene.world_keys import HORIZONS
from plotfeed.models.fluctuation import FluctuatingCfar
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
    bistatic = {"sigma_range_m": "sigma_bistatic_range_m"}
    names = bistatic if sensor.type == "passive_radar" else {}
    for name, expected in stated.items():
        told = getattr(plots, names.get(name, name))
        if told is not None and not np.isnan(told).all():
            np.testing.assert_allclose(expected, told, rtol=1e-9, err_msg=sensor.id)


SCENES = Path(__file__).parents[3] / "examples" / "scenes"
EXAMPLES = {path.stem: path for path in sorted(SCENES.glob("*.toml"))}


@pytest.mark.parametrize("name", [*summaries(), *EXAMPLES])
def test_every_shipped_scene_asks_what_its_sensors_do(name: str, tmp_path: Path) -> None:
    check(load(EXAMPLES[name]) if name in EXAMPLES else example(name), tmp_path, 4)


@pytest.mark.parametrize("seed", range(len(SENSOR_MAKERS)))
def test_random_scenes_ask_what_their_sensors_do(seed: int, tmp_path: Path) -> None:
    """The first sensor of each is of the next kind."""
    check(load(written_scene(seed, tmp_path)), tmp_path, 2)


OF_SCENES = ("terrain", "weather of all", "jammer", "target")
# Each of scenes' in a scene of its own; sensors' in one, a sensor each: so none hides another.
TABLES = [
    *((kind, "plain and own") for kind in SENSOR_MAKERS),
    *((kind, table) for kind in SENSOR_MAKERS for table in OF_SCENES),
]


# With those radars stand in rain that echoes, and turn with pulses; cameras see light, heat, haze.
SEEDS = {"terrain": (1,), "plain and own": (1, 5, 11), "weather of all": (24,)}


@pytest.mark.parametrize(("kind", "which"), TABLES)
def test_each_table_of_each_kind_asks_the_same(kind: str, which: str, tmp_path: Path) -> None:
    """Drawn up to thrice, at drones all over the cover; a camera by light, heat and in haze."""
    write_ridge(tmp_path, height_m=700, plain_m=PLAIN_M)
    tables = [which] if which in OF_SCENES else ["plain", *tables_of(kind)]
    compared: Counter[str] = Counter()
    for seed in SEEDS.get(which, (1, 3)):
        made = from_tree(tree_with(kind, tables, seed), tmp_path / "one.toml")
        compared.update(check(made, tmp_path, 6 if kind.startswith("acoustic") else 1))
    assert {table for table, looks in compared.items() if not looks} <= {"merging"}


SEARCHES = {
    "scan": ElectronicScan(kind="electronic", period_s=1.0, dwell_s=0.06, max_tracks=0),
    "azimuth_beamwidth_deg": 90.0,
    "elevation_beamwidth_deg": 45.0,
}


@pytest.mark.parametrize("changes", [{"decorrelation_s": 1e-3}, SEARCHES])
def test_looks_at_a_strength_that_was_drawn_are_asked_for_on_average(changes: Any) -> None:
    """Of lasting strengths, and of a period's: looks are at a steady target, the law is the mean.

    One run in 16,000 fails.
    """
    scene = example("section-4")
    radar = scene.sensor[0].model_copy(update={"power_w": 20.0} | changes)
    scene = scene.model_copy(update={"sensor": (radar,)})
    for sensor, looks, _, given in sensors_of(scene, 300):
        asked = oracle.asked(scene, sensor, given)
        search = looks.channel == 0
        assert asked.known[search].all()
        off = (looks.pd - asked.pd)[search]
        assert abs(off.mean()) < 4 * off.std() / len(off) ** 0.5
        assert off.std() > 0.05


def test_who_was_seen_once_has_no_speed_that_a_notch_could_be_asked_of() -> None:
    scene = example("section-4")
    (sensor,) = (s for s in scene.sensor if s.type == "mimo_radar")
    sensor = sensor.model_copy(update={"doppler": DopplerKeys(notch_m_s=0.5)})
    for each, _, _, given in sensors_of(scene, 5):
        if each.id == sensor.id:
            once = {n: v[:1] for n, v in vars(given).items() if isinstance(v, np.ndarray)}
            seen_once = replace(given, **once | {"velocity_enu_m_s": None})
            asked = oracle.asked(scene, sensor, seen_once)
            assert not asked.known.any()
            assert "seen once" in asked.why_not


def test_a_zoomed_camera_is_judged_where_its_field_of_view_is_told() -> None:
    scene = example("city")
    for sensor, looks, plots, given in sensors_of(scene, 30):
        if not oracle.zooms(sensor):
            continue
        told_deg = oracle.field_of_view_deg(sensor, plots.sigma_elevation_deg)
        np.testing.assert_allclose(told_deg, 6.0)
        wide = replace(given, field_deg=np.full(len(looks), 6.0))
        asked = oracle.asked(scene, sensor, wide)
        later = looks.t_utc_ns >= plots.t_utc_ns.min()
        np.testing.assert_allclose(asked.pd[later], looks.pd[later], rtol=1e-6)
        assert not oracle.asked(scene, sensor, given).known.any()


def test_looks_of_a_steered_beam_are_as_many_as_are_asked_for() -> None:
    """Of 200 s: those that confirm, and those at tracks but for what is said to be open.

    Successive looks at a track are as strong in one period, so that 4 errors are 5: one in 16,000.
    Of a hundred looks a share that is 25 points off is found, of a thousand 8 points.
    """
    whole = load(EXAMPLES["perimeter"])
    radar: Any = whole.sensor[0]
    weaker = radar.model_copy(update={"power_w": 0.2 * radar.power_w})
    scene = whole.model_copy(update={"sensor": (weaker,)})
    for sensor, looks, _, given in sensors_of(scene, 200):
        asked = oracle.asked(scene, sensor, given)
        for channel in (0, 1, 2):
            of = (looks.channel == channel) & asked.known
            assert of.sum() > 0.9 * (looks.channel == channel).sum() > 100
            error = (asked.pd[of] * (1 - asked.pd[of])).sum() ** 0.5
            off = abs((looks.detected[of] - asked.pd[of]).sum()) - asked.pd_off[of].sum()
            assert off < 5 * max(error, 1.0)


def test_velocities_follow_from_looks_before_and_after_and_turns_are_not_judged() -> None:
    radar = example("field-day").sensor[0]
    radar = radar.model_copy(update={"doppler": DopplerKeys(notch_m_s=3.0)})
    scene = example("field-day").model_copy(update={"sensor": (radar,)})
    for sensor, looks, _, given in sensors_of(scene, 30):
        blind = replace(given, velocity_enu_m_s=None)
        asked = oracle.asked(scene, sensor, blind)
        assert 0.3 < asked.known.mean() < 1.0
        np.testing.assert_allclose(asked.pd[asked.known], looks.pd[asked.known], atol=0.02)


def test_what_it_does_not_know_is_not_judged() -> None:
    scene = example("section-4")
    for sensor, _, _, given in sensors_of(scene, 2):
        strange = replace(given, drone=given.drone + "-of-telemetry")
        asked = oracle.asked(scene, sensor, strange)
        assert not asked.known.any()
        assert asked.why_not == "drones that the scene does not name"


NOWHERE = zlib.compress(struct.pack("<I4d", 1, float("nan"), 0.0, 0.0, 1440.0))
TOO_MANY = zlib.compress(struct.pack("<I4d", 1 << 31, 0.0, 0.0, 0.0, 1440.0))


def test_without_horizons_of_use_nothing_behind_ground_is_judged(tmp_path: Path) -> None:
    scene, path = example("valley"), tmp_path / HORIZONS
    of_valley = list(sensors_of(scene, 2))
    for told in (None, b"", b"none", NOWHERE, TOO_MANY, NOWHERE[:-4]):
        path.write_bytes(told or b"")
        enclosed = scene.enclosed({} if told is None else {HORIZONS: path})
        for sensor, _, _, given in of_valley:
            asked = oracle.asked(enclosed, sensor, given)
            assert not asked.known.any()
            assert "ground and buildings" in asked.why_not


# Means of errors, which no look tells.


def test_the_mean_of_errors_squared_is_exact_where_looks_are_summed() -> None:
    known_noise = 10**7  # reference samples, whose sum errs by 3e-4
    for row in reference_rows("fluctuating_rms_given_detection.csv"):
        snr = np.array([[10 ** (float(row["mean_snr_db"]) / 10)]])
        _, (inverse,) = oracle.unequal(snr, float(row["pfa"]), known_noise)
        assert inverse**0.5 == pytest.approx(float(row["rms_inv_sqrt_inst_snr"]), rel=1e-5)


@pytest.mark.parametrize("order", [np.inf, 1.0, 3.0, 6.0])
@pytest.mark.parametrize("snr", [0.0, 30.0, 1e4])
def test_the_mean_of_errors_squared_is_that_of_detections(order: float, snr: float) -> None:
    """4,000 draws: the means part by more than 4.5 standard errors once in 150,000."""
    n, law = 4_000, (1e-3, 3, 48)
    _, (expected,) = oracle.fluctuating(np.array([snr]), order, *law)
    draws = np.random.default_rng(int(10 * snr)), np.full((n, 1), snr), np.full(n, order)
    power, _ = FluctuatingCfar(*law).draw_detected(draws[1], draws[2], draws[0])
    inverse = 1 / power
    assert abs(inverse.mean() - expected) < 4.5 * inverse.std() / n**0.5
