"""ASTERIX 048 from UDP, put on the Earth: one line for each plot.

plotfeed run examples/scenes/radar-udp.toml
pip install paho-mqtt
python examples/plots_udp.py [UDP_PORT [HOST [PORT [PREFIX]]]]

ASTERIX names its source by SAC and SIC alone. Where that stands is asked once over MQTT: the
description of each sensor is retained on PREFIX/SENSOR/description.
"""

from __future__ import annotations

import json
import math
import socket
import sys
from contextlib import suppress
from typing import Any

import paho.mqtt.client as paho

from plotfeed.models.frames import LocalFrame, aer_to_enu
from plotfeed.proto.asterix.codec.decode import Record, decode
from plotfeed.proto.errors import DecodeError

NM_M, FOOT_M, EARTH_M = 1852.0, 0.3048, 6_371_000.0

given, usual = sys.argv[1:], ("8600", "127.0.0.1", "1883", "plotfeed")
udp_port, host, port, prefix = (*given, *usual[len(given) :])
sensors: dict[tuple[int, int], dict[str, Any]] = {}


def connected(client: paho.Client, *_: Any) -> None:
    """Subscribed here, so that it is done again after each break of the connection."""
    client.subscribe(f"{prefix}/+/description", 1)


def described(_client: paho.Client, _userdata: Any, message: paho.MQTTMessage) -> None:
    """A sensor's description, by the codes that its ASTERIX has."""
    told = json.loads(message.payload)
    sensors[told.get("sac", 0), told.get("sic", 0)] = told


def line(record: Record) -> str | None:
    """A plot's time, sensor and place; None of what is no plot, or of nobody whom we know."""
    told = sensors.get((record.get("I048/010/SAC"), record.get("I048/010/SIC")))
    if told is None or record.get("I048/040") is None:
        return None
    range_m = record.get("I048/040/RHO") * NM_M
    # 048 has no elevation, but a height above the sea (110) where the radar measures heights.
    height_ft = record.get("I048/110")
    altitude_m = told["altitude_m"] if height_ft is None else height_ft * FOOT_M
    up_m = altitude_m - told["altitude_m"] - range_m**2 / (2 * EARTH_M)
    elevation_deg = math.degrees(math.asin(max(-1.0, min(1.0, up_m / range_m))))
    sensor = LocalFrame(told["latitude_deg"], told["longitude_deg"], told["height_m"])
    enu_m = aer_to_enu(record.get("I048/040/THETA"), elevation_deg, range_m)
    latitude_deg, longitude_deg, height_m = sensor.to_geodetic(enu_m)
    minutes, seconds = divmod(record.get("I048/140"), 60)
    time = f"{minutes // 60:02.0f}:{minutes % 60:02.0f}:{seconds:09.6f}"
    place = f"{latitude_deg:.6f} {longitude_deg:.6f} {height_m:.0f} m"
    return f"{time} {told['sensor']:10} {place}"


client = paho.Client(paho.CallbackAPIVersion.VERSION2)
client.on_connect, client.on_message = connected, described
client.connect(host, int(port))
client.loop_start()

with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp, suppress(KeyboardInterrupt):
    udp.bind(("127.0.0.1", int(udp_port)))
    while True:
        try:
            for record in decode(udp.recv(65_536)):
                if found := line(record):
                    print(found, flush=True)
        except DecodeError as error:
            print(error, file=sys.stderr)
