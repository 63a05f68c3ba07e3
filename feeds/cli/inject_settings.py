"""What `inject` is asked beside what it publishes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from plotfeed.feeds.console.option_fields import option


@dataclass(frozen=True, slots=True, kw_only=True)
class InjectSettings:
    """What the options of `inject` ask for."""

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
    changes: tuple[str, ...] = option(
        (),
        "Read or listen by this key, as a scene has it: of [drone.flight] and max_speed_m_s for a "
        "file, of [[telemetry.source]] for a source; rcs_m2, takeoff_height_m and "
        "geoid_undulation_m for both. May be repeated.",
        metavar="KEY=VALUE",
        name="--set",
    )
    duration: float | None = option(
        None, "End after listening to a source for so long.", over=0, metavar="SECONDS"
    )
