"""Sensors of random scenes: each kind, each table that its keys may hold, and links."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, get_args

from support.dice import Dice, Keys

from plotfeed.feeds.scene.fields import SceneTable
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.sensors import SENSORS
from plotfeed.feeds.scene.sensors.effect_keys import BiasKeys
from plotfeed.feeds.scene.sensors.multistatic_keys import NOT_MODELLED

CHANCE = 0.3  # Of each table that a sensor may hold


def random_sensor(dice: Dice, kind: str, others: Sequence[Keys]) -> Keys:
    """A sensor of that kind with some of its tables; a mount may be cued by one of the others."""
    number = len(others)
    sensor = {
        "id": f"sensor-{number}",
        "type": kind,
        "sic": number + 1,
        "position_enu_m": [dice.between(-800, 800), dice.between(-800, 800), dice.between(0, 30)],
    } | SENSOR_MAKERS[kind](dice)
    cuers = [str(other["id"]) for other in others]
    for name in tables_of(kind):
        keys = TABLE_MAKERS[name](dice, sensor, cuers) if dice.happens(CHANCE) else None
        if keys is not None:
            sensor[name] = keys
    sensor["report"] = _report(dice, kind, sensor)
    if dice.happens(0.6):
        sensor["link"] = random_link(dice)
    if dice.happens(0.4):
        sensor["event"] = _events(dice, sensor)
    drop_what_is_refused(sensor)
    return sensor


def drop_what_is_refused(sensor: Keys) -> None:
    """Systematic errors that are not modelled of places by several receivers or arrays."""
    kept = set(BiasKeys.model_fields)
    if sensor["type"].startswith("multistatic"):
        kept = {"time_offset_s"}
    elif sensor["type"] == "acoustic_pair":
        kept -= {"range_offset_m", "range_scale"}
        sensor.get("drift", {}).pop("sigma_range_m", None)
    for keys in (sensor, *(event["set"] for event in sensor.get("event", ()))):
        if "bias" in keys:
            keys["bias"] = {name: value for name, value in keys["bias"].items() if name in kept}


def tables_of(kind: str) -> Iterator[str]:
    """Tables that a sensor of a kind may leave out, but for its link."""
    for name, field in SENSORS[kind].model_fields.items():
        kinds = get_args(field.annotation)
        is_table = type(None) in kinds and any(
            isinstance(k, type) and issubclass(k, SceneTable) for k in kinds
        )
        is_table |= name == "jamming"
        is_modelled = name not in NOT_MODELLED or not kind.startswith("multistatic")
        if is_table and name != "link" and is_modelled:
            yield name


def _report(dice: Dice, kind: str, sensor: Keys) -> list[str]:
    formats = [REPORT_FORMATS[name] for name in SENSORS[kind].formats]
    if not sensor.get("measures_azimuth", True):
        formats = [row for row in formats if not row.needs_azimuth]
    report: list[str] = dice.some_of(*(row.name for row in formats if not row.tells_tracks))
    tracks = [row.name for row in formats if row.tells_tracks]
    if tracks and sensor["scan"]["kind"] != "electronic" and dice.happens(0.2):
        report.append(dice.one_of(*tracks))
    return report


def _scan(dice: Dice, *kinds: str) -> Keys:
    kind = dice.one_of(*kinds)
    if kind == "rotating":
        period_s = dice.one_of(0.5, 1.0, 2.0)
        scan = {"kind": kind, "period_s": period_s, "sectors": dice.one_of(4, 5, 8)}
        return scan | ({"jitter_ms": 5.0} if dice.happens(0.3) else {})
    if kind == "electronic":
        return {"kind": kind, "period_s": 0.5, "dwell_s": dice.one_of(0.01, 0.02)}
    return {"kind": kind, "period_s": dice.one_of(0.2, 0.5, 1.0)}


def _radar(dice: Dice) -> Keys:
    return {
        "frequency_hz": dice.one_of(3e9, 10e9),
        "gain_tx_dbi": dice.between(15, 30),
        "gain_rx_dbi": dice.between(25, 32),
        "integration_s": 0.02,
        "pfa": dice.log_between(1e-7, 3e-6),
        "range_resolution_m": dice.one_of(3.0, 10.0, 30.0),
        "range_min_m": dice.one_of(0.0, 150.0),
        "range_max_m": dice.one_of(3000.0, 8000.0),
        "azimuth_beamwidth_deg": dice.between(1.5, 5),
        "elevation_beamwidth_deg": dice.between(4, 12),
        "elevation_min_deg": -10.0,
        "elevation_max_deg": dice.one_of(40.0, 80.0),
        "range_floor_m": dice.one_of(0.0, 1.0),
        "azimuth_floor_deg": dice.one_of(0.0, 0.1),
        "elevation_floor_deg": dice.one_of(0.0, 0.2),
    }


def _active(dice: Dice) -> Keys:
    scan = _scan(dice, "rotating", "staring", "electronic")
    steered = {
        "integration_s": 0.01,
        "azimuth_min_deg": -60.0,
        "azimuth_max_deg": 60.0,
        "elevation_max_deg": 30.0,
    }
    is_steered = scan["kind"] == "electronic"
    lasting = {"decorrelation_s": dice.log_between(0.1, 10)} if dice.happens(0.2) else {}
    flat = {"measures_elevation": False} if not is_steered and dice.happens(0.15) else {}
    power = {"power_w": dice.log_between(0.5, 500), "scan": scan}
    return _radar(dice) | power | lasting | flat | (steered if is_steered else {})


def _mimo(dice: Dice) -> Keys:
    transmitters = [
        {"power_w": dice.log_between(0.5, 200), **dice.place(50, 2, 3)}
        for _ in range(dice.one_of(2, 3))
    ]
    return _radar(dice) | {"transmitters": transmitters, "scan": _scan(dice, "staring")}


def _mimo_net(dice: Dice) -> Keys:
    receivers = [{"id": f"r{n}", **dice.place(2500, 2, 10)} for n in range(dice.one_of(1, 2))]
    transmitters = [{"power_w": dice.log_between(50, 2000), **dice.place(900, 2, 5)} for _ in "12"]
    return _mimo(dice) | {"transmitters": transmitters, "receivers": receivers}


def _passive(dice: Dice, most: int = 2) -> Keys:
    return {
        "transmitters": [
            {
                "id": f"t{n}",
                "erp_w": 50_000.0,
                "frequency_hz": dice.one_of(600e6, 700e6),
                "bandwidth_hz": 7.6e6,
                "place": {
                    **dice.place(4000),
                    "east_m": dice.one_of(-1, 1) * dice.between(5e3, 2e4),
                },
                "external_noise_db": 3.0,
            }
            for n in range(dice.one_of(most - 1, most))
        ],
        "gain_rx_dbi": 15.0,
        "azimuth_beamwidth_deg": dice.between(4, 12),
        "integration_s": 0.2,
        "pfa": dice.log_between(1e-6, 1e-4),
        "range_max_m": dice.one_of(4000.0, 10_000.0),
        "elevation_min_deg": -10.0,
        "elevation_max_deg": 80.0,
        "scan": {"kind": "staring", "period_s": dice.one_of(0.5, 1.0)},
    }


def _passive_net(dice: Dice) -> Keys:
    receivers = [{"id": f"r{n}", **dice.place(3000, 2, 20)} for n in range(dice.one_of(1, 2))]
    return _passive(dice, most=3) | {"receivers": receivers}


def _acoustic(dice: Dice) -> Keys:
    elevation = {"elevation_beamwidth_deg": dice.between(8, 20)} if dice.happens(0.7) else {}
    return {
        "noise_db": dice.between(20, 35),
        "sensitivity_db": dice.between(3, 10),
        "microphones": 32,
        "pfa": dice.log_between(1e-5, 1e-3),
        "range_max_m": 2000.0,
        "azimuth_beamwidth_deg": dice.between(8, 20),
        "scan": {"kind": "staring", "period_s": dice.one_of(0.5, 1.0)},
    } | elevation


def _pair(dice: Dice) -> Keys:
    second = {**dice.place(200, 0, 10), "east_m": dice.between(60, 300)}
    return _acoustic(dice) | {"second_array": second}


def _rf(dice: Dice) -> Keys:
    keys = {
        "frequency_min_hz": 2.40e9,
        "frequency_max_hz": 2.48e9,
        "channel_bandwidth_hz": 10e6,
        "integration_s": 1e-4,
        "duty_cycle": dice.between(0.4, 1.0),
        "pfa": dice.log_between(1e-6, 1e-4),
        "range_max_m": 8000.0,
        "path_loss": dice.one_of(
            {"kind": "friis"},
            {"kind": "log-distance", "exponent": dice.between(2, 2.8)},
            {"kind": "city", "environment": "suburban", "shadowing_db": dice.between(0, 6)},
        ),
        "scan": {"kind": "staring", "period_s": dice.one_of(0.5, 1.0)},
    }
    if dice.happens(0.2):
        return keys | {"measures_azimuth": False, "decodes": ["video"]}
    bearing = {"azimuth_beamwidth_deg": 30.0, "azimuth_floor_deg": dice.one_of(0.5, 2.0)}
    elevation = {"elevation_baseline_m": 0.3} if dice.happens(0.3) else {}
    return keys | bearing | {"baseline_m": dice.between(0.1, 0.5)} | elevation


def _gate(dice: Dice) -> Keys:
    return {
        "range_max_m": dice.one_of(3000.0, 8000.0),
        "sigma_m": dice.one_of(0.0, 2.0, 15.0),
        "scan": _scan(dice, "staring"),
    }


def _camera(dice: Dice) -> Keys:
    turns = dice.happens(0.3)
    return {
        "range_max_m": 3000.0,
        "horizontal_fov_deg": 360.0 if turns else dice.between(40, 110),
        "pan_deg": dice.between(-180, 180),
        "tilt_deg": dice.between(5, 30),
        "pixels_across": 60_000 if turns else 12_000,
        "pixels_down": 10_000,
        "false_alarms_per_frame": dice.between(0, 0.3),
        "class_probability": dice.between(0.5, 1.0),
        "scan": {"kind": "rotating", "period_s": 0.5} if turns
        else {"kind": "staring", "period_s": dice.one_of(0.2, 1.0)},
    } | dice.one_of({}, {"visibility_m": 5000.0}, {"hotter_k": 5.0})  # fmt: skip


# What makes the keys of each kind of sensor that it cannot leave out, and some others.
SENSOR_MAKERS: dict[str, Callable[[Dice], Keys]] = {
    "acoustic": _acoustic,
    "acoustic_pair": _pair,
    "active_radar": _active,
    "camera": _camera,
    "mimo_radar": _mimo,
    "multistatic_mimo": _mimo_net,
    "multistatic_passive": _passive_net,
    "passive_radar": _passive,
    "range_gate": _gate,
    "rf": _rf,
}


def _events(dice: Dice, sensor: Keys) -> list[Keys]:
    """What lasts for a part of the scene, one thing or several."""
    changes: list[Keys] = [{"enabled": False}, {"bias": TABLE_MAKERS["bias"](dice, sensor, ())}]
    changes.append({"degradation": TABLE_MAKERS["degradation"](dice, sensor, ())})
    if "pfa" in sensor:
        changes.append({"pfa_factor": dice.one_of(0.2, 3.0)})
    if "link" in sensor:
        changes += [{"link": {"down": True}}, {"link": {"latency_ms": dice.between(10, 300)}}]
    found = []
    for change in dice.some_of(*changes):
        from_s = dice.between(5, 40)
        found.append({"from_s": from_s, "to_s": from_s + dice.between(5, 15), "set": change})
    return found


def random_link(dice: Dice) -> Keys:
    link: Keys = {"latency_ms": dice.between(0, 200)}
    if dice.happens(0.7):
        link |= {
            "jitter_ms": dice.between(1, 40),
            "distribution": dice.one_of("normal", "uniform", "pareto", "paretonormal"),
        }
    if dice.happens(0.5):
        link["loss"] = dice.one_of(
            {"kind": "random", "probability": dice.between(0.001, 0.3)},
            {"kind": "random", "probability": 0.1, "correlation": dice.between(0, 0.6)},
            {
                "kind": "gilbert-elliott",
                "mean_loss": dice.between(0.01, 0.3),
                "mean_burst": dice.between(1.5, 8),
            },
            {"kind": "four-state", "p13": 0.02, "p31": 0.3, "p32": 0.1, "p23": 0.5},
        )
    extra = {
        "duplicate": dice.between(0.001, 0.1),
        "corrupt": dice.between(0.001, 0.1),
        "in_order": True,
        "delay_correlation": dice.between(0.1, 0.8),
    }
    link |= {key: value for key, value in extra.items() if dice.happens(0.25)}
    if "jitter_ms" not in link:
        link.pop("delay_correlation", None)
    return link


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
