"""The plain tracker that plotfeed itself offers, as a tracker under test: plots in, tracks out.

pip install paho-mqtt
python examples/plain_tracker.py [HOST [PORT [PREFIX [TOPIC]]]]

It follows each sensor that measures range and azimuth by itself, and publishes its tracks on TOPIC
as ASTERIX 062, after every sector that has some. It is no commercial tracker, and knows no truth.
"""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from dataclasses import fields
from typing import Any

import numpy as np
import paho.mqtt.client as paho

from plotfeed.models.accuracy import stated_covariance_m2
from plotfeed.models.frames import LocalFrame, aer_to_enu
from plotfeed.models.plain_tracker import LocatedPlots, PlainMotion, PlainTracker
from plotfeed.models.state import Plots
from plotfeed.models.tracks import TrackRule, TrackStates
from plotfeed.proto.asterix.cat062 import TrackEncoder062
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.plot_messages import batch_in, plots_of_batches
from plotfeed.proto.tracks.encode_tracks import Tracks

NS = 1_000_000_000
ACCELERATION_M_S2 = 3.0
MEASURED = (
    "range_m", "azimuth_deg", "elevation_deg",
    "sigma_range_m", "sigma_azimuth_deg", "sigma_elevation_deg",
)  # fmt: skip


class Follower:
    """The tracks of one sensor, as its description has it."""

    def __init__(self, told: dict[str, Any], number: int) -> None:
        self.frame = LocalFrame(told["latitude_deg"], told["longitude_deg"], told["height_m"])
        self.sectors = int(told.get("sectors", 1))
        self.period_ns = round(told["scan_period_s"] * NS)
        rule = TrackRule(
            confirm_hits=3,
            confirm_window=5,
            drop_misses=5,
            period_ns=self.period_ns,
            patience_ns=self.period_ns // 2 if self.sectors > 1 else 0,
            first_number=1000 * number + 1,  # so that no track of another sensor has it
            last_number=1000 * number + 1000,
        )
        motion = PlainMotion(
            density_m2_s3=ACCELERATION_M_S2**2 * self.period_ns / NS,
            initial_speed_m_s=15.0,
            gate_probability=0.999,
        )
        self.tracker = PlainTracker(rule, motion, turns=self.sectors > 1)
        self.encoder = TrackEncoder062(25, number)

    def blocks(self, payload: bytes) -> bytes:
        """Tracks at the end of the sector that a batch is of."""
        batch = batch_in(payload)
        start_ns, end_ns = (
            (batch.scan * self.sectors + batch.sector + more) * self.period_ns // self.sectors
            for more in (0, 1)
        )
        measured = plots_of_batches([batch])
        plots = Plots.of(
            t_utc_ns=measured.t_utc_ns.astype(np.int64),
            **{name: np.array(getattr(measured, name)) for name in MEASURED},
        )
        states = self.tracker.take(self.located(plots), start_ns=start_ns, end_ns=end_ns)
        told = self.told(states, end_ns)
        which = (states.has_height, ~states.has_height)
        return b"".join(b for rows in which for b in self.encoder.blocks(told.rows(rows)))

    def located(self, plots: Plots) -> LocatedPlots:
        """Plots east, north and up of the sensor; without an elevation, on its horizontal."""
        has_height = ~np.isnan(plots.elevation_deg)
        level_deg = np.where(has_height, plots.elevation_deg, 0.0)
        covariance_m2 = stated_covariance_m2(plots) + 1e-4 * np.eye(3)
        covariance_m2[~has_height, 2, 2] += 1.0
        found = LocatedPlots(
            t_utc_ns=plots.t_utc_ns,
            channel=np.zeros(len(plots), np.int64),
            position_enu_m=aer_to_enu(plots.azimuth_deg, level_deg, plots.range_m),
            covariance_m2=covariance_m2,
            has_height=has_height,
        )
        is_place = np.isfinite(found.position_enu_m).all(axis=1)
        return found.rows(is_place & np.isfinite(covariance_m2).all(axis=(1, 2)))

    def told(self, states: TrackStates, end_ns: int) -> Tracks:
        """Tracks on the Earth; no height of those of a sensor that measures none."""
        latitude_deg, longitude_deg, height_m = self.frame.to_geodetic(states.position_enu_m)
        has = states.has_height
        columns = {
            "track": states.track,
            "t_utc_ns": np.full(len(states), end_ns),
            "latitude_deg": latitude_deg,
            "longitude_deg": longitude_deg,
            "east_m": states.position_enu_m[:, 0],
            "north_m": states.position_enu_m[:, 1],
            "velocity_east_m_s": states.velocity_enu_m_s[:, 0],
            "velocity_north_m_s": states.velocity_enu_m_s[:, 1],
            "height_m": np.where(has, height_m, np.nan),
            "climb_m_s": np.where(has, states.velocity_enu_m_s[:, 2], np.nan),
            "age_s": states.age_s,
            "sigma_east_m": states.sigma_position_m[:, 0],
            "sigma_north_m": states.sigma_position_m[:, 1],
            "tentative": np.zeros(len(states), np.bool_),
            "coasted": states.misses > 0,
            "first": states.first,
            "last": states.last,
        }
        return Tracks(**{field.name: columns[field.name] for field in fields(Tracks)})


def main() -> None:
    """Follow what comes until the broker or the user ends it."""
    usual = ("127.0.0.1", "1883", "plotfeed", "tracker/tracks")
    host, port, prefix, topic = (*sys.argv[1:], *usual[len(sys.argv) - 1 :])
    followers: dict[str, Follower | None] = {}

    def connected(client: paho.Client, *_: Any) -> None:
        client.subscribe([(f"{prefix}/+/description", 1), (f"{prefix}/+/plots", 0)])
        print(f"tracks of {prefix}/+/plots go to {topic}", flush=True)

    def described(_client: paho.Client, _userdata: Any, message: paho.MQTTMessage) -> None:
        told = json.loads(message.payload)
        if told["sensor"] not in followers:
            can = told.get("range_kind") == "SLANT"
            followers[told["sensor"]] = Follower(told, len(followers) + 1) if can else None

    def plotted(client: paho.Client, _userdata: Any, message: paho.MQTTMessage) -> None:
        follower = followers.get(message.topic.split("/")[-2])
        if follower is None:
            return
        try:
            blocks = follower.blocks(message.payload)
        except DecodeError as error:
            print(f"{message.topic}: {error}", file=sys.stderr)
            return
        if blocks:
            client.publish(topic, blocks)

    client = paho.Client(paho.CallbackAPIVersion.VERSION2)
    client.on_connect = connected
    client.message_callback_add(f"{prefix}/+/description", described)
    client.message_callback_add(f"{prefix}/+/plots", plotted)
    client.connect(host, int(port))
    with suppress(KeyboardInterrupt):
        client.loop_forever()


if __name__ == "__main__":
    main()
