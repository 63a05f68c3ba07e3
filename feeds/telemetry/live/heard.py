"""What a live source has been heard to say: reports by drone, and what was not taken."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import TypeVar

from plotfeed.feeds.telemetry.position_report import PositionReport, Reason, Refused, check

Known = TypeVar("Known")
MAX_NAME = 64
UNFORESEEN = "something that no reader foresaw"
_FIELD = re.compile(r"\{([a-z_]*)\}")
_NO_NAME = re.compile(r"[\s/+#]|[^ -~]")


@dataclass(frozen=True, slots=True)
class HeardReport:
    """A report of a drone, or a refusal of one; `drone` is empty if it is not known whose."""

    drone: str
    said: PositionReport | Refused

    @classmethod
    def checked(cls, drone: str, report: PositionReport) -> HeardReport:
        """The report, or the refusal of one with a value that cannot be."""
        try:
            check(report)
        except Refused as refused:
            return cls(drone, refused)
        return cls(drone, report)


def unforeseen(error: Exception) -> Refused:
    """The refusal of something at which a reader broke, instead of saying what is wrong with it."""
    return Refused(Reason.UNDECODABLE, f"{UNFORESEEN}: {type(error).__name__}")


def remember(known: dict[str, Known], name: str, what: Known, most: int) -> list[str]:
    """Know that of a name, as the last that is forgotten; the names that gave way."""
    known.pop(name, None)
    gone = list(islice(known, max(len(known) + 1 - most, 0)))
    for other in gone:
        del known[other]
    known[name] = what
    return gone


class Listener(ABC):
    """Makes reports of what comes, each peer's octets by themselves."""

    @abstractmethod
    def hear(self, peer: str, data: bytes, now_utc_ns: int) -> Iterator[HeardReport]:
        """What a peer has said with these octets, which came now. Raises nothing."""

    def forget(self, peer: str) -> None:  # noqa: B027 - of most nothing waits
        """Drop what waits of a peer that has gone: what comes next from it begins anew."""

    def notes(self) -> list[str]:
        """What was found out since this was last asked, a line each: for whoever runs it."""
        return []


def named(template: str, values: Mapping[str, object]) -> str:
    """The name of a drone: fields in braces filled in, what no topic can hold replaced."""
    filled = _FIELD.sub(lambda found: str(values.get(found[1], "")), template)
    return _NO_NAME.sub("-", filled.strip())[:MAX_NAME] or "unnamed"
