"""A session in a terminal: where it sends, a line of counts that lives, its page."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import signal
import sys
from collections import Counter
from collections.abc import Callable, Coroutine, Iterator
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from plotfeed.feeds.cli.options import RunSettings, table_of, udp_destination
from plotfeed.feeds.console import FAILED, INTERRUPTED
from plotfeed.feeds.console.printed import say, show_last_status, show_status
from plotfeed.feeds.console.process import (
    GARBAGE_OF_SESSION,
    keep_freed,
    leave_alone_what_is_there,
    own_folder,
    stopped_by_signals,
    undisturbed,
)
from plotfeed.feeds.link.counters import SessionCounters, lateness_us
from plotfeed.feeds.scene.fields import split_address
from plotfeed.feeds.scene.output_keys import (
    TOKEN_VARIABLE,
    HttpDestination,
    TakServer,
    TrackDestination,
    WaysOut,
)
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import Clock, InstantClock, WallClock
from plotfeed.feeds.transport.brokers import NO_BROKER
from plotfeed.feeds.transport.mqtt.address import BrokerAddress, without_secrets
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

if TYPE_CHECKING:
    from plotfeed.feeds.session.part import SessionPart


# Of the token that goes where the command line says, if the environment has one.
TOKEN_NAME = "COMMAND_LINE"  # noqa: S105 - its name, not its value  # nosec B105


PAGES = {"page", "audience"}  # Addresses that are looked at in a browser
MOST_UNSEEN = 3  # Drones that no sensor sees, told one by one


def named_outgoing(scene: Scene, settings: RunSettings) -> WaysOut:
    """Destinations of the scene, or those that the command line names instead."""
    named: dict[str, Any] = {"waits": settings.wait}
    if settings.middleware is not None:
        try:
            split_address(settings.middleware)
        except ValueError as error:
            raise PlotfeedError(f"--middleware: {error}") from None
        named["middleware"] = settings.middleware
    if settings.telemetry is not None:
        named["sources"] = ()  # what they said is in the record
    if settings.tak:
        servers = ({"server": text} for text in settings.tak)
        named["tak"] = tuple(table_of(TakServer, s, lambda _: "--tak") for s in servers)
    if settings.http:
        named["http"] = tuple(map(_http, settings.http))
    if settings.udp:
        named["udp"] = tuple(map(udp_destination, settings.udp))
    to = replace(scene.outgoing, **named)
    lacking = {each.format for each in to.queued} - {f for s in scene.sensor for f in s.report}
    if lacking and (settings.tak or settings.http):
        raise PlotfeedError(f"no sensor of the scene has {min(lacking)!r} in its report")
    return to


def _http(text: str) -> HttpDestination:
    carries, _, url = text.partition("=")
    keys = {"carries": carries, "url": url}
    if f"{TOKEN_VARIABLE}{TOKEN_NAME}" in os.environ:
        keys["token"] = TOKEN_NAME
    return table_of(HttpDestination, keys, lambda _: "--http", "; FORMAT=URL")


def sent_elsewhere(scene: Scene, settings: RunSettings) -> Iterator[str]:
    """Where the scene of a recording was sent, and is not unless somebody says so."""
    if scene.mqtt.broker not in (None, NO_BROKER) and settings.broker is None:
        yield f"{without_secrets(scene.mqtt.broker)} (--broker)"
    if scene.udp and not settings.udp:
        yield f"{', '.join(udp.destination for udp in scene.udp)} (--udp)"
    if scene.tak and not settings.tak:
        yield f"{', '.join(tak.server for tak in scene.tak)} (--tak)"
    if scene.http and not settings.http:
        yield f"{', '.join(without_secrets(http.url) for http in scene.http)} (--http)"
    if scene.websocket:
        yield "the ports of its WebSockets"
    if scene.remote_id_service:
        yield "the ports of its services of Remote ID"
    if scene.sapient.middleware is not None and settings.middleware is None:
        yield f"the middleware {scene.sapient.middleware} (--middleware)"


def doubt_lines(totals: SessionCounters) -> Iterator[str]:
    """What is known before a session begins: drones that nobody will see, and odd heights."""
    yield from totals.doubts
    if not totals.unseen:
        return
    told = [f"{drone} ({why})" for drone, why in islice(totals.unseen.items(), MOST_UNSEEN)]
    more = len(totals.unseen) - len(told)
    told += [f"{more} more"] if more else []
    yield f"no sensor sees {', '.join(told)}; plotfeed check SCENE says who sees what"


def introduce(scene: Scene, urls: dict[str, str], note: str) -> None:
    """Say where everything is; `note` is why there is no page."""
    prefix = scene.mqtt.prefix
    say(f"scene {scene.scene.name}")
    for protocol, url in urls.items():
        say(f"  {protocol:<12}{url}")
    if note:
        say(f"  {'page':<12}{note}")
    if urls.keys() - PAGES:
        for sensor in scene.sensor:
            for topics in _topics(sensor):
                say(f"  {sensor.id:<12}{prefix}/{sensor.id}/{topics}")
        say(f"  telemetry   {prefix}/telemetry/DRONE, refusals on {prefix}/errors")
        if scene.mqtt.truth:
            say(f"  truth       {prefix}/truth, not for the tracker")
    else:
        say("  MQTT        none, so no topics and no telemetry from elsewhere")
    for source in scene.outgoing.sources:
        say(f"  listens to  {source.address}, drones are {source.template}")
    for name, where in _destinations(scene.outgoing):
        say(f"  {name:<12}{where}")
    looks = [f"in a browser {urls['page']}"] if "page" in urls else []
    looks += [f"plotfeed show {url.split()[0]}" for name, url in urls.items() if name not in PAGES][
        :1
    ]
    if looks:
        say(f"look at it: {', or '.join(looks)}; stop: Ctrl-C")
    sys.stdout.flush()


def _destinations(to: WaysOut) -> Iterator[tuple[str, str]]:
    """Where messages go beside MQTT: by what, and where."""
    if to.middleware is not None:
        yield "SAPIENT", f"tcp://{to.middleware}, a connection each"
    for udp in to.udp:
        whose = f" of {', '.join(udp.sensors)}" if udp.sensors else ""
        how = f", multicast with TTL {udp.ttl}" if udp.is_multicast else ""
        yield "UDP", f"{udp.destination} ({udp.format or 'ASTERIX'}{whose}{how})"
    for tak in to.tak:
        yield "TAK", f"{tak.server} ({_of(tak)})"
    for http in to.http:
        yield "HTTP", f"{without_secrets(http.url)} ({_of(http)})"
    for websocket in to.websocket:
        yield "WebSocket", f"ws://{websocket.host}:{websocket.port} ({_of(websocket)})"
    for service in to.remote_id_service:
        yield "Remote ID", f"http://{service.host}:{service.port}/uss/flights ({_of(service)})"


def _of(to: TrackDestination) -> str:
    """What goes to a destination of tracks, and of whom."""
    return to.format + (f" of {', '.join(to.sensors)}" if to.sensors else "")


def _topics(sensor: Sensor) -> Iterator[str]:
    """Topics of a sensor's messages, a line for each format."""
    for name in dict.fromkeys(sensor.report):
        sent = ", /".join(f"{category:03d}" for category in sensor.categories(name))
        yield f"asterix/{sent}" if sent else "plots (protobuf)" if name == "plots" else name


# Of the extra `page`; the page loads them once the session is under way.
LIBRARIES = ("starlette", "uvicorn", "websockets")
BEFORE_TICKS = (
    "plotfeed: {} was made before sessions went by ticks of 10 ms: what came in counts from the "
    "next tick on, so plots near it may not be the same again"
)
# A recording is data: whoever wrote it does not say where anything is sent.
NOT_SENT = "plotfeed: {}: not sent to where its session went: {}"
REASONS_TOLD = 3  # Of refusals, in the line of status
RECORDS = ".mcap"  # How the names of files end that hold the record of a session
FASTEST = "max"  # In place of a speed
NO_PAGE = "none"  # In place of the page's address

RunSession = Callable[..., Coroutine[None, None, SessionCounters]]  # Given `stop` and `on_ready`


def run_in_terminal(scene: Scene, settings: RunSettings) -> int:
    """Run until it ends or is stopped; the exit code."""
    if settings.broker not in (None, NO_BROKER):
        BrokerAddress.parse(settings.broker)  # what is wrong with it is told before anything begins
    scene = scene.sent_to(named_outgoing(scene, settings))
    serves_page, note = _page(settings)
    again: SessionRecord | None = None
    if settings.telemetry:
        from plotfeed.feeds.recording.recorder import RecordedTelemetry, SessionRecord

        again = SessionRecord.open(settings.telemetry)
        if not again.has_ticks:
            say(BEFORE_TICKS.format(again.path), err=True)
    start_utc_ns = scene.scene.start_utc_ns if again is None else again.start_utc_ns
    part, clock = _part_and_clock(scene, settings, start_utc_ns)
    duration_s, begins_ns = settings.duration, clock.now_ns()
    if again is not None and duration_s is None and scene.scene.duration_s is None:
        duration_s = (again.end_utc_ns - again.start_utc_ns) / NS
    with contextlib.ExitStack() as files:
        raw: RawFile | None = None
        recorder: Recorder | None = None
        observers: list[Observer] = []
        if settings.write:
            from plotfeed.feeds.recording.recorder import RawFile

            raw = files.enter_context(RawFile(settings.write, force=settings.force))
            observers.append(raw)
        if settings.record:
            from plotfeed.feeds.recording.recorder import Recorder, SessionRecorder, attachments_of

            recorder = files.enter_context(
                Recorder(
                    settings.record,
                    attachments=attachments_of(scene, part.began_utc_ns if part else begins_ns),
                    force=settings.force,
                    waits=clock.can_wait,
                )
            )
            observers.append(SessionRecorder(recorder, ledger_is_sent=scene.mqtt.truth))
        if settings.telemetry:
            observers.append(RecordedTelemetry(settings.telemetry))
        if settings.metrics is not None:
            from plotfeed.feeds.metrics import MetricsAddress, served

            address = MetricsAddress.parse(settings.metrics)
            observers.append(files.enter_context(served(address)))
        runner = partial(_run_with_page, settings) if serves_page else _runner(scene, settings)
        if part is not None:
            from plotfeed.feeds.fleet.part_hold import run_part

            runner = partial(run_part, part)
        run_session: RunSession = partial(
            runner,
            scene=scene,
            clock=clock,
            broker=settings.broker,
            duration_s=duration_s,
            observers=observers,
        )
        own = scene if part is None else part.scene_of(scene)
        code, totals = asyncio.run(_run(own, run_session, note, quiet=settings.as_json))
    if settings.as_json:
        say(json.dumps(_summary(totals)))
    else:
        show_last_status(_line(totals))
    missing = [raw.failure] if raw and raw.failure else []
    for line in [*missing, *(recorder.losses() if recorder else ())]:
        say(f"plotfeed: {line}", err=True)
    return FAILED if any(file and file.failure for file in (raw, recorder)) else code


def _part_and_clock(
    scene: Scene, settings: RunSettings, start_utc_ns: int | None
) -> tuple[SessionPart | None, Clock]:
    """The part that is asked for, if one is, and the session's clock; raises `PlotfeedError`."""
    if settings.part is None:
        if settings.start is not None:
            raise PlotfeedError("--start is for parts of a scene, with --part K/N")
        return None, _clock(start_utc_ns, settings)
    from plotfeed.feeds.fleet.parts import part_asked

    for option, value in {"--page": settings.page, "--telemetry": settings.telemetry}.items():
        if value not in (None, NO_PAGE):
            raise PlotfeedError(
                f"{option} is of a whole session; plotfeed fleet status has the page of all parts"
            )
    broker, speed = settings.broker, settings.speed
    return part_asked(scene, settings.part, start=settings.start, broker=broker, speed=speed)


def is_record(path: Path) -> bool:
    """Whether a file is to be taken for a record and not for a scene."""
    return path.suffix == RECORDS


def run_again(path: Path, settings: RunSettings) -> int:
    """Run the record of a session again, with the scene that it holds; the exit code."""
    with own_folder() as folder:
        from plotfeed.feeds.recording.recorder import SessionRecord

        scene = SessionRecord.open(path).scene(folder)
        elsewhere = list(sent_elsewhere(scene, settings))
        if elsewhere:
            say(NOT_SENT.format(path, ", ".join(elsewhere)), err=True)
        return run_in_terminal(scene, replace(settings, telemetry=settings.telemetry or path))


def _page(settings: RunSettings) -> tuple[bool, str]:
    """Whether to serve the page, and what to say if not; raises `PlotfeedError` where it must be.

    Where nobody asked for it, it is not served if nobody would be told, nor where time leaps.
    """
    is_welcome = settings.shows_page and not settings.as_json and settings.speed != FASTEST
    if settings.page == NO_PAGE or (settings.page is None and not is_welcome):
        return False, ""
    absent = [name for name in LIBRARIES if not find_spec(name)]
    if not absent:
        return True, ""
    missing = f"{', '.join(absent)} missing here: pip install 'plotfeed[page]'"
    if settings.page is not None:
        raise PlotfeedError(f"the page cannot be served, {missing}")
    return False, f"none, {missing}"


def _runner(scene: Scene, settings: RunSettings) -> RunSession:
    """What runs it without a page: with a score beside it, if there is a tracker to hear."""
    if scene.page.tracks_topic is None or settings.broker == NO_BROKER:
        return run
    from plotfeed.feeds.lab.live import run_scored

    return run_scored


async def _run_with_page(settings: RunSettings, **session: Any) -> SessionCounters:
    """Sessions as the page's viewers want them, at the page's usual port or any that is free."""

    def another_clock(other: Scene) -> Clock:
        return _clock(other.scene.start_utc_ns, settings)

    from plotfeed.feeds.page.page_access import DEFAULT_PORT, PageAddress, PageError, fixed_tokens
    from plotfeed.feeds.page.run_with_page import run_with_page

    tokens = fixed_tokens(os.environ)

    async def run_at(address: PageAddress) -> SessionCounters:
        return await run_with_page(address, another_clock=another_clock, tokens=tokens, **session)

    if settings.page is not None:
        return await run_at(PageAddress.parse(settings.page))
    try:
        return await run_at(PageAddress())
    except PageError:  # before anything has begun
        say(f"port {DEFAULT_PORT} is taken: the page has another")
        return await run_at(PageAddress(port=0))


def _clock(start_utc_ns: int | None, settings: RunSettings) -> Clock:
    if settings.speed == FASTEST:
        return InstantClock(start_utc_ns)
    try:
        factor = float(settings.speed)
    except ValueError:
        factor = 0.0
    if not 0.001 <= factor <= 10_000:
        raise click.BadParameter("expected 0.001 to 10000, or max", param_hint="--speed")
    return WallClock(start_utc_ns, speed=factor, can_be_held=settings.can_be_held)


async def _run(
    scene: Scene, run_session: RunSession, note: str, *, quiet: bool
) -> tuple[int, SessionCounters]:
    """The exit code and the counts of a session that signals stop."""
    stop = asyncio.Event()
    keep_freed()
    asyncio.get_running_loop().set_exception_handler(partial(_stray_error, stop))
    status: asyncio.Task[None] | None = None
    counted = SessionCounters()

    def ready(urls: dict[str, str], totals: SessionCounters) -> None:
        nonlocal status, counted
        counted = totals  # a page begins one session after the other
        if status is None:
            leave_alone_what_is_there()  # nothing is due yet
        if status is None and not quiet:
            introduce(scene, urls, note)
        for line in doubt_lines(totals):
            say(f"plotfeed: {line}", err=True)
        if status is None and not quiet:
            status = asyncio.create_task(show_status(lambda: _line(counted)), name="status")

    with stopped_by_signals(stop.set) as signals, undisturbed(GARBAGE_OF_SESSION):
        totals = await run_session(stop=stop, on_ready=ready)
    if status is not None:
        status.cancel()
    return (INTERRUPTED if signal.SIGINT in signals else 0), totals


def _line(totals: SessionCounters) -> str:
    p50_us, p99_us = lateness_us(totals.lateness_ns, 50, 99)
    text = (
        f"drones {totals.drones}  plots {totals.plots} (false {totals.false_alarms})  "
        f"messages {totals.messages}  late p50 {p50_us / 1e3:.2f} p99 {p99_us / 1e3:.2f} ms"
    )
    asked, reached = totals.speed or 1.0, totals.speed_reached or 1.0
    most = Counter(totals.refused_by).most_common(REASONS_TOLD)
    why = ", ".join(f"{reason} {number}" for reason, number in most)
    more = {
        f"speed x{reached:.3g}{f' of x{asked:g}' if reached < 0.98 * asked else ''}": asked != 1,
        f"forgotten {totals.forgotten}": totals.forgotten,
        f"telemetry {totals.telemetry} refused {totals.refused}{f' ({why})' if why else ''}": (
            totals.telemetry + totals.refused
        ),
        f"lost {totals.lost} doubled {totals.duplicated}": totals.lost + totals.duplicated,
        f"too late for SAPIENT {totals.stale}": totals.stale,
        f"SAPIENT errors {totals.sapient_errors}": totals.sapient_errors,
        f"on the way at the end {totals.ended}": totals.ended,
        f"undelivered {totals.undelivered}": totals.undelivered,
        **{f"not to {to} {count}": count for to, count in totals.undelivered_to.items()},
        f"not heard back {totals.not_heard_back} of "
        f"{totals.not_heard_back + totals.heard_back} samples": totals.not_heard_back,
        f"missed scans {totals.missed_scans}": totals.missed_scans,
        f"other sessions on the prefix {totals.other_sessions}": totals.other_sessions,
    }
    return "  ".join([text, *(told for told, count in more.items() if count)])


def _summary(totals: SessionCounters) -> dict[str, Any]:
    p50, p99, p999 = lateness_us(totals.lateness_ns, 50, 99, 99.9)
    counts = {name: getattr(totals, name) for name in totals.__slots__ if name != "lateness_ns"}
    return {**counts, "lateness_p50_us": p50, "lateness_p99_us": p99, "lateness_p999_us": p999}


def _stray_error(
    stop: asyncio.Event, _loop: asyncio.AbstractEventLoop, context: dict[str, object]
) -> None:
    """What a library's own task died of: a line, not a traceback; of the end, no news."""
    logging.getLogger("plotfeed").log(
        logging.DEBUG if stop.is_set() else logging.WARNING,
        "%s: %s",
        context.get("message"),
        context.get("exception", "no more is known"),
    )
