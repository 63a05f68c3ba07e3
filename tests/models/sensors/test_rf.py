"""The RF sensor: link budget, band edges, bursts and hops, bearings, what is read of emissions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.models import propagation
from plotfeed.models.beam import AzimuthCover, Timetable
from plotfeed.models.frames import aer_to_enu
from plotfeed.models.propagation import C_M_S
from plotfeed.models.sensors.rf import RfDirectionFinder, emissions_of
from plotfeed.models.sensors.sensor_model import Targets
from plotfeed.models.state import Emitter, Signatures

SCAN = Timetable(1_000_000_000, 1).sector(3, 0)
FINDER = RfDirectionFinder(
    frequency_min_hz=2.40e9,
    frequency_max_hz=2.48e9,
    instantaneous_bandwidth_hz=80e6,
    channel_bandwidth_hz=1e6,
    integration_s=1e-3,
    gain_rx_dbi=3.0,
    loss_db=1.0,
    noise_figure_db=6.0,
    path_loss_exponent=2.0,
    path_loss_reference_m=1.0,
    pfa=1e-6,
    duty_cycle=1.0,
    bursts_per_dwell=1,
    range_max_m=10_000.0,
    azimuth_cover=AzimuthCover(-180.0, 180.0),
    azimuth_beams=1,
    measures_azimuth=True,
    baseline_m=0.3,
    azimuth_floor_deg=0.0,
    classifies=False,
    decodes=frozenset(),
)
CONTROL = Emitter(frequency_hz=2.44e9, bandwidth_hz=1e6, eirp_dbm=20.0, kind="control")
REMOTE_ID = Emitter(
    frequency_hz=2.437e9, bandwidth_hz=1e6, eirp_dbm=15.0, kind="remote-id", identity="1596F3"
)
VIDEO = Emitter(frequency_hz=5.8e9, bandwidth_hz=20e6, eirp_dbm=27.0, kind="video")


def finder(**changes: Any) -> RfDirectionFinder:
    return replace(FINDER, **changes)


def targets(position_enu_m: Any, emitters: Sequence[tuple[Emitter, ...]]) -> Targets:
    positions = np.asarray(position_enu_m, dtype=np.float64).reshape(-1, 3)
    n = len(positions)
    return Targets(
        drone=np.arange(n),
        t_utc_ns=np.full(n, SCAN.end_ns),
        position_enu_m=positions,
        true_position_enu_m=positions,
        signatures=Signatures(
            rcs_m2=np.full(n, 0.01), sound_power_db=np.full(n, 80.0), emitters=list(emitters)
        ),
    )


def many(emitter: Emitter, n: int, range_m: float, azimuth_deg: float = 70.0) -> Targets:
    return targets(np.tile(aer_to_enu(azimuth_deg, 5.0, range_m), (n, 1)), [(emitter,)] * n)


def test_free_space_loss() -> None:
    """100.05 dB over a kilometre at 2.4 GHz, 32.45 dB over a kilometre at 1 MHz (ITU-R P.525)."""
    loss_db = propagation.path_loss_db(1000.0, C_M_S / np.array([2.4e9, 1e6]))
    assert loss_db == pytest.approx([100.05, 32.45], abs=0.01)


def test_noise_is_minus_174_dbm_a_hertz_and_the_noise_figure() -> None:
    assert FINDER.noise_dbm == pytest.approx(-174 + 60 + 6, abs=0.03)


def test_signal_to_noise_ratio_is_the_link_budget() -> None:
    """20 dBm + 3 dBi - 1 dB - 100.19 dB over -107.98 dBm."""
    looks, _ = FINDER.observe(many(CONTROL, 1, 1000.0), np.random.default_rng(1))
    assert 10 * np.log10(looks.snr) == pytest.approx([29.79], abs=0.02)
    town = finder(path_loss_exponent=3.0, path_loss_reference_m=10.0)
    looks, _ = town.observe(many(CONTROL, 1, 1000.0), np.random.default_rng(1))
    assert 10 * np.log10(looks.snr) == pytest.approx([9.79], abs=0.02)


def test_fewer_samples_than_one_are_one() -> None:
    assert finder(integration_s=1e-9).samples == 1


@pytest.mark.parametrize(
    ("centre_mhz", "width_mhz", "share"),
    [
        (2440, 20, 1.0),
        (2400, 20, 0.5),
        (2480, 20, 0.5),
        (2395, 20, 0.25),
        (2490, 20, 0.0),  # touches
        (2500, 20, 0.0),
        (2440, 160, 0.5),  # on both sides
        (2400, 0, 1.0),  # a carrier on the edge
        (2399.9, 0, 0.0),
    ],
)
def test_share_of_an_emission_in_the_band(
    centre_mhz: float, width_mhz: float, share: float
) -> None:
    emitter = replace(CONTROL, frequency_hz=centre_mhz * 1e6, bandwidth_hz=width_mhz * 1e6)
    there = many(emitter, 1, 3000.0)
    looks, _ = FINDER.observe(there, np.random.default_rng(2))
    if share == 0:
        assert not len(looks)
        assert FINDER.predict(there).pd == 0
        return
    whole = finder(frequency_min_hz=1e9, frequency_max_hz=4e9, instantaneous_bandwidth_hz=3e9)
    assert looks.snr == pytest.approx(
        share * whole.observe(there, np.random.default_rng(2))[0].snr, rel=1e-12
    )


def test_hops_outside_what_is_heard_at_once_are_missed() -> None:
    hopping = replace(CONTROL, bandwidth_hz=80e6)
    narrow = finder(instantaneous_bandwidth_hz=20e6)
    assert narrow.predict(many(hopping, 1, 100.0)).pd == pytest.approx([0.25], rel=1e-12)
    twice = finder(instantaneous_bandwidth_hz=20e6, bursts_per_dwell=2, duty_cycle=0.5)
    assert twice.predict(many(hopping, 1, 100.0)).pd == pytest.approx([1 - 0.875**2], rel=1e-12)
    assert narrow.predict(many(CONTROL, 1, 100.0)).pd == pytest.approx([1.0])
    assert FINDER.predict(many(hopping, 1, 100.0)).pd == pytest.approx([1.0])


def test_received_power_is_noise_and_the_estimated_ratio() -> None:
    _, plots = FINDER.observe(many(CONTROL, 500, 1000.0), np.random.default_rng(6))
    np.testing.assert_allclose(plots.amplitude_dbm, FINDER.noise_dbm + 10 * np.log10(plots.snr))
    assert np.median(plots.amplitude_dbm) == pytest.approx(20 + 3 - 1 - 100.19, abs=0.05)


def test_cover_ends_at_the_range_and_at_the_azimuths() -> None:
    sensor = finder(azimuth_cover=AzimuthCover(-30.0, 60.0))
    places = aer_to_enu(
        np.array([0.0, 0.0, 59.0, 61.0, 331.0]), 5.0, np.array([9999.0, 10_001.0, 50.0, 50.0, 50.0])
    )
    looks, _ = sensor.observe(targets(places, [(CONTROL,)] * 5), np.random.default_rng(10))
    assert looks.drone.tolist() == [0, 2, 4]


def test_prediction_is_of_a_report_by_any_emitter() -> None:
    sensor = finder(duty_cycle=0.4)
    there = targets(
        np.tile(aer_to_enu(10.0, 5.0, 300.0), (4, 1)),
        [(CONTROL, REMOTE_ID), (CONTROL,), (), (VIDEO,)],
    )
    predicted = sensor.predict(there)
    assert predicted.pd == pytest.approx([1 - 0.6**2, 0.4, 0.0, 0.0])
    snr = sensor.mean_snr(emissions_of(there), np.full(4, 300.0))
    assert predicted.snr[:2] == pytest.approx([snr[:2].max(), snr[2]])
    assert np.isnan(predicted.snr[2])
    assert np.isnan(predicted.sigma_azimuth_deg[2:]).all()
    assert (predicted.sigma_azimuth_deg[:2] > 0).all()


decibels = st.floats(-300, 300)
frequencies = st.floats(0, 12).map(lambda e: 10.0**e)
emitters = st.builds(
    Emitter,
    frequency_hz=frequencies,
    bandwidth_hz=st.just(0.0) | frequencies,
    eirp_dbm=decibels,
    kind=st.sampled_from(["", "control", "remote-id"]),
    identity=st.sampled_from(["", "X"]),
)


@st.composite
def sensors(draw: st.DrawFn) -> RfDirectionFinder:
    low_hz = draw(frequencies)
    band_hz = draw(frequencies)
    heard_hz = band_hz * draw(st.floats(0.01, 1))
    channel_hz = heard_hz * draw(st.floats(0.01, 1))
    return finder(
        frequency_min_hz=low_hz,
        frequency_max_hz=low_hz + band_hz,
        instantaneous_bandwidth_hz=heard_hz,
        channel_bandwidth_hz=channel_hz,
        integration_s=draw(st.floats(1e-3, 1e8)) / channel_hz,
        gain_rx_dbi=draw(decibels),
        loss_db=draw(st.floats(0, 300)),
        noise_figure_db=draw(st.floats(0, 300)),
        path_loss_exponent=draw(st.floats(1, 10)),
        path_loss_reference_m=draw(st.floats(0.01, 1e4)),
        pfa=10 ** draw(st.floats(-15, -1)),
        duty_cycle=draw(st.floats(1e-9, 1)),
        bursts_per_dwell=draw(st.integers(1, 1_000_000)),
        range_max_m=draw(st.floats(1e-3, 470_000)),
        measures_azimuth=draw(st.booleans()),
        baseline_m=draw(st.floats(1e-3, 1e4)),
        azimuth_floor_deg=draw(st.floats(0, 1e3)),
        classifies=draw(st.booleans()),
        decodes=draw(st.frozensets(st.sampled_from(["control", "remote-id"]))),
    )


coordinates = st.floats(-5e5, 5e5)
places = st.tuples(coordinates, coordinates, coordinates)


@given(sensors(), st.lists(st.tuples(places, st.lists(emitters, max_size=3)), max_size=4))
def test_whatever_the_parameters_nothing_is_undefined(
    sensor: RfDirectionFinder, drones: list[tuple[Any, list[Emitter]]]
) -> None:
    there = targets([place for place, _ in drones], [tuple(own) for _, own in drones])
    looks, plots = sensor.observe(there, np.random.default_rng(13))
    assert ((looks.pd >= 0) & (looks.pd <= 1)).all()
    assert np.isfinite(looks.snr).all()
    assert (plots.snr > 0).all()
    assert np.isfinite(plots.amplitude_dbm).all()
    if sensor.measures_azimuth:
        assert ((plots.azimuth_deg >= 0) & (plots.azimuth_deg < 360)).all()
        assert np.isfinite(plots.sigma_azimuth_deg).all()
    predicted = sensor.predict(there)
    assert ((predicted.pd >= 0) & (predicted.pd <= 1)).all()
    assert not np.isinf(predicted.sigma_azimuth_deg).any()


@given(sensors(), places, emitters, decibels)
def test_a_stronger_emitter_is_never_detected_less(
    sensor: RfDirectionFinder, place: Any, emitter: Emitter, other_dbm: float
) -> None:
    powers = sorted((emitter.eirp_dbm, other_dbm))
    weak, strong = (
        sensor.predict(targets([place], [(replace(emitter, eirp_dbm=p),)])) for p in powers
    )
    if np.linalg.norm(place) > 0:
        assert weak.snr <= strong.snr
        assert 0 <= weak.pd <= strong.pd + 1e-12
        assert strong.pd <= 1
