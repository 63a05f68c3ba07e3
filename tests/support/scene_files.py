"""Scenes for tests, as the text of their files."""

from __future__ import annotations

from pathlib import Path

from support.brokers import free_port

ORIGIN = "http://127.0.0.1:8000"
FOR_BROWSERS = f'[mqtt.embedded]\nwebsocket_origins = ["{ORIGIN}"]'  # Lets a page of that origin in

RADAR = """
[[sensor]]
id = "{id}"
type = "active_radar"
power_w = 500.0
frequency_hz = 10e9
gain_tx_dbi = 30.0
integration_s = 0.01
pfa = 1e-5
range_resolution_m = 30.0
range_max_m = 10_000.0
azimuth_beamwidth_deg = 2.0
elevation_beamwidth_deg = 10.0
elevation_min_deg = -5.0
elevation_max_deg = 40.0
{more}
[sensor.scan]
kind = "rotating"
period_s = {period_s}
sectors = {sectors}
"""

DRONE = """
[[drone]]
id = "visitor"
rcs_m2 = 0.05
speed_m_s = 15.0
repeat = true
path = [
    { east_m = 1500.0, north_m = 800.0, above_site_m = 200.0 },
    { east_m = -900.0, north_m = 1200.0, above_site_m = 200.0 },
]
"""

# Stays where it is, within a centimetre.
STILL = """
[[drone]]
id = "still"
rcs_m2 = 1.0
speed_m_s = 0.01
repeat = true
path = [
    { east_m = 800.0, north_m = 600.0, above_site_m = 150.0 },
    { east_m = 800.01, north_m = 600.0, above_site_m = 150.0 },
]
"""


def radar(id: str = "radar", *, period_s: float = 0.5, sectors: int = 8, more: str = "") -> str:  # noqa: A002
    return RADAR.format(id=id, period_s=period_s, sectors=sectors, more=more)


def scene_text(
    *,
    start_utc: str | None = None,
    general: str = "",
    telemetry: str = "takeoff_height_m = 650.0\ngeoid_undulation_m = 51.0",
    port: int | None = None,
    mqtt: str = "",
    sensors: str | None = None,
    drones: str = DRONE,
) -> str:
    start = f"start_utc = {start_utc}" if start_utc else ""
    return f"""
[scene]
name = "test"
seed = 3
{start}
{general}
[scene.site]
latitude_deg = 40.45
longitude_deg = -3.73
height_m = 650.0
[telemetry]
{telemetry}
[mqtt]
port = {free_port() if port is None else port}
{mqtt}
{radar() if sensors is None else sensors}
{drones}
"""


def scene_file(folder: Path, text: str) -> Path:
    path = folder / "scene.toml"
    path.write_text(text)
    return path
