"""What is ordinary about a site: birds, a road, a turbine and clutter by its drones, and trees."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from plotfeed.feeds.engine.scene_drones import launch, trajectories_of
from plotfeed.feeds.scene.fields import site_frame
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.world_keys import (
    BirdsKeys,
    ClutterKeys,
    RoadKeys,
    TerrainKeys,
    TurbineKeys,
)
from plotfeed.models.state import Floats
from plotfeed.proto.utc import NS

START_UTC_NS = 1_767_268_800 * NS  # Where the scene does not say when it begins
# Those of the world that are usual somewhere, and the keys of a table of each.
WORLD_KEYS = {
    "terrain": TerrainKeys,
    "birds": BirdsKeys,
    "road": RoadKeys,
    "turbine": TurbineKeys,
    "clutter": ClutterKeys,
}
TREES = "trees.geojson"  # The file of an ordinary terrain


def ordinary_world(scene: Scene) -> dict[str, dict[str, Any]]:
    """Ordinary birds, road, turbine, clutter and terrain, by keys of scenes: a table of each.

    They are about the place on the ground above which drones are on average in the first minute.
    The terrain is that of `trees_about`. Raises `PlotfeedError`.
    """
    east_m, north_m = _middle_of_drones(scene)

    def place(east: float, north: float, up: float = 0.0) -> dict[str, float]:
        metres = {"east_m": east_m + east, "north_m": north_m + north, "above_site_m": up}
        return {name: round(value) for name, value in metres.items()}

    return {
        "terrain": {"buildings": [TREES]},
        "birds": {
            "id": "gulls",
            "count": 10,
            "path": [place(-300, -200, 50), place(300, -200, 50), place(0, 300, 50)],
        },
        "road": {
            "id": "road",
            "path": [place(-1000, -300), place(1000, 300)],
            "cars_per_h": 600.0,
            "speed_m_s": 20.0,
        },
        "turbine": {"id": "turbine", **place(400, 400, 100), "radius_m": 50.0},
        "clutter": {
            "id": "scrub",
            "area": [place(*each) for each in ((-500, -500), (500, -500), (500, 500), (-500, 500))],
            "plots_per_km2": 2.0,
        },
    }


def trees_about(scene: Scene) -> str:
    """GeoJSON of a wood before each sensor, 10 m high and 200 m wide, 300 m towards the drones."""
    site, drones_m = site_frame(scene.scene.site), _middle_of_drones(scene)
    features = []
    for sensor in scene.sensor:
        here_m = np.array(sensor.position_enu_m[:2])
        way = drones_m - here_m
        ahead = way / np.hypot(*way) if np.hypot(*way) else np.array([0.0, 1.0])
        right = np.array([ahead[1], -ahead[0]])
        corners = ((300, -100), (300, 100), (320, 100), (320, -100), (300, -100))
        ring_m = [here_m + along * ahead + across * right for along, across in corners]
        degrees = np.array(site.to_geodetic(np.column_stack([ring_m, np.zeros(5)])))
        ring = degrees[1::-1].T.round(7).tolist()
        shape = {"type": "Polygon", "coordinates": [ring]}
        features.append({"type": "Feature", "properties": {"height": 10}, "geometry": shape})
    return json.dumps({"type": "FeatureCollection", "features": features})


def _middle_of_drones(scene: Scene) -> Floats:
    """East and north of the site, metres (2,), of where drones are on average at first."""
    trajectories = trajectories_of(scene)
    launch(scene, trajectories, START_UTC_NS)
    t_utc_ns = START_UTC_NS + 5 * NS * np.arange(13)
    places_m = site_frame(scene.scene.site).from_ecef(trajectories.positions_at(t_utc_ns))
    names = frozenset(scene.fleet.names)
    own = [i for i, name in enumerate(trajectories.names) if name in names]
    there_m = places_m[:, own, :2].reshape(-1, 2)
    there_m = there_m[np.isfinite(there_m).all(axis=1)]
    return there_m.mean(axis=0) if len(there_m) else np.zeros(2)
