"""Sensors in one model give what each gives by itself, to the last bit, in whatever company."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest

from plotfeed.models.beam import AzimuthCover
from plotfeed.models.chance import Chance, Purpose, ScanDraws
from plotfeed.models.effects.doppler import Doppler
from plotfeed.models.effects.multipath import Multipath
from plotfeed.models.frames import aer_to_enu
from plotfeed.models.sensors.acoustic import MicrophoneArray
from plotfeed.models.sensors.active_radar import ActiveRadar, MimoRadar, MimoTransmitter
from plotfeed.models.sensors.camera import Camera, HotSpot, LostContrast
from plotfeed.models.sensors.passive_radar import PassiveRadar
from plotfeed.models.sensors.passive_signals import Illuminator
from plotfeed.models.sensors.range_gate import RangeGate
from plotfeed.models.sensors.rf import RfDirectionFinder
from plotfeed.models.sensors.sensor_model import SensorModel, Targets, grouping_key, stacked
from plotfeed.models.state import Columns, Emitter, Floats, Ints, Signatures

SENSORS = 4
POLAR: dict[str, Any] = {
    "frequency_hz": 15e9, "gain_rx_dbi": 20.0, "integration_s": 0.06, "loss_db": 1.1,
    "noise_figure_db": 5.0, "n_reference": 16, "range_resolution_m": 20.0,
    "azimuth_beamwidth_deg": 3.0, "elevation_beamwidth_deg": 10.0, "doppler_cells": 1,
    "range_floor_m": 0.5, "azimuth_floor_deg": 0.1, "elevation_floor_deg": 0.1,
    "measures_elevation": True, "range_min_m": 10.0, "range_max_m": 9000.0, "pfa": 1e-6,
    "azimuth_cover": AzimuthCover(-130.0, 130.0), "elevation_min_deg": -2.0,
    "elevation_max_deg": 40.0,
}  # fmt: skip
TRANSMITTERS = tuple(
    MimoTransmitter(position_enu_m=place, power_w=2e3, gain_dbi=11.6)
    for place in ((0.0, 100.0, 3.0), (87.0, -50.0, 0.0), (-87.0, -50.0, 0.0))
)
ILLUMINATORS = tuple(
    Illuminator(erp_w=erp_w, frequency_hz=frequency_hz, bandwidth_hz=7.6e6,
                position_enu_m=place, external_noise_db=2.0, range_floor_m=floor_m)
    for erp_w, frequency_hz, place, floor_m in (
        (1e5, 600e6, (-17e3, 9e3, 200.0), 1.0), (3e4, 200e6, (6e3, -8e3, 90.0), 2.0),
    )
)  # fmt: skip
ACTIVE = ActiveRadar(**POLAR, power_w=50.0, gain_tx_dbi=25.0)
MIMO = MimoRadar(**POLAR, transmitters=TRANSMITTERS)
PASSIVE = PassiveRadar(
    transmitters=ILLUMINATORS, gain_rx_dbi=8.0, azimuth_beamwidth_deg=4.0, integration_s=0.3,
    loss_db=4.0, sidelobe_db=-22.0, cancellation_db=-60.0, line_loss_db=0.5, antenna_loss_db=0.5,
    receiver_noise_figure_db=4.0, pfa=1e-5, n_reference=16, doppler_cells=1, range_min_m=10.0,
    range_max_m=9000.0, azimuth_cover=AzimuthCover(-150.0, 100.0), elevation_min_deg=-5.0,
    elevation_max_deg=60.0, azimuth_floor_deg=0.2,
)  # fmt: skip
MICROPHONES = MicrophoneArray(
    frequency_hz=1000.0,
    directivity_db=3.0, absorption_db_per_m=0.005, barrier_db=3.0, misc_db=1.0, array_gain_db=20.0,
    noise_db=0.5, sensitivity_db=10.0, slope_per_db=1.0, pfa=1e-6, range_max_m=8000.0,
    height_above_ground_m=1.5, sound_speed_m_s=343.2, azimuth_cover=AzimuthCover(-180.0, 180.0),
    azimuth_beamwidth_deg=11.0, elevation_beamwidth_deg=14.0, azimuth_floor_deg=1.0,
    elevation_floor_deg=1.0, kind="drone",
)  # fmt: skip
RF = RfDirectionFinder(
    frequency_min_hz=2.40e9, frequency_max_hz=2.48e9, instantaneous_bandwidth_hz=40e6,
    channel_bandwidth_hz=1e6, integration_s=1e-3, gain_rx_dbi=3.0, loss_db=1.0,
    noise_figure_db=6.0, path_loss_exponent=2.2, path_loss_reference_m=2.0, pfa=1e-6,
    duty_cycle=0.9, bursts_per_dwell=2, range_max_m=9000.0,
    azimuth_cover=AzimuthCover(-180.0, 180.0), azimuth_beams=1, measures_azimuth=True,
    baseline_m=0.3, azimuth_floor_deg=1.0, classifies=False, decodes=frozenset({"remote-id"}),
)  # fmt: skip
CAMERA = Camera(
    pfa=1e-7, azimuth_cover=AzimuthCover(-85.0, 85.0), range_max_m=8000.0, pan_deg=0.0,
    tilt_deg=20.0, horizontal_fov_deg=170.0, vertical_fov_deg=160.0, pixels_across=9e5,
    pixels_down=8000.0, panoramic=False, steered=False, detect_cycles=1.0, recognise_cycles=4.0,
    identify_cycles=6.4, pointing_error_deg=0.05, pixel_error=0.5, classes=("drone", "bird"),
    class_probability=0.9, contrast=None, hot_spot=None,
)  # fmt: skip
HAZE = LostContrast(inherent=0.5, threshold=0.02, at_nyquist=0.3, visibility_m=5000.0)
WARMTH = HotSpot(warmer_k=4.0, noise_k=0.05, visibility_m=5000.0)
GATE = RangeGate(range_max_m=7000.0, sigma_m=5.0)
GROUND = Multipath(reflection=-0.9, antenna_height_m=12.0)


def doppler(channels: int = 1, **changes: Any) -> Doppler:
    case = {
        "cells_m_s": (0.2, 0.4)[:channels], "spans_m_s": (80.0, 70.0)[:channels], "folds": False,
        "notch_m_s": 1.0, "floors_m_s": (0.1, 0.2)[:channels],
    }  # fmt: skip
    return Doppler(**(case | changes))


MODELS: dict[str, SensorModel] = {
    "active": ACTIVE,
    "active, without elevations": replace(ACTIVE, measures_elevation=False),
    "active, ground": replace(ACTIVE, multipath=GROUND),
    "active, rates": replace(ACTIVE, doppler=doppler()),
    "active, folded rates over ground": replace(
        ACTIVE, multipath=GROUND, doppler=doppler(folds=True, notch_m_s=0.0)
    ),
    "mimo": MIMO,
    "mimo, ground and rates": replace(MIMO, multipath=GROUND, doppler=doppler()),
    "passive": PASSIVE,
    "passive, one channel": replace(PASSIVE, transmitters=ILLUMINATORS[:1]),
    "passive, ground and rates": replace(PASSIVE, multipath=GROUND, doppler=doppler(2)),
    "microphones": MICROPHONES,
    "microphones, without elevations": replace(MICROPHONES, elevation_beamwidth_deg=None),
    "rf": RF,
    "rf, ground": replace(RF, multipath=GROUND),
    "rf, without bearings": replace(RF, measures_azimuth=False),
    "gate": GATE,
    "camera": CAMERA,
    "camera, haze and heat": replace(CAMERA, contrast=HAZE, hot_spot=WARMTH),
    "panorama": replace(CAMERA, panoramic=True),
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
    assert plots_seen > n / 2


@pytest.mark.parametrize("kind", ["active", "active, rates"])
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
    models = [replace(ACTIVE, range_max_m=float(m)) for m in (1000, 2000, 3000)]
    stack = stacked(models)
    assert stack.range_max_m.tolist() == [1000.0, 2000.0, 3000.0]
    assert stack.range_min_m == 10.0
    rows = stack.rows(np.array([2, 2, 0, 1]))
    assert rows.range_max_m.tolist() == [3000.0, 3000.0, 1000.0, 2000.0]
    assert rows.rows(slice(1, None)).rows(np.array([True, False, True])).range_max_m.tolist() == [
        3000.0,
        2000.0,
    ]
    assert rows.rows(slice(None)) is rows
    with pytest.raises(AttributeError, match="no_such_key"):
        rows.no_such_key  # noqa: B018


def test_what_must_be_equal_tells_groups_apart() -> None:
    same = [ACTIVE, replace(ACTIVE, power_w=1.0, azimuth_cover=AzimuthCover(0.0, 10.0))]
    others = [
        replace(ACTIVE, n_reference=8),
        replace(ACTIVE, measures_elevation=False),
        replace(ACTIVE, pfa=1e-5),
        replace(ACTIVE, multipath=GROUND),
        replace(ACTIVE, doppler=doppler()),
        MIMO,
        replace(MIMO, transmitters=TRANSMITTERS[:2]),
        MICROPHONES,
        replace(MICROPHONES, elevation_beamwidth_deg=None),
        replace(MICROPHONES, kind=""),
        RF,
        replace(RF, integration_s=2e-3),
    ]
    assert len({grouping_key(model) for model in same}) == 1
    assert len({grouping_key(model) for model in [*same, *others]}) == 1 + len(others)


def test_a_kind_that_knows_nothing_of_columns_shares_a_pass_with_its_equals_alone() -> None:
    @dataclass(frozen=True, kw_only=True)
    class Plain(RangeGate):
        alike = None

    one, same, other = (Plain(range_max_m=1.0, sigma_m=s) for s in (2.0, 2.0, 3.0))
    assert grouping_key(one) == grouping_key(same)
    assert grouping_key(one) != grouping_key(other)
    assert stacked([one, same]) is one
