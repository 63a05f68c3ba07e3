"""What the options of `plotfeed replay` ask for, as destinations and settings of a replay."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from plotfeed.feeds.cli.options import udp_destination
from plotfeed.feeds.console.option_fields import MAX_SEED, option
from plotfeed.proto.errors import PlotfeedError

if TYPE_CHECKING:
    from plotfeed.feeds.replaying.destinations import Destinations
    from plotfeed.feeds.replaying.replay_settings import LinkRule, ReplaySettings
    from plotfeed.feeds.scene.output_keys import UdpDestination

MAX_OCTETS = 1 << 20  # Of a file with the keys of a link
RECORDED = "recorded"  # In place of an address: where each datagram once went
ANY_GROUP = "239.0.0.0:1"  # Stands for the groups that they once went to, whose keys are given
FASTEST = "max"  # In place of a speed


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayOptions:
    """What the options of `replay` ask for."""

    broker: str | None = option(
        None,
        "Send to the broker at mqtt://HOST:PORT or mqtts://HOST:PORT; without it and without "
        "--udp to mqtt://127.0.0.1:1883.",
        metavar="URL",
    )
    udp: tuple[str, ...] = option(
        (),
        "Send ASTERIX there by UDP, or by 'recorded' each datagram to where it once went, with "
        "keys of a scene's [[udp]] such as ?ttl=4&interface=eth0 behind either; may be repeated.",
        metavar="ADDRESS:PORT[?KEYS]",
    )
    topics: tuple[str, ...] = option(
        (),
        "Let topics that begin with the levels of OLD begin with NEW; may be repeated.",
        metavar="OLD=NEW",
        name="--topic",
    )
    speed: str = option(
        "1",
        "Replay so many times as fast as it was recorded (0.001 to 10000), or with 'max' as fast "
        "as possible, without deadlines.",
        metavar="FACTOR",
    )
    start: str | None = option(
        None,
        "Begin so many seconds after the beginning, or at a time as 2026-01-01T12:00:00Z.",
        metavar="TIME",
    )
    end: str | None = option(
        None,
        "End before that time, given as for --start; what was recorded at it is left out.",
        metavar="TIME",
    )
    laps: int = option(
        1,
        "Replay N times over; without N, until it is stopped.",
        low=0,
        metavar="[N]",
        name="--loop",
        tells_default=False,
        bare=0,
    )
    stage: Literal["after", "before", "telemetry"] = option(
        "after",
        "Send what left or was heard (after), what sensors handed to their links (before), or "
        "what came in (telemetry).",
    )
    truth: bool = option(False, "Send the ledger too, which says whose plot is whose.")
    stamps: str | None = option(
        None,
        "Write times inside messages anew: keep leaves them alone, now makes them as much later "
        "as the message is, and +SECONDS so much later; without it keep, but now for telemetry.",
        metavar="HOW",
    )
    as_json: bool = option(False, "Print nothing but the counts at the end, as one JSON object.")
    links: tuple[str, ...] = option(
        (),
        "Put the messages of each sensor on a link by the keys of a scene's [sensor.link] in "
        "this TOML file; with TOPIC= only those whose topics begin so. May be repeated.",
        metavar="[TOPIC=]FILE",
        name="--link",
    )
    seed: int = option(
        0,
        "Draw delays and losses of links by this seed; with the same seed they are the same.",
        low=0,
        high=MAX_SEED,
    )

    def destinations(self, default_broker: str, access: dict[str, Any]) -> Destinations:
        """The places that it goes to; `access` is all but the URL of a broker's address."""
        from plotfeed.feeds.replaying.destinations import Destinations
        from plotfeed.feeds.transport.mqtt.address import BrokerAddress

        url = self.broker or (None if self.udp else default_broker)
        udp: list[UdpDestination] = []
        recorded: UdpDestination | None = None
        for text in self.udp:
            place, mark, keys = text.partition("?")
            if place == RECORDED:
                recorded = udp_destination(f"{ANY_GROUP}{mark}{keys}")
            else:
                udp.append(udp_destination(text))
        brokers = () if url is None else (BrokerAddress.parse(url, **access),)
        return Destinations(brokers=brokers, udp=tuple(udp), recorded=recorded)

    def settings(self) -> ReplaySettings:
        """What is replayed, and how; raises `ReplayError`."""
        from plotfeed.feeds.replaying.replay_settings import (
            Moment,
            ReplaySettings,
            Selection,
            Stamps,
            TopicRule,
        )
        from plotfeed.replay.pacing import speed_of

        fastest = self.speed == FASTEST
        try:
            speed = speed_of(1.0 if fastest else float(self.speed))
        except ValueError:
            raise PlotfeedError("--speed: expected 0.001 to 10000, or max") from None
        return ReplaySettings(
            selection=Selection(stage=self.stage, truth=self.truth),
            speed=speed,
            fastest=fastest,
            start=None if self.start is None else Moment.parse(self.start),
            end=None if self.end is None else Moment.parse(self.end),
            laps=self.laps or None,
            stamps=Stamps.parse(self.stamps or ("now" if self.stage == "telemetry" else "keep")),
            topics=tuple(TopicRule.parse(text) for text in self.topics),
            # Those of topics before those of all, whatever their order on the command line.
            links=tuple(sorted(map(_link_rule, self.links), key=lambda rule: -len(rule.topic))),
            seed=self.seed,
        )


def _link_rule(text: str) -> LinkRule:
    """The link in FILE, for all topics, or TOPIC=FILE: the keys of a scene's [sensor.link]."""
    from pydantic import ValidationError

    from plotfeed.feeds.replaying.replay_settings import LinkRule, ReplayError
    from plotfeed.feeds.scene.link_keys import LinkSettings
    from plotfeed.feeds.scene.problems import problems_of

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
