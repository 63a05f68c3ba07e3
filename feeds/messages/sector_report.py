"""What one sector of one sensor brought: its looks, its plots and its messages."""

from __future__ import annotations

from dataclasses import dataclass

from plotfeed.feeds.messages.message import Message
from plotfeed.models.beam import Sector
from plotfeed.models.state import Looks, Plots


@dataclass(frozen=True, slots=True)
class SectorReport:
    """What became of one sector: its plots are in the order of time, as they are sent."""

    sensor: str
    sector: Sector
    looks: Looks
    plots: Plots
    messages: list[Message]
