"""A fleet in a terminal: its processes begun, and asked how they do."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import sys
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

from plotfeed.feeds.cli.options import FleetSettings
from plotfeed.feeds.console import INTERRUPTED
from plotfeed.feeds.console.printed import aligned, say
from plotfeed.feeds.console.process import stopped_by_signals
from plotfeed.feeds.fleet.fleet_watch import SILENT, UNKNOWN, FleetWatch, gap_words
from plotfeed.feeds.fleet.parts import check_scene, partition, start_of
from plotfeed.feeds.fleet.starters import LocalParts, manifests, start_parts, stop_parts
from plotfeed.feeds.page.page_access import PageAddress, fixed_tokens
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.transport.brokers import NO_BROKER, broker_address
from plotfeed.proto.errors import PlotfeedError

CONNECT_S = 15.0
HEARD_S, LOOK_S = 4.0, 0.05  # By then every part that goes on has said so
RUN = (sys.executable, "-m", "plotfeed.feeds.cli", "run")


class NoFleetError(PlotfeedError):
    """A prefix on which no part of a fleet says anything."""

    exit_code = 1


def run_fleet(path: Path, settings: FleetSettings) -> int:
    """Have all parts of a scene run; the exit code."""
    scene = load(path)
    broker, begins = broker_of(scene, settings), start_of(settings.start)
    check_scene(scene, broker)
    workers = len(partition(scene, settings.workers))
    asked: dict[str, Any] = {
        "parts": workers,
        "spares": settings.spares,
        "start": begins,
        "broker": broker,
        "duration_s": settings.duration or scene.scene.duration_s,
    }
    if settings.kubernetes:
        say(manifests(path, **asked).rstrip())
        return 0
    if settings.ray is not None:
        from plotfeed.feeds.console.cluster import connected

        with connected(settings.ray) as ray:
            start_parts(ray, scene, **asked)
        say(f"scene {scene.scene.name}: Ray at {settings.ray} runs {workers} parts from {begins}")
        say(f"how they do: plotfeed fleet status {path} --broker {broker}")
        say(f"to end them: plotfeed fleet stop {path} --ray {settings.ray}")
        return 0
    duration, record = settings.duration, settings.record
    if record is not None:
        record.mkdir(parents=True, exist_ok=True)

    def command(part: int, starts: int) -> list[str]:
        words = [*RUN, str(path), "--part", f"{part}/{workers}", "--start", begins]
        words += ["--broker", broker, "--wait", "--json"]
        words += [] if duration is None else ["--duration", str(duration)]
        words += [] if record is None else ["--record", str(record / f"{part}.{starts}.mcap")]
        return words

    parts = LocalParts(command, workers)
    watch = FleetWatch(scene, broker_address(scene, broker))
    code = asyncio.run(_run(watch, parts, settings))
    if settings.as_json:
        say(json.dumps({**watch.news(), "counts": parts.counts}))
    else:
        counts = "  ".join(f"{name.replace('_', ' ')} {n}" for name, n in parts.counts.items())
        say(f"processes started {sum(parts.starts)}  {counts}")
    return code


def broker_of(scene: Scene, settings: FleetSettings) -> str:
    """The broker by which the parts tell how they do; raises `PlotfeedError` without one."""
    broker = settings.broker or scene.outgoing.mqtt.broker
    if broker is None or broker == NO_BROKER:
        raise PlotfeedError("the parts of a fleet need a broker: --broker mqtt://HOST:PORT")
    return broker


def stop_fleet(path: Path, ray_address: str | None) -> int:
    """End the parts that Ray runs; the exit code."""
    from plotfeed.feeds.console.cluster import connected

    if ray_address is None:
        raise PlotfeedError("stop ends what Ray runs: --ray HOST:PORT")
    with connected(ray_address) as ray:
        ended = stop_parts(ray, load(path))
    say(f"{ended} processes have ended")
    return 0 if ended else 1


async def _run(watch: FleetWatch, parts: LocalParts, settings: FleetSettings) -> int:
    stop, quiet = asyncio.Event(), settings.as_json
    address, prefix = watch.link.address, watch.scene.mqtt.prefix
    with stopped_by_signals(stop.set) as signals:
        async with watch.link.connected(CONNECT_S), _shown(watch, settings.page, quiet=quiet):
            if not quiet:
                say(f"scene {watch.scene.scene.name}: {len(parts.starts)} parts send to {address}")
                say(f"look at it: plotfeed show {address}/{prefix}/#; stop: Ctrl-C")
            code = await parts.run(stop, settings.spares)
    return INTERRUPTED if signal.SIGINT in signals else code


@contextlib.asynccontextmanager
async def _shown(watch: FleetWatch, page: str | None, *, quiet: bool) -> AsyncIterator[None]:
    """A page meanwhile, if one is asked for."""
    if page is None:
        yield
        return
    from plotfeed.feeds.page.fleet_page import shown_on_page

    tokens = fixed_tokens(os.environ)
    async with shown_on_page(PageAddress.parse(page), watch, tokens) as urls:
        for name, url in urls.items():
            say(f"{name}: {url}", err=quiet)
        yield


def print_status(path: Path, settings: FleetSettings) -> int:
    """Print how the parts do that run on a scene's prefix, or show it; the exit code."""
    scene = load(path)
    watch = FleetWatch(scene, broker_address(scene, broker_of(scene, settings)))
    code = asyncio.run(_heard(watch, settings.page))
    if not watch.is_heard:
        raise NoFleetError(f"no part of a fleet says on {watch.root}/# that it runs")
    if settings.as_json:
        say(json.dumps(watch.news()))
    elif settings.page is None:
        say("\n".join(_status_lines(watch.news())))
    return code


async def _heard(watch: FleetWatch, page: str | None) -> int:
    stop = asyncio.Event()
    async with watch.link.connected(CONNECT_S):
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(HEARD_S):
                while not _is_known(watch.news()["parts"]):  # noqa: ASYNC110 - of what comes in
                    await asyncio.sleep(LOOK_S)
        if page is None or not watch.is_heard:
            return 0
        with stopped_by_signals(stop.set) as signals:
            async with _shown(watch, page, quiet=False):
                await stop.wait()
    return INTERRUPTED if signal.SIGINT in signals else 0


def _is_known(parts: list[dict[str, Any]]) -> bool:
    return bool(parts) and all(row["state"] not in (SILENT, UNKNOWN) for row in parts)


def _status_lines(news: dict[str, Any]) -> Iterator[str]:
    yield f"scene {news['scene']}: {len(news['parts'])} parts, take-overs {news['takeovers']}"
    rows = [["part", "sensors", "state", "worker", "claim", "plots", "missed", "late p99", ""]]
    for row in news["parts"]:
        late_ms, until = row["lateness_p99_us"] / 1e3, row["sent_until_utc"] or "never"
        told = (len(row["sensors"]), row["state"], row["worker"] or "", row["claim"])
        counts = (row["plots"] or 0, row["missed_scans"] or 0, f"{late_ms:.2f} ms")
        rows.append([str(row["part"]), *map(str, (*told, *counts)), f"sent until {until}"])
    yield from aligned(rows, "<><<>>>>")
    yield from map(gap_words, news["gaps"])
