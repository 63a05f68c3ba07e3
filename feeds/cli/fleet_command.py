"""A fleet in a terminal: begun, and asked how it does."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
from collections.abc import Iterator
from typing import Any

from plotfeed.feeds.console import INTERRUPTED
from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.console.printed import aligned, say
from plotfeed.feeds.console.process import stopped_by_signals
from plotfeed.feeds.console.status_line import show_last_status, show_status
from plotfeed.feeds.fleet.coordinator import Coordinator
from plotfeed.feeds.fleet.fleet_link import FleetLink, health
from plotfeed.feeds.fleet.fleet_parts import FleetSettings
from plotfeed.feeds.fleet.fleet_status import gap_words, part_rows, told_in
from plotfeed.feeds.fleet.ray_workers import starter
from plotfeed.feeds.lab.runs import connected
from plotfeed.feeds.page.page_access import PageAddress, fixed_tokens
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.session.outputs import NO_BROKER, broker_address
from plotfeed.feeds.session.session_part import FLEET
from plotfeed.feeds.transport.mqtt.client import MqttTransport
from plotfeed.proto.errors import PlotfeedError

CONNECT_S = 15.0
HEARD_S = 10.0
"""By then a broker has passed on what it retains."""
FASTEST = "max"
PAGE_LIBRARIES = ("starlette", "uvicorn", "websockets")
COUNTS = ("plots", "missed_scans")


class NoFleetError(PlotfeedError):
    """A prefix on which no fleet says that it runs."""

    exit_code = 1


def run_fleet(
    scene: Scene, ray_address: str | None, metrics: str | None, page: str | None, **asked: Any
) -> int:
    """Run a scene over many workers until it ends or is stopped; the exit code."""
    as_json, speed = asked.pop("as_json"), asked.pop("speed")
    broker = asked.pop("broker") or scene.outgoing.broker
    check_fleet(scene, broker, speed)
    if page is not None:
        check_page(page, broker)
    settings = FleetSettings(
        broker=broker,
        is_simulated=speed == FASTEST,
        duration_s=asked.pop("duration") or scene.scene.duration_s,
        **asked,
    )
    if settings.record is not None:
        settings.record.mkdir(parents=True, exist_ok=True)
    with connected(ray_address, settings.workers) as ray, contextlib.ExitStack() as served:
        fleet = Coordinator(scene, settings, starter(ray))
        if metrics is not None:
            from plotfeed.feeds.metrics import FleetCollector, MetricsAddress
            from plotfeed.feeds.metrics import served as serve

            served.enter_context(serve(MetricsAddress.parse(metrics), FleetCollector(fleet)))
        code = asyncio.run(_run(fleet, page, quiet=as_json))
    if as_json:
        say(json.dumps({**health(fleet, "ENDED"), "counts": fleet.counts}))
    else:
        show_last_status(_line(fleet))
    return code


def check_fleet(scene: Scene, broker: str | None, speed: str) -> None:
    """Raise `PlotfeedError` for a scene that many cannot run."""
    if broker is None:
        raise PlotfeedError(
            "a fleet needs a broker that all its workers reach: --broker mqtt://HOST:PORT, or none"
        )
    if scene.outgoing.sources:
        raise PlotfeedError(
            "telemetry.source: a fleet listens to brokers alone; "
            "let plotfeed inject publish what the source says"
        )
    if scene.outgoing.websocket:
        raise PlotfeedError("websocket: workers cannot all listen on one port; leave it out")
    if speed == FASTEST and scene.scene.duration_s is None and broker != NO_BROKER:
        raise PlotfeedError("--speed max goes to no broker: --broker none --record DIR")


def check_page(page: str, broker: str | None) -> None:
    """Raise `PlotfeedError` where there is nothing to see, nothing to show it by, or no place."""
    PageAddress.parse(page)
    if broker == NO_BROKER:
        raise PlotfeedError("--page: a fleet without a broker tells nothing to show")
    for library in PAGE_LIBRARIES:
        need_extra(library, "the page", "page")


async def _run(fleet: Coordinator, page: str | None, *, quiet: bool) -> int:
    stop = asyncio.Event()
    async with contextlib.AsyncExitStack() as beside:
        signals = beside.enter_context(stopped_by_signals(stop.set))
        broker = fleet.settings.broker or ""
        if broker != NO_BROKER:
            link = FleetLink(fleet, broker_address(fleet.scene, broker))
            await beside.enter_async_context(link.link.connected(CONNECT_S))
            saying = asyncio.create_task(link.run())
            beside.push_async_callback(_ended, saying)
            if page is not None:
                from plotfeed.feeds.page.fleet_page import shown_on_page

                address, tokens = PageAddress.parse(page), fixed_tokens(os.environ)
                urls = await beside.enter_async_context(shown_on_page(address, link, tokens))
                for name, url in urls.items():
                    say(f"{name}: {url}", err=quiet)
        if not quiet:
            where = "nowhere" if broker == NO_BROKER else f"to {broker}"
            say(f"scene {fleet.scene.scene.name}: {fleet.settings.workers} workers send {where}")
            if broker != NO_BROKER:
                say(f"look at it: plotfeed show {broker}/{fleet.scene.mqtt.prefix}/#; stop: Ctrl-C")
        status = asyncio.create_task(show_status(lambda: _line(fleet), quiet=quiet))
        try:
            await fleet.run(stop)
        finally:
            await _ended(status)
    return INTERRUPTED if signal.SIGINT in signals else 0


async def _ended(task: asyncio.Task[None]) -> None:
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await task


def _line(fleet: Coordinator) -> str:
    sending = sum(part.joined_utc_ns > 0 for part in fleet.parts)
    text = f"parts {len(fleet.parts)} sending {sending}  take-overs {fleet.takeovers}"
    counts = "  ".join(f"{name.replace('_', ' ')} {n}" for name, n in fleet.counts.items())
    return f"{text}  {counts}" if counts else text


def print_status(scene: Scene, broker: str | None, *, as_json: bool) -> int:
    """Print how the fleet does that runs on a scene's prefix; the exit code."""
    told, parts = asyncio.run(_heard(scene, broker))
    if as_json:
        say(json.dumps({**told, "status": parts}))
    else:
        say("\n".join(_status_lines(told, parts)))
    return 0


async def _heard(scene: Scene, broker: str | None) -> tuple[dict[str, Any], dict[str, Any]]:
    """What is retained of a fleet and of its parts, by name; raises `NoFleetError`."""
    root = f"{scene.mqtt.prefix}/{FLEET}"
    heard: dict[str, dict[str, Any]] = {}
    are_all_there = asyncio.Event()

    def take(topic: str, payload: bytes, _content_type: str | None) -> None:
        name = topic.removeprefix(f"{root}/")
        try:
            heard[name] = told_in(payload, of_part=topic != root)
        except PlotfeedError as error:
            say(f"plotfeed: {topic} is left out, nothing that a fleet says: {error}", err=True)
            heard[name] = {}
        if _all_there(heard, root):
            are_all_there.set()

    link = MqttTransport(
        _address(scene, broker), "plotfeed-fleet-status", subscribe=[f"{root}/#"], on_message=take
    )
    async with link.connected(CONNECT_S):
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(HEARD_S):
                await are_all_there.wait()
    if not heard.get(root):
        raise NoFleetError(f"no fleet says on {root} that it runs")
    told = heard[root]
    names = [each["part"] for each in told.get("parts", [])]
    return told, {name: heard[name] for name in names if name in heard}


def _all_there(heard: dict[str, dict[str, Any]], root: str) -> bool:
    return root in heard and all(p["part"] in heard for p in heard[root].get("parts", []))


def _status_lines(told: dict[str, Any], parts: dict[str, Any]) -> Iterator[str]:
    yield (
        f"fleet of scene {told['scene']}: {told['state']} since {told['began_utc']}, "
        f"take-overs {told['takeovers']}"
    )
    head = ["part", "sensors", "state", "worker", "epoch", "plots", "missed", "late p99", ""]
    rows = [head]
    for row in part_rows(told, parts):
        plots, missed = ("" if row[key] is None else str(row[key]) for key in COUNTS)
        late, until = f"{row['lateness_p99_ms']:.2f} ms", f"sent until {row['sent_until_utc']}"
        who = [row["part"], str(len(row["sensors"])), row["state"], row["worker"]]
        rows.append([*who, str(row["epoch"]), plots, missed, late, until])
    yield from aligned(rows, "<><<>>>>")
    yield from map(gap_words, told["gaps"])


def _address(scene: Scene, broker: str | None) -> Any:
    url = broker or scene.outgoing.broker
    if url in (None, NO_BROKER):
        raise PlotfeedError("which broker does the fleet send to? --broker mqtt://HOST:PORT")
    return broker_address(scene, str(url))
