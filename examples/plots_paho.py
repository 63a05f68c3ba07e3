"""Plots on the Earth with paho-mqtt, in a thread of its own: one line for each plot.

pip install paho-mqtt
python examples/plots_paho.py [HOST [PORT [PREFIX]]]

Range and angles of a plot count from its sensor, whose place is in the description that is
retained on PREFIX/SENSOR/description, so that whoever comes later has it too.
"""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

import paho.mqtt.client as paho

from plotfeed.models.frames import LocalFrame, aer_to_enu
from plotfeed.proto import plotfeed_pb2 as pb

host, port, prefix = (*sys.argv[1:], *("127.0.0.1", "1883", "plotfeed")[len(sys.argv) - 1 :])
places: dict[str, LocalFrame] = {}


def connected(client: paho.Client, *_: Any) -> None:
    """Subscribed here, so that it is done again after each break of the connection."""
    client.subscribe([(f"{prefix}/+/description", 1), (f"{prefix}/+/plots", 0)])


def described(_client: paho.Client, _userdata: Any, message: paho.MQTTMessage) -> None:
    """Where a sensor stands, anew whenever it changes."""
    told = json.loads(message.payload)
    places[told["sensor"]] = LocalFrame(
        told["latitude_deg"], told["longitude_deg"], told["height_m"]
    )


def plotted(_client: paho.Client, _userdata: Any, message: paho.MQTTMessage) -> None:
    """One line for each plot of a sensor that measures range and azimuth."""
    batch = pb.PlotBatch.FromString(message.payload)
    for plot in batch.plots if batch.sensor in places else ():
        if plot.HasField("range_m") and plot.HasField("azimuth_deg"):
            # A sensor that measures no elevation has 0 here: its plots lie on its horizontal.
            enu_m = aer_to_enu(plot.azimuth_deg, plot.elevation_deg, plot.range_m)
            latitude_deg, longitude_deg, height_m = places[batch.sensor].to_geodetic(enu_m)
            time = datetime.fromtimestamp(plot.time_utc_ns / 1e9, UTC)
            print(
                f"{time:%H:%M:%S.%f} {batch.sensor:10} "
                f"{latitude_deg:.6f} {longitude_deg:.6f} {height_m:.0f} m",
                flush=True,
            )


client = paho.Client(paho.CallbackAPIVersion.VERSION2)
client.on_connect = connected
client.message_callback_add(f"{prefix}/+/description", described)
client.message_callback_add(f"{prefix}/+/plots", plotted)
client.connect(host, int(port))
with suppress(KeyboardInterrupt):
    client.loop_forever()
