"""How the parts of a fleet do, as rows: for a terminal, and for the page."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel, ValidationError

from plotfeed.feeds.scene.problems import problems_of
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

JOINING, UNKNOWN = "joining", "unknown"


class _Part(BaseModel):
    part: str
    sensors: list[str]
    sends: bool
    worker: str
    epoch: int
    sent_until_utc: str


class _Gap(BaseModel):
    part: str
    why: str
    from_utc_ns: int
    to_utc_ns: int | None


class _Fleet(BaseModel):
    scene: str
    state: str
    began_utc: str
    takeovers: int
    parts: list[_Part]
    gaps: list[_Gap]


class _Status(BaseModel):
    state: str = UNKNOWN
    plots: int | None = None
    missed_scans: int | None = None
    lateness_p99_us: float = 0.0


def told_in(payload: bytes, *, of_part: bool) -> dict[str, Any]:
    """What a fleet, or the worker of a part, says of itself; raises `PlotfeedError` if it does not.

    All that it says, of which the keys that are shown have been checked.
    """
    try:
        told: dict[str, Any] = json.loads(payload)
        (_Status if of_part else _Fleet).model_validate(told)
    except ValidationError as error:
        where, why = next(iter(problems_of(error, told)))
        raise PlotfeedError(f"{where}: {why}" if where else why) from None
    except (ValueError, RecursionError):
        raise PlotfeedError("it is not JSON") from None
    return told


def part_rows(told: Mapping[str, Any], statuses: Mapping[str, Mapping[str, Any]]) -> Iterator[Any]:
    """A row of each part, as JSON: of what the fleet tells, and the workers by part."""
    for part in told["parts"]:
        status = statuses.get(part["part"], {})
        yield {
            "part": part["part"],
            "sensors": part["sensors"],
            "state": status.get("state", UNKNOWN) if part["sends"] else JOINING,
            "worker": part["worker"],
            "epoch": part["epoch"],
            "plots": status.get("plots"),
            "missed_scans": status.get("missed_scans"),
            "lateness_p99_ms": status.get("lateness_p99_us", 0.0) / 1e3,
            "sent_until_utc": part["sent_until_utc"],
        }


def gap_words(gap: Mapping[str, Any]) -> str:
    """A gap in a line: whose, how long, and why."""
    to_ns = gap["to_utc_ns"]
    length = "still open" if to_ns is None else f"{(to_ns - gap['from_utc_ns']) / NS:.2f} s"
    return f"nothing of part {gap['part']}: {length}, since {gap['why']}"
