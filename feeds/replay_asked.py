"""`plotfeed replay` as its options ask for it."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from plotfeed.feeds.broker_address import BrokerAddress
from plotfeed.feeds.replay_links import link_rule, simple_link
from plotfeed.feeds.replay_outs import Destinations
from plotfeed.feeds.replay_settings import (
    Choice,
    LinkRule,
    Moment,
    ReplayError,
    ReplaySettings,
    Selection,
    Stamps,
    TopicRule,
)
from plotfeed.feeds.replay_terminal import replay_in_terminal
from plotfeed.feeds.scene_problems import problems_of
from plotfeed.feeds.times import NS
from plotfeed.feeds.udp import Endpoint, UdpDestination
from plotfeed.replay.pacing import speed_of

RECORDED = "recorded"


def replay_as_asked(
    path: Path,
    default_broker: str,
    access: dict[str, Any],
    *,
    broker: str | None,
    udp: Sequence[str],
    ttl: int,
    interface: str | None,
    topics: Sequence[str],
    speed: float,
    fastest: bool,
    start: str | None,
    end: str | None,
    laps: int,
    date: datetime | None,
    stage: Choice,
    truth: bool,
    stamps: str | None,
    seed: int,
    as_json: bool,
    **links: Any,
) -> int:
    """Replay a file; the exit code. Raises `PlotfeedError`.

    `access` holds the keyword arguments of `BrokerAddress.parse`; `laps` of 0 are without end.
    """
    url = broker or (None if udp else default_broker)
    destinations = Destinations(
        brokers=() if url is None else (BrokerAddress.parse(url, **access),),
        udp=tuple(_destination(to, ttl, interface) for to in udp if to != RECORDED),
        recorded_udp=RECORDED in udp,
        ttl=ttl,
        interface=interface,
    )
    settings = ReplaySettings(
        selection=Selection(stage=stage, truth=truth),
        speed=speed_of(1.0 if fastest else speed),
        fastest=fastest,
        start=None if start is None else Moment.parse(start),
        end=None if end is None else Moment.parse(end),
        laps=laps or None,
        stamps=Stamps.parse(stamps or ("now" if stage == "telemetry" else "keep")),
        topics=tuple(TopicRule.parse(text) for text in topics),
        links=_links(**links),
        seed=seed,
    )
    date_utc_ns = 0 if date is None else int(date.replace(tzinfo=UTC).timestamp()) * NS
    return replay_in_terminal(
        path, destinations, settings, date_utc_ns=date_utc_ns, as_json=as_json
    )


def _links(
    *,
    links: Sequence[str],
    latency_ms: float | None,
    jitter_ms: float | None,
    loss: float | None,
) -> tuple[LinkRule, ...]:
    """Those of topics before those of all, whatever their order on the command line."""
    rules = [link_rule(text) for text in links]
    simple = simple_link(latency_ms, jitter_ms, loss)
    if simple is not None:
        rules.append(simple)
    return tuple(sorted(rules, key=lambda rule: -len(rule.topic)))


def _destination(to: str, ttl: int, interface: str | None) -> UdpDestination:
    tree = {"destination": to, "ttl": ttl}
    try:
        if interface is not None and Endpoint.parse(to).address.is_multicast:
            tree["interface"] = interface
        return UdpDestination.model_validate(tree)
    except ValidationError as error:
        _, text = next(iter(problems_of(error, tree)))
        raise ReplayError(f"--udp: {text}") from None
    except ValueError as error:
        raise ReplayError(f"--udp: {error}") from None
