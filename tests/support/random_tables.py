"""Tables of random sensors: systematic errors, weather, effects, mounts, classes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from support.dice import Dice, Keys


def _bias(dice: Dice, *_: Any) -> Keys:
    whole = {
        "range_offset_m": dice.between(-60, 60),
        "range_scale": dice.between(-0.02, 0.02),
        "azimuth_offset_deg": dice.between(-10, 10),
        "tilt_deg": dice.between(0, 5),
        "tilt_azimuth_deg": dice.between(0, 359),
        "time_offset_s": dice.between(-3, 3),
    }
    return {key: whole[key] for key in dice.some_of(*whole)}


def _drift(dice: Dice, *_: Any) -> Keys:
    return {
        "time_constant_s": dice.log_between(2, 200),
        "sigma_range_m": dice.between(0, 30),
        "sigma_azimuth_deg": dice.between(0, 2),
    }


def _degradation(dice: Dice, *_: Any) -> Keys:
    whole = {
        "pd_factor": dice.between(0.2, 1),
        "false_alarm_factor": dice.log_between(0.3, 10),
        "error_factor": dice.between(0.5, 3),
    }
    return {key: whole[key] for key in dice.some_of(*whole)}


def _weather(dice: Dice, *_: Any) -> Keys:
    whole = {"rain_mm_h": dice.between(1, 40), "vapour_g_m3": 15.0, "wind_m_s": dice.between(1, 12)}
    return {key: whole[key] for key in dice.some_of(*whole)}


def _jamming(dice: Dice, sensor: Keys, _: Any) -> Keys:
    frequency_hz = sensor.get("frequency_hz", dice.one_of(2.44e9, 600e6))
    noise = {"frequency_hz": frequency_hz, "bandwidth_hz": 1e8}
    return {"near": {"eirp_w": dice.log_between(1e-3, 1), **noise, **dice.place(4000)}}


def _layout(dice: Dice, sensor: Keys, _: Any) -> Keys:
    shapes = ["circle", "rectangle"]
    shapes += [] if "elevation_beamwidth_deg" in sensor else ["line"]
    return {"shape": dice.one_of(*shapes), "spacing_m": dice.between(0.05, 0.15)}


def _classifier(dice: Dice, sensor: Keys, _: Any) -> Keys:
    sure, wrong = dice.between(0.5, 1), dice.between(0, 0.4)
    classes = ("video", "control") if sensor["type"] == "rf" else ("drone", "bird")
    return {
        "claims": list(classes),
        "confusion": {classes[0]: [sure, 1 - sure], classes[1]: [wrong, 1 - wrong]},
        "held_s": dice.one_of(0.0, 5.0),
    }


def _antenna(dice: Dice, sensor: Keys, _: Any) -> Keys:
    elevation = dice.one_of(
        {"kind": "gaussian", "beamwidth_deg": dice.between(20, 60)},
        {"kind": "cosecant-squared", "from_deg": 4.0, "to_deg": 40.0},
        {"kind": "table", "angle_deg": [-90.0, 0.0, 90.0], "gain_db": [-20.0, 0.0, -15.0]},
    )
    receive = {"elevation": elevation, "sidelobe_db": dice.between(10, 40)}
    if sensor["scan"]["kind"] == "staring" and dice.happens(0.4):
        receive["azimuth"] = {"kind": "beams"}
    is_passive = "power_w" not in sensor and "frequency_hz" not in sensor
    antenna: Keys = {"receive": receive}
    if not is_passive and dice.happens(0.3):
        antenna["transmit"] = {"elevation": elevation}
    if sensor["type"] == "active_radar" and sensor["scan"]["kind"] != "electronic":
        antenna["sidelobe_plots"] = dice.happens(0.4)
    return antenna


def _straddling(dice: Dice, *_: Any) -> Keys:
    return {"range": dice.one_of("sinc", "triangle", "hann")}


def _multipath(dice: Dice, *_: Any) -> Keys:
    return {"antenna_height_m": dice.between(2, 20), "reflection": -0.6}


def _doppler(dice: Dice, sensor: Keys, _: Any) -> Keys | None:
    if sensor["scan"]["kind"] == "electronic":
        return None
    keys = {"floor_m_s": 0.1, "notch_m_s": dice.one_of(0.0, 0.5, 2.0)}
    pulsed = {"prf_hz": dice.one_of(2000.0, 10_000.0)}
    return keys | (pulsed if sensor["type"] == "active_radar" and dice.happens(0.6) else {})


def _pulses(dice: Dice, sensor: Keys, _: Any) -> Keys | None:
    if sensor["scan"]["kind"] == "electronic":
        return None
    sensor.get("doppler", {}).pop("prf_hz", None)
    sensor.pop("decorrelation_s", None)
    prf_hz = dice.some_of(31_000.0, 42_000.0, 50_000.0)
    return {
        "prf_hz": prf_hz,
        "needed": dice.one_of(1, len(prf_hz)),
        "pulse_s": dice.one_of(0.0, 1e-6),
        "stc_range_m": dice.one_of(0.0, 1000.0),
        "beam_passes": sensor["scan"]["kind"] == "rotating" and dice.happens(0.3),
    } | ({"canceller": dice.one_of("single", "double")} if dice.happens(0.3) else {})


def _merging(dice: Dice, sensor: Keys, _: Any) -> Keys | None:
    if sensor["scan"]["kind"] == "electronic":
        return None
    return dice.one_of({}, {"range_m": dice.between(5, 60)})


def _mount(dice: Dice, sensor: Keys, cuers: Sequence[str]) -> Keys | None:
    if sensor["scan"]["kind"] != "staring":
        return None
    if sensor["type"] == "camera":
        sensor |= {"horizontal_fov_deg": dice.between(10, 40), "pixels_down": 4000}
    else:
        sensor |= {"azimuth_min_deg": -30.0, "azimuth_max_deg": 30.0}
    sensor.get("antenna", {}).pop("sidelobe_plots", None)
    look_at = {"azimuth_deg": dice.between(-180, 180), "elevation_deg": dice.between(0, 20)}
    chosen = (
        {"cued_by": dice.one_of(*cuers)} if cuers and dice.happens(0.7) else {"look_at": look_at}
    )
    return chosen | {"dwell_s": dice.between(1, 4)}


# What makes each table that a sensor may hold; None where it cannot hold it as it is.
TABLE_MAKERS: dict[str, Callable[[Dice, Keys, Sequence[str]], Keys | None]] = {
    "bias": _bias,
    "drift": _drift,
    "degradation": _degradation,
    "weather": _weather,
    "jamming": _jamming,
    "layout": _layout,
    "classifier": _classifier,
    "antenna": _antenna,
    "straddling": _straddling,
    "multipath": _multipath,
    "doppler": _doppler,
    "pulses": _pulses,
    "merging": _merging,
    "mount": _mount,
}
