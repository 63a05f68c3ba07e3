"""What `run` and `demo` are asked beside the scene."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from plotfeed.feeds.console.option_fields import option


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSettings:
    """What the options of `run` and `demo` ask for, beside the scene."""

    broker: str | None = option(
        None,
        "Connect to the broker at mqtt://HOST:PORT or mqtts://HOST:PORT, or to none by 'none'; "
        "without it the scene's broker is used, else an embedded one.",
        metavar="URL",
    )
    wait: bool = option(False, "Wait for a broker that is not up yet, with a line, until it is.")
    udp: tuple[str, ...] = option(
        (),
        "Send all ASTERIX to this address by UDP, unicast or multicast, instead of where the "
        "scene says, with keys of its [[udp]] such as ?ttl=4&interface=eth0; may be repeated.",
        metavar="ADDRESS:PORT[?KEYS]",
    )
    middleware: str | None = option(
        None,
        "Connect to this SAPIENT middleware by TCP instead of the scene's.",
        metavar="HOST:PORT",
    )
    tak: tuple[str, ...] = option(
        (),
        "Send events of Cursor on Target to the TAK server at tcp://HOST:PORT instead of the "
        "scene's; may be repeated.",
        metavar="URL",
    )
    http: tuple[str, ...] = option(
        (),
        "Post tracks to this address instead of the scene's, such as "
        "air-traffic=http://HOST:PORT/PATH, with the bearer token in "
        "PLOTFEED_HTTP_TOKEN_COMMAND_LINE, if any; may be repeated.",
        metavar="FORMAT=URL",
    )
    duration: float | None = option(
        None,
        "End after so many seconds of the session's time; else as the scene says, or never.",
        over=0,
        metavar="SECONDS",
    )
    speed: str = option(
        "1",
        "Run so many times as fast as real time (0.001 to 10000), slower where this machine "
        "would else miss scans; or with 'max' as fast as possible.",
        metavar="FACTOR",
    )
    write: Path | None = option(
        None,
        "Write the ASTERIX data blocks that are sent to this raw file (.ast) too.",
        path="file",
        metavar="FILE",
    )
    record: Path | None = option(
        None,
        "Record all that comes in and goes out, and the ledger, to this MCAP file.",
        path="file",
        metavar="FILE",
    )
    force: bool = option(
        False, "Replace the files of --record and --write where they are there already."
    )
    metrics: str | None = option(
        None,
        "Serve Prometheus metrics there: to this machine alone, or where HOST says, with a token.",
        metavar="[HOST:]PORT",
    )
    page: str | None = option(
        None,
        "Serve the live page there: to this machine alone, or where HOST says, with a token; "
        "below /audience/ for an audience, without truth and controls. With 'none' there is none.",
        metavar="[HOST:]PORT",
    )
    as_json: bool = option(False, "Print nothing but the totals at the end, as one JSON object.")
    telemetry: Path | None = None  # A recorded session whose inputs are taken in again
    shows_page: bool = False  # Whether the page is served even if nobody said where
    part: str | None = None  # K/N, where other processes run the other parts of the scene
    start: str | None = None  # When all parts begin
    # Whether time can be paused and hurried although nobody asked for another than the world's.
    can_be_held: bool = False
