"""What the commands on recordings are asked: `show`, `convert`, `record`."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from functools import cache
from typing import TYPE_CHECKING, Literal

from plotfeed.feeds.console.option_fields import end_option, option, start_option

if TYPE_CHECKING:
    from plotfeed.feeds.recording.record_text import Categories, Style
    from plotfeed.replay.recorded import Recorded

StageWord = Literal["telemetry", "before", "after", "received"]
FileKind = Literal["mcap", "pcap", "pcapng", "final", "raw", "jsonl", "csv", "parquet"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ShowSettings:
    """What is to be shown, and how."""

    listed: bool = option(False, "Print the messages of a file, one a line.", name="--list")
    count: int | None = option(None, "End after so many lines; implies --list.", low=1)
    duration: float | None = option(
        None, "End after so many seconds, of what is live.", over=0, metavar="SECONDS"
    )
    topics: tuple[str, ...] = option(
        (),
        "Take only topics that fit this filter, as of MQTT with + and #; may be repeated.",
        metavar="FILTER",
        name="--topic",
    )
    stages: tuple[StageWord, ...] = option(
        (),
        "Take only this stage of a session's record; may be repeated. Without it all are taken, "
        "each line with its stage.",
        name="--stage",
    )
    as_json: bool = option(False, "Print one JSON object a line.")
    verbose: bool = option(
        False, "Print trees with names, units and what numbers stand for; implies --list."
    )
    editions: tuple[Literal["025-half-turn", "062-1.18"], ...] = option(
        (),
        "Read ASTERIX 025 with longitudes in steps of 180 degrees, or 062 as before edition "
        "1.19, where a sender has them so; may be repeated.",
        name="--edition",
    )

    @property
    def categories(self) -> Categories:
        """The layouts that ASTERIX is read by."""
        return _categories(self.editions, verbose=self.verbose)

    @property
    def style(self) -> Style:
        """How messages are written."""
        from plotfeed.feeds.recording.record_text import Style

        return Style.JSON if self.as_json else Style.TREE if self.verbose else Style.LINE

    def chooses(self, message: Recorded) -> bool:
        """Whether that message is wanted."""
        from plotfeed.feeds.messages.message import is_chosen

        of_stage = not self.stages or message.stage in self.stages
        return of_stage and is_chosen(message.topic, self.topics)


@cache
def _categories(editions: tuple[str, ...], *, verbose: bool) -> Categories:
    from plotfeed.feeds.recording.record_text import categories_of

    return categories_of(editions, verbose=verbose)


@dataclass(frozen=True, slots=True, kw_only=True)
class ConvertSettings:
    """What a conversion is asked to do."""

    from_format: FileKind | None = option(
        None,
        "Read IN in this format; without it its content says which, and else its suffix.",
        name="--from",
    )
    to_format: FileKind | None = option(
        None,
        "Write OUT in this format; without it its suffix says which. The table of Parquet or CSV "
        "is that in which its name ends, as site-looks.parquet: plots (each once; without it too), "
        "truths, looks, tracks, messages, fates, asterix-015, -048, -062 or -205.",
        name="--to",
    )
    topics: tuple[str, ...] = option(
        (),
        "Take only topics that fit this filter, as of MQTT with + and #; may be repeated.",
        metavar="FILTER",
        name="--topic",
    )
    stages: tuple[StageWord, ...] = option(
        (),
        "Take only this stage of a session's record; may be repeated. Without it a format that "
        "has no stages takes after and received.",
        name="--stage",
    )
    start: str | None = start_option()
    end: str | None = end_option()
    date: datetime | None = option(
        None, "Let a file without dates (FINAL, raw ASTERIX) begin on this day; else on 1970-01-01."
    )
    force: bool = option(False, "Replace OUT where it is there already.")
    as_json: bool = option(False, "Print the totals as one JSON object.")


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordSettings:
    """What a recording is asked to do."""

    count: int | None = option(None, "End after so many messages.", low=1)
    duration: float | None = option(None, "End after so many seconds.", over=0, metavar="SECONDS")
    force: bool = option(False, "Replace FILE where it is there already.")
    as_json: bool = option(False, "Print nothing but the totals at the end, as one JSON object.")
