"""What `inject` is asked, and how flights are read and sources are heard."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import click

from plotfeed.feeds.console.option_fields import option

if TYPE_CHECKING:
    from plotfeed.feeds.telemetry.flights.flight import FlightOptions


@dataclass(frozen=True, slots=True, kw_only=True)
class InjectSettings:
    """What the options of `inject` ask for, beside how to read the flight."""

    drone: str | None = option(
        None,
        "Name the drone so in its topic; without it as the file is called, or as the source says.",
        metavar="ID",
    )
    broker: str = option(
        "mqtt://127.0.0.1:1883",
        "Publish at the broker mqtt://HOST:PORT or mqtts://HOST:PORT.",
        metavar="URL",
    )
    prefix: str = option(
        "plotfeed", "Begin the topic with these levels, as the session's scene has them."
    )
    speed: float = option(1.0, "Fly so many times as fast as it was flown.", low=0.01, high=1000)
    shift: bool = option(
        False,
        "Let the flight begin now; without it reports keep the times of the file.",
        name="--now",
    )
    encoding: Literal["protobuf", "json"] = option("protobuf", "Encode reports so.")
    raw: bool = option(False, "Send positions as recorded, without smoothing.")
    takeoff_height_m: float | None = option(
        None,
        "Add the height of the place of take-off above the ellipsoid to altitudes above it.",
        metavar="METRES",
    )
    geoid_undulation_m: float | None = option(
        None,
        "Add the height of the sea above the ellipsoid to altitudes above mean sea level.",
        metavar="METRES",
    )
    rcs_m2: float | None = option(
        None,
        "Report this radar cross-section in square metres, in place of the scene's.",
        over=0,
        metavar="M2",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightKeys:
    """What a file of a flight does not say of itself."""

    columns: tuple[str, ...] = option(
        (),
        "Read one of our columns under a CSV's own name for it, such as latitude_deg=lat; may be "
        "repeated.",
        metavar="OURS=THEIRS",
        name="--column",
    )
    altitude_reference: Literal["ellipsoid", "mean_sea_level", "above_takeoff"] | None = option(
        None, "Take altitudes as above this, where the file does not say above what they are."
    )
    gps_order: Literal["lat-lon", "lon-lat"] | None = option(
        None, "Take the GPS(A,B) values of a DJI subtitle file so, where it shows no order."
    )
    utc_offset_h: float = option(
        0.0, "Take times without a zone as so many hours ahead of UTC.", low=-14, high=14
    )
    height_m: float | None = option(
        None,
        "Fly at this height above take-off where the file has no heights.",
        low=-1000,
        high=100000,
        metavar="METRES",
    )
    max_speed_m_s: float = option(
        150.0, "Skip positions that cannot have been flown to at this speed.", over=0, high=1000
    )

    def parsed(self) -> FlightOptions:
        """What readers are told; raises `click.BadParameter`."""
        from plotfeed.feeds.telemetry.flights.flight import FlightOptions
        from plotfeed.models.state import AltitudeReference

        pairs = [column.partition("=") for column in self.columns]
        if any(not (ours and equals and theirs) for ours, equals, theirs in pairs):
            raise click.BadParameter("expected OURS=THEIRS", param_hint="--column")
        reference = self.altitude_reference
        return FlightOptions(
            columns={ours: theirs for ours, _, theirs in pairs},
            altitude_reference=None if reference is None else AltitudeReference(reference),
            gps_order=self.gps_order,
            utc_offset_h=self.utc_offset_h,
            max_speed_m_s=self.max_speed_m_s,
            height_m=self.height_m,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceKeys:
    """How a live source is heard."""

    duration: float | None = option(
        None, "End after listening to a source for so long.", over=0, metavar="SECONDS"
    )
    altitude: Literal["mean_sea_level", "above_takeoff"] = option(
        "mean_sea_level", "Take this altitude of a MAVLink source: above the sea, or above home."
    )
    view: str | None = option(
        None, "Send these two corners to a service of network Remote ID.", metavar="LAT,LON,LAT,LON"
    )
    qnh_hpa: float | None = option(
        None,
        "Take this pressure at sea level for pressure altitudes of ADS-B.",
        low=850,
        high=1100,
        metavar="HPA",
    )
    interface: str | None = option(
        None,
        "Join a multicast group of a source at this network interface, such as eth0.",
        metavar="NAME",
    )
    ask_hz: float | None = option(
        None,
        "Send requests to a MAVLink source for so many positions a second.",
        low=0.1,
        high=50,
        metavar="HERTZ",
    )
