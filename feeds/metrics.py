"""Prometheus metrics of a session, over HTTP: plotfeed[metrics]."""

from __future__ import annotations

import contextlib
import hmac
import logging
import os
import socket
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from socketserver import ThreadingMixIn
from typing import Any, ClassVar
from urllib.parse import parse_qs
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

from plotfeed.feeds.console.printed import bracketed
from plotfeed.feeds.link.counters import lateness_us
from plotfeed.feeds.session.observer import Observer, RunningSession
from plotfeed.feeds.transport.local_hosts import ServedAddress, drawn_token, fixed_token
from plotfeed.proto.errors import PlotfeedError

log = logging.getLogger(__name__)

TOKEN_VARIABLE = "PLOTFEED_METRICS_TOKEN"  # noqa: S105 - its name  # nosec B105
PATH = "/metrics"
# Of the session, by the name in its totals.
COUNTERS = {
    "looks": "Looks at drones within cover",
    "plots": "Plots reported, false alarms among them",
    "false_alarms": "Plots that no drone caused",
    "messages": "Messages that left, each copy counted",
    "lost": "Messages that links lost, as the scene asks",
    "duplicated": "Messages that links doubled",
    "stale": "Messages too late for whom they were for",
    "undelivered": "Messages that no destination got",
    "missed_scans": "Scans skipped because the machine was late",
    "telemetry": "Telemetry messages taken",
    "conflated": "Telemetry messages that gave way to later ones of their drone",
    "refused": "Telemetry and control messages refused",
    "forgotten": "Drones forgotten, since nothing came of them for long",
    "flooded": "Messages refused because too many of their topic waited",
    "late": "Telemetry messages refused because they were taken in too late",
    "heard_back": "Samples of what was published that a broker passed on to the session itself",
    "not_heard_back": "Samples of what was published that it did not pass on",
    "controls": "Changes made by control",
    "sapient_connections": "Connections of sensors to the SAPIENT middleware, so far",
    "sapient_stalls": "Connections given up because the SAPIENT middleware no longer read",
    "sapient_refusals": "Registrations that the SAPIENT middleware refused",
    "sapient_errors": "Errors that the SAPIENT middleware sent, and what cannot be read of it",
    "sapient_tasks": "SAPIENT tasks accepted",
    "sapient_rejected": "SAPIENT tasks rejected",
}


@dataclass(frozen=True, slots=True)
class MetricsAddress(ServedAddress):
    """Host and port at which metrics are served."""

    option: ClassVar[str] = "--metrics"
    port: int = 9464


class MetricsError(PlotfeedError):
    """Metrics that cannot be served."""

    exit_code = 1


class SessionCollector(Observer):
    """Reads the session that runs when it is asked, and costs nothing in between."""

    def __init__(self) -> None:
        self._session: RunningSession | None = None

    def begun(self, session: RunningSession) -> None:
        """The session is the one to read."""
        self._session = session

    def collect(self) -> Iterator[Any]:
        """The metrics of the session, and of each sensor; none before it begins."""
        if self._session is None:
            return
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

        session, totals = self._session, self._session.totals
        for name, text in COUNTERS.items():
            yield CounterMetricFamily(f"plotfeed_{name}", text, value=getattr(totals, name))
        text = "Messages that a destination did not get, whatever others did"
        by_destination = CounterMetricFamily(
            "plotfeed_undelivered_to", text, labels=["destination"]
        )
        for destination, count in totals.undelivered_to.items():
            by_destination.add_metric([destination], count)
        yield by_destination
        yield GaugeMetricFamily("plotfeed_drones", "Drones known now", value=totals.drones)
        yield GaugeMetricFamily(
            "plotfeed_other_sessions",
            "Other sessions that publish on the same prefix",
            value=totals.other_sessions,
        )
        yield GaugeMetricFamily(
            "plotfeed_inbox", "Messages that wait to be taken in", value=len(session.intake)
        )
        yield GaugeMetricFamily(
            "plotfeed_intake_behind_seconds",
            "How long the oldest message has waited to be taken in",
            value=totals.intake_behind_s,
        )
        by_reason = CounterMetricFamily(
            "plotfeed_refused_by_reason", "Messages refused, by reason", labels=["reason"]
        )
        for reason, number in totals.refused_by.items():
            by_reason.add_metric([str(reason)], number)
        yield by_reason
        late = GaugeMetricFamily(
            "plotfeed_lateness_seconds", "Sent after due, of the last messages", labels=["quantile"]
        )
        found_us = lateness_us(totals.lateness_ns, 50, 99, 99.9)
        for quantile, late_us in zip(("0.5", "0.99", "0.999"), found_us, strict=True):
            late.add_metric([quantile], late_us / 1e6)
        yield late
        yield from self._of_sensors(session, GaugeMetricFamily)

    def _of_sensors(self, session: RunningSession, family: Any) -> Iterable[Any]:
        gauges = {
            "scan": "The last scan reported",
            "plots": "Plots reported so far",
            "lost": "Messages that the link lost so far",
            "on_the_way": "Messages that the link holds",
            "waiting": "Messages that wait for the broker",
            "enabled": "1 where the sensor is at work",
        }
        for name, text in gauges.items():
            gauge = family(f"plotfeed_sensor_{name}", text, labels=["sensor"])
            for sensor, task in session.sensors.items():
                gauge.add_metric([sensor], float(getattr(task.status, name)))
            yield gauge


Application = Callable[..., Iterable[bytes]]  # Of WSGI, PEP 3333


def _for_who_may_ask(
    application: Application, address: MetricsAddress, token: str | None
) -> Application:
    """Answer nobody who asked for another host, as by DNS rebinding, or who lacks the token."""

    def answer(environ: dict[str, Any], start_response: Callable[..., Any]) -> Iterable[bytes]:
        if not address.host_is_ours(environ.get("HTTP_HOST", "")):
            start_response("403 Forbidden", [("Content-Type", "text/plain")])
            return [b"This is not the host that was asked for.\n"]
        given = environ.get("HTTP_AUTHORIZATION", "").removeprefix("Bearer ")
        given = parse_qs(environ.get("QUERY_STRING", "")).get("token", [given])[0]
        if token is not None and not hmac.compare_digest(given.encode(), token.encode()):
            start_response("401 Unauthorized", [("WWW-Authenticate", "Bearer")])
            return [b"These metrics need the token that plotfeed has told.\n"]
        return application(environ, start_response)

    return answer


class _Server(ThreadingMixIn, WSGIServer):
    daemon_threads = True


class _ServerV6(_Server):
    address_family = socket.AF_INET6


class _Quiet(WSGIRequestHandler):
    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - its name
        """Say nothing of requests."""


@contextlib.contextmanager
def served(address: MetricsAddress) -> Iterator[Observer]:
    """Serve metrics at /metrics there meanwhile; raises `PlotfeedError`.

    They are those of the session that is observed. Beyond loopback they need the
    token of the environment, or else a drawn one, which is logged with the URL.
    """
    token = fixed_token(os.environ, TOKEN_VARIABLE)
    if token is None and not address.is_loopback:
        token = drawn_token()
    try:
        from prometheus_client import CollectorRegistry, make_wsgi_app
    except ImportError:
        raise MetricsError(
            "metrics need prometheus-client: pip install 'plotfeed[metrics]'"
        ) from None
    registry = CollectorRegistry(auto_describe=False)
    collector = SessionCollector()
    registry.register(collector)
    application = _for_who_may_ask(make_wsgi_app(registry), address, token)
    kind = _ServerV6 if ":" in address.host else _Server
    try:
        server = make_server(address.host, address.port, application, kind, _Quiet)
    except OSError as error:
        where = f"{MetricsAddress.option} {bracketed(address.host)}:{address.port}"
        raise MetricsError(f"{where}: {error.strerror or error}") from None
    if token is not None or not address.port:
        log.info("metrics are at %s", replace(address, port=server.server_port).url(PATH, token))
    thread = threading.Thread(target=server.serve_forever, name="metrics", daemon=True)
    thread.start()
    try:
        yield collector
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
