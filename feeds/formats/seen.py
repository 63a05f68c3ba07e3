"""What formats are given: what came of many sectors, of one sensor or of many, at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self, TypeVar

import numpy as np

from plotfeed.feeds.messages.sector_report import Sighting
from plotfeed.feeds.messages.user_properties import SectorStamp
from plotfeed.models.beam import Sector, Sectors
from plotfeed.models.sensors.sensor_model import NO_LOOKS
from plotfeed.models.state import Columns, Ints, Looks, Plots, TruthState
from plotfeed.proto.asterix.codec.reports import Parts
from plotfeed.proto.tracks.told_tracks import NO_TRACKS, ToldTracks

C = TypeVar("C", bound=Columns)
T = TypeVar("T")


def _no_truth(_row: int, t_utc_ns: int, _drones: Ints, /) -> TruthState:
    raise LookupError(f"nothing is known of the truth at {t_utc_ns}")


@dataclass(frozen=True, slots=True)
class SeenSector:
    """What came of one sector of one sensor, by its index in the scene; times as in `Seen`."""

    sensor: int
    sector: Sector
    stamp: SectorStamp
    """The sector as messages tell of it."""
    plots: Plots
    looks: Looks
    truth_at: Callable[[int, Ints], TruthState]
    """Where drones, by index, truly are at a time, as far as the sensor can tell."""
    clock_ahead_ns: int
    names: Sequence[str]
    tracks: ToldTracks = NO_TRACKS
    """At its end."""


@dataclass(frozen=True)
class Seen:
    """What came of sectors, (m,): all plots of sector i, in the order of time, then of the next.

    Those of sector i are the rows from `plots_by[i]` up to `plots_by[i + 1]`, (m+1,), and so are
    looks. `truth_at` tells where drones, by index, truly are at a time: first it is given i.

    All times are by the sensors' clock, which is ahead by `clock_ahead_ns`, but for those of looks:
    what a sensor sends knows of no other clock, what the ledger says only of the true one.
    """

    sectors: Sectors
    plots: Plots
    plots_by: Ints
    looks: Looks = NO_LOOKS
    looks_by: Ints | None = None
    """None where nobody asks for looks."""
    truth_at: Callable[[int, int, Ints], TruthState] = _no_truth
    clock_ahead_ns: int = 0
    names: Sequence[str] = ()
    """Of the drones then, by index."""
    tracks: ToldTracks = NO_TRACKS
    """Of sensors that report tracks, at the ends of their sectors, as rows by sector."""
    tracked_by: Ints | None = None
    """Where the tracks of each sector begin, (m+1,); None where no sensor reports any."""

    @property
    def tracks_by(self) -> Ints:
        """Where the tracks of each sector begin, (m+1,)."""
        return np.zeros(len(self) + 1, np.int64) if self.tracked_by is None else self.tracked_by

    @classmethod
    def of_one(
        cls,
        sector: Sector,
        plots: Plots,
        looks: Looks = NO_LOOKS,
        truth_at: Callable[[int, Ints], TruthState] | None = None,
        *,
        sensor: int = 0,
    ) -> Self:
        """What came of one sector."""
        return cls(
            sectors=Sectors.of([sector], sensor),
            plots=plots,
            plots_by=np.array([0, len(plots)], np.int64),
            looks=looks,
            looks_by=np.array([0, len(looks)], np.int64),
            truth_at=_no_truth if truth_at is None else lambda _, t, drones: truth_at(t, drones),
        )

    def __len__(self) -> int:
        """How many sectors."""
        return len(self.sectors)

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

    def parts(self, sources: Ints) -> Parts:
        """The plots by sector, for encoders; `sources` are their sensors, (m,)."""
        return Parts(self.plots_by, sources)

    def one(self, i: int) -> SeenSector:
        """What came of sector i."""
        a, b = (0, 0) if self.looks_by is None else self.looks_by[i : i + 2].tolist()
        return SeenSector(
            sensor=int(self.sectors.sensor[i]),
            sector=self.sectors.one(i),
            stamp=self.stamps[i],
            plots=self.plots.between(int(self.plots_by[i]), int(self.plots_by[i + 1])),
            looks=self.looks.between(a, b),
            truth_at=lambda t_utc_ns, drones: self.truth_at(i, t_utc_ns, drones),
            clock_ahead_ns=self.clock_ahead_ns,
            names=self.names,
            tracks=self.tracks.between(int(self.tracks_by[i]), int(self.tracks_by[i + 1])),
        )

    def rows(self, which: Ints) -> Seen:
        """What came of the sectors at those indices, (k,), in that order."""
        plots, plots_by = of_parts(self.plots, self.plots_by, which)
        looks, looks_by = self.looks, self.looks_by
        if looks_by is not None:
            looks, looks_by = of_parts(looks, looks_by, which)
        tracks, tracked_by = self.tracks, self.tracked_by
        if tracked_by is not None:
            tracks, tracked_by = of_parts(tracks, tracked_by, which)
        numbers, truth_at = which.tolist(), self.truth_at
        return Seen(
            sectors=self.sectors.rows(which),
            plots=plots,
            plots_by=plots_by,
            looks=looks,
            looks_by=looks_by,
            truth_at=lambda i, t_utc_ns, drones: truth_at(numbers[i], t_utc_ns, drones),
            clock_ahead_ns=self.clock_ahead_ns,
            names=self.names,
            tracks=tracks,
            tracked_by=tracked_by,
        )

    def with_tracks(self, tracks: ToldTracks, tracks_by: Ints) -> Seen:
        """Add those tracks, of each sector from where `tracks_by` says, (m+1,)."""
        return replace(self, tracks=tracks, tracked_by=tracks_by)

    def in_groups(self, groups: Ints, make: Callable[[int, Seen], list[T]]) -> list[T]:
        """What `make` makes of the sectors of each group, (m,), put in the sectors' order."""
        if len(groups) and (groups == groups[0]).all():
            return make(int(groups[0]), self)
        made: list[T | None] = [None] * len(groups)
        for group in np.unique(groups).tolist():
            which = np.flatnonzero(groups == group)
            for i, one in zip(which.tolist(), make(group, self.rows(which)), strict=True):
                made[i] = one
        return made  # type: ignore[return-value]


def of_parts(columns: C, by: Ints, which: Ints) -> tuple[C, Ints]:
    """Rows of some parts, (k,), and where each of those begins and ends now, (k+1,)."""
    lengths = np.diff(by)[which]
    edges = np.concatenate([[0], np.cumsum(lengths)])
    rows = np.arange(edges[-1]) + np.repeat(by[which] - edges[:-1], lengths)
    return columns.rows(rows), edges


def joined_sightings(scans: Sequence[Sighting]) -> Sighting:
    """Several scans of sensors, the later ones after the earlier ones of each."""
    if len(scans) == 1:
        return scans[0]
    sectors = Sectors.joined([scan.sectors for scan in scans])
    order = np.lexsort((sectors.end_ns, sectors.sensor))

    def in_order(parts: Sequence[C], offsets: Sequence[Ints]) -> tuple[C, Ints]:
        lengths = np.concatenate([np.diff(of_scan) for of_scan in offsets])
        edges = np.concatenate([[0], np.cumsum(lengths)])
        return of_parts(type(parts[0]).joined(parts), edges, order)

    looks, looks_by = in_order([s.looks for s in scans], [s.looks_by for s in scans])
    plots, plots_by = in_order([s.plots for s in scans], [s.plots_by for s in scans])
    return Sighting(sectors.rows(order), looks, looks_by, plots, plots_by, scans[0].names)
