"""Keys of sensors that cannot be are refused in a line that names them; odd ones are warned of."""

from __future__ import annotations

from typing import Any

import pytest
from support.every_kind import MICROPHONES, MIMO, PASSIVE, RF

from plotfeed.feeds.scene.scene import SceneError
from plotfeed.testing import radar, rotating, scene, staring

CLASSIFIER = {
    "claims": ["drone", "bird"], "confusion": {"drone": [0.9, 0.1], "bird": [0.25, 0.75]},
    "codes": {"drone": 7, "bird": 9},
}  # fmt: skip
LINE = MICROPHONES | {"layout": {"shape": "line", "spacing_m": 0.5}, "microphones": 8}
FLAT_LINE = {k: v for k, v in LINE.items() if k != "elevation_beamwidth_deg"}
APART = {"east_m": 150.0, "north_m": 0.0, "above_site_m": 0.0}
PAIR = MICROPHONES | {"type": "acoustic_pair", "second_array": APART}
DWELLS = {"kind": "electronic", "period_s": 0.1, "dwell_s": 0.001, "revisit_s": 0.1}
STEERED = radar(
    azimuth_min_deg=-60.0, azimuth_max_deg=60.0, elevation_min_deg=-40.0, elevation_max_deg=40.0,
    integration_s=0.001, report=["asterix-015", "plots"], scan=DWELLS,
)  # fmt: skip
TOWERS = [
    PASSIVE["transmitters"][0] | {"id": f"m{i}", "place": APART | {"east_m": 9000.0 * i + 4000.0}}
    for i in range(3)
]
NET = PASSIVE | {"type": "multistatic_passive", "transmitters": TOWERS}
MIMO_NET = MIMO | {"type": "multistatic_mimo", "receivers": [{"id": "r1"} | APART]}
SHAPED = {"kind": "cosecant-squared", "from_deg": 4.0, "to_deg": 30.0, "beamwidth_deg": 3.0}
GAINS = {"kind": "table", "gain_db": [0.0, 0.0]}
TOWER = PASSIVE["transmitters"][0]


def without(sensor: dict[str, Any], key: str) -> dict[str, Any]:
    return {name: value for name, value in sensor.items() if name != key}


REFUSED: list[tuple[dict[str, Any], dict[str, Any], str]] = [
    (radar(), {"antenna": {"receive": {"elevation": SHAPED | {"to_deg": 3.0}}}}, "above from_deg"),
    (radar(), {"scan": rotating(), "antenna": {"receive": {"azimuth": {
        "kind": "gaussian", "beamwidth_deg": 8.0}}}}, "meets every drone"),
    (radar(), {"antenna": {"receive": {"azimuth": GAINS | {"angle_deg": [0, 0]}}}}, "must rise"),
    (radar(), {"antenna": {"receive": {"azimuth": GAINS | {"angle_deg": [0, 1, 2]}}}}, "as many"),
    (radar(), {"straddling": {"doppler": "hann"}}, "needs doppler"),
    (radar(), {"antenna": {"sidelobe_plots": True}}, "needs receive"),
    (radar(), {"antenna": {"receive": {}, "sidelobe_plots": True}, "mount": {}},
     "nor of a beam that is steered"),
    (PASSIVE, {"antenna": {"transmit": {}}}, "transmits nothing"),
    (PASSIVE, {"antenna": {"receive": {}, "sidelobe_plots": True}}, "not of a passive radar"),
    (PASSIVE, {"pulses": {"prf_hz": [1e3]}}, "broadcasts have none"),
    (PASSIVE, {"noise_environment": "city"}, "leave it out"),
    (without(PASSIVE, "external_noise_db"), {}, "external_noise_db of 'radar': needed"),
    (without(PASSIVE, "external_noise_db"), {"noise_environment": "quiet-rural"},
     "quiet-rural noise from 0.3 to 100 MHz, not at the 600"),
    (without(PASSIVE, "gain_rx_dbi"), {}, "gain_rx_dbi of 'radar': needed"),
    (PASSIVE, {"sidelobe_db": 22.0}, "sidelobe_db of 'radar': input should be less than"),
    (PASSIVE, {"antenna_loss_db": 1e6}, "antenna_loss_db of 'radar': input should be less than"),
    (PASSIVE, {"line_loss_db": 1e6}, "line_loss_db of 'radar': input should be less than"),
    (PASSIVE, {"transmitters": [TOWER, TOWER]}, "used twice"),
    (PASSIVE, {"transmitters": []}, "transmitters"),
    (PASSIVE, {"scan": rotating()}, "scan"),
    (radar(), {"pulses": {"prf_hz": [1e3], "needed": 2}}, "must not exceed the 1"),
    (radar(), {"pulses": {"prf_hz": [1e3, 2e3], "intervals": 1}}, "at least one for each"),
    (radar(), {"pulses": {"prf_hz": [1e4], "pulse_s": 1e-4}}, "half of the time"),
    (radar(), {"pulses": {"prf_hz": [1e4], "beam_passes": True}}, "is of a radar that turns"),
    (radar(), {"pulses": {"prf_hz": [1e4]}, "doppler": {"prf_hz": 1e4}}, "pulses say it"),
    (MICROPHONES, {"azimuth_max_deg": -180.0}, "azimuth_max_deg"),
    (MICROPHONES, {"range_max_m": 20_000.0}, "range_max_m"),
    (MICROPHONES, {"slope_per_db": 0.0}, "slope_per_db"),
    (MICROPHONES, {"humidity_pct": 101.0}, "humidity_pct"),
    (MICROPHONES, {"report": ["asterix-048"]}, "report"),
    (MICROPHONES, {"scan": rotating()}, "scan.kind"),
    (FLAT_LINE, {"microphones": 2}, "microphones of 'radar': a layout has at least 3"),
    (FLAT_LINE, {"layout": {"shape": "rectangle", "spacing_m": 0.5}, "microphones": 9},
     "a rectangle has an even number"),
    (LINE, {}, "a line of microphones tells no elevations"),
    (PAIR, {"bias": {"range_offset_m": 5.0}}, "range_offset_m of 'radar': not modelled of two"),
    (PAIR, {"drift": {"time_constant_s": 9.0, "sigma_range_m": 5.0}},
     "drift.sigma_range_m of 'radar': not modelled of two"),
    (without(PAIR, "second_array"), {}, "second_array"),
    (RF, {"frequency_max_hz": 2.3e9}, "frequency_min_hz"),
    (RF, {"instantaneous_bandwidth_hz": 1e9}, "instantaneous_bandwidth_hz"),
    (RF, {"channel_bandwidth_hz": 1e9}, "channel_bandwidth_hz"),
    (RF, {"integration_s": 200.0}, "integration_s"),
    (RF, {"azimuth_max_deg": -200.0}, "azimuth_max_deg"),
    (RF, {"duty_cycle": 0.0}, "duty_cycle"),
    (RF, {"path_loss": {"kind": "log-distance"}}, "path_loss.exponent"),
    (RF, {"path_loss": {"kind": "friis", "exponent": 3.0}}, "path_loss.exponent"),
    (RF, {"path_loss": {"kind": "two-ray"}}, "path_loss.kind"),
    (without(RF, "baseline_m"), {}, "baseline_m of 'radar': missing"),
    (RF, {"classifier": CLASSIFIER, "classifies": True}, "leave out classifies"),
    (MICROPHONES, {"classifier": CLASSIFIER, "kind": "drone"}, "leave out kind"),
    (MICROPHONES, {"classifier": CLASSIFIER | {"confusion": {"drone": [0.9, 0.2]}}},
     "confusion.drone of 'radar': must add up to 1, not 1.1"),
    (MICROPHONES, {"classifier": CLASSIFIER | {"confusion": {"drone": [1.0]}}},
     "confusion.drone of 'radar': 1 numbers for 2 claims"),
    (MICROPHONES, {"classifier": CLASSIFIER | {"otherwise": [0.5, 0.4]}},
     "otherwise of 'radar': must add up to 1, not 0.9"),
    (MICROPHONES, {"classifier": CLASSIFIER | {"claims": ["drone", "drone"]}},
     "claims of 'radar': one is there twice"),
    (MICROPHONES, {"classifier": CLASSIFIER | {"codes": {"drone": 1}}}, "codes of 'radar': one"),
    (MIMO_NET, {"classifier": CLASSIFIER}, "classifier of 'radar': not modelled of several"),
    (MIMO_NET, {"receivers": []}, "with 2 transmitters they make 2 pairs; a place takes 3"),
    (MIMO_NET, {"bias": {"range_scale": 0.01}}, "range_scale of 'radar': not modelled of several"),
    (NET, {"transmitters": TOWERS[:2]}, "with 2 transmitters they make 2 pairs; a place takes 3"),
    (NET, {"doppler": {}}, "doppler of 'radar': not modelled of several receivers"),
    (NET, {"bias": {"tilt_deg": 1.0}}, "bias.tilt_deg of 'radar': not modelled of several"),
    (NET, {"fewest_pairs": 4}, "a place takes 4"),
    (STEERED, {"integration_s": 0.01}, "integration_s of 'radar': must not exceed scan.dwell_s"),
    (STEERED, {"doppler": {}}, "doppler of 'radar': not modelled of a beam that is steered"),
    (STEERED, {"merging": {}}, "merging of 'radar': not modelled of a beam that is steered"),
    (STEERED, {"report": ["asterix-062"]}, "asterix-062 is not for a beam that is steered"),
    (STEERED, {"scan": DWELLS | {"dwell_s": 0.05}}, "a period has at least 4 dwells"),
    *((radar(report=["asterix-062"]), {"tracks": tracks}, said) for tracks, said in (
        ({"confirm_hits": 4, "confirm_window": 3}, "must not exceed confirm_window"),
        ({"drop_misses": 0}, "drop_misses"), ({"smoothing_scans": 0.0}, "smoothing_scans"),
        ({"hits": 3}, "no such key"), ({"kind": "best"}, "smoothed-truth"),
        ({"kind": "plain", "gate_probability": 1.0}, "gate_probability"),
        ({"kind": "plain", "numbers": [9, 3]}, "must not exceed the last"),
        ({"kind": "plain", "numbers": [0, 3]}, "numbers"),
    )),
]  # fmt: skip


@pytest.mark.parametrize(("sensor", "changes", "said"), REFUSED)
def test_a_sensor_that_cannot_be_is_refused_by_its_key(
    sensor: dict[str, Any], changes: dict[str, Any], said: str
) -> None:
    with pytest.raises(SceneError) as refused:
        scene([sensor | changes], seed=1)
    assert said in str(refused.value)


NOISY = {"id": "x", "eirp_w": 1.0, "frequency_hz": 9e9, "bandwidth_hz": 4e7, **APART}


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ({"weather": [{"rain_mm_h": -1.0}]}, "weather[0].rain_mm_h"),
        ({"weather": [{"snow_mm_h": 1.0}]}, "weather[0].snow_mm_h"),
        ({"weather": [{"rain_mm_h": 1.0, "from_s": 9.0, "to_s": 3.0}]}, "to_s: must be above"),
        ({"jammer": [NOISY | {"eirp_w": 0.0}]}, "jammer[0].eirp_w"),
        ({"jammer": [{"id": "x"}]}, "jammer[0]"),
        ({"target": [{"swerling": 5}]}, "less than or equal to 4"),
        ({"target": [{"swerling": 1}, {"swerling": 3}]}, "twice"),
        ({"target": [{"aspect": {"kind": "table", "angle_deg": [0, 360], "gain_db": [0, 0]}}]},
         "360 in all"),
    ],
)  # fmt: skip
def test_a_world_that_cannot_be_is_refused_by_its_key(tables: dict[str, Any], said: str) -> None:
    with pytest.raises(SceneError) as refused:
        scene([radar()], seed=1, **tables)
    assert said in str(refused.value)
    assert "event" not in str(refused.value)


FINE = {"range_floor_m": 1.0, "azimuth_floor_deg": 0.5, "elevation_floor_deg": 1.0}
LEVEL = {"bistatic_range_floor_m": 2.0, "azimuth_floor_deg": 0.2}  # the transmitter is at 300
WARNED: list[tuple[dict[str, Any], dict[str, Any], list[str]]] = [
    *((usual, {}, []) for usual in (MICROPHONES, RF, MIMO, PAIR, STEERED | FINE)),
    (PAIR, {"bias": {"azimuth_offset_deg": 5.0, "time_offset_s": 1.0}}, []),
    (MIMO_NET, {"bias": {"time_offset_s": 1.5, "range_offset_m": 0.0}}, []),
    (MICROPHONES, {"scan": staring(0.05), "array_gain_db": 9.03, "microphones": 8},
     ["scan.period_s is 0.05: an array listens", "microphones is not used: array_gain_db"]),
    (RF, {"integration_s": 1.5}, ["integration_s is 1.5, longer than a scan of 1 s"]),
    (without(RF, "azimuth_floor_deg"), {"measures_azimuth": False}, ["baseline_m: not used"]),
    (PASSIVE, LEVEL | {"azimuth_min_deg": -30.0, "azimuth_max_deg": 30.0}, []),
    (PASSIVE, LEVEL | {"azimuth_min_deg": 280.0, "azimuth_max_deg": 330.0, "integration_s": 2.0},
     ["integration_s is 2, but a scan lasts 1 s", "transmitter tv, at azimuth 300.0"]),
    (MIMO, {"report": ["asterix-048", "plots"]}, ["asterix-048 counts range in steps of 7.23 m"]),
    (MIMO, {"integration_s": 1.5}, ["integration_s is 1.5, but a scan lasts 1 s"]),
    (PAIR, {"second_array": APART | {"east_m": 10.0}}, ["less than a twentieth of 500 m"]),
    (PAIR, {"second_array": APART | {"east_m": 2000.0}}, ["the two hear little in common"]),
    (FLAT_LINE, {"frequency_hz": 1000.0},
     ["more than half a wavelength at 1000 Hz", "cannot tell its sides apart"]),
    (FLAT_LINE, {"frequency_hz": 100.0, "azimuth_min_deg": 0.0, "azimuth_max_deg": 180.0}, []),
    (STEERED | FINE, {"scan": DWELLS | {"max_tracks": 200}}, ["they would take 2 of all dwells"]),
    (radar(report=["plots"], **FINE), {"pulses": {"prf_hz": [25_000.0]}},
     ["drones beyond 5996 m are told nearer"]),
]  # fmt: skip


@pytest.mark.parametrize(("sensor", "changes", "said"), WARNED)
def test_a_sensor_that_is_odd_is_warned_of_and_no_other(
    sensor: dict[str, Any], changes: dict[str, Any], said: list[str]
) -> None:
    made = scene([sensor | changes], seed=1)
    found = list(made.sensor[0].warnings(made.scene.site))
    assert len(found) == len(said), found
    for words, warning in zip(said, found, strict=True):
        assert words in warning
