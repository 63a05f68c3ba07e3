"""What a session has done so far, and how late its messages left."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from plotfeed.models.state import Ints
from plotfeed.proto import plotfeed_pb2 as pb

LATENESS_KEPT = 100_000


class LastLateness:
    """How late messages left, nanoseconds: of the last `most` of them, in order.

    Up to twice as many are held, 8 octets each.
    """

    def __init__(self, most: int = LATENESS_KEPT) -> None:
        self._most = most
        self._values = array("q")

    def __len__(self) -> int:
        return min(len(self._values), self._most)

    def __iter__(self) -> Iterator[int]:
        return iter(self.values().tolist())

    def append(self, lateness_ns: int, times: int = 1) -> None:
        """Keep another, of so many messages; the oldest give way where there is no more room."""
        if times == 1:
            self._values.append(lateness_ns)
        else:
            self._values.extend(array("q", (lateness_ns,)) * times)
        if len(self._values) >= 2 * self._most:
            del self._values[: -self._most]

    def clear(self) -> None:
        """Keep none."""
        del self._values[:]

    def values(self) -> Ints:
        """The last of them, oldest first; a copy."""
        return np.array(self._values[-self._most :], np.int64)


def lateness_us(lateness_ns: LastLateness | Sequence[int], *percentiles: float) -> list[float]:
    """Percentiles of how late messages left, microseconds; zeros if none did."""
    if not lateness_ns:
        return [0.0] * len(percentiles)
    values = lateness_ns.values() if isinstance(lateness_ns, LastLateness) else lateness_ns
    ordered = np.sort(np.asarray(values))  # of integers quicker than what np.percentile does
    at = np.array(percentiles) / 100 * (len(ordered) - 1)
    below = at.astype(np.int64)
    above = np.minimum(below + 1, len(ordered) - 1)
    found = ordered[below] + (at - below) * (ordered[above] - ordered[below])
    return [float(p) / 1e3 for p in found]


# Fates that a link decides on, as the scene asks.
LOSSES = frozenset({pb.LOST, pb.QUEUE_FULL, pb.OUTAGE})


@dataclass(slots=True, eq=False)
class SessionCounters:
    """Counts of a session; they only grow. Each is who it is."""

    drones: int = 0  # Known now
    forgotten: int = 0  # Drones that were known, and of which nothing came for long
    scan: int = 0
    looks: int = 0
    plots: int = 0
    false_alarms: int = 0
    messages: int = 0  # Sent, each copy counted
    lost: int = 0  # By links, as the scene asks
    duplicated: int = 0
    stale: int = 0  # Not sent, because who they were for would not take them so late
    # That no destination got, for want of a connection, or of room to wait for one.
    undelivered: int = 0
    # By destination, whatever others got.
    undelivered_to: Counter[str] = field(default_factory=Counter)
    ended: int = 0  # Still on their way when the session ended
    missed_scans: int = 0
    telemetry: int = 0
    conflated: int = 0  # Telemetry that was good, but gave way to later reports that came with it
    refused: int = 0
    refused_by: Mapping[str, int] = field(default_factory=dict)  # The same, by reason
    flooded: int = 0  # Refused because more of the topic waited than may
    late: int = 0  # Refused because no sensor could have seen it any more
    last_refusal: str = ""
    # How long the oldest of what came in had waited when some was last taken in.
    intake_behind_s: float = 0.0
    other_sessions: int = 0  # That publish on the same prefix now, as far as is known
    controls: int = 0  # Changes that were asked for while the session ran, and made
    sapient_connections: int = 0  # Of sensors to the middleware, the first of each among them
    sapient_stalls: int = 0  # Connections given up because the middleware no longer read
    sapient_refusals: int = 0  # Registrations that it refused
    sapient_errors: int = 0  # Errors that it sent, and what it sent that cannot be read
    sapient_tasks: int = 0  # Accepted, wherever they came from
    sapient_rejected: int = 0  # Tasks that were not
    # Samples of what was published that a broker passed on to the session itself.
    heard_back: int = 0
    # Samples that it did not pass on, although it answers: perhaps its access list is against.
    not_heard_back: int = 0
    # Drones of the scene that no sensor will see, and why.
    unseen: Mapping[str, str] = field(default_factory=dict)
    doubts: Sequence[str] = ()  # What looks wrong about heights
    lateness_ns: LastLateness = field(default_factory=LastLateness)
    # Times real time at which its clock is to run; None for as fast as it can.
    speed: float | None = None
    # And at which it ran since that was set: a machine that cannot hold it slows the clock.
    speed_reached: float | None = None

    def add(self, counts: Sequence[tuple[int, int, int, int]]) -> None:
        """Count what sectors brought: scan, looks, plots and false alarms of each."""
        scans, looks, plots, false_alarms = zip(*counts, strict=True)
        self.scan = max(self.scan, *scans)
        self.looks += sum(looks)
        self.plots += sum(plots)
        self.false_alarms += sum(false_alarms)

    def echoed(self, came: bool) -> None:
        """Count a sample of what was published, which has come back or not."""
        self.heard_back += came
        self.not_heard_back += not came

    def sent(self, messages: int, lateness_ns: int) -> None:
        """Count so many that were sent, all of them so late."""
        self.messages += messages
        self.lateness_ns.append(lateness_ns, messages)

    def settle(self, fate: pb.Fate, copy: int, lateness_ns: int, octets: int) -> None:  # noqa: ARG002
        """Count what became of a copy of a message, with so many octets of payload."""
        if fate == pb.SENT:
            self.messages += 1
            self.duplicated += copy > 0
            self.lateness_ns.append(lateness_ns)
        elif fate in LOSSES:
            self.lost += 1
        elif fate == pb.STALE:
            self.stale += 1
        elif fate == pb.ENDED:
            self.ended += 1
        else:
            self.undelivered += 1


@dataclass(slots=True)
class SapientCounters:
    """Counts of a sensor as a node of SAPIENT, which go to the session's as `sapient_...`, too."""

    totals: SessionCounters
    reporting: bool = False  # To the middleware, which has not refused it
    connections: int = 0
    stalls: int = 0
    refusals: int = 0
    errors: int = 0
    tasks: int = 0
    rejected: int = 0

    def count(self, what: str, number: int = 1) -> None:
        """Count so many more of what one of its fields counts."""
        for counts, name in ((self, what), (self.totals, f"sapient_{what}")):
            setattr(counts, name, getattr(counts, name) + number)


@dataclass(slots=True, eq=False)
class ClientCounters:
    """Counts of what one client has sent, for the status of its sensor; each is who it is."""

    lost: int = 0
    duplicated: int = 0
    undelivered: int = 0
    undelivered_to: Counter[str] = field(default_factory=Counter)
    lateness_ns: LastLateness = field(default_factory=LastLateness)
    # When the first and the last were due that did not leave, since `take_not_sent`.
    not_sent_ns: tuple[int, int] | None = None
    sapient: SapientCounters | None = None  # Of a sensor that reports in it

    def settle(self, fate: pb.Fate, copy: int, lateness_ns: int) -> None:
        """Count what became of a copy of a message."""
        if fate == pb.SENT:
            self.lateness_ns.append(lateness_ns)
            self.duplicated += copy > 0
        else:
            self.lost += fate in LOSSES
            self.undelivered += fate == pb.UNDELIVERED

    def leave_out(self, first_due_ns: int, last_due_ns: int) -> None:
        """Note that nothing left of what was due between those times."""
        if self.not_sent_ns is not None:
            first_due_ns = min(first_due_ns, self.not_sent_ns[0])
            last_due_ns = max(last_due_ns, self.not_sent_ns[1])
        self.not_sent_ns = first_due_ns, last_due_ns

    def take_not_sent(self) -> tuple[int, int] | None:
        """Tell once from when until when some of what was due did not leave; None if all did."""
        found, self.not_sent_ns = self.not_sent_ns, None
        return found
