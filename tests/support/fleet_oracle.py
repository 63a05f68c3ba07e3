"""Whether what a fleet sent is what one process would have sent, but for the gaps that it tells."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from support.fleet_scenes import by_topic

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.scene import Scene
from plotfeed.testing import fly


@dataclass
class Verdict:
    """Numbers of messages, and which of one process's nobody heard, by topic."""

    heard: int = 0
    twice: int = 0
    foreign: int = 0  # That one process would not have sent
    foreign_topics: set[str] = field(default_factory=set)
    disordered: int = 0
    # Outside the gaps, up to the last that was heard of each topic.
    missing: list[Message] = field(default_factory=list)
    in_gaps: int = 0


def reference(scene: Scene, began_utc_ns: int, duration_s: float) -> list[Message]:
    """What one process sends of plots and tracks."""
    sent = fly(scene, duration_s, began_utc_ns).messages
    topics = by_topic(sent, began_utc_ns).keys()
    return [m for m in sent if not m.retain and m.topic in topics]


def judged(
    wanted: Sequence[Message],
    heard: Mapping[str, Sequence[bytes]],
    gaps: Sequence[Mapping[str, Any]],
) -> Verdict:
    """What was heard, by topic, against what one process sends."""
    verdict = Verdict()
    places: dict[str, dict[bytes, int]] = {}
    of_topic: dict[str, list[Message]] = {}
    for message in wanted:
        known = places.setdefault(message.topic, {})
        known[message.payload] = len(known)
        of_topic.setdefault(message.topic, []).append(message)
    for topic, payloads in heard.items():
        verdict.heard += len(payloads)
        verdict.twice += sum(count - 1 for count in Counter(payloads).values())
        known = places.get(topic, {})
        at = [known[payload] for payload in payloads if payload in known]
        verdict.foreign += len(payloads) - len(at)
        verdict.foreign_topics |= {topic} if len(payloads) > len(at) else set()
        verdict.disordered += sum(a > b for a, b in pairwise(at))
        came = set(at)
        for place, message in enumerate(of_topic.get(topic, [])):
            if place in came or place > max(came, default=-1):
                continue
            if any(_is_in(gap, message) for gap in gaps):
                verdict.in_gaps += 1
            else:
                verdict.missing.append(message)
    return verdict


def _is_in(gap: Mapping[str, Any], message: Message) -> bool:
    sensor = message.topic.split("/")[1]
    ends_ns = gap["to_utc_ns"]
    return (
        sensor in gap["sensors"]
        and message.due_utc_ns > gap["from_utc_ns"]
        and (ends_ns is None or message.due_utc_ns <= ends_ns)
    )
