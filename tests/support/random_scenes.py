"""Scenes at random: all kinds of sensors, effects, formats, links, mounts, systems and events.

What there is to draw is asked of the registries: a kind of sensor, a table or a system that is
added is drawn, or whoever adds it is told that nobody draws it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import get_args

from support.dice import Dice, Keys
from support.hills import TILE, write_ridge
from support.random_sensors import (
    SENSOR_MAKERS,
    TABLE_MAKERS,
    drop_what_is_refused,
    random_link,
    random_sensor,
    tables_of,
)

from plotfeed.feeds.scene.presets.preset import names as preset_names
from plotfeed.feeds.scene.presets.preset import system_names
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import SENSORS
from plotfeed.feeds.scene.sensors.scan_keys import AnyScan
from plotfeed.feeds.testing.built_scene import toml_of
from plotfeed.testing import SITE

SECONDS = 60.0
PLAIN_M = 545  # Above sea level: some 50 m under the site


def written_scene(seed: int, folder: Path) -> Path:
    """The file of a random scene, and the ground that it may stand on."""
    if not (folder / TILE).exists():
        write_ridge(folder, height_m=700, plain_m=PLAIN_M)
    path = folder / f"{seed}.toml"
    path.write_text(toml_of(random_tree(seed)))
    return path


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


def _weather(dice: Dice) -> list[Keys]:
    whole = {
        "rain_mm_h": dice.between(1, 40),
        "vapour_g_m3": dice.between(2, 20),
        "wind_m_s": dice.between(1, 12),
        "rain_echo": True,
    }
    return [_spell(dice, {key: whole[key] for key in dice.some_of(*whole)})]


def _jammer(dice: Dice) -> list[Keys]:
    noise = {"eirp_w": dice.log_between(0.01, 10), "bandwidth_hz": 1e8}
    frequency_hz = dice.one_of(2.44e9, 3e9, 10e9)
    return [
        _spell(dice, {"id": "noisy", "frequency_hz": frequency_hz, **noise, **dice.place(4000)})
    ]


def _birds(dice: Dice) -> list[Keys]:
    path = [dice.place(2500, 40, 300) for _ in range(2)]
    return [{"id": "flock", "count": dice.one_of(1, 5), "path": path}]


def _road(dice: Dice) -> list[Keys]:
    path = [dice.place(3000, 1, 2) for _ in range(2)]
    return [{"id": "street", "cars_per_h": 200.0, "speed_m_s": 20.0, "path": path}]


def _turbine(dice: Dice) -> list[Keys]:
    return [{"id": "mill", "radius_m": dice.between(20, 60), **dice.place(3000, 60, 100)}]


def _clutter(dice: Dice) -> list[Keys]:
    corner = dice.place(2500, 0, 1)
    area = [
        {**corner, "east_m": corner["east_m"] + east_m, "north_m": corner["north_m"] + north_m}
        for east_m, north_m in ((0.0, 0.0), (800.0, 0.0), (0.0, 800.0))
    ]
    kind = dice.one_of({"plots_per_km2": 4.0}, {"threshold_db": 15.0, "texture_stays": False})
    return [{"id": "woods", "area": area, **kind}]


def _terrain(dice: Dice) -> Keys:
    return {"elevation": [TILE], "diffraction": dice.happens(0.5)}


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
SCENE_TABLES = {
    "terrain": _terrain,
    "weather": _weather,
    "jammer": _jammer,
    "birds": _birds,
    "road": _road,
    "turbine": _turbine,
    "clutter": _clutter,
    "target": _target,
    "swarm": _swarm,
    "cooperative": _cooperative,
}


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
