"""What `fleet` is asked beside the scene."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from plotfeed.feeds.console.option_fields import option


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetSettings:
    """What the options of `fleet` ask for, beside the scene."""

    workers: int = option(
        2,
        "Share the sensors out to so many parts: one for each core is usual.",
        low=1,
        high=10_000,
        metavar="N",
    )
    spares: int = option(
        0,
        "Have so many more processes of each part stand by, which work out the same and take over "
        "at once.",
        low=0,
        high=9,
        metavar="N",
    )
    start: str | None = option(
        None,
        "Begin the scene at this time, as 2026-01-01T12:00:00Z; without it in five seconds.",
        metavar="TIME",
    )
    broker: str | None = option(
        None,
        "Connect all parts to the broker at mqtt://HOST:PORT or mqtts://HOST:PORT; without it the "
        "scene's broker is used.",
        metavar="URL",
    )
    duration: float | None = option(
        None,
        "End after so many seconds of the scene's time; else as the scene says, or never.",
        over=0,
        metavar="SECONDS",
    )
    record: Path | None = option(
        None,
        "Record what each process takes in and sends, and its ledger, to MCAP files there.",
        path="folder",
        metavar="DIR",
    )
    kubernetes: bool = option(
        False, "Start nothing, but print manifests with which Kubernetes runs the parts."
    )
    ray: str | None = option(
        None,
        "Have the Ray cluster whose head is there run the parts, and return.",
        metavar="HOST:PORT",
    )
    page: str | None = option(
        None,
        "Serve a page there that shows the scene and how its parts do: to this machine alone, "
        "or where HOST says, with a token.",
        metavar="[HOST:]PORT",
    )
    as_json: bool = option(False, "Print the answer as one JSON object.")
