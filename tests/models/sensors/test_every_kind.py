"""Models of all kinds: in company, as predicted, at extremes of their keys, in their cover."""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.random_scenes import SENSOR_MAKERS, Dice
from support.significance import assert_sum
from support.targets import targets_at

from plotfeed.models.beam import AzimuthCover, Sector
from plotfeed.models.chance import DrawsBySensor
from plotfeed.models.effects.doppler import Doppler
from plotfeed.models.effects.surroundings import Multipath
from plotfeed.models.frames import aer_to_enu, enu_to_aer
from plotfeed.models.sensors.active_radar import ActiveRadar
from plotfeed.models.sensors.range_gate import RangeGate
from plotfeed.models.sensors.sensor_model import SensorModel, Targets, grouping_key, stacked
from plotfeed.models.state import Columns, Emitter, Floats, Plots, Signature, Signatures
from plotfeed.testing import scene, staring

SENSORS = 4
GROUND = {"reflection": -0.9, "antenna_height_m": 12.0}
DOPPLER = {"notch_m_s": 1.0}
PULSES = {"prf_hz": [20e3, 23e3], "needed": 1}
WIDE = {"horizontal_fov_deg": 170.0, "pixels_across": 900_000, "tilt_deg": 20.0}
EFFECTS: dict[str, list[dict[str, Any]]] = {
    "active_radar": [
        {}, {"measures_elevation": True}, {"multipath": GROUND}, {"doppler": DOPPLER},
        {"multipath": GROUND, "doppler": {"prf_hz": 4000.0}},
    ],
    "mimo_radar": [{}, {"multipath": GROUND, "doppler": DOPPLER}],
    "passive_radar": [{}, {"multipath": GROUND, "doppler": DOPPLER}],
    "rf": [{}, {"multipath": GROUND}],
    "camera": [WIDE, WIDE | {"visibility_m": 5000.0, "hotter_k": 4.0}],
}  # fmt: skip


def made(kind: str, **keys: Any) -> SensorModel:
    """The model of a sensor as random scenes have them."""
    drawn = SENSOR_MAKERS[kind](Dice(1)) | {"scan": staring(), "range_max_m": 9000.0} | keys
    built = scene([drawn | {"id": "one", "type": kind}], seed=1)
    return built.sensor[0].model(built.scene.site)


MODELS = {
    f"{kind} {keys}": made(kind, **keys)
    for kind in SENSOR_MAKERS
    if not kind.startswith("multistatic") and kind != "acoustic_pair"
    for keys in EFFECTS.get(kind, [{}])
}
EMITTERS = (
    Emitter(frequency_hz=2.44e9, bandwidth_hz=1e6, eirp_dbm=20.0, kind="control"),
    Emitter(frequency_hz=2.437e9, eirp_dbm=15.0, kind="remote-id", identity="1596F3"),
    Emitter(frequency_hz=2.401e9, bandwidth_hz=5e6, eirp_dbm=17.0, kind="video"),
)


def varied(value: Any, rng: np.random.Generator, alike: frozenset[str] = frozenset()) -> Any:
    """The same with other numbers, some of them 0, where they may differ."""
    if isinstance(value, AzimuthCover):
        low_deg = rng.uniform(-180, 180)
        return AzimuthCover(low_deg, low_deg + rng.choice([360.0, 300.0, rng.uniform(100, 360)]))
    if isinstance(value, float):
        return value * rng.uniform(0.8, 1.0)
    if isinstance(value, tuple):
        return tuple(varied(part, rng) for part in value)
    if not is_dataclass(value) or isinstance(value, (Doppler, Multipath)):
        return value
    others = {
        f.name: 0.0 if f.name.endswith("floor_m") and rng.random() < 0.3
        else varied(getattr(value, f.name), rng)
        for f in fields(value) if f.name not in alike
    }  # fmt: skip
    return replace(value, **others)  # type: ignore[type-var]


def several(model: SensorModel, rng: np.random.Generator) -> list[SensorModel]:
    """Others of its kind, and itself twice."""
    alike = type(model).alike
    assert alike is not None
    return [model, *(varied(model, rng, alike) for _ in range(SENSORS - 2)), model]


def targets(rng: np.random.Generator, n: int, drones: int = 12) -> Targets:
    enu_m = aer_to_enu(rng.uniform(0, 360, n), rng.uniform(-5, 60, n), 10 ** rng.uniform(1, 4, n))
    return Targets(
        drone=rng.integers(0, drones, n),
        t_utc_ns=rng.integers(0, 10**9, n),
        position_enu_m=enu_m,
        true_position_enu_m=enu_m + rng.normal(0, 5, (n, 3)) if rng.random() < 0.5 else enu_m,
        velocity_enu_m_s=rng.normal(0, 20, (n, 3)),
        signatures=Signatures(
            rcs_m2=10 ** rng.uniform(-3, 1, drones),
            sound_power_db=np.where(rng.random(drones) < 0.2, np.nan, 90.0),
            emitters=[EMITTERS[: rng.integers(0, 4)] for _ in range(drones)],
            size_m=np.where(rng.random(drones) < 0.2, np.nan, 0.5),
            target_class=np.where(rng.random(drones) < 0.5, "drone", "kite").astype(np.object_),
            model=np.where(rng.random(drones) < 0.5, "", "F1").astype(np.object_),
        ),
        sensor=np.sort(rng.integers(0, SENSORS, n)),
    )


def of_rows(found: Targets, which: Any) -> Targets:
    columns = {
        f.name: column[which]
        for f in fields(found)
        if f.name not in {"signatures", "sensor"} and (column := getattr(found, f.name)) is not None
    }
    if found.true_position_enu_m is found.position_enu_m:
        columns["true_position_enu_m"] = columns["position_enu_m"]
    return Targets(**columns, signatures=found.signatures)


def assert_same(together: Columns, alone: Columns) -> None:
    assert len(together) == len(alone)
    if not len(alone):
        return
    held, expected = (
        {name: column for name, column in vars(columns).items() if column is not None}
        for columns in (together, alone)
    )
    assert held.keys() - {"sensor"} == expected.keys()
    for name, column in expected.items():
        np.testing.assert_array_equal(held[name], column, err_msg=name)


@pytest.mark.parametrize("kind", MODELS)
@pytest.mark.parametrize("n", [1, 700])
def test_each_row_has_what_its_sensor_gives_it_alone(kind: str, n: int) -> None:
    plots_seen = 0
    for seed in range(4):
        rng = np.random.default_rng(seed)
        models = several(MODELS[kind], rng)
        assert len({grouping_key(model) for model in models}) == 1
        stack, all_of_them = stacked(models), targets(rng, n)
        sensor = all_of_them.sensor
        draws: Any = DrawsBySensor([np.random.default_rng(i) for i in range(SENSORS)], sensor)
        looks, plots = stack.rows(sensor).observe(all_of_them, draws)
        for i, model in enumerate(models):
            mine = of_rows(all_of_them, sensor == i)
            own_looks, own_plots = model.observe(mine, np.random.default_rng(i))
            assert_same(looks.rows(looks.sensor == i), own_looks)
            if len(plots):
                assert_same(plots.rows(plots.sensor == i), own_plots)
            else:
                assert not len(own_plots)
            plots_seen += len(own_plots)
    assert plots_seen > 25 or n < 700


@pytest.mark.parametrize("kind", MODELS)
def test_equal_sensors_are_one_without_columns(kind: str) -> None:
    model = MODELS[kind]
    stack = stacked([model, replace(model), replace(model)])  # type: ignore[type-var]
    assert stack is model
    assert stack.rows(np.array([2, 0])) is model


def test_rows_follow_each_other() -> None:
    models = [made("active_radar", range_max_m=float(m)) for m in (1000, 2000, 3000)]
    stack: Any = stacked(models)
    assert stack.range_min_m == models[0].range_min_m  # type: ignore[attr-defined]
    rows = stack.rows(np.array([2, 2, 0, 1]))
    assert rows.range_max_m.tolist() == [3000.0, 3000.0, 1000.0, 2000.0]
    some = rows.rows(slice(1, None)).rows(np.array([True, False, True]))
    assert some.range_max_m.tolist() == [3000.0, 2000.0]
    assert rows.rows(slice(None)) is rows
    with pytest.raises(AttributeError, match="no_such_key"):
        rows.no_such_key  # noqa: B018


@dataclass(frozen=True, kw_only=True)
class Plain(RangeGate):
    """A kind that knows nothing of columns: it shares a pass with its equals alone."""

    alike = None


def test_what_must_be_equal_tells_groups_apart() -> None:
    changes = ({}, {"n_reference": 8}, {"measures_elevation": True}, {"pfa": 1e-5},
               {"multipath": GROUND}, {"doppler": DOPPLER})  # fmt: skip
    others = [made("active_radar", **keys) for keys in changes]
    mimo: Any = made("mimo_radar")
    others += [mimo, replace(mimo, transmitters=mimo.transmitters[:1])]
    others += [made("acoustic", elevation_beamwidth_deg=width) for width in (14.0, None)]
    others += [made("rf"), made("rf", integration_s=2e-3)]
    same = made("active_radar", power_w=1.0, azimuth_min_deg=0.0, azimuth_max_deg=10.0)
    assert grouping_key(same) == grouping_key(others[0])
    one, equal, other = (Plain(range_max_m=1.0, sigma_m=s) for s in (2.0, 2.0, 3.0))
    assert grouping_key(one) == grouping_key(equal)
    assert stacked([one, equal]) is one
    others += [one, other]
    assert len({grouping_key(model) for model in others}) == len(others)


# What is predicted is what observation comes to, of each kind, with and without effects.


WORSE = {"degradation": {"pd_factor": 0.6, "error_factor": 2.0}}
# Kind, keys, the place (azimuth, elevation, range), what of a sigma its first order may miss.
PREDICTED: list[tuple[str, dict[str, Any], tuple[float, float, float], float]] = [
    ("active_radar", {"power_w": 10.0}, (40.0, 12.0, 2500.0), 0.01),
    ("active_radar", {"power_w": 10.0, "doppler": DOPPLER} | WORSE, (40.0, 12.0, 2500.0), 0.01),
    ("active_radar", {"power_w": 10.0, "multipath": GROUND}, (40.0, 12.0, 2500.0), 0.01),
    ("active_radar", {"power_w": 10.0, "pulses": PULSES}, (40.0, 12.0, 2500.0), 0.01),
    ("mimo_radar", WORSE, (70.0, 12.0, 2000.0), 0.01),
    ("mimo_radar", {}, (70.0, 12.0, 1200.0), 0.01),
    ("passive_radar", {}, (120.0, 3.0, 2500.0), 0.03),
    ("passive_radar", WORSE, (120.0, 3.0, 1500.0), 0.03),
    ("acoustic", {"sensitivity_db": 15.0}, (200.0, 20.0, 120.0), 0.01),
    ("acoustic", {"sensitivity_db": 12.0} | WORSE, (200.0, 20.0, 120.0), 0.01),
    ("acoustic_pair", {"sensitivity_db": 0.0}, (10.0, 20.0, 120.0), 0.1),
    ("rf", {"elevation_baseline_m": 0.3, "path_loss": {"kind": "friis"}}, (300.0, 5.0, 7000.0),
     0.02),
    ("rf", {"path_loss": {"kind": "friis"}} | WORSE, (300.0, 5.0, 3000.0), 0.02),
    ("range_gate", {"sigma_m": 3.0}, (100.0, 20.0, 900.0), 0.01),
    ("range_gate", {"sigma_m": 3.0} | WORSE, (100.0, 20.0, 900.0), 0.01),
    ("camera", WIDE, (0.0, 20.0, 1500.0), 0.01),
]  # fmt: skip
VELOCITY = np.array([[4.0, 5.0, 0.0]])
OF_PLACES = Signature(rcs_m2=0.02, sound_power_db=80.0, emitters=(EMITTERS[0],), size_m=0.3)


@pytest.mark.parametrize(("kind", "keys", "place", "off"), PREDICTED)
def test_what_is_predicted_is_what_observation_comes_to(
    kind: str, keys: dict[str, Any], place: tuple[float, float, float], off: float
) -> None:
    """Seed 5; by 4 standard errors beside what is to first order."""
    model = made(kind, **{"measures_elevation": True} if kind == "active_radar" else {}, **keys)
    azimuth_deg = place[0]
    if kind == "camera":
        azimuth_deg = float(model.pan_deg)  # type: ignore[attr-defined]
    here = aer_to_enu(np.array([azimuth_deg]), place[1], place[2])
    expected = model.predict(of_places(here, velocity=VELOCITY))
    # Of what joins detections each scan is one target.
    scans, n = (400, 1) if kind == "acoustic_pair" else (1, 8000)
    many, rng = of_places(np.repeat(here, n, axis=0), velocity=VELOCITY), np.random.default_rng(5)
    found = [model.observe(many, rng)[1] for _ in range(scans)]
    plots = Plots.joined(found)
    plots = plots.rows(plots.drone >= 0)
    # A passive radar's errors are those of the transmitter that is heard best.
    of_best = plots.rows(plots.channel == np.bincount(plots.channel).argmax())
    reported = sum(len(np.unique(each.drone[each.drone >= 0])) for each in found)
    pd, looked = float(expected.pd[0]), n * scans
    assert_sum(reported, looked * pd, looked * pd * (1 - pd) + (off * looked * pd) ** 2 / 16 + 1e-9)
    assert pd > 0.02
    for name in ("range_m", "azimuth_deg", "elevation_deg", "range_rate_m_s"):
        sigma = getattr(expected, f"sigma_{name}")
        if sigma is None or np.isnan(sigma[0]) or not of_best.measures(name):
            continue
        error = getattr(of_best, name) - getattr(of_best, f"true_{name}")
        error = np.mod(error + 180, 360) - 180 if name.endswith("deg") else error
        square = (error - error.mean()) ** 2 / float(sigma[0]) ** 2
        spread = square.std() / np.sqrt(len(square))
        assert abs(square.mean() - 1) < 4 * spread + 2 * off, name


def of_places(
    places_m: Floats, one: Signature = OF_PLACES, velocity: Floats | None = None
) -> Targets:
    """A drone at each place, all alike."""
    return targets_at(
        places_m, rcs_m2=one.rcs_m2, sound_power_db=one.sound_power_db, size_m=one.size_m,
        emitters=[one.emitters] * len(places_m), velocity_enu_m_s=velocity,
    )  # fmt: skip


# Whom each looks at, by its keys; and what it makes of parameters at the ends of their bounds.


COVERED = {"azimuth_min_deg": -30.0, "azimuth_max_deg": 60.0, "range_max_m": 1500.0}
ABOVE = {"range_min_m": 100.0, "elevation_min_deg": -5.0, "elevation_max_deg": 40.0}
COVERS = {
    **dict.fromkeys(("active_radar", "mimo_radar", "passive_radar"), COVERED | ABOVE),
    **dict.fromkeys(("acoustic", "rf"), COVERED),
    "range_gate": {"range_max_m": 1500.0},
}


@pytest.mark.parametrize("kind", COVERS)
def test_it_looks_at_those_in_its_cover_alone(kind: str) -> None:
    """At the edges, over and at the sensor itself too, where there is no azimuth."""
    keys, rng = COVERS[kind], np.random.default_rng(3)
    if kind == "passive_radar":
        keys = {key: value for key, value in keys.items() if key != "range_min_m"}
    azimuth_deg = np.append(rng.uniform(0, 360, 300), [329.99, 330.01, 59.99, 60.01, 0.0, 0.0, 0.0])
    elevation_deg = np.append(rng.uniform(-90, 90, 300), [5.0] * 4 + [90.0, 39.99, 40.01])
    range_m = np.append(10 ** rng.uniform(0, 4, 300), [500.0] * 7)
    places = np.append(aer_to_enu(azimuth_deg, elevation_deg, range_m), np.zeros((1, 3)), axis=0)
    looks, _ = made(kind, **keys).observe(of_places(places), np.random.default_rng(4))
    azimuth_deg, elevation_deg, range_m = enu_to_aer(places)
    within = (range_m > 0) & (range_m >= keys.get("range_min_m", 0)) & (range_m <= 1500.0)
    if "azimuth_min_deg" in keys:
        within &= np.mod(azimuth_deg + 30.0, 360.0) <= 90.0
    if "elevation_min_deg" in keys:
        within &= (elevation_deg >= -5.0) & (elevation_deg <= 40.0)
    assert set(looks.drone.tolist()) == set(np.flatnonzero(within).tolist())
    assert 5 < within.sum() < 250


# Powers of ten, and levels, between which fields are drawn.
POWERS = {
    **dict.fromkeys(("power_w", "erp_w"), (-6, 7)), "frequency_hz": (6, 12), "bandwidth_hz": (3, 9),
    "integration_s": (-6, 1), "pfa": (-15, -1), "range_resolution_m": (-2, 4),
    "azimuth_beamwidth_deg": (-2, 2.5), "elevation_beamwidth_deg": (-2, 2.2), "sigma_m": (-9, 9),
    "range_max_m": (2, 5.6), "slope_per_db": (-2, 2), "absorption_db_per_m": (-4, -0.5),
    "height_above_ground_m": (-3, 3), "baseline_m": (-3, 4), "elevation_baseline_m": (-3, 4),
    "path_loss_exponent": (0, 1), "path_loss_reference_m": (-2, 4), "duty_cycle": (-9, 0),
    "azimuth_floor_deg": (-9, 3), "elevation_floor_deg": (-9, 3), "range_floor_m": (-9, 3),
}  # fmt: skip
LEVELS = {
    **dict.fromkeys(("gain_tx_dbi", "gain_rx_dbi", "gain_dbi"), (-100, 80)), "loss_db": (0, 100),
    **dict.fromkeys(("noise_figure_db", "receiver_noise_figure_db"), (0, 50)),
    **dict.fromkeys(("directivity_db", "array_gain_db", "noise_db", "sensitivity_db"), (-90, 90)),
    **dict.fromkeys(("barrier_db", "misc_db"), (0, 90)), "sidelobe_db": (-80, 0),
    "cancellation_db": (-120, 0), "external_noise_db": (-20, 80), "line_loss_db": (0, 3),
    "antenna_loss_db": (0, 3),
}  # fmt: skip


def extreme(value: Any, rng: np.random.Generator) -> Any:
    """The same with numbers from all over their bounds; the rest stays."""
    if isinstance(value, tuple):
        return tuple(extreme(part, rng) for part in value)
    if not is_dataclass(value) or isinstance(value, (Doppler, Multipath, AzimuthCover)):
        return value
    drawn = {
        "n_reference": int(rng.integers(1, 40)),
        "bursts_per_dwell": int(10 ** rng.uniform(0, 6)),
    }
    for f in fields(value):
        held = getattr(value, f.name)
        if isinstance(held, float) and f.name in POWERS:
            drawn[f.name] = float(10 ** rng.uniform(*POWERS[f.name]))
        elif isinstance(held, float) and f.name in LEVELS:
            drawn[f.name] = float(rng.uniform(*LEVELS[f.name]))
        elif isinstance(held, tuple) and f.name == "transmitters":
            drawn[f.name] = extreme(held, rng)
    there = {f.name for f in fields(value)}
    drawn["range_min_m"] = rng.choice([0.0, 0.5]) * drawn.get("range_max_m", 0.0)
    return replace(value, **{n: v for n, v in drawn.items() if n in there})  # type: ignore[type-var]


WHOLE_SCAN = Sector(0, 0, 0, 1_000_000_000, 0.0, 360.0)


@pytest.mark.parametrize("kind", [*MODELS, "acoustic_pair {}"])
@settings(max_examples=25)
@given(seed=st.integers(0, 2**32))
def test_whatever_the_parameters_nothing_is_undefined(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = MODELS[kind] if kind in MODELS else made("acoustic_pair")
    if kind in MODELS:
        model = extreme(model, rng)
    far_m = getattr(model, "range_max_m", 1e3) * 10.0 ** rng.uniform(-6, 0.2, (30, 1))
    direction = aer_to_enu(rng.uniform(0, 360, 30), rng.uniform(-90, 90, 30), 1.0)
    ends_m = model.other_ends_enu_m
    places = [direction * far_m, ends_m, ends_m * rng.uniform(-1, 2, (len(ends_m), 1))]
    places += [np.zeros((1, 3)), np.array([[0.0, 0.0, 50.0], [0.0, 1e-9, 0.0]])]
    emitters = (Emitter(frequency_hz=10 ** rng.uniform(3, 12), bandwidth_hz=10 ** rng.uniform(0, 9),
                        eirp_dbm=rng.uniform(-300, 300)), *EMITTERS)  # fmt: skip
    one = Signature(rcs_m2=10 ** rng.uniform(-6, 4), sound_power_db=rng.uniform(-300, 300),
                    emitters=emitters, size_m=10 ** rng.uniform(-3, 2))  # fmt: skip
    there = of_places(np.concatenate(places), one)
    looks, plots = model.observe(there, rng)
    assert ((looks.pd >= 0) & (looks.pd <= 1)).all()
    assert_sound(plots, model)
    predicted = model.predict(there)
    assert ((predicted.pd >= 0) & (predicted.pd <= 1)).all()
    if "acoustic" not in kind:  # of which some are far below all that is heard
        for column in astuple(predicted):
            assert column is None or not np.isinf(column[: len(there) - 3]).any()
    louder = Signature(rcs_m2=3 * one.rcs_m2, sound_power_db=one.sound_power_db + 3,
                       emitters=tuple(replace(e, eirp_dbm=e.eirp_dbm + 3) for e in emitters),
                       size_m=one.size_m)  # fmt: skip
    more = model.observe(of_places(there.position_enu_m, louder), rng)[0].pd
    assert (more >= looks.pd * (1 - 1e-9)).all()
    if model.false_alarms_per_scan < 1e4:
        assert_sound(model.draw_false_alarms(WHOLE_SCAN, rng), model)


def assert_sound(plots: Plots, model: Any) -> None:
    """What is stated is finite and within its bounds."""
    for name in ("range_m", "azimuth_deg", "elevation_deg", "snr", "amplitude_dbm",
                 "bistatic_range_m", "sigma_range_m", "sigma_azimuth_deg", "sigma_elevation_deg",
                 "sigma_bistatic_range_m", "run_length_deg", "covariance_east_m2"):  # fmt: skip
        column = getattr(plots, name)
        told = ~np.isnan(column)
        if plots.measures(name):
            assert told.all() or not told.any(), name
        assert np.isfinite(column[told]).all(), name
        if name.startswith("sigma") or name in ("range_m", "run_length_deg"):
            assert (column[told] >= 0).all(), name
    azimuth_deg, elevation_deg = plots.azimuth_deg, plots.elevation_deg
    assert ((azimuth_deg >= 0) & (azimuth_deg < 360) | np.isnan(azimuth_deg)).all()
    assert ((np.abs(elevation_deg) <= 90) | np.isnan(elevation_deg)).all()
    if hasattr(model, "range_min_m") and len(plots) and not hasattr(model, "expected_height_m"):
        assert plots.range_m.min() >= model.range_min_m
        assert plots.range_m.max() <= model.range_max_m
    east_m2, north_m2, both_m2 = (
        getattr(plots, f"covariance_{name}_m2") for name in ("east", "north", "east_north")
    )
    minor = east_m2 * north_m2 - both_m2**2
    assert not (minor < -1e-9 * (east_m2 + north_m2) ** 2).any()


# What sensors say of their errors, at a detection's own ratio; and how long echoes last.


def test_what_is_stated_of_an_snr_is_what_plots_of_it_state() -> None:
    """Of several transmitters the worst ranges; of microphones and gates what their keys say."""
    rng = np.random.default_rng(1)
    for kind, model in MODELS.items():
        if "radar" not in kind and not kind.startswith("acoustic"):
            continue
        _, plots = model.observe(replace(targets(rng, 400), sensor=None), rng)
        names = [name for name in plots.__dataclass_fields__ if name.startswith("sigma")]
        for i in range(0, min(len(plots), 40), 2):
            stated = model.stated_sigmas(float(plots.snr[i]))
            told = {name: getattr(plots, name)[i] for name in names if plots.measures(name)}
            told = {name: sigma for name, sigma in told.items() if not np.isnan(sigma)}
            if not kind.startswith("passive"):
                assert stated == pytest.approx(told, rel=1e-12), kind
                continue
            told.pop("sigma_range_m")
            assert stated.keys() == told.keys()
            assert all(stated[n] >= told[n] * (1 - 1e-12) for n in told)
    gate = made("range_gate", sigma_m=3.0, range_max_m=2000.0)
    across_deg = np.degrees(3.0 / 1000.0)
    assert gate.stated_sigmas(1.0) == pytest.approx(
        {"sigma_range_m": 3.0, "sigma_azimuth_deg": across_deg, "sigma_elevation_deg": across_deg}
    )


@pytest.mark.parametrize("measures_azimuth", [True, False])
def test_bearings_of_emissions_are_stated_amidst_the_band(measures_azimuth: bool) -> None:
    model: Any = made("rf", measures_azimuth=measures_azimuth)
    middle_hz = np.array([(model.frequency_min_hz + model.frequency_max_hz) / 2])
    expected = {"sigma_azimuth_deg": model.sigma_azimuth_deg(middle_hz, np.array([20.0]))[0]}
    assert model.stated_sigmas(20.0) == (expected if measures_azimuth else {})


@pytest.mark.parametrize(("beamwidth_deg", "over_db"), [(0.8, 0.1), (3.0, 12.0), (3.0, 30.0)])
def test_a_run_is_as_long_as_a_swept_gaussian_beam_keeps_the_echo(
    beamwidth_deg: float, over_db: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Against the beam moved over a target step by step: at half its width off, it has half."""
    threshold, snr = 20.0, 20.0 * 10 ** (over_db / 10)
    drawn = np.array([snr]), np.array([threshold])
    monkeypatch.setattr(ActiveRadar, "draw_detected", lambda *_: drawn)
    radar: Any = made("active_radar", azimuth_beamwidth_deg=beamwidth_deg, report=["asterix-048"])
    alarm = radar.false_plots(np.zeros(1, np.int64), np.zeros(1), np.random.default_rng(1))
    off_deg, step_deg = np.linspace(-6 * beamwidth_deg, 6 * beamwidth_deg, 40_001, retstep=True)
    kept = snr * 0.5 ** ((off_deg / (beamwidth_deg / 2)) ** 2) >= threshold
    assert alarm.run_length_deg[0] == pytest.approx(kept.sum() * step_deg, abs=2 * step_deg)
