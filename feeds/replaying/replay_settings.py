"""What a replay is asked to do: which messages, when, where, and with which times inside them."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from fractions import Fraction
from typing import Literal

from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.report_formats import is_inbox
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS, utc_ns
from plotfeed.replay.recorded import WHAT_LEFT, Stage

Choice = Literal["after", "before", "telemetry"]
MAX_SECONDS = 10**10


class ReplayError(PlotfeedError):
    """A replay that cannot be as it was asked for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stamps:
    """The times inside messages: left alone, as late as they are replayed, or later by a time."""

    to_now: bool = False
    by_ns: int = 0

    @classmethod
    def parse(cls, text: str) -> Stamps:
        """Read keep, now, or seconds such as +3600 or -0.5; raises `ReplayError`."""
        if text in ("keep", "now"):
            return cls(to_now=text == "now")
        by_ns = _nanoseconds(text)
        if by_ns is None:
            raise ReplayError(f"stamps: expected keep, now, or seconds such as +3600, not {text!r}")
        return cls(by_ns=by_ns)

    def shift_ns(self, due_utc_ns: int, recorded_utc_ns: int) -> int:
        """Shift of the times in a message that was recorded and is due then."""
        return due_utc_ns - recorded_utc_ns if self.to_now else self.by_ns


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """A place in a recording: so long after its beginning, or at a time."""

    since_ns: int | None = None
    utc_ns: int | None = None

    @classmethod
    def parse(cls, text: str) -> Moment:
        """Read seconds or a time such as 2026-01-01T12:00:00Z; raises `ReplayError`."""
        since_ns = _nanoseconds(text)
        if since_ns is not None and since_ns >= 0:
            return cls(since_ns=since_ns)
        at_utc_ns = utc_ns(text)
        if at_utc_ns is None:
            expected = "seconds from the beginning, or a time such as 2026-01-01T12:00:00Z"
            raise ReplayError(f"expected {expected}, not {text!r}")
        return cls(utc_ns=at_utc_ns)

    def at(self, first_ns: int) -> int:
        """The recorded time of that place, in a recording that begins then."""
        return first_ns + (self.since_ns or 0) if self.utc_ns is None else self.utc_ns


@dataclass(frozen=True, slots=True)
class TopicRule:
    """Topics that are or begin with the levels of `old` have those of `new` instead."""

    old: str
    new: str

    @classmethod
    def parse(cls, text: str) -> TopicRule:
        """Read OLD=NEW; raises `ReplayError`."""
        old, equals, new = text.partition("=")
        rule = cls(old, new)
        if not equals or not rule.old or not is_topic(rule.new):
            raise ReplayError(f"topic: expected OLD=NEW, topics without + and #, not {text!r}")
        return rule

    def apply(self, topic: str) -> str | None:
        """The topic that it has instead; None if the rule is not for it."""
        is_of_it = f"{topic}/".startswith(f"{self.old}/")
        return self.new + topic[len(self.old) :] if is_of_it else None


@dataclass(frozen=True, slots=True)
class LinkRule:
    """What the links of the topics are like that begin with these levels; "" is all topics."""

    topic: str
    link: LinkSettings

    def holds_for(self, topic: str) -> bool:
        """Whether it is for that topic."""
        return not self.topic or f"{topic}/".startswith(f"{self.topic}/")


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplaySettings:
    """A replay."""

    # After: what left sensors, or was received. Before: what sensors handed to their links.
    stage: Choice = "after"
    truth: bool = False  # Whether the ledger is replayed too
    speed: Fraction = Fraction(1)
    fastest: bool = False  # As fast as possible: time is simulated, at the recording's own pace
    start: Moment | None = None
    end: Moment | None = None  # Messages of this time and later are left out
    laps: int | None = 1  # None: again and again
    # Recorded time, not before the last message, at which it stands until it is sought or stopped;
    # None, and without deadlines: it ends with its last message.
    stands_at_ns: int | None = None
    stamps: Stamps = Stamps()
    topics: tuple[TopicRule, ...] = ()  # The first that is for a topic counts
    # The first that is for a topic counts; a link each for what has the same source.
    links: tuple[LinkRule, ...] = ()
    seed: int = 0  # Of the links' chance

    def takes(self, topic: str, content_type: str, stage: Stage) -> bool:
        """Whether messages on that topic are replayed, of that type and at that stage."""
        levels = topic.split("/")
        is_telemetry = levels[-2:-1] == ["telemetry"]
        if levels[-1] == "control" or is_inbox(topic):
            return False
        if self.stage == "telemetry":
            return is_telemetry and stage in (Stage.TELEMETRY, Stage.RECEIVED)
        if self.stage == "before":
            return stage is Stage.BEFORE
        if stage not in WHAT_LEFT or is_telemetry:
            return False
        return self.truth or not (levels[-1] == "truth" or "Ledger" in content_type)


def is_topic(text: str) -> bool:
    """Whether a broker takes messages on it."""
    try:
        octets = len(text.encode())
    except UnicodeEncodeError:
        return False
    return 0 < octets < 1 << 16 and not set(text) & set("+#\0")


def _nanoseconds(text: str) -> int | None:
    """Exact."""
    try:
        seconds = Decimal(text)
        if not seconds.is_finite() or abs(seconds) > MAX_SECONDS:
            return None
        return int(seconds * NS)
    except InvalidOperation:
        return None
