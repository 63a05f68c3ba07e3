"""A tracker that tells the same place whenever plots come, or does what no tracker should.

    python echo_tracker.py HOST PORT PREFIX TOPIC HOW [LATITUDE LONGITUDE]

HOW is good, silent, dies, garbage or future.
"""

from __future__ import annotations

import json
import os
import sys
from typing import Any

import paho.mqtt.client as paho

host, port, prefix, topic, how, *place = sys.argv[1:]
GARBAGE = (b"", b"\x00\xff\xfe", b"[", b'{"track": []}', b"\x3e\xff\xff\xff", b"null")
told = {"track": 1, "latitude_deg": float(place[0]), "longitude_deg": float(place[1])}
if how == "future":
    told["time_utc"] = "2100-01-01T00:00:00Z"


def connected(client: paho.Client, *_: Any) -> None:
    client.subscribe([(f"{prefix}/+/plots", 0), (f"{prefix}/truth", 0)])
    print("ready", flush=True)


def plotted(client: paho.Client, _userdata: Any, message: paho.MQTTMessage) -> None:
    if message.topic == f"{prefix}/truth":
        os._exit(5)  # no tracker under test is to know it
    if how == "dies":
        print("out of luck", flush=True)
        os._exit(3)
    for payload in GARBAGE if how == "garbage" else [json.dumps(told).encode()]:
        if how != "silent":
            client.publish(topic, payload)


client = paho.Client(paho.CallbackAPIVersion.VERSION2)
client.on_connect, client.on_message = connected, plotted
client.connect(host, int(port))
client.loop_forever()
