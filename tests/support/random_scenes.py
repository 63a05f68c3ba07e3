"""Scenes at random: all kinds of sensors, effects, formats, links, mounts, systems and events.

What there is to draw is asked of the registries: a kind of sensor, a table or a system that is
added is drawn, or whoever adds it is told that nobody draws it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
from support.hills import TILE, write_ridge
from support.ledgers import record_session, told

from plotfeed.feeds.scene.fields import SceneTable
from plotfeed.feeds.scene.presets.preset import names as preset_names
from plotfeed.feeds.scene.presets.preset import system_names
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.scene.sensors import SENSORS
from plotfeed.feeds.scene.sensors.effect_keys import BiasKeys
from plotfeed.feeds.scene.sensors.multistatic_keys import NOT_MODELLED
from plotfeed.feeds.scene.sensors.scan_keys import AnyScan
from plotfeed.feeds.testing.built_scene import toml_of
from plotfeed.models.residuals import Check
from plotfeed.testing import SITE

SECONDS = 60.0
PLAIN_M = 545  # Above sea level: some 50 m under the site
CHANCE = 0.3  # Of each table that a sensor may hold
Keys = dict[str, Any]


class Dice:
    """Draws of one scene, by its seed."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def between(self, low: float, high: float) -> float:
        return round(float(self._rng.uniform(low, high)), 4)

    def log_between(self, low: float, high: float) -> float:
        return float(f"{np.exp(self._rng.uniform(np.log(low), np.log(high))):.4g}")

    def one_of(self, *choices: Any) -> Any:
        return choices[int(self._rng.integers(len(choices)))]

    def happens(self, chance: float) -> bool:
        return bool(self._rng.random() < chance)

    def some_of(self, *choices: Any) -> list[Any]:
        """At least one."""
        kept = [choice for choice in choices if self.happens(0.5)]
        return kept or [self.one_of(*choices)]

    def some(self, whole: Keys) -> Keys:
        """At least one of the keys."""
        return {key: whole[key] for key in self.some_of(*whole)}

    def place(self, far_m: float, low_m: float = 20.0, high_m: float = 150.0) -> Keys:
        return {
            "east_m": self.between(-far_m, far_m),
            "north_m": self.between(-far_m, far_m),
            "above_site_m": self.between(low_m, high_m),
        }


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
    "range_gate": lambda dice: {
        "range_max_m": dice.one_of(3000.0, 8000.0),
        "sigma_m": dice.one_of(0.0, 2.0, 15.0),
        "scan": _scan(dice, "staring"),
    },
    "rf": _rf,
}


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
    "bias": lambda dice, *_: dice.some({
        "range_offset_m": dice.between(-60, 60),
        "range_scale": dice.between(-0.02, 0.02),
        "azimuth_offset_deg": dice.between(-10, 10),
        "tilt_deg": dice.between(0, 5),
        "tilt_azimuth_deg": dice.between(0, 359),
        "time_offset_s": dice.between(-3, 3),
    }),
    "drift": lambda dice, *_: {
        "time_constant_s": dice.log_between(2, 200),
        "sigma_range_m": dice.between(0, 30),
        "sigma_azimuth_deg": dice.between(0, 2),
    },
    "degradation": lambda dice, *_: dice.some({
        "pd_factor": dice.between(0.2, 1),
        "false_alarm_factor": dice.log_between(0.3, 10),
        "error_factor": dice.between(0.5, 3),
    }),
    "weather": lambda dice, *_: dice.some({
        "rain_mm_h": dice.between(1, 40), "vapour_g_m3": 15.0, "wind_m_s": dice.between(1, 12),
    }),
    "jamming": _jamming,
    "layout": _layout,
    "classifier": _classifier,
    "antenna": _antenna,
    "straddling": lambda dice, *_: {"range": dice.one_of("sinc", "triangle", "hann")},
    "multipath": lambda dice, *_: {"antenna_height_m": dice.between(2, 20), "reflection": -0.6},
    "doppler": _doppler,
    "pulses": _pulses,
    "merging": lambda dice, sensor, _: (
        None
        if sensor["scan"]["kind"] == "electronic"
        else dice.one_of({}, {"range_m": dice.between(5, 60)})
    ),
    "mount": _mount,
}  # fmt: skip


def optional_tables(model: type[SceneTable]) -> set[str]:
    """Keys of tables that may be left out, and then nothing of them is modelled."""
    kinds = {name: get_args(field.annotation) for name, field in model.model_fields.items()}
    may_be_left_out = {name: each for name, each in kinds.items() if type(None) in each}
    return {
        name
        for name, each in may_be_left_out.items()
        if any(isinstance(kind, type) and issubclass(kind, SceneTable) for kind in each)
    }


def tables_of(kind: str) -> Iterator[str]:
    """Tables that a sensor of a kind may leave out, but for its link, in the order of its keys."""
    tables = (optional_tables(SENSORS[kind]) | {"jamming"}) - {"link"}
    if kind.startswith("multistatic"):
        tables -= {*NOT_MODELLED}
    return (name for name in SENSORS[kind].model_fields if name in tables)


def _report(dice: Dice, kind: str, sensor: Keys) -> list[str]:
    formats = [REPORT_FORMATS[name] for name in SENSORS[kind].formats]
    if not sensor.get("measures_azimuth", True):
        formats = [row for row in formats if not row.needs_azimuth]
    report: list[str] = dice.some_of(*(row.name for row in formats if not row.tells_tracks))
    tracks = [row.name for row in formats if row.tells_tracks]
    if tracks and sensor["scan"]["kind"] != "electronic" and dice.happens(0.2):
        report.append(dice.one_of(*tracks))
    return report


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


def _preset(dice: Dice, number: int) -> Keys:
    return {
        "id": f"sensor-{number}",
        "preset": dice.one_of(*preset_names()),
        "sic": number + 1,
        "position_enu_m": [dice.between(-800, 800), dice.between(-800, 800), 20.0],
    } | ({"link": random_link(dice)} if dice.happens(0.5) else {})


def _system(dice: Dice, seed: int) -> Keys:
    return {
        "id": "system",
        "preset": system_names()[seed % len(system_names())],
        "position_enu_m": [dice.between(-300, 300), dice.between(-300, 300), 20.0],
        "facing_deg": dice.between(-180, 180),
    } | ({"every": {"link": random_link(dice)}} if dice.happens(0.5) else {})


def _drones(dice: Dice) -> list[Keys]:
    drones = []
    for number in range(dice.one_of(1, 2, 4)):
        drone = {
            "id": f"drone-{number}",
            "rcs_m2": dice.log_between(0.005, 0.3),
            **({"swerling": dice.one_of(0, 2, 3, 4)} if dice.happens(0.2) else {}),
            "sound_power_db": dice.between(95, 115),
            "target_class": dice.one_of("drone", "drone", "bird"),
            "repeat": True,
            "emitters": [_emitter(dice, number)],
        }
        drones.append(drone | (_legs(dice) if dice.happens(0.2) else _path(dice)))
    if len(drones) > 1 and "path" in drones[0] and dice.happens(0.4):  # one in another's wake
        behind = [{**place, "north_m": place["north_m"] + 25.0} for place in drones[0]["path"]]
        for key in ("home", "leg", "limits", "contingency"):
            drones[1].pop(key, None)
        drones[1] |= {"path": behind, "speed_m_s": drones[0]["speed_m_s"]}
    return drones


def _emitter(dice: Dice, number: int) -> Keys:
    return {
        "frequency_hz": 2.44e9,
        "bandwidth_hz": 10e6,
        "eirp_dbm": dice.between(10, 24),
        "kind": dice.one_of("video", "control"),
        "identity": f"serial-{number}",
    }


def _path(dice: Dice) -> Keys:
    near = dice.place(2500, 40, 600)
    step_m = dice.log_between(30, 2500)
    places = [
        {
            "east_m": near["east_m"] + dice.between(-step_m, step_m),
            "north_m": near["north_m"] + dice.between(-step_m, step_m),
            "above_site_m": max(near["above_site_m"] + dice.between(-30, 30), 20.0),
        }
        for _ in range(dice.one_of(2, 3))
    ]
    return {"path": places, "speed_m_s": dice.between(2, 40)}


def _legs(dice: Dice) -> Keys:
    to = {"kind": "to", **dice.place(1500, 60, 300)}
    hover = {"kind": "hover", "for_s": dice.between(2, 10)}
    lost = {"kind": "lost-link", "at_s": dice.between(20, 50)}
    return {
        "home": dice.place(800, 5, 10),
        "limits": {"speed_m_s": dice.between(5, 30)},
        "leg": [{"kind": "take-off", "height_m": 80.0}, to, hover],
    } | ({"contingency": [lost]} if dice.happens(0.3) else {})


def _spell(dice: Dice, keys: Keys) -> Keys:
    from_s = dice.one_of(0.0, dice.between(5, 40))
    return keys | {"from_s": from_s} | ({"to_s": from_s + 15.0} if dice.happens(0.5) else {})


def _jammer(dice: Dice) -> list[Keys]:
    noise = {"eirp_w": dice.log_between(0.01, 10), "bandwidth_hz": 1e8}
    frequency_hz = dice.one_of(2.44e9, 3e9, 10e9)
    return [
        _spell(dice, {"id": "noisy", "frequency_hz": frequency_hz, **noise, **dice.place(4000)})
    ]


def _birds(dice: Dice) -> list[Keys]:
    path = [dice.place(2500, 40, 300) for _ in range(2)]
    return [{"id": "flock", "count": dice.one_of(1, 5), "path": path}]


def _clutter(dice: Dice) -> list[Keys]:
    corner = dice.place(2500, 0, 1)
    area = [
        {**corner, "east_m": corner["east_m"] + east_m, "north_m": corner["north_m"] + north_m}
        for east_m, north_m in ((0.0, 0.0), (800.0, 0.0), (0.0, 800.0))
    ]
    kind = dice.one_of({"plots_per_km2": 4.0}, {"threshold_db": 15.0, "texture_stays": False})
    return [{"id": "woods", "area": area, **kind}]


def _target(dice: Dice) -> list[Keys]:
    table = {
        "kind": "table",
        "angle_deg": [0.0, 90.0, 180.0, 270.0],
        "gain_db": [0.0, 6.0, 1.0, 6.0],
    }
    aspect = dice.one_of({"kind": "lobes", "depth_db": dice.between(1, 10)}, table)
    return [{"target_class": "drone", "swerling": dice.one_of(0, 1, 2, 3, 4), "aspect": aspect}]


def _swarm(dice: Dice) -> list[Keys]:
    formation = dice.one_of(
        {"kind": "line", "spacing_m": dice.between(20, 200)},
        {"kind": "random", "radius_m": dice.between(50, 300)},
    )
    return [{"id": "swarm", "number": 3, "rcs_m2": 0.02, "formation": formation, **_path(dice)}]


def _cooperative(dice: Dice) -> Keys:
    link = {"link": random_link(dice)} if dice.happens(0.5) else {}
    report = dice.some_of("asterix-129", dice.one_of("json", "protobuf"))
    return {"report": report, "accuracy_m": dice.one_of(0.0, 5.0), **link}


# What makes each table of a scene that changes what sensors see, or what is sent of drones.
SCENE_TABLES: dict[str, Callable[[Dice], Any]] = {
    "terrain": lambda dice: {"elevation": [TILE], "diffraction": dice.happens(0.5)},
    "weather": lambda dice: [_spell(dice, dice.some({
        "rain_mm_h": dice.between(1, 40),
        "vapour_g_m3": dice.between(2, 20),
        "wind_m_s": dice.between(1, 12),
        "rain_echo": True,
    }))],
    "jammer": _jammer,
    "birds": _birds,
    "road": lambda dice: [{
        "path": [dice.place(3000, 1, 2) for _ in range(2)],
        "id": "street", "cars_per_h": 200.0, "speed_m_s": 20.0,
    }],
    "turbine": lambda dice: [
        {"id": "mill", "radius_m": dice.between(20, 60), **dice.place(3000, 60, 100)}
    ],
    "clutter": _clutter,
    "target": _target,
    "swarm": _swarm,
    "cooperative": _cooperative,
}  # fmt: skip


def random_tree(seed: int) -> Keys:
    """A scene of a few sensors and drones, as its file would have it.

    Its first sensor is of the next kind in each scene, so that a few scenes have them all.
    """
    dice = Dice(seed)
    kinds = list(SENSOR_MAKERS)
    more = (dice.one_of(*kinds) for _ in range(dice.one_of(0, 0, 1, 1, 2)))
    sensors: list[Keys] = []
    for kind in (kinds[seed % len(kinds)], *more):
        sensors.append(random_sensor(dice, kind, sensors))
    tree: Keys = {
        "scene": {
            "name": f"random-{seed}",
            "seed": seed,
            "site": {
                "latitude_deg": SITE.latitude_deg,
                "longitude_deg": SITE.longitude_deg,
                "height_m": SITE.height_m,
            },
        },
        "telemetry": dice.one_of({}, {"geoid_undulation_m": 0.0}, {"geoid_undulation_m": -30.0}),
    }
    if dice.happens(0.15):
        sensors.append(_preset(dice, len(sensors)))
    if dice.happens(0.15):
        tree["system"] = [_system(dice, seed)]
    tree |= {"sensor": sensors, "drone": _drones(dice)}
    tree |= {name: make(dice) for name, make in SCENE_TABLES.items() if dice.happens(0.15)}
    if any(str(sensor.get("type")).startswith("multistatic") for sensor in sensors):
        tree.pop("weather", None)  # which they refuse
        tree.pop("jammer", None)
    return tree


def written_scene(seed: int, folder: Path) -> Path:
    """The file of a random scene, and the ground that it may stand on."""
    if not (folder / TILE).exists():
        write_ridge(folder, height_m=700, plain_m=PLAIN_M)
    path = folder / f"{seed}.toml"
    path.write_text(toml_of(random_tree(seed)))
    return path


def tree_with(kind: str, tables: Sequence[str], seed: int) -> Keys:
    """A scene of many drones, and of a sensor for each of the tables, its own or the scene's.

    Sensors are called after their tables.
    """
    sensors: list[Keys] = []
    for table in tables:
        dice = Dice(seed)
        name = table.split(maxsplit=1)[0]
        sensor = {"id": name, "type": kind, "position_enu_m": [0.0, 0.0, 10.0]}
        sensor |= SENSOR_MAKERS[kind](dice) | {"sic": len(sensors) + 1}
        if keys := TABLE_MAKERS[table](dice, sensor, ()) if table in TABLE_MAKERS else None:
            sensor[table] = keys
        drop_what_is_refused(sensor)
        sensors.append(sensor)
    drones = [drone for _ in range(6) for drone in _drones(dice)]
    for n, drone in enumerate(drones):  # for every kind some within reach
        for key in ("home", "leg", "limits", "contingency"):
            drone.pop(key, None)
        far_m = (150.0, 800.0, 2500.0)[n % 3]
        drone |= {"path": [dice.place(far_m, 20, far_m / 3) for _ in "12"], "speed_m_s": 20.0}
    tree = random_tree(seed)
    for name in (*SCENE_TABLES, "system"):
        tree.pop(name, None)
    for table in tables:
        name = table.split(maxsplit=1)[0]
        is_refused = kind.startswith("multistatic") and name in ("weather", "jammer")
        if table not in TABLE_MAKERS and name in SCENE_TABLES and not is_refused:
            tree[name] = SCENE_TABLES[name](dice)
    drones = [drone | {"id": f"d{n}"} for n, drone in enumerate(drones)]
    return tree | {"sensor": sensors, "drone": drones}


# Where messages go, what every scene has, what comes in, what is shown, what comes at a word.
OTHER_TABLES = frozenset(
    {
        *("udp", "tak", "http", "websocket", "remote_id_service", "mqtt", "asterix", "sapient"),
        *("scene", "telemetry", "sensor", "drone", "page", "story"),
    }
)


def names_in(tree: Keys) -> Iterator[str]:
    """What a scene draws on: kinds of sensors, their tables and scans, its own tables, systems."""
    for sensor in tree["sensor"]:
        if "preset" not in sensor:
            kind = sensor["type"]
            yield kind
            yield f"{sensor['scan']['kind']} scan"
            yield from (f"{kind}.{name}" for name in tables_of(kind) if name in sensor)
    yield from (table for table in tree if table not in OTHER_TABLES)
    yield from (f"system {system['preset']}" for system in tree.get("system", ()))


def every_name() -> set[str]:
    """All that scenes can draw on, by the registries."""
    tables = {f"{kind}.{name}" for kind in SENSORS for name in tables_of(kind)}
    scans = {
        f"{get_args(scan.model_fields['kind'].annotation)[0]} scan"
        for scan in get_args(get_args(AnyScan)[0])
    }
    of_scene = set(Scene.model_fields) - OTHER_TABLES
    return {*SENSORS, *tables, *scans, *of_scene, *(f"system {name}" for name in system_names())}


LINKS = "links"
OF_LINKS = {"delay", "loss", "duplicates", "flipped bits", "order", "bursts of losses"}
NOT_OF_ERRORS = {"false alarms", "missed scans", "time", "plots"}


@dataclass(frozen=True)
class JudgedScene:
    """What the report says of one of them."""

    seed: int
    figures: list[Check]  # That chance decides
    kinds: dict[str, str]  # Of sensors, by id
    plots: Counter[str]  # Of drones, found in what sensors handed to their links, by kind of sensor
    wrong: list[str]
    notes: list[str]
    not_compared: int  # Of the plots
    lost: int  # Plots of the ledger that were not found, though a format that has them was recorded

    def judged(self) -> Counter[tuple[str, str]]:
        """Figures by kind of sensor and by what they are of."""
        return Counter((self.kinds.get(f.sensor, LINKS), _subject(f)) for f in self.figures)


def _subject(figure: Check) -> str:
    if figure.name in OF_LINKS:
        return LINKS
    if figure.name.startswith("Pd"):
        return "detection"
    return figure.name if figure.name in NOT_OF_ERRORS else "errors"


def judged_scene(seed: int, folder: Path) -> JudgedScene:
    """Run and report the random scene of that seed."""
    scene = load(written_scene(seed, folder))
    record = record_session(scene, folder / f"{seed}.mcap", SECONDS)
    found = told(record)
    record.unlink()
    kinds = {sensor.id: sensor.type_name() for sensor in scene.sensor}
    with_plots = [sensor for sensor in found.sensors if sensor.plots_from]
    plots: Counter[str] = Counter()
    for sensor in with_plots:
        plots[kinds[sensor.sensor]] += sensor.joined - sensor.not_compared
    return JudgedScene(
        seed,
        [c for c in found.verdicts.checks if 0 < c.p < 1],
        kinds,
        plots,
        [
            f"{c.sensor} ({kinds.get(c.sensor, '-')}) {c.name}: {c.found:.4g} of {c.expected:.4g}"
            for c in found.verdicts.wrong
        ],
        list(found.notes),
        sum(sensor.not_compared for sensor in with_plots),
        sum(sensor.plots - sensor.joined for sensor in with_plots),
    )
