"""A recorded ledger in figures, and these as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from plotfeed.feeds.console.printed import finite
from plotfeed.feeds.report.error_tally import EDGES, ErrorFigures
from plotfeed.feeds.report.ledger_reading import Counted, SensorTally
from plotfeed.feeds.report.link_figures import CURVE, LinkFigures, link_figures
from plotfeed.feeds.report.plot_tally import AlarmFigures, PdFigures, pd_by_range, pd_of_all
from plotfeed.feeds.report.spreads import CELLS, STEPS
from plotfeed.feeds.report.verdicts import (
    Judged,
    Verdicts,
    of_alarms,
    of_count,
    of_errors,
    of_link,
    of_looks,
    verdicts,
)
from plotfeed.proto.utc import iso_utc
from plotfeed.replay.recorded import Damage


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


def report(path: Path, found: Counted) -> LedgerReport:
    """The figures of what was counted."""
    names, sensors = _names(found.sensors.values()), _in_order(found)
    links = [link for tally in found.sensors.values() for link in tally.links.values()]
    begins = [link.first_due_utc_ns for link in links if link.first_due_utc_ns is not None]
    ends = [link.last_due_utc_ns for link in links if link.last_due_utc_ns is not None]
    told_links = [
        link_figures(names[key], number + 1, link, tally.passage.order_of(number))
        for key, tally in sensors
        for number, link in enumerate(tally.links.values())
        if link.messages
    ]
    told_sensors = [
        _sensor(names[key], tally, found.plots_from.get(key, "")) for key, tally in sensors
    ]
    return LedgerReport(
        file=str(path),
        scene=found.scene,
        entries=found.entries,
        first_utc_ns=min(begins, default=found.first_ns or 0),
        last_utc_ns=max([found.last_ns or 0, *ends]),
        links=told_links,
        sensors=told_sensors,
        verdicts=verdicts(judged_of(told_links, told_sensors)),
        notes=_notes(found),
        damage=list(found.damage),
        curve=[*CURVE.tolist(), 1.0],
        normalised_edges=EDGES.tolist(),
        resolution={"times": math.expm1(0.5 / STEPS), "distance": 1 / CELLS},
    )


def _names(tallies: Any) -> dict[tuple[str, str], str]:
    """Names of sensors, with the prefix of their topics where the file has several."""
    several = len({tally.prefix for tally in tallies}) > 1
    return {
        (t.prefix, t.sensor): f"{t.prefix}/{t.sensor}" if several else t.sensor for t in tallies
    }


def _in_order(found: Counted) -> list[tuple[tuple[str, str], SensorTally]]:
    """Sensors as the scene has them, then by name."""
    places = {name: place for place, name in enumerate(found.scene_sensors)}
    by_name = sorted(found.sensors.items())
    return sorted(by_name, key=lambda each: (each[0][0], places.get(each[0][1], len(places))))


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
        missed_sectors=0
        if tally.asked is None
        else sum(map(tally.asked.missed, tally.sectors.lacking)),
        is_known=tally.asked is not None,
        unjudged="" if tally.asked is None else tally.asked.unjudged,
        errors=tally.errors.figures(),
        false_alarms=tally.alarms.figures(),
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


def _notes(found: Counted) -> list[str]:
    tallies = found.sensors.values()
    counts = {
        "entries are no ledger and are left out": found.unreadable,
        "entries were recorded twice and count once": found.repeated,
        "entries are under more link settings than are told": sum(t.left_out for t in tallies),
        "messages came too late for their place: neither in bursts nor in overtaking": sum(
            t.passage.turns.out_of_turn for t in tallies
        ),
    }
    return [*found.notes, *(f"{count} {what}" for what, count in counts.items() if count)]


def as_values(told: LedgerReport) -> dict[str, Any]:
    """The report for JSON: times also as text, and null for what is not there."""
    values: dict[str, Any] = finite(asdict(told))
    for each in (values, *values["links"]):
        for end in ("first", "last"):
            each[f"{end}_utc"] = iso_utc(each[f"{end}_utc_ns"])
    return values
