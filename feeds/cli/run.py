"""A session in a terminal: where to connect, a line of counts that lives, its page."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import signal
import sys
from collections.abc import Callable, Coroutine, Iterator, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click

from plotfeed.feeds.console.signals import (
    INTERRUPTED,
    collect_seldom,
    keep_freed,
    stopped_by_signals,
)
from plotfeed.feeds.delivery.counters import SessionCounters, lateness_us
from plotfeed.feeds.metrics import served
from plotfeed.feeds.recording.raw_file import RawFile
from plotfeed.feeds.recording.recorder import Recorder
from plotfeed.feeds.recording.session_record import (
    RecordedTelemetry,
    SessionRecord,
    SessionRecorder,
    attachments_of,
)
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.session.observer import Observer
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import Clock, InstantClock, WallClock
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

LIBRARIES = ("starlette", "uvicorn", "websockets")
"""Of the extra `page`; the page loads them once the session is under way."""


def what_is_missing() -> str:
    """A word to whoever wants the page where its libraries are not installed; else empty."""
    if all(find_spec(name) for name in LIBRARIES):
        return ""
    return "needs more: pip install 'plotfeed[page]'"


async def with_page(
    stop: asyncio.Event,
    on_ready: Callable[[dict[str, str], SessionCounters], None],
    *,
    page: str | None,
    another_clock: Callable[[Scene], Clock],
    scene: Scene,
    clock: Clock,
    broker: str | None,
    duration_s: float | None,
    observers: Sequence[Observer],
) -> SessionCounters:
    """Sessions as the page's viewers want them; raises `PlotfeedError`.

    `page` is its address. None is for the usual one, or any that is free where that is taken.
    """
    from plotfeed.feeds.page.page_access import (
        DEFAULT_PORT,
        PageAddress,
        PageError,
    )
    from plotfeed.feeds.page.run_with_page import run_with_page

    run = partial(
        run_with_page,
        scene=scene,
        clock=clock,
        another_clock=another_clock,
        broker=broker,
        duration_s=duration_s,
        stop=stop,
        observers=observers,
        on_ready=on_ready,
    )
    if page is not None:
        return await run(PageAddress.parse(page))
    try:
        return await run(PageAddress())
    except PageError:  # before anything has begun
        click.echo(f"port {DEFAULT_PORT} is taken: the page has another")
        return await run(PageAddress(port=0))


def asked_page(page: str | None, *, or_usual: bool) -> tuple[bool, str]:
    """Whether to serve it, and what to say if not; raises `PlotfeedError` where it must be.

    `or_usual` says that it is welcome even where nobody asked for it.
    """
    if page is None and not or_usual:
        return False, ""
    missing = what_is_missing()
    if missing and page is not None:
        raise PlotfeedError(f"the page {missing}")
    return not missing, missing


TERMINAL_EVERY_S = 0.5
LOG_EVERY_S = 10.0
FASTEST = "max"
"""In place of a speed."""
FAILED = 1


def run_in_terminal(
    scene: Scene,
    *,
    broker: str | None,
    duration: float | None,
    speed: str,
    write: Path | None,
    record: Path | None,
    telemetry: Path | None,
    force: bool,
    metrics: int | None,
    page: str | None,
    as_json: bool,
    shows_page: bool = False,
) -> int:
    """Run until it ends or is stopped; the exit code.

    `page` is where to serve it. With `shows_page` it is served even if nobody said where, but not
    where nobody would be told, nor where time leaps.
    """
    or_usual = shows_page and not as_json and speed != FASTEST
    serves_page, note = asked_page(page, or_usual=or_usual)
    again = SessionRecord.open(telemetry) if telemetry else None
    clock = _clock(scene.scene.start_utc_ns if again is None else again.start_utc_ns, speed)
    if again is not None and duration is None and scene.scene.duration_s is None:
        duration = (again.end_utc_ns - again.start_utc_ns) / NS
    with contextlib.ExitStack() as files:
        raw = files.enter_context(RawFile(write)) if write else None
        recorder = files.enter_context(_recorder(scene, record, clock, force)) if record else None
        observers: list[Observer] = [raw] if raw else []
        if recorder:
            observers.append(SessionRecorder(recorder, ledger_is_sent=scene.mqtt.truth))
        if telemetry:
            observers.append(RecordedTelemetry(telemetry))
        if metrics is not None:
            observers.append(files.enter_context(served(metrics)))
        run_so: Callable[..., Coroutine[None, None, SessionCounters]] = _plainly
        if serves_page:
            another_clock = partial(_clock_of, speed=speed)
            run_so = partial(with_page, page=page, another_clock=another_clock)
        how = partial(
            run_so,
            scene=scene,
            clock=clock,
            broker=broker,
            duration_s=duration,
            observers=observers,
        )
        code, totals = asyncio.run(_run(scene, how, note, quiet=as_json))
    if as_json:
        click.echo(json.dumps(_summary(totals)))
    else:
        click.echo(f"\r\033[K{_line(totals)}" if sys.stdout.isatty() else _line(totals))
    failures = [file.failure for file in (raw, recorder) if file and file.failure]
    for failure in failures:
        click.echo(f"plotfeed: {failure}", err=True)
    return FAILED if failures else code


def run_again(path: Path, *, telemetry: Path | None, **options: Any) -> int:
    """Run the record of a session again, with the scene that it holds; the exit code."""
    with TemporaryDirectory(prefix="plotfeed-") as folder:
        scene = SessionRecord.open(path).scene(Path(folder))
        return run_in_terminal(scene, telemetry=telemetry or path, **options)


def _recorder(scene: Scene, path: Path, clock: Clock, force: bool) -> Recorder:
    return Recorder(
        path,
        attachments=attachments_of(scene, clock.now_ns()),
        force=force,
        waits=isinstance(clock, InstantClock),
    )


def _clock(start_utc_ns: int | None, speed: str) -> Clock:
    if speed == FASTEST:
        return InstantClock(start_utc_ns)
    try:
        factor = float(speed)
    except ValueError:
        factor = 0.0
    if not 0.001 <= factor <= 10_000:
        raise click.BadParameter("expected 0.001 to 10000, or max", param_hint="--speed")
    return WallClock(start_utc_ns, speed=factor)


def _clock_of(scene: Scene, speed: str) -> Clock:
    return _clock(scene.scene.start_utc_ns, speed)


OnReady = Callable[[dict[str, str], SessionCounters], None]
How = Callable[[asyncio.Event, OnReady], Coroutine[None, None, SessionCounters]]
"""Runs a session until it is told to stop, and says when it is ready."""


async def _plainly(
    stop: asyncio.Event,
    on_ready: OnReady,
    *,
    scene: Scene,
    clock: Clock,
    broker: str | None,
    duration_s: float | None,
    observers: Sequence[Observer],
) -> SessionCounters:
    """One session, and nothing beside it."""
    return await run(
        scene,
        clock=clock,
        broker=broker,
        duration_s=duration_s,
        stop=stop,
        observers=observers,
        on_ready=on_ready,
    )


async def _run(scene: Scene, how: How, note: str, *, quiet: bool) -> tuple[int, SessionCounters]:
    stop = asyncio.Event()
    collect_seldom()
    keep_freed()
    asyncio.get_running_loop().set_exception_handler(partial(_stray_error, stop))
    teller: asyncio.Task[None] | None = None

    def ready(urls: dict[str, str], totals: SessionCounters) -> None:
        nonlocal teller
        if not quiet:
            _introduce(scene, urls, note)
            teller = asyncio.create_task(_tell(totals), name="tell")

    with stopped_by_signals(stop.set) as signals:
        totals = await how(stop, ready)
    if teller is not None:
        teller.cancel()
    return (INTERRUPTED if signal.SIGINT in signals else 0), totals


def _introduce(scene: Scene, urls: dict[str, str], note: str) -> None:
    """Where everything is; `note` is why there is no page."""
    prefix = scene.mqtt.prefix
    click.echo(f"scene {scene.scene.name}")
    for protocol, url in urls.items():
        click.echo(f"  {protocol:<12}{url}")
    if note:
        click.echo(f"  {'page':<12}{note}")
    for sensor in scene.sensor:
        for topics in _topics(sensor):
            click.echo(f"  {sensor.id:<12}{prefix}/{sensor.id}/{topics}")
    click.echo(f"  telemetry   {prefix}/telemetry/DRONE, refusals on {prefix}/errors")
    if scene.mqtt.truth:
        click.echo(f"  truth       {prefix}/truth, not for the tracker")
    if scene.sapient.middleware is not None:
        click.echo(f"  SAPIENT     tcp://{scene.sapient.middleware}, a connection each")
    for udp in scene.udp:
        whose = f" of {', '.join(udp.sensors)}" if udp.sensors else ""
        how = f", multicast with TTL {udp.ttl}" if udp.is_multicast else ""
        click.echo(f"  UDP         {udp.destination} (ASTERIX{whose}{how})")
    ways = [f"in a browser {urls['page']}"] if "page" in urls else []
    ways += [f"plotfeed show {url}" for name, url in urls.items() if name != "page"][:1]
    if ways:
        click.echo(f"look at it: {', or '.join(ways)}; stop: Ctrl-C")
    sys.stdout.flush()


def _topics(sensor: Sensor) -> Iterator[str]:
    """Where a sensor's messages are, a line for each format."""
    for name in dict.fromkeys(sensor.report):
        sent = ", /".join(f"{category:03d}" for category in sensor.categories(name))
        yield f"asterix/{sent}" if sent else "plots (protobuf)" if name == "plots" else name


async def _tell(totals: SessionCounters) -> None:
    """The line of counts: over itself in a terminal, now and then in a log."""
    in_terminal = sys.stdout.isatty()
    while True:
        await asyncio.sleep(TERMINAL_EVERY_S if in_terminal else LOG_EVERY_S)
        end = "" if in_terminal else "\n"
        sys.stdout.write(("\r\033[K" if in_terminal else "") + _line(totals) + end)
        sys.stdout.flush()


def _line(totals: SessionCounters) -> str:
    p50_us, p99_us = lateness_us(totals.lateness_ns, 50, 99)
    text = (
        f"drones {totals.drones}  plots {totals.plots} (false {totals.false_alarms})  "
        f"messages {totals.messages}  late p50 {p50_us / 1e3:.2f} p99 {p99_us / 1e3:.2f} ms"
    )
    if totals.telemetry or totals.refused:
        text += f"  telemetry {totals.telemetry} refused {totals.refused}"
    if totals.lost or totals.duplicated:
        text += f"  lost {totals.lost} doubled {totals.duplicated}"
    if totals.stale:
        text += f"  too late for SAPIENT {totals.stale}"
    if totals.ended:
        text += f"  on the way at the end {totals.ended}"
    if totals.undelivered:
        text += f"  undelivered {totals.undelivered}"
    if totals.missed_scans:
        text += f"  missed scans {totals.missed_scans}"
    return text


def _summary(totals: SessionCounters) -> dict[str, float | int | str]:
    p50, p99, p999 = lateness_us(totals.lateness_ns, 50, 99, 99.9)
    counts = {
        name: getattr(totals, name) for name in totals.__slots__ if name not in {"lateness_ns"}
    }
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
