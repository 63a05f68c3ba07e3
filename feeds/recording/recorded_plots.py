"""Plots of a recording by sector, which wait for the ledger that says whose they are."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from plotfeed.feeds.formats import FORMATS
from plotfeed.models.clutter import CLUTTER, SIDELOBE
from plotfeed.models.state import OTHER, Bools, Ints, Texts
from plotfeed.proto.asterix.decode_plots import told_of_plots_and_tracks
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.ledger import ToldLooks, ToldPlots
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.proto.plot_messages import batch_in, plots_of_batches
from plotfeed.proto.plotfeed_pb2 import PlotBatch
from plotfeed.replay.mcap import ChannelKey
from plotfeed.replay.recorded import Recorded, Stage

NO_PLOTS = MeasuredPlots.of(())
# Plots that wait for what is true of them; then the oldest are given up.
MAX_WAITING_PLOTS = 200_000


def plot_topics() -> list[str]:
    """Ends of topics with plots that can be joined with the ledger, those that say most first.

    SAPIENT is none of them, since it keeps the plots of several sectors together.
    """
    rows = (row for row in FORMATS.values() if row.plots_in is not None and row.name != "sapient")
    return [row.facts.topic for row in rows]


def names_of(told: ToldLooks | ToldPlots) -> Texts:
    """Names of what looks or plots are of, drones or not, (n,); empty for false alarms."""
    return np.where(told.drone != "", told.drone, told.other)


def are_targets(names: Texts) -> Bools:
    """Which of those were looked at: neither false alarms nor what is nowhere, (n,)."""
    nowhere = ("", CLUTTER + OTHER, SIDELOBE + OTHER)
    known = {name: bool(name) and not name.startswith(nowhere[1:]) for name in set(names.tolist())}
    return np.array([known[name] for name in names.tolist()], np.bool_)


class SectorKey(NamedTuple):
    """The sector that plots are of."""

    prefix: str  # Of the session's topics
    sensor: str
    scan: int
    sector: int


@dataclass(frozen=True, slots=True)
class SectorPlots:
    """The plots in a message: some rows of a table, which is that of many messages."""

    key: SectorKey
    number: int  # Of the message, among those of its sector
    table: MeasuredPlots
    first: int
    end: int

    def __len__(self) -> int:
        return self.end - self.first


def plots_in_rows(parts: Iterable[SectorPlots]) -> MeasuredPlots:
    """The plots of all parts, in their order."""
    tables = [NO_PLOTS]
    for _, together in groupby(parts, key=lambda part: id(part.table)):
        several = list(together)
        rows = [np.arange(part.first, part.end) for part in several]
        tables.append(several[0].table.rows(np.concatenate(rows)))
    return MeasuredPlots.joined(tables)


def sector_plots(
    messages: Iterable[Recorded], whose: Callable[[Recorded], tuple[str, str]]
) -> Iterator[SectorPlots]:
    """Plots in messages that hold any; what cannot be read or placed is left out."""
    of_batches: list[tuple[SectorKey, int, int]] = []
    of_asterix: list[tuple[SectorKey, int, int]] = []
    batches: list[PlotBatch] = []
    told: list[dict[str, Any]] = []
    for message in messages:
        prefix, sensor = whose(message)
        if message.topic.endswith("/plots"):
            try:
                batch = batch_in(message.payload)
            except DecodeError:
                continue
            key = SectorKey(prefix, sensor, batch.scan, batch.sector)
            batches.append(batch)
            of_batches.append((key, 0, len(batch.plots)))
            continue
        properties = dict(message.properties)
        try:
            key = SectorKey(prefix, sensor, int(properties["scan"]), int(properties["sector"]))
            number = int(properties["id"].rpartition("-")[2])
        except (KeyError, ValueError):
            continue
        plots = told_of_plots_and_tracks(message.payload, message.log_time_ns) or []
        told += plots
        of_asterix.append((key, number, len(plots)))
    for table, several in (
        (plots_of_batches(batches), of_batches),
        (MeasuredPlots.of(told), of_asterix),
    ):
        end = 0
        for key, number, count in several:
            first, end = end, end + count
            if count:
                yield SectorPlots(key, number, table, first, end)


class WaitingPlots:
    """Plots by sector, until the ledger's entry comes, which is the last as a rule."""

    def __init__(self) -> None:
        self._sectors: OrderedDict[SectorKey, dict[int, SectorPlots]] = OrderedDict()
        self.total = 0

    def add(self, found: SectorPlots) -> None:
        """Keep the plots of a message; a duplicate of it is passed over."""
        messages = self._sectors.setdefault(found.key, {})
        if found.number in messages:
            return
        messages[found.number] = found
        self.total += len(found)
        while self.total > MAX_WAITING_PLOTS and self._sectors:
            self._forget(next(iter(self._sectors)))

    def count(self, key: SectorKey) -> int:
        """Count the plots of a sector."""
        return sum(map(len, self._sectors.get(key, {}).values()))

    def take(self, key: SectorKey, t_utc_ns: Ints) -> list[SectorPlots] | None:
        """Plots of a sector, in order, which wait no longer; None if those times are of others.

        The sensor's clock may be ahead, but of all its plots by as much.
        """
        messages = self._forget(key)
        parts = [messages[n] for n in sorted(messages)]
        if sum(map(len, parts)) != len(t_utc_ns):
            return None
        ahead_ns, at = set(), 0
        for part in parts:
            true_ns = t_utc_ns[at : (at := at + len(part))]
            if not part.table.category[part.first]:  # of ASTERIX times are told in steps
                measured_ns = part.table.t_utc_ns[part.first : part.end]
                ahead_ns |= {*(measured_ns - true_ns).tolist()}
        return parts if len(ahead_ns) < 2 else None

    def _forget(self, key: SectorKey) -> dict[int, SectorPlots]:
        messages = self._sectors.pop(key, {})
        self.total -= sum(map(len, messages.values()))
        return messages


def plot_topics_of(
    series: Iterable[ChannelKey], prefixes: set[str], stages: Sequence[Stage]
) -> dict[tuple[str, Stage], tuple[str, str]]:
    """Prefix and sensor by topic and stage: of each sensor the most exact kind of plots.

    At the first of those stages at which there are any.
    """
    best: dict[tuple[str, str], tuple[int, int, str, Stage]] = {}
    for each in series:
        for rank, kind in enumerate(plot_topics()):
            place = each.topic.removesuffix(f"/{kind}")
            prefix, _, sensor = place.rpartition("/")
            if place == each.topic or prefix not in prefixes or each.stage not in stages:
                continue
            found = (rank, stages.index(each.stage), each.topic, each.stage)
            key = (prefix, sensor)
            best[key] = min(best.get(key, found), found)
    return {(topic, stage): key for key, (_, _, topic, stage) in best.items()}
