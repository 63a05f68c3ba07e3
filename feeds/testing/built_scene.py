"""A scene built in a few words: sensors and drones by where they are seen from the site."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from plotfeed.feeds.scene.scene import Scene, parsed
from plotfeed.feeds.scene.scene_text import inline
from plotfeed.models.frames import LocalFrame, aer_to_enu

SITE = LocalFrame(40.45, -3.73, 650.0)


def staring(period_s: float = 1.0) -> dict[str, Any]:
    """Keys of a scan that sees everything once in each period."""
    return {"kind": "staring", "period_s": period_s}


def rotating(period_s: float = 1.0, sectors: int = 8) -> dict[str, Any]:
    """Keys of a scan that turns once in each period, clockwise from north."""
    return {"kind": "rotating", "period_s": period_s, "sectors": sectors}


def radar(**changes: Any) -> dict[str, Any]:
    """Keys of a sensor "radar": the paper's active radar, which stares at the whole sky.

    It has no errors but those of noise, and hardly a false alarm. `changes` are keys of
    `[[sensor]]` in place of these; None leaves one out.
    """
    paper = {
        "id": "radar",
        "type": "active_radar",
        "report": ["asterix-048", "plots"],
        "scan": staring(),
        "power_w": 500.0,
        "frequency_hz": 10e9,
        "gain_tx_dbi": 20.0,
        "gain_rx_dbi": 35.4,
        "integration_s": 0.06,
        "loss_db": 4.0,
        "noise_figure_db": 5.0,
        "pfa": 1e-6,
        "n_reference": 16,
        "range_resolution_m": 10.0,
        "range_max_m": 20_000.0,
        "azimuth_beamwidth_deg": 2.0,
        "elevation_beamwidth_deg": 6.0,
        "elevation_min_deg": -10.0,
        "elevation_max_deg": 80.0,
        "range_floor_m": 0.0,
        "azimuth_floor_deg": 0.0,
        "elevation_floor_deg": 0.0,
    }
    return paper | changes


def waypoint(azimuth_deg: float, elevation_deg: float, range_m: float) -> dict[str, float]:
    """Keys of a place that is seen from the site at that azimuth, elevation and range."""
    enu_m = aer_to_enu(azimuth_deg, elevation_deg, range_m)
    latitude_deg, longitude_deg, height_m = (float(x) for x in SITE.to_geodetic(enu_m))
    return {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg, "height_m": height_m}


def flown(name: str, *path: dict[str, float], **changes: Any) -> dict[str, Any]:
    """Keys of a drone that flies there and back at 10 m/s; `changes` are keys of `[[drone]]`."""
    return {"id": name, "path": list(path), "speed_m_s": 10.0, "repeat": True} | changes


def held(
    name: str, azimuth_deg: float, elevation_deg: float, range_m: float, **changes: Any
) -> dict[str, Any]:
    """Keys of a drone that stays where it is, within a centimetre."""
    places = (waypoint(azimuth_deg, elevation_deg, r) for r in (range_m, range_m + 0.01))
    return flown(name, *places, speed_m_s=0.01, **changes)


def scene(
    sensors: Sequence[dict[str, Any]],
    drones: Sequence[dict[str, Any]] = (),
    *,
    seed: int,
    folder: Path = Path(),
    **tables: Any,
) -> Scene:
    """The scene of these sensors and drones at `SITE`; raises `SceneError`.

    `tables` are other tables of scenes, such as `mqtt={"prefix": "here"}`; files that the scene
    names are looked for in `folder`.
    """
    general = {
        "name": "road",
        "seed": seed,
        "site": {
            "latitude_deg": SITE.latitude_deg,
            "longitude_deg": SITE.longitude_deg,
            "height_m": SITE.height_m,
        },
    }
    tree = {"scene": general, "sensor": list(sensors), "drone": list(drones)} | tables
    return parsed(toml_of(tree).encode(), folder / "road.toml")


def toml_of(tree: dict[str, Any]) -> str:
    """The text of a scene's file that has these tables and keys."""
    return "".join(f"{name} = {inline(value)}\n" for name, value in tree.items())
