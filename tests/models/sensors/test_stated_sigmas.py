from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from plotfeed import simulate
from plotfeed.feeds.scene.presets.preset import names
from plotfeed.feeds.scene.scene import example
from plotfeed.models.sensors.acoustic import MicrophoneArray
from plotfeed.models.sensors.sensor_model import SensorModel
from plotfeed.testing import scene, staring

SIGMAS = (
    "sigma_range_m",
    "sigma_bistatic_range_m",
    "sigma_azimuth_deg",
    "sigma_elevation_deg",
    "sigma_range_rate_m_s",
)


def test_they_are_what_plots_of_that_snr_state() -> None:
    """But for the place in the plane of a passive radar, which is no measurement of its own."""
    there_is = example("section-4")
    seen = simulate(there_is, duration_s=30.0, start_utc_ns=1_767_268_800 * 10**9)
    kinds: set[str] = set()
    for sensor in there_is.sensor:
        model, plots = sensor.model(there_is.scene.site), seen[sensor.id].plots
        kinds |= {sensor.type} if len(plots) else set()
        for i in range(min(len(plots), 20)):
            stated = model.stated_sigmas(float(plots.snr[i]))
            assert stated
            for name in SIGMAS:
                column = getattr(plots, name)
                is_measured = column is not None and not np.isnan(column[i])
                if name == "sigma_range_m" and sensor.illuminators:
                    continue
                assert (name in stated) == is_measured, (sensor.id, name)
                if is_measured:
                    assert stated[name] == pytest.approx(column[i], rel=1e-12)
    assert kinds >= {"active_radar", "mimo_radar", "passive_radar"}


def test_a_microphone_states_what_its_bearings_do() -> None:
    there_is = example("section-4")
    (model,) = (s.model(there_is.scene.site) for s in there_is.sensor if s.type == "acoustic")
    assert isinstance(model, MicrophoneArray)
    at_20 = model.sigma_azimuth_deg(np.array([100.0]))[0]
    assert model.stated_sigmas(100.0) == {"sigma_azimuth_deg": at_20}
    upwards = replace(model, elevation_beamwidth_deg=10.0)
    assert upwards.stated_sigmas(100.0) == {
        "sigma_azimuth_deg": at_20,
        "sigma_elevation_deg": upwards.sigma_elevation_deg(np.array([100.0]))[0],
    }


def test_bearings_of_emissions_are_stated_amidst_the_band() -> None:
    some = [{"id": f"p{i}", "preset": name} for i, name in enumerate(names())]
    there_is = scene(some, seed=1)
    of_rf = [s.model(there_is.scene.site) for s in there_is.sensor if s.type == "rf"]
    assert {model.measures_azimuth for model in of_rf} == {True, False}
    for model in of_rf:
        middle_hz = (model.frequency_min_hz + model.frequency_max_hz) / 2
        stated = model.stated_sigmas(20.0)
        if model.measures_azimuth:
            expected = model.sigma_azimuth_deg(np.array([middle_hz]), np.array([20.0]))
            assert stated == {"sigma_azimuth_deg": expected[0]}
        else:
            assert stated == {}


def test_a_range_gate_is_as_wrong_at_any_ratio() -> None:
    gate = {
        "id": "gate",
        "type": "range_gate",
        "range_max_m": 2000.0,
        "sigma_m": 3.0,
        "scan": staring(),
    }
    there_is = scene([gate], seed=1)
    stated = there_is.sensor[0].model(there_is.scene.site).stated_sigmas(1.0)
    across_deg = np.degrees(3.0 / 1000.0)
    assert stated == pytest.approx(
        {"sigma_range_m": 3.0, "sigma_azimuth_deg": across_deg, "sigma_elevation_deg": across_deg}
    )


def test_a_sensor_that_says_nothing_of_its_errors_states_none() -> None:
    assert SensorModel.stated_sigmas(object(), 10.0) == {}  # type: ignore[arg-type]
