"""What a recording holds of each sensor and link, gathered part by part, judged and told."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plotfeed.feeds.console.printed import finite
from plotfeed.feeds.lab import judge
from plotfeed.feeds.lab.evidence import (
    AS_DELIVERED,
    MOST_COMPLETE,
    AskedByTime,
    AskedSensor,
    Evidence,
    SectorKey,
    SectorPlots,
    WaitingPlots,
    are_targets,
    names_of,
    plots_in_rows,
)
from plotfeed.feeds.lab.laws import CELLS, TrueEchoes, TruePlots
from plotfeed.feeds.lab.links import CURVE, LinkFigures, Order, Setting, link_checks, orders_of
from plotfeed.models.clutter import CLUTTER, SIDELOBE
from plotfeed.models.residuals import Check
from plotfeed.models.state import OTHER, Bools, Ints, Texts
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger import LedgerTables, ToldMessages, ToldPlots
from plotfeed.proto.utc import iso_utc
from plotfeed.replay.recorded import SCENE_NAME, WHAT_LEFT, Stage

# Settings of one sensor's link, of which numbers have an octet; others are not told.
MAX_LINKS = 100
MAX_SENSORS = 10_000
MOST_HELD = 400_000  # Looks and plots, of all sensors together, that are held until they are judged
FEWEST_HELD = 2000  # Of one sensor, from which on they are judged, however many sensors there are
MOST_WAITING = 20_000  # Plots that wait, until all are judged by the ledger
MOST_RUNS = 1000  # In a row, of which is looked which are lacking although the sensor was at work
WRITTEN_TOGETHER = 4096  # Of a sensor, which takes so many times 32 octets
STAGES: Mapping[judge.Against, Sequence[Stage]] = {"asked": MOST_COMPLETE, "claimed": AS_DELIVERED}
NOT_CLAIMED = "clutter that the scene has beside, or side lobes bring, is not claimed"
# Of messages: the number of their link's setting in place of their entry's, and what else is told.
KEPT = np.dtype(
    [
        *((name, np.int64) for name in ("due_utc_ns", "link_due_utc_ns", "sent_utc_ns")),
        ("number", np.int32),
        *((name, np.int8) for name in ("entry", "fate", "copy", "flipped_bit")),
    ]
)


class _Part(NamedTuple):
    """Sectors that wait until all their plots are there."""

    told: LedgerTables
    keys: Sequence[SectorKey]
    expected: list[int]  # The number of what is expected in each
    is_read: Bools  # Whether its plots are looked for


def runs_of(ends: Ints) -> Ints:
    """The first and the last of numbers in a row, of each such row, (2, n), ascending.

    `ends` are the same of rows in any order, which may overlap, follow each other or be one number.
    """
    first, last = ends[:, np.argsort(ends[0], kind="stable")]
    last = np.maximum.accumulate(last)
    begins = np.flatnonzero(np.append(True, first[1:] - last[:-1] > 1)[: len(first)])
    return np.stack([first[begins], last[np.append(begins, len(last))[1:] - 1]])


def lacking_of(ends: Ints) -> list[range]:
    """Numbers of sectors between those that are there, as `runs_of` takes them; of so many gaps."""
    first, last = runs_of(ends)[:, : MOST_RUNS + 1].tolist()
    return [range(end + 1, begin) for end, begin in zip(last, first[1:], strict=False)]


class KeptMessages:
    """What became of a sensor's messages, in a file that all share: hours of them are gigabytes."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._pieces: list[tuple[int, int]] = []  # Where in the file, and octets
        self._last: list[NDArray[Any]] = []  # That are not in the file yet
        self._waiting = 0

    def add(self, sent: ToldMessages) -> None:
        """Keep more; raises `OSError`."""
        rows = np.empty(len(sent), KEPT)
        for name in KEPT.names or ():
            rows[name] = getattr(sent, name)
        self._last.append(rows)
        self._waiting += len(rows)
        if self._waiting >= WRITTEN_TOGETHER:
            data = np.concatenate(self._last).tobytes()
            self._pieces.append((self._file.seek(0, io.SEEK_END), len(data)))
            self._file.write(data)
            self._last, self._waiting = [], 0

    def all(self) -> ToldMessages:
        """All of them, with the columns that are kept."""
        data = bytearray()
        for at, octets in self._pieces:
            self._file.seek(at)
            data += self._file.read(octets)
        rows = np.concatenate([np.frombuffer(data, KEPT), *self._last])
        return ToldMessages.holding({name: rows[name].copy() for name in KEPT.names or ()})


class Gathering:
    """What came of one sensor: its sectors until they are judged, and its messages."""

    def __init__(
        self,
        against: judge.Against,
        asked: AskedByTime | None,
        waiting: WaitingPlots,
        kept: KeptMessages,
        topic: str | None,
    ) -> None:
        """Plots of its sectors come to `waiting`, by the topic that ends so; None: none come."""
        self.tally = judge.FeedTally(against)
        self.asked = asked
        self.entries = self.plots = self.contradicted = self.lost = self.left_out = 0
        # Plots of what is no drone, by what it is.
        self.of_others: Counter[str] = Counter()
        # By the JSON of their keys, in the order in which they came into force.
        self.links: dict[str, Setting] = {}
        self._against, self._waiting, self._topic = against, waiting, topic
        self._kept = kept
        self._runs: Ints = np.zeros((2, 0), np.int64)  # Of sectors that are there, by number
        self._joined_runs = 0
        self._numbers: dict[str, int] = {}  # Of targets, by name
        self._expected: dict[int, tuple[int, AskedSensor | None, AskedSensor | None]] = {}
        self._parts: list[_Part] = []
        self._overdue = self.held = 0

    def take(self, told: LedgerTables, keys: Sequence[SectorKey], spoilt: set[int]) -> None:
        """Take entries, of which the plots of some are spoilt: of these nothing can be compared."""
        if self._against == "asked":
            self._take_messages(told)
        else:
            sent = told.messages
            failed = (~sent.delivered | (sent.flipped_bit >= 0)) & (sent.copy == 0)
            failed &= np.array([t == self._topic for t in sent.topic], np.bool_)
            arrived = np.setdiff1d(np.arange(len(told)), sent.entry[failed])
            self.lost += len(told) - len(arrived)
            told, keys = told.of(arrived), [keys[i] for i in arrived.tolist()]
        self.entries += len(told)
        names = names_of(told.plots)
        is_target = are_targets(names)
        self.plots += int(is_target.sum())
        self.of_others.update(name.partition(OTHER)[0] for name in told.plots.other if name)
        in_plots = names[is_target] if self._against == "asked" else ()
        for name in dict.fromkeys([*in_plots, *names_of(told.looks)]):
            self._numbers.setdefault(name, len(self._numbers))
        is_read = np.full(len(told), self._topic is not None)
        is_read[list(spoilt)] = False
        if self.asked is not None:
            entries = told.entries
            numbers = entries.scan * self.asked.sectors + entries.sector
            self._runs = np.column_stack([self._runs, runs_of(np.stack([numbers, numbers]))])
            if self._runs.shape[1] > MOST_RUNS + 2 * self._joined_runs:
                self._runs = runs_of(self._runs)
                self._joined_runs = self._runs.shape[1]
        held = replace(told, messages=told.messages.rows(np.zeros(0, np.int64)))  # They are kept
        self._parts.append(_Part(held, keys, [self._number(key) for key in keys], is_read))
        self.held += len(told.looks) + len(told.plots)

    def _number(self, key: SectorKey) -> int:
        """The number of what is expected in a sector."""
        asked = None if self.asked is None else self.asked.in_sector(key.scan, key.sector)
        if id(asked) not in self._expected:
            expected = asked if asked is None or self._against == "asked" else asked.claimed
            self._expected[id(asked)] = (len(self._expected), asked, expected)
        return self._expected[id(asked)][0]

    def _targets(self, names: Texts) -> Ints:
        """Numbers of targets, (n,)."""
        return np.array([self._numbers[name] for name in names.tolist()], np.int64)

    def settle(self, *, at_end: bool = False) -> None:
        """Judge sectors whose plots are all there, or have been waited for since the last time."""
        due: list[_Part] = []
        left: list[_Part] = []
        for i, part in enumerate(self._parts):
            counts = np.bincount(part.told.plots.entry, minlength=len(part.keys))
            there = [self._waiting.count(key) for key in part.keys]
            is_there = bool((counts <= there)[part.is_read].all())
            (due if at_end or i < self._overdue or is_there else left).append(part)
        self._parts, self._overdue = left, len(left)
        self.held = sum(len(p.told.looks) + len(p.told.plots) for p in left)
        if due:
            self._judge(due)

    def _judge(self, parts: Sequence[_Part]) -> None:
        told = LedgerTables.joined([part.told for part in parts])
        keys, is_asked = [key for part in parts for key in part.keys], self._against == "asked"
        names = names_of(told.plots)
        is_target, is_kept = are_targets(names), np.zeros(len(names), np.bool_)
        plots: list[SectorPlots] = []
        sectors: list[Ints] = [np.zeros(0, np.int64)]
        ends = np.searchsorted(told.plots.entry, np.arange(len(told) + 1)).tolist()
        for row in np.flatnonzero(np.concatenate([part.is_read for part in parts])).tolist():
            of = slice(ends[row], ends[row + 1])
            is_there = self._waiting.count(keys[row]) > 0
            found = self._waiting.take(keys[row], told.plots.t_utc_ns[of] if is_asked else None)
            if found is None:
                self.contradicted += int(is_target[of].sum()) if is_there else 0
                continue
            is_kept[of] = True
            plots += found
            sectors.append(np.full(sum(map(len, found)), row))
        truths = None
        if is_asked:
            truths = truths_of(told, is_target, self._targets(names[is_target])).rows(is_kept)
        has_clutter = bool(self.of_others[CLUTTER] or self.of_others[SIDELOBE]) and not is_asked
        self.tally.take(
            judge.SensorFeed(
                looks=judge.FeedLooks(
                    sector=told.looks.entry,
                    target=self._targets(names_of(told.looks)),
                    emitted_utc_ns=told.looks.emitted_utc_ns,
                    counts=np.ones(len(told.looks), np.bool_),
                    **{name: getattr(told.looks, name) for name in judge.OF_LOOKS},
                ),
                plots=plots_in_rows(plots),
                plot_sector=np.concatenate(sectors),
                keys_of_sector=np.array([n for part in parts for n in part.expected], np.int64),
                expected=[expected for *_, expected in self._expected.values()],
                scans=len(told) / (1 if self.asked is None else self.asked.sectors),
                names=list(self._numbers),
                told=truths,
                false_alarms=int((names == "").sum()),
                why_no_clutter=NOT_CLAIMED if has_clutter else "",
            )
        )

    def missed(self) -> int:
        """Sectors that are lacking although the sensor was at work."""
        return 0 if self.asked is None else sum(map(self.asked.missed, lacking_of(self._runs)))

    def messages(self) -> Iterator[tuple[Setting, ToldMessages, Order]]:
        """What became of messages, by link setting."""
        sent = self._kept.all()
        orders = orders_of(sent.rows(sent.copy == 0), len(self.links))
        for number, setting in enumerate(self.links.values()):
            yield setting, sent.rows(sent.entry == number), orders[number]

    def _take_messages(self, told: LedgerTables) -> None:
        links, sent = told.entries.link.tolist(), told.messages
        for text in dict.fromkeys(links):
            if text not in self.links and len(self.links) < MAX_LINKS:
                self.links[text] = Setting(text)
        numbers = {text: number for number, text in enumerate(self.links)}
        number = np.array([numbers.get(text, -1) for text in links], np.int64)
        self.left_out += int((number < 0).sum())
        sent = sent.but(
            entry=number[sent.entry],
            fate=np.where((sent.fate == 0) & sent.delivered, int(pb.SENT), sent.fate),
            copy=np.clip(sent.copy, 0, 127),
            flipped_bit=np.clip(sent.flipped_bit, -1, 0),
        )
        self._kept.add(sent.rows(sent.entry >= 0))

    def checks(self) -> list[Check]:
        """All of the sensor that is judged; without a scene nothing is known of what was asked."""
        if self._against == "claimed":
            return self.tally.checks()
        found = [judge.never("plots", self.contradicted, self.plots)]
        if self.asked is not None:
            found += self.tally.checks()
            found.append(judge.never("missed scans", self.missed(), self.entries))
        return found


def truths_of(told: LedgerTables, is_target: Bools, target: Ints) -> judge.ToldTruth:
    """What is true of plots, of which those are of targets, with these numbers."""
    plots = told.plots.rows(is_target)
    merged = np.fromiter(map(len, plots.merged_drones), np.int64, len(plots))
    return judge.ToldTruth(
        is_target,
        TruePlots(
            t_utc_ns=plots.t_utc_ns,
            target=target,
            drones=1 + merged,
            range_rate_m_s=plots.range_rate_m_s,
        ),
        echoes_of(told, plots),
    )


def echoes_of(told: LedgerTables, plots: ToldPlots) -> TrueEchoes:
    """Where the drones in plots were: by the looks, where a plot's truth is another."""
    looks, names, look_names = told.looks, names_of(plots), names_of(told.looks)
    place = np.stack([plots.azimuth_deg, plots.elevation_deg, plots.range_m])
    looked = np.stack([looks.azimuth_deg, looks.elevation_deg, looks.range_m])
    if looks.emitted_utc_ns.any():
        columns = (looks.entry.tolist(), look_names.tolist(), looks.t_utc_ns.tolist())
        heard = np.flatnonzero(looks.emitted_utc_ns).tolist()
        row_of = {tuple(column[row] for column in columns): row for row in reversed(heard)}
        keys = zip(plots.entry.tolist(), names.tolist(), plots.t_utc_ns.tolist(), strict=True)
        for n, key in enumerate(keys):
            if key in row_of:
                place[:, n] = looked[:, row_of[key]]
    is_merged = np.array([bool(each) for each in plots.merged_drones], np.bool_)
    alone = np.flatnonzero(~is_merged)
    number, row = [alone], [np.zeros(0, np.int64)]
    for n in np.flatnonzero(is_merged).tolist():
        first, end = np.searchsorted(looks.entry, [plots.entry[n], plots.entry[n] + 1])
        for drone in (names[n], *plots.merged_drones[n]):
            row.append(first + np.flatnonzero(look_names[first:end] == drone))
            number.append(np.full(len(row[-1]), n))
    rows, numbers = np.concatenate(row), np.concatenate(number)
    order = np.argsort(numbers, kind="stable")
    azimuth_deg, elevation_deg, range_m = np.column_stack([place[:, alone], looked[:, rows]])
    found = TrueEchoes(
        plot=numbers,
        channel=np.append(np.full(len(alone), -1), looks.channel[rows]),
        azimuth_deg=azimuth_deg,
        elevation_deg=elevation_deg,
        range_m=range_m,
        weight=np.append(np.ones(len(alone)), 10 ** (looks.snr_db[rows] / 10)),
    )
    return found if len(alone) == len(plots) else found.rows(order)


def _gathered(
    evidence: Evidence, against: judge.Against, spare: BinaryIO
) -> dict[tuple[str, str], Gathering]:
    """What came of each sensor, by prefix and id; beside claims, of those with plots alone.

    `spare` is an empty file, for what would fill the memory.
    """
    carriers = {whose: topic for (topic, _), whose in evidence.carriers.items()}
    found: dict[tuple[str, str], Gathering] = {}
    waiting = WaitingPlots()

    def of(whose: tuple[str, str]) -> Gathering:
        if whose not in found:
            asked, kept = evidence.asked.get(whose[1]), KeptMessages(spare)
            found[whose] = Gathering(against, asked, waiting, kept, carriers.get(whose))
        return found[whose]

    for whose in carriers if against == "claimed" else ():
        of(whose)
    for part in evidence.parts():
        for plots in part.plots:
            waiting.add(plots)
        for whose, told, keys in part.by_sensor():
            if whose not in found and (against == "claimed" or len(found) >= MAX_SENSORS):
                continue
            # Entries of which the link has flipped a bit of the very plots that are to be read.
            flipped = told.messages.rows((told.messages.flipped_bit >= 0) & (against == "asked"))
            spoilt = {
                entry
                for entry, topic in zip(flipped.entry.tolist(), flipped.topic, strict=True)
                if any(evidence.carriers.get((topic, stage)) == whose for stage in WHAT_LEFT)
            }
            of(whose).take(told, keys, spoilt)
        crowded = against == "asked" and waiting.total >= MOST_WAITING
        most = 1 if crowded else max(MOST_HELD // max(len(found), 1), FEWEST_HELD)
        for each in found.values():
            if each.held >= most:
                each.settle()
    for each in found.values():
        each.settle(at_end=True)
    return found


class SensorFigures:
    """What there was of a sensor, beside its checks."""

    def __init__(self, name: str, of: Gathering, plots_from: str) -> None:
        """`plots_from` is where plots were found: their kind and whether before the link or after.

        It is empty for none.
        """
        tally, self.sensor, self.entries = of.tally, name, of.entries
        self.plots_from = plots_from
        self.plots = of.plots  # Of drones and what else was looked at, by the ledger
        # Of what is no drone, by what it is; of clutter, which is not looked at, too.
        self.plots_of_others = dict(sorted(of.of_others.items()))
        self.joined = tally.joined  # Of these, the ones that were found with what was measured
        # Of the others, those in sectors whose recorded plots are not those of the ledger.
        self.contradicted = of.contradicted
        self.not_compared = tally.left_out  # Of which it is not known what they were to say
        self.lost = of.lost  # Sectors whose plots did not arrive: a judge of claims leaves them out
        self.is_known = of.asked is not None  # Whether the file has what the scene asks of it
        # What of its plots is not judged, and why; empty where all is.
        self.unjudged = "" if of.asked is None else of.asked.unjudged
        self.looks_by_range = tally.by_range()
        self.looks_unjudged = tally.unjudged  # Of which it is not known what Pd was asked
        self.why_not_pd = tally.why_not_pd
        # Errors over their standard deviations between the report's edges, beyond in the last.
        histograms = zip(judge.NAMES, tally.histograms.tolist(), strict=True)
        self.histograms = {name: counts for name, counts in histograms if any(counts)}


class FeedReport:
    """What a recording says of feeds."""

    def __init__(self, path: Path, against: judge.Against) -> None:
        """Judge a recording; raises `PlotfeedError` if it holds no ledger, and `OSError`."""
        with Evidence.of(path, STAGES[against]) as evidence, TemporaryFile() as spare:
            attached = (attachment.name for attachment in evidence.log.attachments())
            if against == "claimed" or SCENE_NAME in attached:
                evidence.ask()
            self._take(path, evidence, against, _gathered(evidence, against, spare))

    def _take(
        self,
        path: Path,
        evidence: Evidence,
        against: judge.Against,
        found: Mapping[tuple[str, str], Gathering],
    ) -> None:
        """Say what was found of each sensor, in the order of the scene, and then by name."""
        scene = evidence.scene
        places = {} if scene is None else {s.id: place for place, s in enumerate(scene.sensor)}
        sensors = sorted(found, key=lambda key: (key[0], places.get(key[1], len(places)), key[1]))
        several = len({prefix for prefix, _ in sensors}) > 1
        names = {key: "/".join(key) if several else key[1] for key in sensors}
        after = "after the link" if against == "asked" else "as delivered"
        when = {Stage.BEFORE: "before the link", Stage.AFTER: after, Stage.RECEIVED: "as received"}
        plots_from = {
            whose: f"{topic.removeprefix('/'.join(whose)).strip('/')}, {when[stage]}"
            for (topic, stage), whose in evidence.carriers.items()
        }
        links, checks = list[LinkFigures](), list[Check]()
        for key in sensors:
            for number, (setting, sent, order) in enumerate(found[key].messages(), 1):
                if (sent.copy == 0).any():
                    links.append(LinkFigures(names[key], number, setting, sent, order))
                    checks += link_checks(links[-1], setting.differs)
        for key in sensors:
            checks += [replace(each, sensor=names[key]) for each in found[key].checks()]
        notes = [f"its scene cannot be used: {evidence.problem}"] if evidence.problem else []
        left_out = sum(each.left_out for each in found.values())
        counts = {
            "entries are no ledger and are left out": evidence.unreadable,
            "entries were recorded twice and count once": evidence.repeated,
            "entries are under more link settings than are told": left_out,
        }
        first_ns, last_ns = evidence.first_ns or 0, evidence.last_ns or 0
        self.file = str(path)
        # Of the session that was recorded; empty if the file has none.
        self.scene = "" if scene is None else scene.scene.name
        self.entries = sum(each.entries for each in found.values())
        # When the first message was handed over; without any, when the first entry was written.
        self.first_utc_ns = min((link.first_utc_ns for link in links), default=first_ns)
        # When the last entry was written, or the last message handed over.
        self.last_utc_ns = max([last_ns, *(link.last_utc_ns for link in links)])
        self.links = links  # None beside claims
        self.sensors = [SensorFigures(names[k], found[k], plots_from.get(k, "")) for k in sensors]
        self.verdicts = judge.Verdicts(checks, against)
        self.notes = notes + [f"{count} {what}" for what, count in counts.items() if count]
        self.damage = list(evidence.log.damage)
        self.curve = [*CURVE.tolist(), 1.0]  # Probabilities of all `curve_ms`
        self.normalised_edges: list[float] = judge.EDGES.tolist()
        # Relative, of times that are quantiles; of Kolmogorov's distance.
        self.resolution = {"times": 0.0, "distance": 1 / CELLS}

    def as_values(self) -> dict[str, Any]:
        """The report for JSON: times also as text, and null for what is not there."""
        held = vars(self) | {"verdicts": self.verdicts.as_json()}
        values: dict[str, Any] = finite(_plain(held))
        for each in (values, *values["links"]):
            for end in ("first", "last"):
                each[f"{end}_utc"] = iso_utc(each[f"{end}_utc_ns"])
        return values


def _plain(value: Any) -> Any:
    """A tree of what objects hold, by the names of their attributes."""
    if isinstance(value, Mapping):
        return {name: _plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if is_dataclass(value):
        return _plain({each.name: getattr(value, each.name) for each in fields(value)})
    return _plain(vars(value)) if hasattr(value, "__dict__") else value
