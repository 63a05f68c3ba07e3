"""A table of plots, a row each, of our own batches and of ASTERIX 048, 015 and 205; only written.

Tracks of 062 have rows, too.

What is empty was not measured, or is not in the category. Ranges of 015 are bistatic where the
record says that its sensor is multistatic. Heights are above the WGS-84 ellipsoid, altitudes, which
048 tells, above mean sea level.

A sensor may report its plots in several formats, and by MQTT and UDP besides. A mean over all of
these would count such plots several times: a table takes each once, or all of one format.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from plotfeed.proto.asterix.categories import PLOT_ITEMS
from plotfeed.proto.asterix.decode_plots import plots_and_tracks_in
from plotfeed.proto.content_types import PLOT_BATCH
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.measured_plots import ABSENT, NOT_TOLD, MeasuredPlots
from plotfeed.proto.message_kinds import kind_of
from plotfeed.proto.plot_messages import plots_in_batch
from plotfeed.proto.utc import iso_utc
from plotfeed.replay.asterix_files import is_asterix
from plotfeed.replay.recorded import PLOT_TABLES, Recorded, RecordingWriter, TableName

TIME, TOPIC, DOPPLER = "time_utc", "topic", "doppler_m_s"
# What tables call columns that have other names in `MeasuredPlots`.
NAMES = {"t_utc_ns": TIME, "range_rate_m_s": DOPPLER}
LEFT_OUT = ("sigma_range_rate_m_s", "kind_probability")
COLUMNS = (TIME, TOPIC, *(NAMES.get(name, name) for name in [*ABSENT][1:] if name not in LEFT_OUT))
# The plots of a message that a table takes, or why it takes none; None of what holds none.
Selection = Callable[[Recorded], MeasuredPlots | str | None]
FORMULAS = ("=", "+", "-", "@", "\t", "\r")  # What spreadsheets run begins with one of these


class PlotsCsvWriter(RecordingWriter):
    """Rows of the plots in messages; a message that cannot hold plots is left out."""

    def __init__(self, file: BinaryIO, select: Selection | None = None) -> None:
        """`select` says which plots of a message it takes; without it, it takes all."""
        self._select = select or plots_in
        self._text = io.TextIOWrapper(file, "utf-8", newline="", write_through=True)
        self._rows = csv.writer(self._text, lineterminator="\n")
        self._rows.writerow(COLUMNS)

    def write(self, message: Recorded) -> str | None:
        """Write the plots of a message, if any; why it cannot have any, or None."""
        found = self._select(message)
        if not isinstance(found, MeasuredPlots):
            return found or "no plots"
        columns = table_of(found, message.topic)
        columns[TIME] = [t_ns if t_ns is None else iso_utc(t_ns) for t_ns in columns[TIME]]
        columns["category"] = [each and f"{each:03d}" for each in columns["category"]]
        for row in zip(*columns.values(), strict=True):
            self._rows.writerow([as_text(cell) if isinstance(cell, str) else cell for cell in row])
        return None

    def notes(self) -> list[str]:
        """What a table of plots is not."""
        return ["it holds plots, not messages, and is not read back"]

    def close(self) -> None:
        """Leave the file to whoever opened it."""
        self._text.detach()


def plots_in(message: Recorded) -> MeasuredPlots | None:
    """The plots in a message; None if it cannot hold any or cannot be read."""
    if is_asterix(message.content_type, message.payload):
        return plots_and_tracks_in(message.payload, message.log_time_ns)
    if kind_of(message.topic, message.content_type, message.payload) == PLOT_BATCH:
        try:
            return plots_in_batch(message.payload)
        except DecodeError:
            return None
    return None


def sensor_of_asterix(topic: str) -> str:
    """Whose a topic {sensor}/asterix/{category} is; empty of any other topic."""
    levels = topic.split("/")
    return levels[-3] if len(levels) > 2 and levels[-2] == "asterix" else ""


def table_of(plots: MeasuredPlots, topic: str) -> dict[str, list[Any]]:
    """What stands in each of `COLUMNS`, None for what was not told; times are ns of UTC."""
    sensor = sensor_of_asterix(topic)
    held = {NAMES.get(name, name): _told(column) for name, column in vars(plots).items()}
    held[TOPIC] = [topic] * len(plots)
    held["sensor"] = [own or sensor or None for own in held["sensor"]]
    held["category"] = [category or None for category in held["category"]]
    return {name: held[name] for name in COLUMNS}


def _told(column: NDArray[Any]) -> list[Any]:
    if not column.strides[0]:  # nothing is told
        return [None] * len(column)
    if column.dtype == np.object_:
        return [None if cell == "" else cell for cell in column]
    absent = column == NOT_TOLD if column.dtype == np.int64 else np.isnan(column)
    return [None if no else value for value, no in zip(column.tolist(), absent, strict=True)]


def as_text(cell: str) -> str:
    """A cell that no spreadsheet takes for a formula, whoever chose the name in it."""
    return f"'{cell}" if cell.startswith(FORMULAS) else cell


# A sensor: what stands before the format in its topic, or a topic of datagrams, SAC and SIC.
Source = str | tuple[str, int, int]


def selection_of(table: TableName, messages: Iterable[Recorded]) -> Selection:
    """Which plots of those messages a table takes; it reads them all, if that depends on them."""
    category = PLOT_TABLES[table]
    if category is not None:
        return partial(_of_category, category)
    once = PlotsOnce()
    for message in messages:
        once.see(message)
    return once.select


def _of_category(category: int, message: Recorded) -> MeasuredPlots | None:
    found = plots_in(message)
    if found is None or category not in found.category:
        return None
    return found.rows(found.category == category)


@dataclass(slots=True)
class PlotsOnce:
    """The plots of a recording, of each sensor in the format that says most of them."""

    # Of each sensor, the category that it is taken from; 0 for PlotBatch.
    _formats: dict[Source, int] = field(default_factory=dict)
    # SAC and SIC of those that have a topic of their own.
    _sensors: set[tuple[int, int]] = field(default_factory=set)

    def see(self, message: Recorded) -> None:
        """Take notice of a message, of all before any is selected."""
        found = plots_in(message)
        if found is None:
            return
        sensor = _sensor_of(message.topic)
        for category, sac, sic in set(_keys(found)):
            if sensor and category:
                self._sensors.add((sac, sic))
            source = sensor or (_carrier(message.topic), sac, sic)
            if category in FORMATS:
                known = self._formats.get(source, category)
                self._formats[source] = min(known, category, key=FORMATS.index)

    def select(self, message: Recorded) -> MeasuredPlots | str | None:
        """The plots of a message that no better format of the recording has too."""
        found = plots_in(message)
        if found is None:
            return None
        sensor = _sensor_of(message.topic)
        keys = _keys(found)
        takes = np.array([self._takes(sensor, message.topic, *key) for key in keys], np.bool_)
        if takes.any() or not keys:
            return found if takes.all() else found.rows(takes)
        category = keys[0][0]
        if category not in FORMATS:
            return f"tracks, which a file whose name ends in asterix-{category:03d} has"
        return f"plots that are there in another format; x-asterix-{category:03d} would have them"

    def _takes(self, sensor: str, topic: str, category: int, sac: int, sic: int) -> bool:
        if not sensor and (sac, sic) in self._sensors:
            return False
        return self._formats.get(sensor or (_carrier(topic), sac, sic)) == category


FORMATS = (0, *PLOT_ITEMS)  # Categories that hold plots, 0 for PlotBatch, those that say most first


def _keys(plots: MeasuredPlots) -> list[tuple[int, int, int]]:
    columns = (plots.category.tolist(), plots.sac.tolist(), plots.sic.tolist())
    return list(zip(*columns, strict=True))


def _sensor_of(topic: str) -> str:
    """What stands before /plots or /asterix/048; empty of any other topic."""
    front, _, last = topic.rpartition("/")
    return front if last == "plots" else front.removesuffix("/asterix") * front.endswith("/asterix")


def _carrier(topic: str) -> str:
    """A topic of datagrams; empty of data blocks in a file, which have one for each category."""
    return "" if topic.startswith("asterix/") else topic
