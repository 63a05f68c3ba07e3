"""Sensors in one model give what each gives by itself, to the last bit, in whatever company."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest
from support.dice import Dice
from support.random_sensors import SENSOR_MAKERS

from plotfeed.models.beam import AzimuthCover
from plotfeed.models.chance import Chance, Purpose, ScanDraws
from plotfeed.models.effects.doppler import Doppler
from plotfeed.models.effects.surroundings import Multipath
from plotfeed.models.frames import aer_to_enu
from plotfeed.models.sensors.range_gate import RangeGate
from plotfeed.models.sensors.sensor_model import SensorModel, Targets, grouping_key, stacked
from plotfeed.models.state import Columns, Emitter, Floats, Ints, Signatures
from plotfeed.testing import scene, staring

SENSORS = 4
GROUND = {"reflection": -0.9, "antenna_height_m": 12.0}
DOPPLER = {"notch_m_s": 1.0}
WIDE = {"horizontal_fov_deg": 170.0, "pixels_across": 900_000, "tilt_deg": 20.0}
EFFECTS: dict[str, list[dict[str, Any]]] = {
    "active_radar": [
        {},
        {"measures_elevation": True},
        {"multipath": GROUND},
        {"doppler": DOPPLER},
        {"multipath": GROUND, "doppler": {"prf_hz": 4000.0}},
    ],
    "mimo_radar": [{}, {"multipath": GROUND, "doppler": DOPPLER}],
    "passive_radar": [{}, {"multipath": GROUND, "doppler": DOPPLER}],
    "rf": [{}, {"multipath": GROUND}],
    "camera": [WIDE, WIDE | {"visibility_m": 5000.0, "hotter_k": 4.0}],
}


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


@dataclass
class OfEachSensor:
    """Stand-in for a generator: each row has draws of its own sensor's generator, in its order."""

    generators: list[np.random.Generator]
    sensor: Ints

    def rows(self, which: Any) -> OfEachSensor:
        return OfEachSensor(self.generators, self.sensor[which])

    def random(self, size: Any) -> Floats:
        return self._drawn(size, lambda rng, shape, _: rng.random(shape))

    def standard_normal(self, size: Any) -> Floats:
        return self._drawn(size, lambda rng, shape, _: rng.standard_normal(shape))

    def standard_exponential(self, size: Any) -> Floats:
        return self._drawn(size, lambda rng, shape, _: rng.standard_exponential(shape))

    def standard_gamma(self, order: Any, size: Any) -> Floats:
        orders = np.broadcast_to(order, size)
        return self._drawn(
            size, lambda rng, shape, mine: rng.standard_gamma(orders[..., mine], shape)
        )

    def _drawn(self, size: Any, draw: Any) -> Floats:
        assert size[-1] == len(self.sensor)
        drawn = np.full(size, np.nan)
        for i, rng in enumerate(self.generators):
            mine = self.sensor == i
            drawn[..., mine] = draw(rng, (*size[:-1], int(mine.sum())), mine)
        return drawn


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
        sensor=rng.integers(0, SENSORS, n),
    )


def of_rows(found: Targets, which: Any) -> Targets:
    columns = {
        f.name: column[which]
        for f in fields(found)
        if f.name not in {"signatures", "sensor", "true_position_enu_m"}
        and (column := getattr(found, f.name)) is not None
    }
    true_m = columns["position_enu_m"]
    if found.true_position_enu_m is not found.position_enu_m:
        true_m = found.true_position_enu_m[which]
    return Targets(**columns, true_position_enu_m=true_m, signatures=found.signatures)


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
@pytest.mark.parametrize("n", [1, 3, 700])
def test_each_row_has_what_its_sensor_gives_it_alone(kind: str, n: int) -> None:
    plots_seen = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        models = several(MODELS[kind], rng)
        assert len({grouping_key(model) for model in models}) == 1
        stack, all_of_them = stacked(models), targets(rng, n)
        sensor = all_of_them.sensor
        draws = OfEachSensor([np.random.default_rng(i) for i in range(SENSORS)], sensor)
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
    assert plots_seen > 50 or n < 700


@pytest.mark.parametrize("kind", list(MODELS)[1:4:2])
def test_with_draws_by_drone_too(kind: str) -> None:
    rng = np.random.default_rng(5)
    models = several(MODELS[kind], rng)
    found = targets(rng, 300)
    draws = ScanDraws([Chance(1, str(i)) for i in range(SENSORS)], Purpose.DETECTION)
    sensor, scans = found.sensor, np.full(len(found), 7)
    looks, plots = (
        stacked(models).rows(found.sensor).observe(found, draws.of(sensor, scans, found.drone))
    )
    for i, model in enumerate(models):
        mine = of_rows(found, found.sensor == i)
        own_draws = draws.of(sensor[sensor == i], scans[: len(mine)], mine.drone)
        own_looks, own_plots = model.observe(mine, own_draws)
        assert_same(looks.rows(looks.sensor == i), own_looks)
        assert_same(plots.rows(plots.sensor == i), own_plots)


@pytest.mark.parametrize("kind", MODELS)
def test_equal_sensors_are_one_without_columns(kind: str) -> None:
    model = MODELS[kind]
    stack = stacked([model, replace(model), replace(model)])  # type: ignore[type-var]
    assert stack is model
    assert stack.rows(np.array([2, 0])) is model


def test_rows_follow_each_other() -> None:
    models = [made("active_radar", range_max_m=float(m)) for m in (1000, 2000, 3000)]
    stack: Any = stacked(models)
    assert stack.range_max_m.tolist() == [1000.0, 2000.0, 3000.0]
    assert stack.range_min_m == models[0].range_min_m  # type: ignore[attr-defined]
    rows = stack.rows(np.array([2, 2, 0, 1]))
    assert rows.range_max_m.tolist() == [3000.0, 3000.0, 1000.0, 2000.0]
    some = rows.rows(slice(1, None)).rows(np.array([True, False, True]))
    assert some.range_max_m.tolist() == [3000.0, 2000.0]
    assert rows.rows(slice(None)) is rows
    with pytest.raises(AttributeError, match="no_such_key"):
        rows.no_such_key  # noqa: B018


def test_what_must_be_equal_tells_groups_apart() -> None:
    changes = ({}, {"n_reference": 8}, {"measures_elevation": True}, {"pfa": 1e-5},
               {"multipath": GROUND}, {"doppler": DOPPLER})  # fmt: skip
    others = [made("active_radar", **keys) for keys in changes]
    mimo: Any = made("mimo_radar")
    others += [mimo, replace(mimo, transmitters=mimo.transmitters[:1])]
    others += [
        made("acoustic", elevation_beamwidth_deg=14.0),
        made("acoustic", elevation_beamwidth_deg=None),
    ]
    others += [made("rf"), made("rf", integration_s=2e-3)]
    same = made("active_radar", power_w=1.0, azimuth_min_deg=0.0, azimuth_max_deg=10.0)
    assert grouping_key(same) == grouping_key(others[0])
    assert len({grouping_key(model) for model in others}) == len(others)


def test_a_kind_that_knows_nothing_of_columns_shares_a_pass_with_its_equals_alone() -> None:
    @dataclass(frozen=True, kw_only=True)
    class Plain(RangeGate):
        alike = None

    one, same, other = (Plain(range_max_m=1.0, sigma_m=s) for s in (2.0, 2.0, 3.0))
    assert grouping_key(one) == grouping_key(same)
    assert grouping_key(one) != grouping_key(other)
    assert stacked([one, same]) is one
