"""A recorded ledger in figures, read once in bounded memory."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.feeds.console.printed import finite
from plotfeed.feeds.lab.asked import AskedByTime, AskedSensor
from plotfeed.feeds.lab.checks import (
    CELL_M,
    EDGES,
    MAX_CELLS,
    AlarmFigures,
    AwaitedPlots,
    ErrorFigures,
    ErrorsTally,
    Judged,
    LookTally,
    PdFigures,
    Verdicts,
    alarm_figures,
    lacking_of,
    of_alarms,
    of_count,
    of_errors,
    of_link,
    of_looks,
    pd_by_range,
    pd_of_all,
    sector_truths,
    settled_errors,
    verdicts,
)
from plotfeed.feeds.lab.evidence import Evidence, WaitingPlots, are_targets, names_of
from plotfeed.feeds.lab.laws import CELLS
from plotfeed.feeds.lab.links import (
    CURVE,
    LinkFigures,
    LinkMessages,
    Order,
    Setting,
    link_figures,
    orders_of,
)
from plotfeed.models.state import OTHER, Ints
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger import LedgerTables, ToldMessages
from plotfeed.proto.utc import iso_utc
from plotfeed.replay.recorded import WHAT_LEFT, Damage, Stage

MAX_LINKS = 100
"""Settings of one sensor's link; what is under further ones is not told."""


class SensorTally:
    """Takes its entries one after the other."""

    def __init__(self, prefix: str, sensor: str, asked: AskedByTime | None) -> None:
        self.prefix = prefix
        self.sensor = sensor
        self.entries = 0
        self.plots = 0
        """Of drones and what else was looked at, by the ledger."""
        self.of_others: Counter[str] = Counter()
        """Plots of what is no drone, by what it is."""
        self.links: dict[str, Setting] = {}
        """By the JSON of their keys, in the order in which they came into force."""
        self.left_out = 0
        """Entries under settings that were too many."""
        self._sent: list[ToldMessages] = []
        """Of messages what is needed, with the number of the link in place of that of the entry."""
        self.looks = LookTally(CELL_M, MAX_CELLS)
        self.errors = ErrorsTally()
        self.asked = asked
        """What its scene asked of it; None if that is not known."""
        self.false_alarms = 0
        self.alarms_asked = 0.0
        """As many as were to be expected."""
        self._sectors: list[Ints] = []

    def add(self, told: LedgerTables) -> list[AskedSensor | None]:
        """Take entries; what was asked of the sensor in each, if that is known."""
        self.entries += len(told)
        asked: list[AskedSensor | None] = [None] * len(told)
        if self.asked is not None:
            scan, sector = told.entries.scan, told.entries.sector
            asked = list(map(self.asked.in_sector, scan.tolist(), sector.tolist()))
            self._sectors.append(scan * self.asked.sectors + sector)
            alarms = (math.nan if each is None else each.false_alarms_per_scan for each in asked)
            self.alarms_asked += sum(alarms) / self.asked.sectors
        looks = told.looks
        merges = np.array([each is not None and each.merges for each in asked], np.bool_)
        if merges.any():
            # Those whose echoes merged have one outcome, of the very same odds.
            alone = np.where(merges[looks.entry], -1, np.arange(len(looks)))
            odds = np.stack([looks.entry, looks.pd, looks.channel, alone])[:, ::-1]
            looks = looks.rows(len(looks) - 1 - np.unique(odds, axis=1, return_index=True)[1])
        self.looks.add(looks.range_m, looks.pd, looks.detected)
        names = names_of(told.plots)
        self.plots += int(are_targets(names).sum())
        self.of_others.update(name.partition(OTHER)[0] for name in told.plots.other if name)
        self.false_alarms += int((names == "").sum())
        self._take_messages(told)
        return asked

    def missed(self) -> int:
        """Sectors that are lacking although the sensor was at work."""
        if self.asked is None or not self._sectors:
            return 0
        return sum(map(self.asked.missed, lacking_of(np.concatenate(self._sectors))))

    def messages(self) -> Iterator[tuple[LinkMessages, Order]]:
        """What became of messages, by link setting."""
        sent = ToldMessages.joined(self._sent)
        orders = orders_of(sent.rows(sent.copy == 0), len(self.links))
        for number, setting in enumerate(self.links.values()):
            yield LinkMessages(setting, sent.rows(sent.entry == number)), orders[number]

    def _take_messages(self, told: LedgerTables) -> None:
        links, sent = told.entries.link.tolist(), told.messages
        for text in dict.fromkeys(links):
            if text not in self.links and len(self.links) < MAX_LINKS:
                self.links[text] = Setting.of(text)
        numbers = {text: number for number, text in enumerate(self.links)}
        number = np.array([numbers.get(text, -1) for text in links], np.int64)
        self.left_out += int((number < 0).sum())
        fate = np.where((sent.fate == 0) & sent.delivered, int(pb.SENT), sent.fate)
        sent = sent.but(entry=number[sent.entry], fate=fate.astype(np.int8))
        needed = sent.picked(np.flatnonzero(sent.entry >= 0), NEEDED)
        self._sent.append(needed)


NEEDED = (
    *("entry", "due_utc_ns", "link_due_utc_ns", "sent_utc_ns"),
    *("fate", "number", "copy", "flipped_bit"),
)
MAX_SENSORS = 10_000


def counted(evidence: Evidence) -> dict[tuple[str, str], SensorTally]:
    """What a recording's ledger came to, by prefix and sensor, read in one pass."""
    found: dict[tuple[str, str], SensorTally] = {}
    carried, waiting = set(evidence.carriers.values()), WaitingPlots()
    awaited: list[AwaitedPlots] = []
    for part in evidence.parts():
        for plots in part.plots:
            waiting.add(plots)
        for whose, told, keys in part.by_sensor():
            if whose not in found and len(found) >= MAX_SENSORS:
                continue
            tally = found.setdefault(whose, SensorTally(*whose, evidence.asked.get(whose[1])))
            asked = tally.add(told)
            spoilt = _spoilt(told, whose, evidence.carriers)
            for entry, truth in sector_truths(told, asked) if whose in carried else ():
                if entry not in spoilt:
                    awaited.append((keys[entry], truth, tally.errors))
        awaited = settled_errors(waiting, awaited)
    settled_errors(waiting, awaited, at_end=True)
    for tally in found.values():
        tally.errors.count()
    return found


WHEN = {
    Stage.BEFORE: "before the link",
    Stage.AFTER: "after the link",
    Stage.RECEIVED: "as received",
}


def _spoilt(
    told: LedgerTables,
    whose: tuple[str, str],
    carriers: Mapping[tuple[str, Stage], tuple[str, str]],
) -> set[int]:
    """Entries of which the link has flipped a bit of the very plots that are to be read."""
    flipped = told.messages.rows(told.messages.flipped_bit >= 0)
    return {
        entry
        for entry, topic in zip(flipped.entry.tolist(), flipped.topic, strict=True)
        if any(carriers.get((topic, stage)) == whose for stage in WHAT_LEFT)
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorFigures:
    """A sensor in figures, but for its link."""

    sensor: str
    entries: int
    looks: PdFigures | None
    looks_by_range: Sequence[PdFigures]
    plots_from: str
    """Where plots were found: their kind and whether before or after the link; empty for none."""
    plots: int
    """Of drones and what else was looked at, by the ledger."""
    plots_of_others: Mapping[str, int]
    """Of what is no drone, by what it is; of clutter, which is not looked at, too."""
    joined: int
    """Of these, the ones that were found with what was measured."""
    contradicted: int
    """Of the others, those in sectors whose recorded plots are not those of the ledger."""
    not_compared: int
    """Of those that were found: it is not known what they were to say."""
    times_off: int
    """Of those that were found: another time than the one asked for."""
    missed_sectors: int
    """In which the sensor was at work, and of which the ledger has nothing."""
    is_known: bool
    """Whether the file has what the scene asks of the sensor."""
    unjudged: str
    """What of its plots is not judged, and why; empty where all is."""
    errors: Sequence[ErrorFigures]
    false_alarms: AlarmFigures


@dataclass(frozen=True, slots=True, kw_only=True)
class LedgerReport:
    """A recorded ledger in figures."""

    file: str
    scene: str
    """Of the session that was recorded; empty if the file has none."""
    entries: int
    first_utc_ns: int
    """When the first message was handed over; without any, when the first entry was written."""
    last_utc_ns: int
    """When the last entry was written, or the last message handed over."""
    links: Sequence[LinkFigures]
    sensors: Sequence[SensorFigures]
    verdicts: Verdicts
    """What is not as it was asked."""
    notes: Sequence[str]
    damage: Sequence[Damage]
    curve: Sequence[float]
    """Probabilities of the `curve_ms` of all distributions of times."""
    normalised_edges: Sequence[float]
    """Between which errors over their standard deviations were counted."""
    resolution: Mapping[str, float]
    """Relative, of times that are quantiles; of Kolmogorov's distance."""


def report(path: Path) -> LedgerReport:
    """A file in figures; raises `PlotfeedError` if it holds no ledger, and `OSError`."""
    with Evidence.of(path) as evidence:
        if evidence.has_scene:
            evidence.ask()
        found = counted(evidence)
        scene = evidence.scene
        places = {} if scene is None else {s.id: place for place, s in enumerate(scene.sensor)}
        # As the scene has them, then by name.
        sensors = sorted(found, key=lambda key: (key[0], places.get(key[1], len(places)), key[1]))
        several = len({prefix for prefix, _ in sensors}) > 1
        names = {key: "/".join(key) if several else key[1] for key in sensors}
        plots_from = evidence.carrier_of(WHEN)
        links = [
            link_figures(names[key], number, link, order)
            for key in sensors
            for number, (link, order) in enumerate(found[key].messages(), 1)
            if len(link.first)
        ]
        told = [_sensor(names[key], found[key], plots_from.get(key, "")) for key in sensors]
        first_ns, last_ns = evidence.first_ns or 0, evidence.last_ns or 0
        return LedgerReport(
            file=str(path),
            scene="" if scene is None else scene.scene.name,
            entries=sum(tally.entries for tally in found.values()),
            first_utc_ns=min((link.first_utc_ns for link in links), default=first_ns),
            last_utc_ns=max([last_ns, *(link.last_utc_ns for link in links)]),
            links=links,
            sensors=told,
            verdicts=verdicts(judged_of(links, told)),
            notes=_notes(evidence, sum(tally.left_out for tally in found.values())),
            damage=list(evidence.log.damage),
            curve=[*CURVE.tolist(), 1.0],
            normalised_edges=EDGES.tolist(),
            resolution={"times": 0.0, "distance": 1 / CELLS},
        )


def _sensor(name: str, tally: SensorTally, plots_from: str) -> SensorFigures:
    return SensorFigures(
        sensor=name,
        entries=tally.entries,
        looks=pd_of_all(tally.looks),
        looks_by_range=pd_by_range(tally.looks),
        plots_from=plots_from,
        plots=tally.plots,
        plots_of_others=dict(sorted(tally.of_others.items())),
        joined=tally.errors.joined,
        contradicted=tally.errors.contradicted,
        not_compared=tally.errors.left_out,
        times_off=tally.errors.times_off,
        missed_sectors=tally.missed(),
        is_known=tally.asked is not None,
        unjudged="" if tally.asked is None else tally.asked.unjudged,
        errors=tally.errors.figures(),
        false_alarms=alarm_figures(
            tally.false_alarms,
            tally.entries,
            tally.alarms_asked,
            0 if tally.asked is None else tally.asked.sectors,
        ),
    )


def judged_of(links: Sequence[LinkFigures], sensors: Sequence[SensorFigures]) -> Iterator[Judged]:
    """All figures that can be judged; without a scene nothing is known of plots."""
    for link in links:
        yield from of_link(link)
    for of in sensors:
        off = f"of {of.plots} plots of drones in sectors that are not those of the ledger"
        yield of_count(of.sensor, "plots", of.contradicted, off)
        if not of.is_known:
            continue
        if of.looks is not None:
            by_range = of.looks_by_range if len(of.looks_by_range) > 1 else ()
            yield from of_looks(of.sensor, [of.looks, *by_range])
        yield from of_errors(of.sensor, of.errors)
        yield of_alarms(of.sensor, of.false_alarms)
        yield of_count(of.sensor, "missed scans", of.missed_sectors, "sectors that are lacking")
        yield of_count(of.sensor, "time", of.times_off, f"of {of.joined} plots at other times")


def _notes(evidence: Evidence, left_out: int) -> list[str]:
    counts = {
        "entries are no ledger and are left out": evidence.unreadable,
        "entries were recorded twice and count once": evidence.repeated,
        "entries are under more link settings than are told": left_out,
    }
    notes = [f"its scene cannot be used: {evidence.problem}"] if evidence.problem else []
    return notes + [f"{count} {what}" for what, count in counts.items() if count]


def as_values(told: LedgerReport) -> dict[str, Any]:
    """The report for JSON: times also as text, and null for what is not there."""
    values: dict[str, Any] = finite(asdict(told))
    for each in (values, *values["links"]):
        for end in ("first", "last"):
            each[f"{end}_utc"] = iso_utc(each[f"{end}_utc_ns"])
    return values
