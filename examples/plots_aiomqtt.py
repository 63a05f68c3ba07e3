"""Plots on the Earth in asyncio, with aiomqtt: one line for each plot.

pip install aiomqtt
python examples/plots_aiomqtt.py [HOST [PORT [PREFIX]]]

Range and angles of a plot count from its sensor, whose place is in the description that is
retained on PREFIX/SENSOR/description, so that whoever comes later has it too.
"""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import AsyncIterator
from contextlib import suppress
from datetime import UTC, datetime

import aiomqtt

from plotfeed.models.frames import LocalFrame, aer_to_enu
from plotfeed.proto import plotfeed_pb2 as pb

RECONNECT_S = 1.0
# Sensor, plot, and its latitude, longitude and height above the ellipsoid.
PlacedPlot = tuple[str, pb.Plot, tuple[float, float, float]]


async def plots(client: aiomqtt.Client, prefix: str) -> AsyncIterator[PlacedPlot]:
    """Sensors and their plots on the Earth, as long as the connection lasts."""
    places: dict[str, LocalFrame] = {}
    await client.subscribe(f"{prefix}/+/description", qos=1)
    await client.subscribe(f"{prefix}/+/plots")
    async for message in client.messages:
        if message.topic.matches(f"{prefix}/+/description"):
            told = json.loads(message.payload)
            places[told["sensor"]] = LocalFrame(
                told["latitude_deg"], told["longitude_deg"], told["height_m"]
            )
            continue
        batch = pb.PlotBatch.FromString(message.payload)
        for plot in batch.plots if batch.sensor in places else ():
            if plot.HasField("range_m") and plot.HasField("azimuth_deg"):
                # A sensor that measures no elevation has 0 here: plots lie on its horizontal.
                enu_m = aer_to_enu(plot.azimuth_deg, plot.elevation_deg, plot.range_m)
                yield batch.sensor, plot, places[batch.sensor].to_geodetic(enu_m)


async def main(host: str = "127.0.0.1", port: str = "1883", prefix: str = "plotfeed") -> None:
    """Plots until it is interrupted, over every break of the connection."""
    while True:
        try:
            async with aiomqtt.Client(host, int(port)) as client:
                async for sensor, plot, (latitude_deg, longitude_deg, height_m) in plots(
                    client, prefix
                ):
                    time = datetime.fromtimestamp(plot.time_utc_ns / 1e9, UTC)
                    print(
                        f"{time:%H:%M:%S.%f} {sensor:10} "
                        f"{latitude_deg:.6f} {longitude_deg:.6f} {height_m:.0f} m",
                        flush=True,
                    )
        except aiomqtt.MqttError as error:
            print(error, file=sys.stderr)
            await asyncio.sleep(RECONNECT_S)


with suppress(KeyboardInterrupt):
    asyncio.run(main(*sys.argv[1:]))
