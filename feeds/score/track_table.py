"""What a tracker published, as columns: one row a report, in the order in which it came."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from plotfeed.models.state import Bools, Columns, Floats, Ints

UNKNOWN_NS = -(2**63)
"""In place of a time that nobody told."""
LATEST_NS = 2**63 - 1
COVARIANCES = ("east_m2", "north_m2", "up_m2", "east_north_m2", "east_up_m2", "north_up_m2")


@dataclass(frozen=True, kw_only=True)
class ReportedTracks(Columns):
    """Reports of tracks as they were told, (n,), right or wrong.

    Places are WGS-84, heights above its ellipsoid; velocities are east, north, up, (n, 3), and
    covariances of the position (n, 3, 3), of the place. NaN stands for what is not told, and
    `UNKNOWN_NS` for such times.
    """

    t_utc_ns: Ints
    """For which the report holds."""
    received_utc_ns: Ints
    track: Ints
    """Index of the name."""
    latitude_deg: Floats
    longitude_deg: Floats
    height_m: Floats
    velocity_enu_m_s: Floats
    covariance_m2: Floats
    tentative: Bools
    ended: Bools


@dataclass(frozen=True, slots=True, kw_only=True)
class TracksRead:
    """All that was read of a tracker."""

    reports: ReportedTracks
    names: Sequence[str]
    """Of tracks, by their numbers in `reports`."""
    unreadable: Mapping[str, int] = field(default_factory=dict)
    """What could not be read, and how often; by the reason."""
    source: str = ""
    """Where tracks were found, in a few words."""
    crashed: str = ""
    """How the tracker ended, where it is known to have failed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ToldTrack:
    """One report as a message or a line has it; NaN and None for what it does not tell."""

    name: str
    t_utc_ns: int | None
    latitude_deg: float
    longitude_deg: float
    height_m: float = np.nan
    velocity_enu_m_s: tuple[float, float, float] = (np.nan,) * 3
    covariance_m2: tuple[float, ...] = (np.nan,) * 6
    """As `COVARIANCES`."""
    tentative: bool = False
    coasted: bool = False
    """Predicted, for want of a plot."""
    ended: bool = False
    received_utc_ns: int | None = None
    """Where the report itself says it."""


class TrackTable:
    """Takes reports one by one, and makes columns of them."""

    def __init__(self) -> None:
        self.unreadable: Counter[str] = Counter()
        self._numbers: dict[str, int] = {}
        self._rows: list[tuple[Any, ...]] = []

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, told: ToldTrack, received_utc_ns: int | None = None) -> None:
        """Take a report that came at a time, if that is known."""
        received = told.received_utc_ns if received_utc_ns is None else received_utc_ns
        number = self._numbers.setdefault(told.name, len(self._numbers))
        self._rows.append(
            (
                _time(told.t_utc_ns if told.t_utc_ns is not None else received),
                _time(received),
                number,
                told.tentative,
                told.ended,
                told.latitude_deg,
                told.longitude_deg,
                told.height_m,
                *told.velocity_enu_m_s,
                *told.covariance_m2,
            )
        )

    def refuse(self, reason: str) -> None:
        """Count what could not be read."""
        self.unreadable[reason] += 1

    def read(self, source: str, crashed: str = "") -> TracksRead:
        """All reports so far."""
        return TracksRead(
            reports=self._columns(),
            names=list(self._numbers),
            unreadable=dict(self.unreadable),
            source=source,
            crashed=crashed,
        )

    def _columns(self) -> ReportedTracks:
        columns = list(zip(*self._rows, strict=True)) or [()] * 17
        times, flags = columns[:3], columns[3:5]
        numbers = np.array(columns[5:], np.float64).T.reshape(-1, 12)
        covariance_m2 = np.empty((len(numbers), 3, 3))
        for value, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
            covariance_m2[:, i, j] = covariance_m2[:, j, i] = numbers[:, 6 + value]
        t_utc_ns, received_utc_ns, track = (np.array(column, np.int64) for column in times)
        tentative, ended = (np.array(column, np.bool_) for column in flags)
        return ReportedTracks(
            t_utc_ns=t_utc_ns,
            received_utc_ns=received_utc_ns,
            track=track,
            latitude_deg=numbers[:, 0],
            longitude_deg=numbers[:, 1],
            height_m=numbers[:, 2],
            velocity_enu_m_s=numbers[:, 3:6],
            covariance_m2=covariance_m2,
            tentative=tentative,
            ended=ended,
        )


def _time(t_ns: int | None) -> int:
    """A time that a column can hold."""
    return t_ns if t_ns is not None and UNKNOWN_NS < t_ns <= LATEST_NS else UNKNOWN_NS
