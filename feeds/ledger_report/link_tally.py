"""What became of a sensor's messages under one link setting, counted in bounded memory."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from pydantic import ValidationError

from plotfeed.feeds.impairment.asked import Asked
from plotfeed.feeds.impairment.settings import Link
from plotfeed.feeds.ledger_report.law_fit import LawFit
from plotfeed.feeds.ledger_report.spread import Spread
from plotfeed.feeds.scene_problems import problems_of
from plotfeed.models.state import Ints
from plotfeed.proto import plotfeed_pb2 as pb

AT_ONCE = 4096
"""Messages that are counted together."""
LET_THROUGH = frozenset({pb.SENT, pb.UNDELIVERED, pb.ENDED, pb.STALE})
"""Fates of messages whose link had said when they were to leave."""


@dataclass(frozen=True, slots=True)
class Setting:
    """A link as the ledger has it."""

    text: str
    """JSON of its keys, empty for none."""
    asked: Asked | None
    """None if it is not a link as we know them."""
    problem: str = ""
    """Why not."""

    @classmethod
    def of(cls, text: str) -> Setting:
        """Whatever it may be."""
        if not text:
            return cls(text, Asked(Link()))
        try:
            tree = json.loads(text)
        except (ValueError, RecursionError):
            return cls(text, None, "expected JSON")
        if not isinstance(tree, dict):
            return cls(text, None, "expected an object")
        try:
            return cls(text, Asked(Link.model_validate_json(text)))
        except ValidationError as error:
            key, what = next(problems_of(error, tree))
            return cls(text, None, f"{key}: {what}" if key else what)


@dataclass(slots=True)
class LinkTally:
    """Of one sensor and one setting. Delays are those of first copies, lateness is of all."""

    setting: Setting
    first_due_utc_ns: int | None = None
    last_due_utc_ns: int | None = None
    fates: Counter[int] = field(default_factory=Counter)
    """Of first copies."""
    duplicates: int = 0
    let_through: int = 0
    """Copies that the link let through, first ones and duplicates."""
    corrupted: int = 0
    delay: Spread = field(default_factory=Spread)
    """Sending less being handed over."""
    lateness: Spread = field(default_factory=Spread)
    """Sending less when the link was to let it leave."""
    sent_fit: LawFit | None = None
    """Of the delays as delivered."""
    link_fit: LawFit | None = None
    """Of the delays as the link drew them, without the engine's lateness."""
    _delays_ns: list[int] = field(default_factory=list)
    _drawn_ns: list[int] = field(default_factory=list)
    _late_ns: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        asked = self.setting.asked
        if asked is not None and not why_not_plain(asked):
            self.sent_fit, self.link_fit = LawFit(asked.delay), LawFit(asked.delay)

    def add(self, sent: pb.Sent, fate: int) -> None:
        """Take what became of a copy."""
        due_ns, link_due_ns = sent.due_utc_ns, sent.link_due_utc_ns
        first = sent.copy == 0
        if first:
            self.fates[fate] += 1
            self._take_due(due_ns)
        else:
            self.duplicates += 1
        if fate not in LET_THROUGH:
            return
        self.let_through += 1
        self.corrupted += sent.HasField("flipped_bit")
        if first:
            self._drawn_ns.append(link_due_ns - due_ns)
        if fate == pb.SENT:
            sent_ns = sent.sent_utc_ns
            self._late_ns.append(sent_ns - link_due_ns)
            if first:
                self._delays_ns.append(sent_ns - due_ns)
        if len(self._late_ns) >= AT_ONCE or len(self._drawn_ns) >= AT_ONCE:
            self.count()

    def count(self) -> None:
        """Count what has been gathered."""
        delays_ns, late_ns = _array(self._delays_ns), _array(self._late_ns)
        self.delay.add(delays_ns)
        self.lateness.add(late_ns)
        if self.sent_fit is not None and self.link_fit is not None:
            self.sent_fit.add(delays_ns)
            self.link_fit.add(_array(self._drawn_ns))
        for gathered in (self._delays_ns, self._late_ns, self._drawn_ns):
            gathered.clear()

    def _take_due(self, due_ns: int) -> None:
        if self.first_due_utc_ns is None or self.last_due_utc_ns is None:
            self.first_due_utc_ns = self.last_due_utc_ns = due_ns
        elif due_ns > self.last_due_utc_ns:
            self.last_due_utc_ns = due_ns
        elif due_ns < self.first_due_utc_ns:
            self.first_due_utc_ns = due_ns

    @property
    def messages(self) -> int:
        """First copies, whatever became of them."""
        return self.fates.total()


def why_not_plain(asked: Asked) -> str:
    """Why delays do not follow the law that a link asks for, if it has a spread; else empty."""
    link, (least_ms, most_ms) = asked.link, asked.delay_quantile_ms([0.0, 1.0])
    reasons = {
        "down": link.down,
        "stalls": link.on_loss == "stall",
        "kept in order": link.in_order,
        "rate limited": link.rate_kbit_s is not None,
        "reordered on purpose": link.reorder is not None,
        "all the same": not most_ms > least_ms,
    }
    return ", ".join(reason for reason, holds in reasons.items() if holds)


def _array(times_ns: list[int]) -> Ints:
    """Differences of times that a hostile file may have made too large for 64 bits."""
    try:
        return np.array(times_ns, np.int64)
    except OverflowError:
        limit = 1 << 62
        return np.array([max(-limit, min(limit, t)) for t in times_ns], np.int64)
