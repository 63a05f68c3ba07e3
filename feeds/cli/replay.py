"""A recording replayed as the command line asks, in a terminal where keys steer it."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
import time
import tomllib
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from plotfeed.feeds.cli.options import DEFAULT_BROKER, ReplayOptions, udp_destination
from plotfeed.feeds.console import FAILED, INTERRUPTED
from plotfeed.feeds.console.posix import keys_of
from plotfeed.feeds.console.printed import say, say_damage, show_last_status, show_status
from plotfeed.feeds.console.process import stopped_by_signals
from plotfeed.feeds.link.counters import lateness_us
from plotfeed.feeds.messages.transports import Transport
from plotfeed.feeds.recording.foreign_recordings import ForeignReader
from plotfeed.feeds.replaying.replay_settings import (
    LinkRule,
    Moment,
    ReplayError,
    ReplaySettings,
    Stamps,
    TopicRule,
)
from plotfeed.feeds.replaying.replayer import Replayer
from plotfeed.feeds.replaying.routes import Destinations, ReplayCounters, open_transports
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.output_keys import UdpDestination
from plotfeed.feeds.scene.problems import problems_of
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import iso_utc
from plotfeed.replay.files import RepeatableRecording
from plotfeed.replay.pacing import MAX_SPEED, MIN_SPEED, speed_of

SKIP_S = 10.0
HELP = "space pauses, left and right seek 10 s, + and - change the speed, q ends"


def _hurry(replayer: Replayer, factor: Fraction) -> None:
    replayer.set_speed(min(max(replayer.speed * factor, MIN_SPEED), MAX_SPEED))


# What a terminal sends, and what is done then; the arrows first, for they hold other keys.
KEYS: dict[bytes, Callable[[Replayer], object]] = {
    b"\x1b[C": lambda replayer: replayer.skip(SKIP_S),
    b"\x1b[D": lambda replayer: replayer.skip(-SKIP_S),
    b" ": lambda replayer: replayer.toggle(),
    b"+": lambda replayer: _hurry(replayer, Fraction(2)),
    b"=": lambda replayer: _hurry(replayer, Fraction(2)),
    b"-": lambda replayer: _hurry(replayer, Fraction(1, 2)),
    b"q": lambda replayer: replayer.stop(),
}


def press(replayer: Replayer, typed: bytes) -> None:
    """Do what keys ask for; what is no key of ours is passed over."""
    while typed:
        key = next((key for key in KEYS if typed.startswith(key)), typed[:1])
        typed = typed[len(key) :]
        if key in KEYS:
            KEYS[key](replayer)


MAX_OCTETS = 1 << 20  # Of a file with the keys of a link
RECORDED = "recorded"  # In place of an address: where each datagram once went
ANY_GROUP = "239.0.0.0:1"  # Stands for the groups that they once went to, whose keys are given
FASTEST = "max"  # In place of a speed


def replay_as_asked(path: Path, access: dict[str, Any], options: ReplayOptions) -> int:
    """Replay a file until it ends or is stopped; the exit code. Raises `PlotfeedError`.

    `access` is all but the URL of a broker's address.
    """
    to, settings = _destinations(options, access), _settings(options)
    with ForeignReader(path) as source:
        return asyncio.run(_replay(path, source, to, settings, as_json=options.as_json))


def _destinations(options: ReplayOptions, access: dict[str, Any]) -> Destinations:
    url = options.broker or (None if options.udp else DEFAULT_BROKER)
    udp: list[UdpDestination] = []
    recorded: UdpDestination | None = None
    for text in options.udp:
        place, mark, keys = text.partition("?")
        if place == RECORDED:
            recorded = udp_destination(f"{ANY_GROUP}{mark}{keys}")
        else:
            udp.append(udp_destination(text))
    brokers = () if url is None else (BrokerAddress.parse(url, **access),)
    return Destinations(brokers=brokers, udp=tuple(udp), recorded=recorded)


def _settings(options: ReplayOptions) -> ReplaySettings:
    """What is replayed, and how."""
    fastest = options.speed == FASTEST
    try:
        speed = speed_of(1.0 if fastest else float(options.speed))
    except ValueError:
        raise PlotfeedError("--speed: expected 0.001 to 10000, or max") from None
    usual_stamps = "now" if options.stage == "telemetry" else "keep"
    return ReplaySettings(
        stage=options.stage,
        truth=options.truth,
        speed=speed,
        fastest=fastest,
        start=None if options.start is None else Moment.parse(options.start),
        end=None if options.end is None else Moment.parse(options.end),
        laps=options.laps or None,
        stamps=Stamps.parse(options.stamps or usual_stamps),
        topics=tuple(TopicRule.parse(text) for text in options.topics),
        # Those of topics before those of all, whatever their order on the command line.
        links=tuple(sorted(map(_link_rule, options.links), key=lambda rule: -len(rule.topic))),
        seed=options.seed,
    )


def _link_rule(text: str) -> LinkRule:
    """The link in FILE, for all topics, or TOPIC=FILE: the keys of a scene's [sensor.link]."""
    topic, equals, name = text.rpartition("=")
    if equals and not topic:
        raise ReplayError(f"link: expected FILE or TOPIC=FILE, not {text!r}")
    path = Path(name)
    try:
        with path.open("rb") as file:
            tree = tomllib.loads(file.read(MAX_OCTETS).decode("utf-8-sig"))
    except OSError as error:
        raise ReplayError(f"{path}: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise ReplayError(f"{path}: not TOML: {error}") from None
    try:
        return LinkRule(topic, LinkSettings.model_validate(tree))
    except ValidationError as error:
        problems = ((f"{key}: " if key else "", text) for key, text in problems_of(error, tree))
        lines = [f"{path}: {key}{text}" for key, text in problems]
        raise ReplayError("\n".join(lines)) from None


async def _replay(
    path: Path,
    source: RepeatableRecording,
    to: Destinations,
    settings: ReplaySettings,
    *,
    as_json: bool,
) -> int:
    totals = ReplayCounters()
    replayer = Replayer(settings, totals=totals)
    async with open_transports(to, waits=settings.fastest) as outs:
        keys = keys_of(sys.stdin, partial(press, replayer))
        with stopped_by_signals(replayer.stop) as signals, keys as has_keys:
            if not as_json:
                _introduce(path, to, has_keys=has_keys)
            status = asyncio.create_task(
                show_status(lambda: _position(replayer, totals), quiet=as_json), name="status"
            )
            began_s = time.monotonic()
            try:
                await replayer.run(source, outs)
            finally:
                status.cancel()
                await asyncio.gather(status, return_exceptions=True)
    took_s = time.monotonic() - began_s
    if as_json:
        say(json.dumps(_summary(totals, outs, took_s)))
    else:
        show_last_status(_line(totals, settings, took_s))
        for why, count in totals.skipped.items():
            say(f"plotfeed: {count} messages were not sent: {why}", err=True)
        for what, count in totals.left.items():
            say(f"plotfeed: times left alone {count} times: {what}", err=True)
    found = source.damage
    say_damage(path, found)
    if signal.SIGINT in signals:
        return INTERRUPTED
    is_silent = not (totals.messages or totals.lost or totals.undelivered or replayer.stopped)
    if is_silent:
        say(f"plotfeed: nothing of {path} was sent: no message is of what was asked for", err=True)
    return FAILED if totals.undelivered or is_silent else 0


def _introduce(path: Path, to: Destinations, *, has_keys: bool) -> None:
    say(f"{path}")
    for broker in to.brokers:
        say(f"  MQTT  {broker}")
    for udp in to.udp:
        say(f"  UDP   {udp.destination}")
    if to.recorded is not None:
        say("  UDP   where each datagram once went")
    if has_keys:
        say(HELP)
    sys.stdout.flush()


def _position(replayer: Replayer, totals: ReplayCounters) -> str:
    lap, position_ns = replayer.position
    where = f"{iso_utc(position_ns)[11:23]}  lap {lap + 1}  x{float(replayer.speed):g}"
    return f"{where}{'  paused' if replayer.is_paused else ''}  messages {totals.messages}"


def _line(totals: ReplayCounters, settings: ReplaySettings, took_s: float) -> str:
    text = f"messages {totals.messages}  octets {totals.octets}  in {took_s:.2f} s"
    if settings.fastest:
        text += f", {totals.messages / max(took_s, 1e-9):.0f} a second"
    else:
        p50_us, p99_us = lateness_us(totals.lateness_ns, 50, 99)
        late = f"{p50_us / 1e3:.3f} p99 {p99_us / 1e3:.3f} most {totals.worst_ns / 1e6:.3f}"
        text += f"  late p50 {late} ms"
    for name in ("lost", "duplicated", "undelivered", "ended"):
        if count := getattr(totals, name):
            text += f"  {name} {count}"
    return text if totals.laps < 2 else f"{text}  laps {totals.laps}"


def _summary(
    totals: ReplayCounters, outs: Sequence[Transport], took_s: float
) -> dict[str, float | dict[str, int]]:
    p50_us, p99_us, p999_us = lateness_us(totals.lateness_ns, 50, 99, 99.9)
    return {
        "messages": totals.messages,
        "octets": totals.octets,
        "laps": totals.laps,
        "duration_s": took_s,
        "lost": totals.lost,
        "duplicated": totals.duplicated,
        "undelivered": totals.undelivered,
        "ended": totals.ended,
        "refused": sum(getattr(out, "refused", 0) for out in outs),
        "skipped": dict(totals.skipped),
        "times_left_alone": dict(totals.left),
        "lateness_p50_us": p50_us,
        "lateness_p99_us": p99_us,
        "lateness_p999_us": p999_us,
        "lateness_max_us": totals.worst_ns / 1e3,
    }
