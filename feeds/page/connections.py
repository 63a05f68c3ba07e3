"""Where and how to receive what a session sends, as the page tells it of each sensor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from plotfeed.feeds.scene.output_keys import UdpDestination
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.session.sensor_description import outputs_of


def connections(scene: Scene, urls: Mapping[str, str], *, sends_udp: bool = True) -> dict[str, Any]:
    """Brokers, and of each sensor its topics and what of it goes by UDP, as JSON.

    `urls` are addresses of the session's brokers by protocol, whatever is said after them. There is
    no word of the ledger, of control and of telemetry: they are not for a tracker.
    """
    access = scene.outgoing.credentials_file is not None
    return {
        "brokers": [
            {"protocol": protocol, "url": url.split()[0], "needs_password": access}
            for protocol, url in urls.items()
        ],
        "sensors": {
            sensor.id: {
                "topics": [
                    {"topic": o.topic, "format": o.format, "content_type": o.content_type}
                    for o in outputs_of(scene.mqtt.prefix, sensor)
                ],
                "udp": [_udp(to) for to in scene.outgoing.udp if _goes(to, sensor)]
                if sends_udp
                else [],
            }
            for sensor in scene.sensor
        },
    }


def _goes(to: UdpDestination, sensor: Sensor) -> bool:
    """Whether anything of that sensor goes there."""
    has = any(
        to.format == name or (to.format is None and REPORT_FORMATS[name].categories)
        for name in sensor.report
    )
    return to.takes(sensor.id) and has


def _udp(to: UdpDestination) -> dict[str, Any]:
    return {
        "destination": to.destination,
        "is_multicast": to.is_multicast,
        "interface": to.interface,
        "carries": to.carries,
    }
