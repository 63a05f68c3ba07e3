"""A table of plots, a row each, of our own batches and of ASTERIX 048, 015 and 205; only written.

Tracks of 062 have rows, too.

What is empty was not measured, or is not in the category. Ranges of 015 are bistatic where the
record says that its sensor is multistatic. Heights are above the WGS-84 ellipsoid, altitudes, which
048 tells, above mean sea level.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from plotfeed.proto.asterix.decode_plots import plots_and_tracks_in
from plotfeed.proto.content_types import PLOT_BATCH
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.measured_plots import NOT_TOLD, MeasuredPlots
from plotfeed.proto.message_kinds import kind_of
from plotfeed.proto.plot_messages import plots_in_batch
from plotfeed.proto.utc import iso_utc
from plotfeed.replay.asterix_blocks import is_asterix
from plotfeed.replay.recorded import Recorded, RecordingWriter

COLUMNS = (
    "time_utc",
    "topic",
    "sensor",
    "category",
    "sac",
    "sic",
    "range_m",
    "bistatic_range_m",
    "azimuth_deg",
    "elevation_deg",
    "height_m",
    "altitude_m",
    "doppler_m_s",
    "snr_db",
    "amplitude_dbm",
    "sigma_range_m",
    "sigma_bistatic_range_m",
    "sigma_azimuth_deg",
    "sigma_elevation_deg",
    "channel",
    "kind",
    "identity",
    "mode_3a",
    "address",
    "track",
    "flight_level",
    "ssr_amplitude_dbm",
    "latitude_deg",
    "longitude_deg",
    "east_m",
    "north_m",
    "velocity_east_m_s",
    "velocity_north_m_s",
    "climb_m_s",
)


Selection = Callable[[Recorded], MeasuredPlots | str | None]
"""The plots of a message that a table takes, or why it takes none; None of what holds none."""
FORMULAS = ("=", "+", "-", "@", "\t", "\r")
"""What spreadsheets run begins with one of these."""


class PlotsCsvWriter(RecordingWriter):
    """Rows of the plots in messages; a message that cannot hold plots is left out."""

    def __init__(self, file: BinaryIO, select: Selection | None = None) -> None:
        """`select` says which plots of a message it takes; without it, it takes all."""
        self._file = file
        self._select = select or plots_in
        self._text = io.StringIO(newline="")
        self._rows = csv.writer(self._text, lineterminator="\n")
        self._rows.writerow(COLUMNS)
        self._flush()

    def write(self, message: Recorded) -> str | None:
        """Write the plots of a message, if any; why it cannot have any, or None."""
        found = self._select(message)
        if not isinstance(found, MeasuredPlots):
            return found or "no plots"
        self._rows.writerows(zip(*_cells(found, message.topic), strict=True))
        self._flush()
        return None

    def notes(self) -> list[str]:
        """What a table of plots is not."""
        return ["it holds plots, not messages, and is not read back"]

    def _flush(self) -> None:
        self._file.write(self._text.getvalue().encode())
        self._text.seek(0)
        self._text.truncate()


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


def _cells(plots: MeasuredPlots, topic: str) -> Iterator[list[Any]]:
    """What stands in each column of the table."""
    sensor = sensor_of_asterix(topic)
    categories, times_ns = plots.category.tolist(), plots.t_utc_ns.tolist()
    known: dict[str, list[Any]] = {
        "time_utc": ["" if t_ns is None else iso_utc(t_ns) for t_ns in times_ns],
        "topic": [as_text(topic)] * len(plots),
        "sensor": [
            as_text(sensor if c else own) for c, own in zip(categories, plots.sensor, strict=True)
        ],
        "category": [f"{category:03d}" if category else "" for category in categories],
    }
    columns = vars(plots) | {"doppler_m_s": plots.range_rate_m_s}
    for name in COLUMNS:
        yield known[name] if name in known else _where_told(columns[name])


def as_text(cell: str) -> str:
    """A cell that no spreadsheet takes for a formula, whoever chose the name in it."""
    return f"'{cell}" if cell.startswith(FORMULAS) else cell


def _where_told(column: NDArray[Any]) -> list[Any]:
    if not column.strides[0]:  # nothing is told
        return [""] * len(column)
    if column.dtype == np.object_:
        return [as_text(cell) if isinstance(cell, str) else cell for cell in column]
    absent = column == NOT_TOLD if column.dtype == np.int64 else np.isnan(column)
    return ["" if no else value for value, no in zip(column.tolist(), absent, strict=True)]
