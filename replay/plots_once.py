"""Which plots of a recording a table takes: each once, or all of one format.

A sensor may report its plots in several formats, and by MQTT and UDP besides. A mean over all of
these would count such plots several times.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from plotfeed.proto.asterix.categories import PLOT_ITEMS
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.replay.plots_csv import Selection, plots_in
from plotfeed.replay.recorded import PLOT_TABLES, Recorded, TableName

Source = str | tuple[str, int, int]
"""A sensor: what stands before the format in its topic, or a topic of datagrams, SAC and SIC."""


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

    _formats: dict[Source, int] = field(default_factory=dict)
    """Of each sensor, the category that it is taken from; 0 for PlotBatch."""
    _sensors: set[tuple[int, int]] = field(default_factory=set)
    """SAC and SIC of those that have a topic of their own."""

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
            return f"tracks, which --table asterix-{category:03d} has"
        return f"plots that are there in another format; --table asterix-{category:03d} has them"

    def _takes(self, sensor: str, topic: str, category: int, sac: int, sic: int) -> bool:
        if not sensor and (sac, sic) in self._sensors:
            return False
        return self._formats.get(sensor or (_carrier(topic), sac, sic)) == category


FORMATS = (0, *PLOT_ITEMS)
"""Categories that hold plots, 0 for PlotBatch, those that say most first."""


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
