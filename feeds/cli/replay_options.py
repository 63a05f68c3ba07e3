"""What the options of `plotfeed replay` ask for, as destinations and settings of a replay."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from plotfeed.feeds.cli.options import udp_destination
from plotfeed.feeds.replaying.destinations import Destinations
from plotfeed.feeds.replaying.replay_settings import (
    Choice,
    LinkRule,
    Moment,
    ReplayError,
    ReplaySettings,
    Selection,
    Stamps,
    TopicRule,
)
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.problems import problems_of
from plotfeed.feeds.transport.mqtt.address import BrokerAddress
from plotfeed.proto.utc import NS
from plotfeed.replay.pacing import speed_of

MAX_OCTETS = 1 << 20
"""Of a file with the keys of a link."""
RECORDED = "recorded"
"""In place of an address: where each datagram once went."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayOptions:
    """What the options of `replay` ask for."""

    broker: str | None
    udp: tuple[str, ...]
    ttl: int
    interface: str | None
    topics: tuple[str, ...]
    speed: float
    fastest: bool
    start: str | None
    end: str | None
    laps: int
    """0 is without end."""
    date: datetime | None
    """On which a file without dates begins."""
    stage: Choice
    truth: bool
    stamps: str | None
    seed: int
    links: tuple[str, ...]
    latency_ms: float | None
    jitter_ms: float | None
    loss: float | None
    as_json: bool

    @property
    def date_utc_ns(self) -> int:
        """Midnight of the date; 0 without one."""
        return 0 if self.date is None else int(self.date.replace(tzinfo=UTC).timestamp()) * NS

    def destinations(self, default_broker: str, access: dict[str, Any]) -> Destinations:
        """The places that it goes to; `access` is all but the URL of a broker's address."""
        url = self.broker or (None if self.udp else default_broker)
        return Destinations(
            brokers=() if url is None else (BrokerAddress.parse(url, **access),),
            udp=tuple(
                udp_destination(to, self.ttl, self.interface) for to in self.udp if to != RECORDED
            ),
            recorded_udp=RECORDED in self.udp,
            ttl=self.ttl,
            interface=self.interface,
        )

    def settings(self) -> ReplaySettings:
        """What is replayed, and how; raises `ReplayError`."""
        return ReplaySettings(
            selection=Selection(stage=self.stage, truth=self.truth),
            speed=speed_of(1.0 if self.fastest else self.speed),
            fastest=self.fastest,
            start=None if self.start is None else Moment.parse(self.start),
            end=None if self.end is None else Moment.parse(self.end),
            laps=self.laps or None,
            stamps=Stamps.parse(self.stamps or ("now" if self.stage == "telemetry" else "keep")),
            topics=tuple(TopicRule.parse(text) for text in self.topics),
            links=self._links(),
            seed=self.seed,
        )

    def _links(self) -> tuple[LinkRule, ...]:
        """Links of topics before those of all, whatever their order on the command line."""
        rules = [_link_rule(text) for text in self.links]
        tree: dict[str, Any] = {"latency_ms": self.latency_ms, "jitter_ms": self.jitter_ms}
        if self.loss is not None:
            tree["loss"] = {"kind": "random", "probability": self.loss}
        tree = {key: value for key, value in tree.items() if value is not None}
        if tree:
            rules.append(LinkRule("", _link(tree, "link: ")))
        return tuple(sorted(rules, key=lambda rule: -len(rule.topic)))


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
    return LinkRule(topic, _link(tree, f"{path}: "))


def _link(tree: dict[str, Any], where: str) -> LinkSettings:
    try:
        return LinkSettings.model_validate(tree)
    except ValidationError as error:
        problems = problems_of(error, tree)
        lines = [f"{where}{key}: {text}" if key else f"{where}{text}" for key, text in problems]
        raise ReplayError("\n".join(lines)) from None
