"""What a recording holds of each sensor and link, gathered part by part, judged and told."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

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
    EvidencePart,
)
from plotfeed.feeds.lab.links import CURVE, LinkFigures, Order, Setting, link_checks, orders_of
from plotfeed.feeds.link.delays import CELLS
from plotfeed.feeds.recording.recorded_plots import SectorKey, are_targets, names_of, plots_in_rows
from plotfeed.models.residuals import Check
from plotfeed.models.state import OTHER, Ints
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger import LedgerTables, ToldMessages
from plotfeed.proto.utc import iso_utc
from plotfeed.replay.recorded import SCENE_NAME, WHAT_LEFT, Stage

# Settings of one sensor's link, of which numbers have an octet; others are not told.
MAX_LINKS = 100
MAX_SENSORS = 10_000
MOST_HELD = 400_000  # Looks and plots, of all sensors together, that are held until they are judged
FEWEST_HELD = 2000  # Of one sensor, from which on they are judged, however many sensors there are
MOST_GAPS = 1000  # In which is looked for sectors that are lacking although the sensor was at work
WRITTEN_TOGETHER = 4096  # Of a sensor, which takes so many times 32 octets
STAGES: Mapping[judge.Against, Sequence[Stage]] = {"asked": MOST_COMPLETE, "claimed": AS_DELIVERED}
# Of messages: the number of their link's setting in place of their entry's, and what else is told.
KEPT = np.dtype(
    [
        *((name, np.int64) for name in ("due_utc_ns", "link_due_utc_ns", "sent_utc_ns")),
        ("number", np.int32),
        *((name, np.int8) for name in ("entry", "fate", "copy", "flipped_bit")),
    ]
)


def lacking_of(numbers: Ints) -> list[range]:
    """Numbers of sectors that are lacking between those that are there, in the first gaps."""
    there = np.unique(numbers)
    gaps = np.flatnonzero(np.diff(there) > 1)[:MOST_GAPS]
    ends = zip(there[gaps].tolist(), there[gaps + 1].tolist(), strict=True)
    return [range(last + 1, first) for last, first in ends]


class KeptMessages:
    """What became of a sensor's messages, in a file of its own: hours of them are gigabytes."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._last: list[NDArray[Any]] = []  # That are not in the file yet

    def add(self, sent: ToldMessages) -> None:
        """Keep more; raises `OSError`."""
        rows = np.empty(len(sent), KEPT)
        for name in KEPT.names or ():
            rows[name] = getattr(sent, name)
        self._last.append(rows)
        if sum(map(len, self._last)) >= WRITTEN_TOGETHER:
            with self._path.open("ab") as file:
                file.write(np.concatenate(self._last).tobytes())
            self._last = []

    def all(self) -> ToldMessages:
        """All of them, with the columns that are kept."""
        written = np.fromfile(self._path, KEPT) if self._path.exists() else np.empty(0, KEPT)
        rows = np.concatenate([written, *self._last])
        return ToldMessages.holding({name: rows[name].copy() for name in KEPT.names or ()})


class Gathering:
    """What came of one sensor: its sectors until they are judged, and its messages."""

    def __init__(
        self,
        against: judge.Against,
        asked: AskedByTime | None,
        kept: KeptMessages,
        carrier: tuple[str, Stage] | None,
    ) -> None:
        """`carrier` is the topic and the stage of its plots; None where none come."""
        self.tally = judge.FeedTally(against)
        self.asked = asked
        self.entries = self.plots = self.contradicted = self.lost = self.left_out = 0
        # Plots of what is no drone, by what it is.
        self.of_others: Counter[str] = Counter()
        # By the JSON of their keys, in the order in which they came into force.
        self.links: dict[str, Setting] = {}
        self._against, self._kept, self._carrier = against, kept, carrier
        self._numbers: list[Ints] = []  # Of sectors that are there
        # Number, what was asked and what is expected, by the identity of what was asked.
        self._expected: dict[int, tuple[int, AskedSensor | None, AskedSensor | None]] = {}
        self._parts: list[EvidencePart] = []  # That are to be judged
        self.held = 0

    def take(self, part: EvidencePart) -> None:
        """Take entries, and the plots of those that the link neither lost nor changed."""
        spoilt = self._spoilt(part.told.messages)
        if self._against == "asked":
            self._take_messages(part.told)
        else:
            arrived = np.setdiff1d(np.arange(len(part.told)), spoilt)
            self.lost += len(spoilt)
            part, spoilt = part.rows(arrived), spoilt[:0]
        told = part.told
        self.entries += len(told)
        is_target = are_targets(names_of(told.plots))
        self.plots += int(is_target.sum())
        self.of_others.update(name.partition(OTHER)[0] for name in told.plots.other if name)
        contradicted, plots = part.contradicted.copy(), [*part.plots]
        for n in spoilt.tolist():
            contradicted[n], plots[n] = False, None
        self.contradicted += int(contradicted[told.plots.entry[is_target]].sum())
        if self.asked is not None:
            self._numbers.append(told.entries.scan * self.asked.sectors + told.entries.sector)
        held = replace(told, messages=told.messages.rows(np.zeros(0, np.int64)))  # They are kept
        self._parts.append(part._replace(told=held, plots=plots))
        self.held += len(told.looks) + len(told.plots)

    def _spoilt(self, sent: ToldMessages) -> Ints:
        """Entries whose very plots the link changed on their way to where they are found.

        Beside claims, also those of which it delivered none.
        """
        topic, stage = self._carrier or ("", None)
        flipped = sent.flipped_bit >= 0
        if self._against == "asked":
            spoilt = flipped & (stage in WHAT_LEFT)
        else:
            spoilt = (~sent.delivered | flipped) & (sent.copy == 0)
        spoilt &= np.array([each == topic for each in sent.topic], np.bool_)
        return np.unique(sent.entry[spoilt])

    def settle(self) -> None:
        """Judge all that is held."""
        parts, self._parts, self.held = self._parts, [], 0
        if not parts:
            return
        told = LedgerTables.joined([part.told for part in parts])
        plots = [each for part in parts for each in part.plots]
        came = np.array([each is not None for each in plots], np.bool_)
        numbers = [self._number(key) for part in parts for key in part.keys]
        looks = told.looks
        if self._against == "claimed":  # by what came
            looks = looks.but(detected=looks.detected & came[looks.entry])
        self.tally.take(
            judge.SensorFeed(
                looks=looks,
                truths=told.plots,
                plots=plots_in_rows(each for several in plots for each in several or ()),
                came=came[told.plots.entry],
                keys_of_sector=np.array(numbers, np.int64),
                expected=[expected for *_, expected in self._expected.values()],
                scans=len(told) / (1 if self.asked is None else self.asked.sectors),
            )
        )

    def _number(self, key: SectorKey) -> int:
        """The number of what is expected in a sector."""
        asked = None if self.asked is None else self.asked.in_sector(key.scan, key.sector)
        if id(asked) not in self._expected:
            expected = asked if asked is None or self._against == "asked" else asked.claimed
            self._expected[id(asked)] = (len(self._expected), asked, expected)
        return self._expected[id(asked)][0]

    def missed(self) -> int:
        """Sectors that are lacking although the sensor was at work."""
        if self.asked is None or not self._numbers:
            return 0
        return sum(map(self.asked.missed, lacking_of(np.concatenate(self._numbers))))

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


def _gathered(
    evidence: Evidence, against: judge.Against, spare: Path
) -> dict[tuple[str, str], Gathering]:
    """What came of each sensor, by prefix and id; beside claims, of those with plots alone.

    `spare` is an empty folder, for what would fill the memory.
    """
    carriers = {whose: carrier for carrier, whose in evidence.carriers.items()}
    found: dict[tuple[str, str], Gathering] = {}

    def of(whose: tuple[str, str]) -> Gathering:
        if whose not in found:
            kept = KeptMessages(spare / f"{len(found)}")
            asked = evidence.asked.get(whose[1])
            found[whose] = Gathering(against, asked, kept, carriers.get(whose))
        return found[whose]

    for whose in carriers if against == "claimed" else ():
        of(whose)
    for part in evidence.parts():
        for whose, own in part.by_sensor():
            if whose not in found and (against == "claimed" or len(found) >= MAX_SENSORS):
                continue
            of(whose).take(own)
        for each in found.values():
            if each.held >= max(MOST_HELD // len(found), FEWEST_HELD):
                each.settle()
    for each in found.values():
        each.settle()
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
        with Evidence.of(path, STAGES[against]) as evidence, TemporaryDirectory() as spare:
            attached = (attachment.name for attachment in evidence.log.attachments())
            if against == "claimed" or SCENE_NAME in attached:
                evidence.ask()
            self._take(path, evidence, against, _gathered(evidence, against, Path(spare)))

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
