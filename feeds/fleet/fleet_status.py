"""How the parts of a fleet do, as rows: for a terminal, and for the page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from plotfeed.proto.utc import NS

JOINING, UNKNOWN = "joining", "unknown"


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
