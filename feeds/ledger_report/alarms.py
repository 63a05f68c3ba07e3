"""False alarms of a sensor, asked and delivered."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from plotfeed.feeds.ledger_report.significance import z_score


class AskedAlarms(Protocol):
    """Says how many false alarms a sensor was to have."""

    @property
    def sectors(self) -> int:
        """Of a scan."""

    def in_sector(self, scan: int, sector: int) -> float:
        """Their mean number; NaN if that cannot be told."""

    def control(self, payload: bytes, t_utc_ns: int) -> None:
        """Take what a settings message says, from that time on."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmFigures:
    """False alarms of one sensor."""

    count: int
    scans: float
    """That the ledger tells of, parts of them counted as such; NaN where no scene says."""
    asked: float
    """By the scene, in all of these scans; NaN where no scene says."""
    asked_per_scan: float
    delivered_per_scan: float
    z: float


@dataclass(slots=True)
class AlarmsTally:
    """Of one sensor's ledger."""

    asked: AskedAlarms | None
    count: int = 0
    _sectors: int = 0
    _mean: float = 0.0

    def add(self, false_alarms: int, scan: int, sector: int) -> None:
        """Take a sector."""
        self.count += false_alarms
        self._sectors += 1
        if self.asked is not None:
            self._mean += self.asked.in_sector(scan, sector)

    def figures(self) -> AlarmFigures:
        """Of all that were taken."""
        if self.asked is None:
            nan = math.nan
            return AlarmFigures(
                count=self.count,
                scans=nan,
                asked=nan,
                asked_per_scan=nan,
                delivered_per_scan=nan,
                z=nan,
            )
        scans = self._sectors / self.asked.sectors
        return AlarmFigures(
            count=self.count,
            scans=scans,
            asked=self._mean,
            asked_per_scan=self._mean / scans if scans else math.nan,
            delivered_per_scan=self.count / scans if scans else math.nan,
            z=z_score(self.count - self._mean, self._mean),  # binomial over very many cells
        )
