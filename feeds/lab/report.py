"""`plotfeed report`: a recorded ledger as aligned tables or as JSON, and its chart beside them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from math import isfinite
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np

from plotfeed.feeds.console.extras import check_picture
from plotfeed.feeds.console.printed import Row, printable, say, say_damage
from plotfeed.feeds.console.process import refuse_if_there
from plotfeed.feeds.lab.gathering import FeedReport, SensorFigures
from plotfeed.feeds.lab.judge import NAMES, Against, Verdicts
from plotfeed.feeds.lab.links import LatencyFigures, LinkFigures, link_text
from plotfeed.feeds.lab.pictures import INK, QUIET, figure_of, finish, save_picture
from plotfeed.feeds.lab.tables import NOTHING, Table, TextColumn, number, of_cells
from plotfeed.models.residuals import Check
from plotfeed.models.verdicts import share_interval
from plotfeed.proto.utc import NS, iso_utc

BURSTS_SHOWN = 10


def lines(told: FeedReport) -> Iterator[str]:
    """All lines of a report."""
    lasted_s = (told.last_utc_ns - told.first_utc_ns) / NS
    of_scene = f"scene {printable(told.scene)}, " if told.scene else ""
    yield (
        f"{told.file}: {of_scene}{told.entries} entries of {len(told.sensors)} sensor(s), "
        f"{lasted_s:.1f} s from {iso_utc(told.first_utc_ns)}"
    )
    for note in told.notes:
        yield f"  note: {printable(note)}"
    if told.links:
        yield from _link_tables(told)
    yield from feed_lines(told)


def feed_lines(told: FeedReport) -> Iterator[str]:
    """Checks of sensors, where their plots are from, and the verdict, last."""
    verdicts, rows, before = told.verdicts, [], ""
    for each in verdicts.checks:
        if not (each.link or each.is_never):
            rows.append(("" if each.sensor == before else each.sensor, each))
            before = each.sensor
    title, columns = WORDS[verdicts.against][0], checks_columns(verdicts, with_links=False)
    yield from Table(f"Sensors beside what {title}", columns, rows).lines()
    if not rows:
        yield "  nothing that can be judged: no scene, or no plots that can be read"
    for sensor in told.sensors:
        if sensor.plots:
            yield f"  {printable(sensor.sensor)}: {_whence(sensor, verdicts)}"
        if sensor.looks_unjudged:
            looks = f"{sensor.looks_unjudged} looks whose Pd is not judged"
            yield f"  {printable(sensor.sensor)}: {looks}: {sensor.why_not_pd}"
        if sensor.unjudged:
            yield f"  {printable(sensor.sensor)}: not judged: {sensor.unjudged}"
        if sensor.plots_of_others:
            counts = (f"{n} of {printable(what)}" for what, n in sensor.plots_of_others.items())
            named = f"  {printable(sensor.sensor)}: plots of no drone and no false alarms: "
            yield named + ", ".join(counts)
    wrong = [(each.sensor, each) for each in verdicts.wrong]
    if wrong:
        columns = checks_columns(verdicts, with_links=bool(told.links))
        yield from Table(differs(verdicts).capitalize(), columns, wrong).lines()
    yield ""
    how = (
        f"all as {verdicts.against}"
        if not wrong
        else f"{len(wrong)} {differs(verdicts, len(wrong))}"
    )
    yield (
        f"{verdicts.judged} checks: {how}. "
        f"Where all is right, one recording in {1 / verdicts.false_rate:.0f} says otherwise."
    )


NAMED = (TextColumn("sensor", "sensor"), TextColumn("link", "number", "d"))  # Of links


def _pair(of: str) -> list[TextColumn]:
    """What was asked and delivered, in percent, and the z-score."""
    return [
        TextColumn("asked", f"{of}.asked", "%"),
        TextColumn("delivered", f"{of}.delivered", "%"),
        TextColumn("z", f"{of}.z", "+.1f"),
    ]


def _link_tables(told: FeedReport) -> Iterator[str]:
    """What links asked and delivered."""
    begin_ns = told.first_utc_ns
    settings = [
        *NAMED,
        TextColumn("from s", lambda link: (link.first_utc_ns - begin_ns) / NS, ".1f"),
        TextColumn("to s", lambda link: (link.last_utc_ns - begin_ns) / NS, ".1f"),
        TextColumn("messages", "messages", "d"),
        TextColumn("keys in force", lambda link: link_text(link.link)),
    ]
    title = "Links, and when messages under them were handed over"
    yield from Table(title, settings, told.links).lines()
    for link in told.links:
        if link.link_problem:
            named = f"link {link.number} of {printable(link.sensor)}"
            yield f"  {named} is not one that is known: {printable(link.link_problem)}"
    yield from _delays(told)
    losses = [
        *NAMED,
        TextColumn("messages", "loss.of", "d"),
        TextColumn("lost", "loss.count", "d"),
        *_pair("loss"),
        TextColumn("bursts", "bursts.bursts", "d"),
        TextColumn("asked", "bursts.asked_mean", ".3f"),
        TextColumn("delivered", "bursts.delivered_mean", ".3f"),
        TextColumn("z", "bursts.z", "+.1f"),
    ]
    groups = {4: "share lost, %", 8: "mean burst"}
    yield from Table("Loss, and messages lost in a row", losses, told.links, groups).lines()
    yield from _bursts(told)
    copies = [*NAMED, *_pair("duplicates"), *_pair("corrupted"), *_pair("overtook")[:2]]
    title = "Duplicates, flipped bits, and messages that left before one handed over earlier"
    groups = {2: "doubled, %", 5: "corrupted, %", 8: "overtook, %"}
    yield from Table(title, copies, told.links, groups).lines()
    some = [link for link in told.links if any(link.other_fates.values())]
    if some:

        def fate(name: str) -> Callable[[LinkFigures], int]:
            return lambda link: link.other_fates[name]

        fates = [TextColumn(n.replace("_", " "), fate(n), "d") for n in some[0].other_fates]
        yield from Table("Messages that did not leave otherwise", [*NAMED, *fates], some).lines()


def _delays(told: FeedReport) -> Iterator[str]:
    rows: list[Row] = []
    for link in told.links:
        name, fit, sent = printable(link.sensor), link.fit, str(link.sent)
        why = f"not compared: {fit.not_comparable}" if fit.not_comparable else ""
        rows.append((name, str(link.number), "asked", "", *_times(link.asked), "", "", why))
        fits = number(fit.distance, ".4f"), number(fit.p_value, ".2g")
        rows.append(("", "", "delivered", sent, *_times(link.delivered), *fits, ""))
        fits = number(fit.link_distance, ".4f"), number(fit.link_p_value, ".2g")
        by_link = "of the link alone" if fits[0] != NOTHING else ""
        rows.append(("", "", "engine late", "", *_times(link.lateness), *fits, by_link))
    header = ("sensor", "link", "", "messages", "mean", "p50", "p90", "p99", "max", "KS", "p", "")
    title = "Delay from being handed over to sending, ms"
    columns = of_cells(header, "<><>>>>>>>><")
    yield from Table(title, columns, rows, {9: "distance from the law"}).lines()


def _times(times: LatencyFigures | None) -> Iterator[str]:
    if times is None:
        return iter([NOTHING] * 5)
    told = (times.mean_ms, times.p50_ms, times.p90_ms, times.p99_ms, times.max_ms)
    return (number(value, ".3f") for value in told)


def _bursts(told: FeedReport) -> Iterator[str]:
    rows = []
    for link in told.links:
        bursts = link.bursts
        if not bursts.bursts:
            continue
        for what, survival in (
            ("asked", bursts.asked_survival),
            ("delivered", bursts.delivered_survival),
        ):
            shares = [number(share, "%") for share in survival[:BURSTS_SHOWN]]
            shares += [NOTHING] * (BURSTS_SHOWN - len(shares))
            named = (printable(link.sensor), str(link.number)) if what == "asked" else ("", "")
            rows.append((*named, what, *shares))
    if rows:
        header = ("sensor", "link", "", *map(str, range(1, BURSTS_SHOWN + 1)))
        columns = of_cells(header, "<><" + ">" * BURSTS_SHOWN)
        yield from Table("Bursts of so many losses or more, %", columns, rows).lines()


# Of each way to judge: what is expected, and what differs from it.
WORDS: Mapping[Against, tuple[str, str]] = {
    "asked": ("was asked of them", "what was asked"),
    "claimed": ("they claim, as a tracker sees it", "its claims"),
}


def differs(verdicts: Verdicts, many: int = 1) -> str:
    """Say that something is not as expected, in the words that the page has for it."""
    return f"differ{'s' if many == 1 else ''} from {WORDS[verdicts.against][1]}"


def checks_columns(verdicts: Verdicts, *, with_links: bool) -> Sequence[TextColumn]:
    """Columns of pairs of a name and a check."""

    def verdict(row: tuple[str, Check]) -> str:
        check = row[1]
        if not check.is_judged:
            return f"not judged: {check.why_not or 'too few'}"
        return differs(verdicts) if check.wrong else "ok"

    def z(row: tuple[str, Check]) -> str:
        """Standard deviations, where they say anything; what cannot be by chance never is."""
        check = row[1]
        if check.p == 0:
            return "never"
        return NOTHING if check.is_never else number(check.z, "+.1f")

    def of(name: str) -> Callable[[tuple[str, Check]], Any]:
        return lambda row: getattr(row[1], name)

    link = TextColumn("link", lambda row: str(row[1].link or ""), "s")
    return (
        TextColumn("sensor", lambda row: row[0]),
        *([link] if with_links else ()),
        TextColumn("check", of("name")),
        TextColumn(verdicts.against, of("expected"), ".4g"),
        TextColumn("found", of("found"), ".4g"),
        TextColumn("+-", of("sigma"), ".2g"),
        TextColumn("", of("unit")),
        TextColumn("z", z, "s"),
        TextColumn("of", of("of"), "d"),
        TextColumn("", verdict),
    )


def _whence(sensor: SensorFigures, verdicts: Verdicts) -> str:
    """Say from which messages plots are, and what is left out: nothing is without a word."""
    if verdicts.against == "claimed":
        lost = f"; {sensor.lost} sectors that did not arrive are left out" if sensor.lost else ""
        return f"by {sensor.plots_from}{lost}"
    where = (
        f"{sensor.joined} found in {sensor.plots_from}"
        if sensor.plots_from
        else "none was recorded in a format that is read here"
    )
    counts = {
        "in sectors whose plots are not those of the ledger": sensor.contradicted,
        "not compared, since noise decides whether they are there": sensor.not_compared,
    }
    rest = "".join(f"; {count} {what}" for what, count in counts.items() if count)
    return f"of {sensor.plots} plots of drones {where}{rest}"


# The picture: what was asked as broken lines, what was delivered as whole ones.

INCHES = (16.5, 9.3)
COLOURS = ("#1d4ed8", "#c2410c", "#15803d", "#7e22ce", "#0e7490", "#a16207", "#be123c", "#475569")
ASKED: Mapping[str, Any] = {"ls": (0, (4, 2)), "lw": 2.2, "alpha": 0.55}
DOTTED = (0, (3, 1, 1, 1, 1, 1))
LINES = dict(zip(NAMES, ("-", "-.", "--", ":", DOTTED, (0, (6, 3))), strict=True))
BURSTS_DRAWN = 30
FEWEST_LOOKS = 5  # Of a bin of ranges that is drawn
LEGEND_LETTERS, LEGEND_LINES = 70, 5
LEAST_LATE_MS = 1e-3
MOST_SPREAD = 30.0  # Of median delays, beyond which their axis is logarithmic


Links = Sequence[tuple[str, LinkFigures]]  # Each with its colour, and likewise sensors
Sensors = Sequence[tuple[str, SensorFigures]]


def draw_report(told: FeedReport, path: Path) -> None:
    """Write the picture, in the format that its name says: of as many as there are colours."""
    some = (link for link in told.links if link.messages)
    links = list(zip(COLOURS, some, strict=False))
    # A sensor has the colour of its first link.
    colours = {link.sensor: colour for colour, link in reversed(links)}
    spare = iter(COLOURS[len(links) :])
    sensors = [
        (colours.get(sensor.sensor) or next(spare, INK), sensor)
        for sensor in told.sensors
        if sensor.sensor in colours or not told.links
    ][: len(COLOURS)]
    name = printable(told.scene or Path(told.file).name)
    title = f"{name}: asked and delivered, by {told.entries:,} entries of the ledger"
    with figure_of(INCHES, title) as figure:
        (delays, bursts, detection), (lateness, errors, legend) = figure.subplots(2, 3)
        _delay_curves(delays, links, told.curve)
        _burst_lengths(bursts, links)
        _detection_by_range(detection, sensors)
        _lateness(lateness, links, told.curve)
        _error_spreads(errors, sensors, told.normalised_edges)
        _legend(legend, links, sensors, left_out=len(told.links) - len(links))
        save_picture(figure, path)


def _delay_curves(axes: Any, links: Links, curve: Sequence[float]) -> None:
    left = [(colour, link) for colour, link in links if link.sent]
    for colour, link in left:
        if link.asked is not None:
            axes.plot(link.asked.curve_ms, curve, color=colour, **ASKED)
        axes.plot(link.delivered.curve_ms, curve, color=colour, lw=1.1)
    medians = [link.delivered.p50_ms for _, link in left]
    if medians and min(medians) > 0 and max(medians) > MOST_SPREAD * min(medians):
        axes.set_xscale("log")
    # The last hundredth may be far away.
    ends_ms = [max(k.asked.max_ms if k.asked else 0.0, k.delivered.p99_ms) for _, k in left]
    if max(ends_ms, default=0) > 0:
        axes.set_xlim(right=1.05 * max(ends_ms))
    x, y = "ms from being handed over to sending", "share of messages"
    finish(axes, "Delay", x, y, drawn=medians, nothing="nothing left")


def _lateness(axes: Any, links: Links, curve: Sequence[float]) -> None:
    """The share that left later still, so that the tail can be seen."""
    later = 1 - np.array(curve)
    late = [k for k in links if k[1].sent and k[1].lateness.curve_ms[-1] >= LEAST_LATE_MS]
    for colour, link in late:
        later_still = np.where(later > 0, later, 1 / max(link.sent, 1000))
        late_ms = np.maximum(link.lateness.curve_ms, LEAST_LATE_MS)
        axes.plot(late_ms, later_still, color=colour, lw=1.1)
    if late:
        axes.set_xscale("log")
        axes.set_yscale("log")
    nothing = "all left when they were due"
    x, y = "ms after the link let them leave", "share later still"
    finish(axes, "Lateness of the engine", x, y, drawn=late, nothing=nothing)


def _burst_lengths(axes: Any, links: Links) -> None:
    some = [(colour, link.bursts) for colour, link in links if link.bursts.bursts]
    for colour, bursts in some:
        asked, found = (
            np.array(survival)[:BURSTS_DRAWN]
            for survival in (bursts.asked_survival, bursts.delivered_survival)
        )
        lengths = np.arange(1, len(asked) + 1)
        shown, there = asked > 0.2 / bursts.bursts, found > 0
        axes.plot(lengths[shown], asked[shown], color=colour, **ASKED)
        intervals = [share_interval(round(s * bursts.bursts), bursts.bursts) for s in found[there]]
        _bars(axes, lengths[there], found[there], np.array(intervals).T, colour)
    if some:
        axes.set_yscale("log")
        axes.xaxis.get_major_locator().set_params(integer=True)
    title, rows, shares = "Bursts of losses", "messages lost in a row", "share as long or longer"
    finish(axes, title, rows, shares, drawn=some, nothing="no bursts of losses")


def _bars(axes: Any, x: Any, y: Any, interval: Any, colour: str) -> None:
    low, high = interval
    spans = np.maximum([y - low, high - y], 0)
    axes.errorbar(x, y, yerr=spans, color=colour, fmt="o", ms=3.5, lw=1.1, capsize=2)


def _detection_by_range(axes: Any, sensors: Sensors) -> None:
    drawn = False
    for colour, sensor in sensors:
        bins = [at for at in sensor.looks_by_range if at.looks >= FEWEST_LOOKS]
        if not bins:
            continue
        drawn = True
        x_km = np.array([(at.from_m + at.to_m) / 2000 for at in bins])
        axes.plot(x_km, [at.expected for at in bins], color=colour, **ASKED)
        delivered, *interval = np.array([(at.found, at.low, at.high) for at in bins]).T
        _bars(axes, x_km, delivered, interval, colour)
    if drawn:
        axes.set_ylim(-0.03, 1.03)
        axes.set_xlim(left=0)
    x, y = "true range, km", "probability of detection, share detected"
    finish(axes, "Detection", x, y, drawn=drawn, nothing="nobody was looked at")


def _error_spreads(axes: Any, sensors: Sensors, edges: Sequence[float]) -> None:
    from matplotlib.lines import Line2D

    x = np.linspace(edges[0], edges[-1], 300)
    axes.fill_between(x, np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi), color=QUIET, alpha=0.35, lw=0)
    step, used = edges[2] - edges[0], []
    for colour, sensor in sensors:
        for name, histogram in sensor.histograms.items():
            counts = np.array(histogram).reshape(-1, 2).sum(axis=1)
            density = counts / (counts.sum() * step)
            axes.stairs(density, edges[::2], color=colour, ls=LINES[name], lw=1.1)
            used.append(name)
    handles = [
        Line2D([], [], color=INK, ls=LINES[name], label=name) for name in dict.fromkeys(used)
    ]
    if handles:
        asked = Line2D([], [], color=QUIET, lw=6, alpha=0.35, label="asked: N(0, 1)")
        axes.legend(handles=[asked, *handles], frameon=False, fontsize=8.5, loc="upper right")
    axes.set_xlim(-5, 5)
    scale, nothing = "error over its standard deviation", "no plots whose error is known"
    finish(axes, "Errors of plots", scale, "density", drawn=used, nothing=nothing)


def _legend(axes: Any, links: Links, sensors: Sensors, *, left_out: int) -> None:
    """The legend: which colour is whose, and what it asked."""
    from matplotlib.lines import Line2D

    axes.axis("off")
    handles = [
        Line2D([], [], color=INK, label="asked", **ASKED),
        Line2D([], [], color=INK, lw=1.1, marker="o", ms=3.5, label="delivered, bars: 95 %"),
    ]
    for colour, link in links:
        fit, how = link.fit, ""
        if fit.not_comparable or not isfinite(fit.p_value):
            how = f"delay not compared: {fit.not_comparable or 'too few'}"
        else:  # whether the delays can be those that were asked for
            how = f"delay: KS {fit.distance:.4f}, p {fit.p_value:.2g}"
        text = f"{link.sensor}, link {link.number}: {link_text(link.link)}; {how}"
        several = wrap(printable(text), LEGEND_LETTERS, break_on_hyphens=False)
        if len(several) > LEGEND_LINES:
            several = [*several[: LEGEND_LINES - 1], f"... {several[-1]}"]
        label = "\n".join(several).replace("$", r"\$")
        handles.append(Line2D([], [], color=colour, lw=3, label=label))
    if not links:
        handles += [
            Line2D([], [], color=colour, lw=3, label=printable(sensor.sensor))
            for colour, sensor in sensors
        ]
    if left_out:
        handles.append(Line2D([], [], lw=0, label=f"and {left_out} more, not drawn"))
    axes.legend(handles=handles, loc="upper left", frameon=False, fontsize=9, labelspacing=0.9)


def print_report(path: Path, *, as_json: bool, chart: Path | None, force: bool = False) -> int:
    """Print what the ledger in a file says, and draw it if there is a place to; the exit code.

    That is 2 if the file is damaged: what is whole of it counts. Raises `PlotfeedError` and
    `OSError`.
    """
    if chart is not None:
        refuse_if_there(chart, force=force)  # before anything is read in vain
        check_picture(chart)
    told = FeedReport(path, "asked")
    if chart is not None:
        draw_report(told, chart)
    if as_json:
        say(json.dumps(told.as_values()))
    else:
        for line in lines(told):
            say(line)
    say_damage(path, told.damage, all_in="; --json has all")
    return 2 if told.damage else 0
