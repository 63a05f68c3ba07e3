"""Part K/N of a scene as the command line asks for it: its sensors, and its time."""

from __future__ import annotations

import re
import time

from plotfeed.feeds.fleet.partition import partition
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.part import SessionPart
from plotfeed.feeds.timing.clock import Clock, InstantClock, WallClock
from plotfeed.feeds.transport.brokers import NO_BROKER
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS, iso_utc, utc_ns, whole_second_ns

LEAD_NS = 5 * NS  # In which processes are up
FASTEST = "max"  # In place of a speed


def check_scene(scene: Scene, broker: str | None) -> None:
    """Raise `PlotfeedError` for a scene that several processes cannot run."""
    if broker is None:
        raise PlotfeedError(
            "the parts of a fleet need a broker that all of them reach: "
            "--broker mqtt://HOST:PORT, or none"
        )
    if scene.outgoing.sources:
        raise PlotfeedError(
            "telemetry.source: the parts of a fleet listen to brokers alone; "
            "let plotfeed inject publish what the source says"
        )
    if scene.outgoing.websocket or scene.outgoing.remote_id_service:
        raise PlotfeedError(
            "websocket, remote_id_service: parts cannot all listen on one port; leave them out"
        )


def start_of(text: str | None) -> str:
    """A start as it is given to all parts: the one asked for, else in `LEAD_NS`, a whole second.

    Raises `PlotfeedError`.
    """
    if text is None:
        return iso_utc(whole_second_ns(time.time_ns() + LEAD_NS))
    if utc_ns(text) is None:
        raise PlotfeedError(f"--start: expected a time as 2026-01-01T12:00:00Z, not {text!r}")
    return text


def part_asked(
    scene: Scene, text: str, *, start: str | None, broker: str | None, speed: str
) -> tuple[SessionPart, Clock]:
    """The part, and the clock of its session; raises `PlotfeedError`.

    `start` is when the scene begins, by the world's time.
    """
    found = re.fullmatch(r"([0-9]{1,5})/([0-9]{1,5})", text)
    number, parts = map(int, found.groups()) if found else (0, 0)
    if not 1 <= number <= parts:
        raise PlotfeedError(f"--part: expected K/N, such as 2/3 for the second of three: {text!r}")
    broker = broker or scene.outgoing.broker
    check_scene(scene, broker)
    is_simulated = speed == FASTEST and broker == NO_BROKER
    if speed != "1" and not is_simulated:
        raise PlotfeedError("--part: parts run in real time, or by --speed max with --broker none")
    began_ns = scene.scene.start_utc_ns
    if start is None and not (is_simulated and began_ns):
        raise PlotfeedError(
            "--part needs --start TIME, the same for all parts, such as "
            f"--start {start_of(None)}: then all agree on the scene's time"
        )
    start_ns = (utc_ns(start_of(start)) or 0) if start else 0
    began_ns = began_ns or start_ns
    sensors = partition(scene, parts)
    if len(sensors) < parts:
        raise PlotfeedError(
            f"--part: the scene's sensors make {len(sensors)} parts at most, not {parts}: "
            "those that cue each other, or belong to a system, stay together"
        )
    part = SessionPart(
        number=number, parts=parts, sensors=sensors[number - 1], began_utc_ns=began_ns
    )
    if is_simulated:
        return part, InstantClock(began_ns)
    if began_ns == start_ns:
        return part, WallClock()
    clock = WallClock(began_ns + time.time_ns() - start_ns)
    clock.start()
    return part, clock
