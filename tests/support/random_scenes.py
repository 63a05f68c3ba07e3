"""Scenes at random: all sensors, effects, formats, links and events."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from support.road import SITE

SECONDS = 60.0
Keys = dict[str, Any]


class Dice:
    """Draws of one scene."""

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


def random_tree(seed: int) -> Keys:
    """A scene of one to three sensors and a few drones, as its file would have it."""
    dice = Dice(seed)
    sensors = [_sensor(dice, number) for number in range(dice.one_of(1, 2, 3))]
    return {
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
        "sensor": sensors,
        "drone": _drones(dice),
    }


def _drones(dice: Dice) -> list[Keys]:
    drones = []
    for number in range(dice.one_of(1, 2, 4)):
        place = [dice.between(-2500, 2500), dice.between(-2500, 2500), dice.between(40, 600)]
        legs = dice.one_of(2, 3)
        step = dice.log_between(30, 2500)
        path = [
            {
                "east_m": place[0] + dice.between(-step, step),
                "north_m": place[1] + dice.between(-step, step),
                "above_site_m": max(place[2] + dice.between(-30, 30), 20.0),
            }
            for _ in range(legs)
        ]
        drones.append(
            {
                "id": f"drone-{number}",
                "rcs_m2": dice.log_between(0.005, 0.3),
                **({"swerling": dice.one_of(0, 2, 3, 4)} if dice.happens(0.2) else {}),
                "sound_power_db": dice.between(95, 115),
                "speed_m_s": dice.between(2, 40),
                "repeat": True,
                "path": path,
                "emitters": [
                    {
                        "frequency_hz": 2.44e9,
                        "bandwidth_hz": 10e6,
                        "eirp_dbm": dice.between(10, 24),
                        "kind": "video",
                    }
                ],
            }
        )
    if len(drones) > 1 and dice.happens(0.4):  # one in the wake of another
        behind = [{**place, "north_m": place["north_m"] + 25.0} for place in drones[0]["path"]]
        drones[1] |= {"path": behind, "speed_m_s": drones[0]["speed_m_s"]}
    return drones


def _sensor(dice: Dice, number: int) -> Keys:
    make: Callable[[Dice], Keys] = dice.one_of(
        _active, _active, _mimo, _passive, _acoustic, _rf, _gate, _camera
    )
    sensor = {
        "id": f"sensor-{number}",
        "sic": number + 1,
        "position_enu_m": [dice.between(-800, 800), dice.between(-800, 800), dice.between(0, 30)],
    } | make(dice)
    if dice.happens(0.5):
        sensor["bias"] = _bias(dice)
    if dice.happens(0.35):
        sensor["drift"] = {
            "time_constant_s": dice.log_between(2, 200),
            "sigma_range_m": dice.between(0, 30),
            "sigma_azimuth_deg": dice.between(0, 2),
        }
    if dice.happens(0.3):
        sensor["degradation"] = _degradation(dice)
    if dice.happens(0.7):
        sensor["link"] = _link(dice)
    if dice.happens(0.4):
        sensor["event"] = _events(dice, sensor)
    return sensor


def _bias(dice: Dice) -> Keys:
    whole = {
        "range_offset_m": dice.between(-60, 60),
        "range_scale": dice.between(-0.02, 0.02),
        "azimuth_offset_deg": dice.between(-10, 10),
        "tilt_deg": dice.between(0, 5),
        "tilt_azimuth_deg": dice.between(0, 359),
        "time_offset_s": dice.between(-3, 3),
    }
    return {key: whole[key] for key in dice.some_of(*whole)}


def _degradation(dice: Dice) -> Keys:
    whole = {
        "pd_factor": dice.between(0.2, 1),
        "false_alarm_factor": dice.log_between(0.3, 10),
        "error_factor": dice.between(0.5, 3),
    }
    return {key: whole[key] for key in dice.some_of(*whole)}


def _scan(dice: Dice, *, rotates: bool) -> Keys:
    if rotates:
        period_s = dice.one_of(0.5, 1.0, 2.0)
        scan = {"kind": "rotating", "period_s": period_s, "sectors": dice.one_of(4, 5, 8)}
        return scan | ({"jitter_ms": 5.0} if dice.happens(0.3) else {})
    return {"kind": "staring", "period_s": dice.one_of(0.2, 0.5, 1.0)}


def _effects(dice: Dice, **more: Keys) -> Keys:
    effects = {
        "multipath": {"antenna_height_m": dice.between(2, 20), "reflection": -0.6},
        "doppler": {"floor_m_s": 0.1, "notch_m_s": dice.one_of(0.0, 0.5, 2.0)},
        "merging": {},
        "antenna": {
            "receive": {
                "elevation": {"kind": "gaussian", "beamwidth_deg": dice.between(20, 60)},
                "sidelobe_db": dice.between(10, 30),
            }
        },
        "straddling": {"range": dice.one_of("sinc", "triangle", "hann")},
    } | more
    return {name: keys for name, keys in effects.items() if dice.happens(0.3)}


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
    pulsed = {"floor_m_s": 0.1, "prf_hz": dice.one_of(2000.0, 10_000.0)}
    pulses = {
        "prf_hz": dice.some_of(31_000.0, 42_000.0, 50_000.0),
        "pulse_s": dice.one_of(0.0, 1e-6),
        "stc_range_m": dice.one_of(0.0, 1000.0),
    }
    if dice.happens(0.3):
        return _active_with(dice, doppler={"floor_m_s": 0.1}, pulses=pulses)
    return _active_with(dice, doppler=pulsed)


def _active_with(dice: Dice, *, doppler: Keys, pulses: Keys | None = None) -> Keys:
    return (
        _radar(dice)
        | {
            "type": "active_radar",
            "power_w": dice.log_between(0.5, 500),
            "report": dice.some_of("asterix-048", "asterix-015", "plots", "sapient"),
            "scan": _scan(dice, rotates=dice.happens(0.6)),
        }
        | _effects(dice, doppler=doppler)
        | ({"pulses": pulses} if pulses is not None else {})
    )


def _place(dice: Dice) -> Keys:
    return {
        "east_m": dice.between(-4000, 4000),
        "north_m": dice.between(-4000, 4000),
        "above_site_m": dice.between(20, 150),
    }


def _mimo(dice: Dice) -> Keys:
    return (
        _radar(dice)
        | {
            "type": "mimo_radar",
            "transmitters": [
                {
                    "power_w": dice.log_between(0.5, 200),
                    "east_m": dice.between(-50, 50),
                    "north_m": dice.between(-50, 50),
                    "above_site_m": 2.0,
                }
                for _ in range(dice.one_of(2, 3))
            ],
            "report": dice.some_of("asterix-015", "plots"),
            "scan": _scan(dice, rotates=False),
        }
        | _effects(dice)
    )


def _passive(dice: Dice) -> Keys:
    return {
        "type": "passive_radar",
        "transmitters": [
            {
                "id": f"t{n}",
                "erp_w": 50_000.0,
                "frequency_hz": dice.one_of(600e6, 700e6),
                "bandwidth_hz": 7.6e6,
                "place": {**_place(dice), "east_m": dice.one_of(-1, 1) * dice.between(5e3, 2e4)},
                "external_noise_db": 3.0,
            }
            for n in range(dice.one_of(1, 2))
        ],
        "gain_rx_dbi": 15.0,
        "azimuth_beamwidth_deg": dice.between(4, 12),
        "integration_s": 0.2,
        "pfa": dice.log_between(1e-6, 1e-4),
        "range_max_m": dice.one_of(4000.0, 10_000.0),
        "elevation_min_deg": -10.0,
        "elevation_max_deg": 80.0,
        "report": dice.some_of("asterix-015", "plots"),
        "scan": {"kind": "staring", "period_s": dice.one_of(0.5, 1.0)},
    } | _effects(dice)


def _acoustic(dice: Dice) -> Keys:
    elevation = {"elevation_beamwidth_deg": dice.between(8, 20)} if dice.happens(0.7) else {}
    return {
        "type": "acoustic",
        "noise_db": dice.between(20, 35),
        "sensitivity_db": dice.between(3, 10),
        "microphones": 32,
        "pfa": dice.log_between(1e-5, 1e-3),
        "range_max_m": 2000.0,
        "azimuth_beamwidth_deg": dice.between(8, 20),
        "report": dice.some_of("asterix-015", "plots"),
        "scan": {"kind": "staring", "period_s": dice.one_of(0.5, 1.0)},
    } | elevation


def _rf(dice: Dice) -> Keys:
    return {
        "type": "rf",
        "frequency_min_hz": 2.40e9,
        "frequency_max_hz": 2.48e9,
        "channel_bandwidth_hz": 10e6,
        "integration_s": 1e-4,
        "duty_cycle": dice.between(0.4, 1.0),
        "pfa": dice.log_between(1e-6, 1e-4),
        "range_max_m": 8000.0,
        "azimuth_beamwidth_deg": 30.0,
        "baseline_m": dice.between(0.1, 0.5),
        "azimuth_floor_deg": dice.one_of(0.5, 2.0),
        "report": dice.some_of("asterix-205", "plots"),
        "scan": {"kind": "staring", "period_s": dice.one_of(0.5, 1.0)},
    }


def _gate(dice: Dice) -> Keys:
    return {
        "type": "range_gate",
        "range_max_m": dice.one_of(3000.0, 8000.0),
        "sigma_m": dice.one_of(0.0, 2.0, 15.0),
        "report": dice.some_of("asterix-015", "plots"),
        "scan": {"kind": "staring", "period_s": dice.one_of(0.2, 1.0)},
    }


def _camera(dice: Dice) -> Keys:
    turns = dice.happens(0.3)
    return {
        "type": "camera",
        "range_max_m": 3000.0,
        "horizontal_fov_deg": 360.0 if turns else dice.between(40, 110),
        "pan_deg": dice.between(-180, 180),
        "tilt_deg": dice.between(5, 30),
        "pixels_across": 60_000 if turns else 12_000,
        "pixels_down": 10_000,
        "false_alarms_per_frame": dice.between(0, 0.3),
        "class_probability": dice.between(0.5, 1.0),
        "report": dice.some_of("asterix-015", "asterix-205", "plots"),
        "scan": {"kind": "rotating", "period_s": 0.5} if turns
        else {"kind": "staring", "period_s": dice.one_of(0.2, 1.0)},
    } | dice.one_of({}, {"visibility_m": 5000.0}, {"hotter_k": 5.0})  # fmt: skip


def _link(dice: Dice) -> Keys:
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


def _events(dice: Dice, sensor: Keys) -> list[Keys]:
    """What lasts for a part of the scene, one thing or several."""
    changes: list[Keys] = [{"enabled": False}, {"bias": _bias(dice)}]
    changes.append({"degradation": _degradation(dice)})
    if "pfa" in sensor:
        changes.append({"pfa_factor": dice.one_of(0.2, 3.0)})
    if "link" in sensor:
        changes += [{"link": {"down": True}}, {"link": {"latency_ms": dice.between(10, 300)}}]
    found = []
    for change in dice.some_of(*changes):
        from_s = dice.between(5, 40)
        found.append({"from_s": from_s, "to_s": from_s + dice.between(5, 15), "set": change})
    return found
