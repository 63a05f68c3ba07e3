"""What sectors of sensors brought: their looks, their plots and their messages."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plotfeed.feeds.messages.message import Message
from plotfeed.models.beam import Sector, Sectors
from plotfeed.models.state import FALSE_ALARM, Ints, Looks, Plots


@dataclass(frozen=True, slots=True)
class Sighting:
    """What came of several sectors: rows by sector, and where those of each begin, (m + 1,).

    Plots of a sector are in the order of time, as they are sent.
    """

    sectors: Sectors
    looks: Looks
    looks_by: Ints
    plots: Plots
    plots_by: Ints
    names: Sequence[str] = ()
    """Of the drones then, by index."""

    def looks_of(self, row: int) -> Looks:
        """The looks of a sector, not copied."""
        return self.looks.between(int(self.looks_by[row]), int(self.looks_by[row + 1]))

    def plots_of(self, row: int) -> Plots:
        """The plots of a sector, not copied."""
        return self.plots.between(int(self.plots_by[row]), int(self.plots_by[row + 1]))

    def reports(
        self, sensors: Sequence[str], messages: Sequence[list[Message]]
    ) -> Iterator[SectorReport]:
        """One a sector, with its messages; `sensors` are names by index."""
        looks, plots = np.diff(self.looks_by).tolist(), np.diff(self.plots_by).tolist()
        alarms = [0] * len(looks)
        if len(self.plots):
            before = np.concatenate([[0], np.cumsum(self.plots.drone == FALSE_ALARM)])
            alarms = np.diff(before[self.plots_by]).tolist()
        of_sensor, scan = self.sectors.sensor.tolist(), self.sectors.scan.tolist()
        due_ns = self.sectors.end_ns.tolist()
        for row, i in enumerate(of_sensor):
            counts = SectorCounts(due_ns[row], scan[row], looks[row], plots[row], alarms[row])
            yield SectorReport(sensors[i], counts, messages[row], self, row)


@dataclass(frozen=True, slots=True)
class SectorCounts:
    """When messages of a sector are due, of which scan it is, and how much it brought."""

    due_utc_ns: int
    scan: int
    looks: int
    plots: int
    false_alarms: int


class SectorReport:
    """What became of one sector; looks and plots are taken out of all when somebody asks."""

    def __init__(
        self,
        sensor: str,
        counts: SectorCounts,
        messages: list[Message],
        sighting: Sighting,
        row: int,
        *,
        claims: bytes = b"",
    ) -> None:
        """The sector in that row of `sighting`, whose messages are due when it ends.

        `claims` are what drones said of themselves, as octets of the ledger's entry.
        """
        self.sensor = sensor
        self.counts = counts
        self.messages = messages
        self.sighting = sighting
        self.row = row
        self.claims = claims

    @classmethod
    def of(
        cls,
        sensor: str,
        sector: Sector,
        looks: Looks,
        plots: Plots,
        messages: list[Message],
        *,
        claims: bytes = b"",
    ) -> SectorReport:
        """A report of a sector by itself."""
        offsets = [np.array([0, len(rows)], np.int64) for rows in (looks, plots)]
        sighting = Sighting(Sectors.of([sector]), looks, offsets[0], plots, offsets[1])
        report = next(sighting.reports([sensor], [messages]))
        report.claims = claims
        return report

    @cached_property
    def sector(self) -> Sector:
        """When and where it was."""
        return self.sighting.sectors.one(self.row)

    @cached_property
    def looks(self) -> Looks:
        """Whom the sensor looked at."""
        return self.sighting.looks_of(self.row)

    @cached_property
    def plots(self) -> Plots:
        """Plots that it measured, in the order of time."""
        return self.sighting.plots_of(self.row)
