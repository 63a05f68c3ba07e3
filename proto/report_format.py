"""What there is to know of a format that sensors report in, before any message is made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from plotfeed.proto.asterix.codec.layout import Category
from plotfeed.proto.content_types import asterix_content_type


@dataclass(frozen=True, slots=True)
class SentCategory:
    """A category of ASTERIX that a format brings, and from which of its sensors."""

    summary: str
    rotates: bool = False  # Only of a beam that turns
    # Only of a receiver of echoes whose transmitters stand elsewhere.
    has_illuminators: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class PlotItems:
    """Paths into the records of a category to what they tell of plots or tracks."""

    columns: Mapping[str, str]  # The path of each column of `MeasuredPlots`
    # What one is of a column, in the column's own unit, where that is not the layout's.
    units: Mapping[str, float] = field(default_factory=dict)
    # A part, and the values by which it says that a record is a plot; all are, without one.
    plots_alone: tuple[str, tuple[int, ...]] = ("", ())


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportFormat:
    """A format as scenes name it, and what its messages can and cannot say."""

    name: str  # As in a sensor's `report`
    # End of the topic of the messages that hold plots or tracks, behind prefix and sensor.
    topic: str
    content_type: str  # Of those messages
    summary: str  # What they are
    inbox: str = ""  # End of the topics on which sensors are asked something in it; empty for none
    message: str = ""  # The protobuf message that they are; empty for ASTERIX, XML and JSON
    schema: Mapping[str, Any] | None = None  # Of JSON
    # Of ASTERIX: the format's own category first, then its companions, and what they bring.
    categories: Mapping[int, SentCategory] = field(default_factory=dict)
    layouts: tuple[Category, ...] = ()  # Of the categories that the format is the first to bring
    # Where records of the format's own category tell of plots or tracks.
    plot_items: PlotItems | None = None
    tells_tracks: bool = False  # It brings tracks, and no plots
    tells_heights: bool = False
    tells_run_lengths: bool = False  # Over how much azimuth the beam saw the target
    needs_azimuth: bool = False
    range_step_m: float = 0.0  # In which it counts ranges; 0 if that is finer than any sensor


def asterix(categories: Mapping[int, SentCategory], **says: Any) -> ReportFormat:
    """A format of ASTERIX: its own category, which names it, and those that come with it.

    `says` are its layouts, and what its messages can and cannot say, by the names of
    `ReportFormat`.
    """
    own = next(iter(categories))
    return ReportFormat(
        name=f"asterix-{own:03d}",
        topic=f"asterix/{own:03d}",
        content_type=asterix_content_type(own),
        summary=categories[own].summary,
        categories=categories,
        **says,
    )
