"""Where `run` and `demo` send: what the scene says, or the command line instead; and telling it."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

from pydantic import ValidationError

from plotfeed.feeds.cli.options import udp_destination
from plotfeed.feeds.cli.run_settings import RunSettings
from plotfeed.feeds.console.printed import say
from plotfeed.feeds.link.counters import SessionCounters
from plotfeed.feeds.scene.fields import split_address
from plotfeed.feeds.scene.output_keys import (
    TOKEN_VARIABLE,
    HttpDestination,
    TakServer,
    TrackDestination,
    WaysOut,
)
from plotfeed.feeds.scene.problems import problems_of
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.transport.brokers import NO_BROKER
from plotfeed.feeds.transport.mqtt.address import without_secrets
from plotfeed.proto.errors import PlotfeedError

# Of the token that goes where the command line says, if the environment has one.
TOKEN_NAME = "COMMAND_LINE"  # noqa: S105 - its name, not its value  # nosec B105


PAGES = {"page", "audience"}  # Addresses that are looked at in a browser
MOST_UNSEEN = 3  # Drones that no sensor sees, told one by one


def named_outgoing(scene: Scene, settings: RunSettings) -> WaysOut:
    """Destinations of the scene, or those that the command line names instead."""
    to = replace(scene.outgoing, waits=settings.wait)
    if settings.middleware is not None:
        try:
            split_address(settings.middleware)
        except ValueError as error:
            raise PlotfeedError(f"--middleware: {error}") from None
        to = replace(to, middleware=settings.middleware)
    if settings.telemetry is not None:
        to = replace(to, sources=())  # what they said is in the record
    if settings.tak:
        to = replace(to, tak=tuple(_tak(text) for text in settings.tak))
    if settings.http:
        to = replace(to, http=tuple(_http(text) for text in settings.http))
    udp = tuple(map(udp_destination, settings.udp))
    to = replace(to, udp=udp) if udp else to
    lacking = {each.format for each in to.queued} - {f for s in scene.sensor for f in s.report}
    if lacking and (settings.tak or settings.http):
        raise PlotfeedError(f"no sensor of the scene has {min(lacking)!r} in its report")
    return to


def _tak(server: str) -> TakServer:
    try:
        return TakServer.model_validate({"server": server})
    except ValidationError as error:
        raise PlotfeedError(f"--tak: {_first_problem(error)}") from None


def _http(text: str) -> HttpDestination:
    carries, _, url = text.partition("=")
    try:
        keys = {"carries": carries, "url": url}
        if f"{TOKEN_VARIABLE}{TOKEN_NAME}" in os.environ:
            keys["token"] = TOKEN_NAME
        return HttpDestination.model_validate(keys)
    except ValidationError as error:
        raise PlotfeedError(f"--http: {_first_problem(error)}; FORMAT=URL") from None


def _first_problem(error: ValidationError) -> str:
    return next(iter(problems_of(error, {})))[1]


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
