"""What readers find that run in a process of their own, without that process."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from plotfeed.feeds.telemetry.foreign_files import found_in
from plotfeed.proto.errors import PlotfeedError


def found_here(kind: str, source: bytes | Path) -> Any:
    """As `read_apart`, in this process and without its limits."""
    found = found_in(kind, source if isinstance(source, bytes) else str(source))
    if "error" in found:
        raise PlotfeedError(found["error"])
    return found["found"]
