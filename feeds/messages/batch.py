"""`Batch`: what came of sectors, from sensing to octets, page, recording and score."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Self, TypeVar

import numpy as np

from plotfeed.feeds.messages.message import Message, SectorStamp
from plotfeed.models.beam import Sector, Sectors
from plotfeed.models.sensors.sensor_model import NO_LOOKS, NO_PLOTS
from plotfeed.models.state import FALSE_ALARM, Columns, Ints, Looks, Plots, TruthState
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.tracks.encode_tracks import NO_TRACKS, ToldTracks

C = TypeVar("C", bound=Columns)
T = TypeVar("T")


def _no_truth(t_utc_ns: int, _drones: Ints, /) -> TruthState:
    raise LookupError(f"nothing is known of the truth at {t_utc_ns}")


@dataclass(frozen=True, eq=False)
class Batch:
    """What came of sectors, (m,), of one sensor or of many.

    Plots of sector i are the rows from `plots_by[i]` up to `plots_by[i + 1]`, in the order of time;
    looks, tracks and their offsets, (m+1,), likewise. Times are UTC; `by_clock` gives a batch whose
    sectors and plots have the times of a sensor's own clock, as its messages tell them.
    """

    sectors: Sectors
    plots: Plots
    plots_by: Ints
    looks: Looks
    looks_by: Ints
    # Tracks of sensors that report some, at the ends of their sectors; None where none does.
    tracks: ToldTracks = NO_TRACKS
    tracks_by: Ints | None = None
    sensors: Sequence[str] = ()  # Ids of sensors, by the index in `sectors.sensor`
    # Ids of drones when the sectors were worked out, by the index in the columns `drone`.
    names: Sequence[str] = ()
    # Messages of each sector, handed to its link at its end, with when that lets them leave.
    messages: Sequence[Sequence[Message]] = ()
    # Keys of the link that each sector's messages passed, as JSON; empty where there is none.
    links: Sequence[str] = ()
    # What drones said of themselves; None of a sensor's batch.
    claims: Sequence[pb.Claim] | None = None
    # By how much the times of sectors and plots are ahead of UTC; those of looks never are.
    clock_ahead_ns: int = 0
    # Where drones, by index, are at a time, by the clock and axes of the sensors.
    truth_at: Callable[[int, Ints], TruthState] = _no_truth

    def __len__(self) -> int:
        """How many sectors."""
        return len(self.sectors)

    @classmethod
    def of_one(
        cls,
        sector: Sector,
        plots: Plots = NO_PLOTS,
        looks: Looks = NO_LOOKS,
        *,
        sensor: int = 0,
        sensors: Sequence[str] = (),
        claims: Sequence[pb.Claim] | None = None,
    ) -> Self:
        """What came of one sector of the sensor at that place among `sensors`."""
        return cls(
            sectors=Sectors.of([sector], sensor),
            plots=plots,
            plots_by=np.array([0, len(plots)], np.int64),
            looks=looks,
            looks_by=np.array([0, len(looks)], np.int64),
            sensors=sensors,
            messages=[()],
            links=[""],
            claims=claims,
        )

    @classmethod
    def joined(cls, scans: Sequence[Self], order: Ints | None = None) -> Self:
        """Looks and plots of several scans; of each sensor, later ones after earlier ones.

        Or in that order of the sectors of all, if it is given.
        """
        if len(scans) == 1:
            return scans[0]
        sectors = Sectors.joined([scan.sectors for scan in scans])
        if order is None:
            order = np.lexsort((sectors.end_ns, sectors.sensor))

        def in_order(parts: Sequence[C], offsets: Sequence[Ints]) -> tuple[C, Ints]:
            lengths = np.concatenate([np.diff(of_scan) for of_scan in offsets])
            return of_parts(type(parts[0]).joined(parts), edges(lengths), order)

        looks, looks_by = in_order([s.looks for s in scans], [s.looks_by for s in scans])
        plots, plots_by = in_order([s.plots for s in scans], [s.plots_by for s in scans])
        return replace(
            scans[0],
            sectors=sectors.rows(order),
            looks=looks,
            looks_by=looks_by,
            plots=plots,
            plots_by=plots_by,
        )

    @property
    def of_tracks(self) -> Ints:
        """Where the tracks of each sector begin, (m+1,)."""
        return np.zeros(len(self) + 1, np.int64) if self.tracks_by is None else self.tracks_by

    @cached_property
    def stamps(self) -> list[SectorStamp]:
        """The sectors as messages tell of them; where sensors are in step, it is one for all."""
        of = self.sectors
        keys = zip(of.scan.tolist(), of.index.tolist(), of.end_ns.tolist(), strict=True)
        known: dict[tuple[int, int, int], SectorStamp] = {}
        ahead_ns = self.clock_ahead_ns
        return [
            known.get(key) or known.setdefault(key, SectorStamp(*key, ahead_ns)) for key in keys
        ]

    @cached_property
    def counts(self) -> list[tuple[int, int, int, int]]:
        """Scan, and the number of looks, plots and false alarms of each sector, (m,)."""
        looks, plots = np.diff(self.looks_by).tolist(), np.diff(self.plots_by).tolist()
        alarms = [0] * len(looks)
        if len(self.plots):
            before = edges(self.plots.drone == FALSE_ALARM)
            alarms = np.diff(before[self.plots_by]).tolist()
        return list(zip(self.sectors.scan.tolist(), looks, plots, alarms, strict=True))

    @property
    def sensor(self) -> str:
        """The id of the sensor of the first sector, which is the only one of `one`."""
        return self.sensors[int(self.sectors.sensor[0])]

    @cached_property
    def sector(self) -> Sector:
        """The first sector, which is the only one of `one`."""
        return self.sectors.one(0)

    @property
    def stamp(self) -> SectorStamp:
        """The first sector as its messages tell of it."""
        return self.stamps[0]

    @property
    def due_utc_ns(self) -> int:
        """When the messages of the first sector are due, UTC."""
        return int(self.sectors.end_ns[0]) - self.clock_ahead_ns

    def one(self, i: int) -> Self:
        """What came of sector i, not copied."""
        cut = partial(_between, i=i)
        one = self._cut(self.sectors.between(i, i + 1), cut)
        return replace(one, messages=self.messages[i : i + 1], links=self.links[i : i + 1])

    def rows(self, which: Ints) -> Self:
        """What came of the sectors at those indices, (k,), in that order; without messages."""
        return self._cut(self.sectors.rows(which), partial(of_parts, which=which))

    def _cut(self, sectors: Sectors, cut: Callable[[Any, Ints], tuple[Any, Ints]]) -> Self:
        """The batch of those sectors, with what `cut` leaves of columns and of their offsets."""
        parts: dict[str, Any] = {}
        for name in ("plots", "looks", "tracks"):
            by: Ints | None = getattr(self, f"{name}_by")
            if by is not None:
                parts[name], parts[f"{name}_by"] = cut(getattr(self, name), by)
        return replace(self, sectors=sectors, messages=(), links=(), **parts)

    def by_clock(self, ahead_ns: int) -> Self:
        """The batch by the clock of its sensors, which is so far ahead."""
        of = self.sectors
        return replace(
            self,
            sectors=of.but(start_ns=of.start_ns + ahead_ns, end_ns=of.end_ns + ahead_ns),
            plots=self.plots.but(t_utc_ns=self.plots.t_utc_ns + ahead_ns),
            clock_ahead_ns=ahead_ns,
        )

    def in_groups(self, groups: Ints, make: Callable[[int, Self], Sequence[T]]) -> list[T]:
        """What `make` makes of the sectors of each group, (m,), put in the sectors' order."""
        if len(groups) and (groups == groups[0]).all():
            return list(make(int(groups[0]), self))
        made: list[T | None] = [None] * len(groups)
        for group in np.unique(groups).tolist():
            which = np.flatnonzero(groups == group)
            for i, one in zip(which.tolist(), make(group, self.rows(which)), strict=True):
                made[i] = one
        return made  # type: ignore[return-value]


def edges(lengths: Ints) -> Ints:
    """Where parts of those lengths, (k,), begin and end when one follows the other; (k+1,)."""
    return np.concatenate([np.zeros(1, np.int64), np.cumsum(lengths)])


def of_parts(columns: C, by: Ints, which: Ints) -> tuple[C, Ints]:
    """Rows of some parts, (k,), and where each of those begins and ends now, (k+1,)."""
    if len(which) and (np.diff(which) == 1).all():  # they lie together: nothing is copied
        by = by[which[0] : which[-1] + 2]
        return columns.between(int(by[0]), int(by[-1])), by - by[0]
    by_now = edges(np.diff(by)[which])
    rows = np.arange(by_now[-1]) + np.repeat(by[which] - by_now[:-1], np.diff(by_now))
    return columns.rows(rows), by_now


def _between(columns: C, by: Ints, i: int) -> tuple[C, Ints]:
    return columns.between(int(by[i]), int(by[i + 1])), by[i : i + 2] - by[i]
