"""`plotfeed report`: a recorded ledger as aligned tables or as JSON, and its chart beside them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from plotfeed.feeds.console.extras import check_picture
from plotfeed.feeds.console.printed import Row, printable, say, say_damage
from plotfeed.feeds.console.process import refuse_if_there
from plotfeed.feeds.report.error_tally import ErrorFigures
from plotfeed.feeds.report.figures import LedgerReport, SensorFigures, as_values, report
from plotfeed.feeds.report.ledger_reading import read
from plotfeed.feeds.report.link_figures import LatencyFigures, LinkFigures, Share, link_text
from plotfeed.feeds.report.plot_tally import PdFigures
from plotfeed.feeds.report.report_pictures import draw
from plotfeed.feeds.report.text_tables import NOTHING, number, percent, seconds, table
from plotfeed.feeds.report.verdicts import Verdicts
from plotfeed.proto.utc import NS, iso_utc

BURSTS_SHOWN = 10
PAIR = ("asked", "delivered", "z")


def lines(told: LedgerReport) -> Iterator[str]:
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
        yield from _settings(told)
        yield from _delays(told)
        yield from _losses(told)
        yield from _bursts(told)
        yield from _copies(told)
        yield from _other_fates(told)
    yield from _detection(told)
    yield from _errors(told)
    yield from _false_alarms(told)
    yield ""
    yield "z: standard deviations from what was asked; -: none, too few, or not judged"
    for sensor in told.sensors:
        if sensor.unjudged:
            yield f"{printable(sensor.sensor)}: not judged: {sensor.unjudged}"
    yield from _verdicts(told.verdicts)


def _settings(told: LedgerReport) -> Iterator[str]:
    rows = [
        (
            printable(link.sensor),
            str(link.number),
            seconds(link.first_utc_ns - told.first_utc_ns),
            seconds(link.last_utc_ns - told.first_utc_ns),
            str(link.messages),
            printable(link_text(link.link)),
        )
        for link in told.links
    ]
    header = ("sensor", "link", "from s", "to s", "messages", "keys in force")
    yield from table("Links, and when messages under them were handed over", header, rows, "<>>>><")
    for link in told.links:
        if link.link_problem:
            named = f"link {link.number} of {printable(link.sensor)}"
            yield f"  {named} is not one that is known: {printable(link.link_problem)}"


def _delays(told: LedgerReport) -> Iterator[str]:
    rows = [row for link in told.links for row in _delay_rows(link)]
    header = ("sensor", "link", "", "messages", "mean", "p50", "p90", "p99", "max", "KS", "p", "")
    title = "Delay from being handed over to sending, ms"
    yield from table(title, header, rows, "<><>>>>>>>><", {9: "distance from the law"})


def _delay_rows(link: LinkFigures) -> Iterator[Row]:
    name, fit, sent = printable(link.sensor), link.fit, str(link.sent)
    why = f"not compared: {fit.not_comparable}" if fit.not_comparable else ""
    yield name, str(link.number), "asked", "", *_times(link.asked), "", "", why
    fits = number(fit.distance, ".4f"), number(fit.p_value, ".2g")
    yield "", "", "delivered", sent, *_times(link.delivered), *fits, ""
    fits = number(fit.link_distance, ".4f"), number(fit.link_p_value, ".2g")
    by_link = "of the link alone" if fits[0] != NOTHING else ""
    yield "", "", "engine late", "", *_times(link.lateness), *fits, by_link


def _times(times: LatencyFigures | None) -> Iterator[str]:
    if times is None:
        return iter([NOTHING] * 5)
    told = (times.mean_ms, times.p50_ms, times.p90_ms, times.p99_ms, times.max_ms)
    return (number(value, ".3f") for value in told)


def _losses(told: LedgerReport) -> Iterator[str]:
    rows = []
    for link in told.links:
        loss, bursts = link.loss, link.bursts
        rows.append(
            (
                printable(link.sensor),
                str(link.number),
                str(loss.of),
                str(loss.count),
                *_share(loss),
                str(bursts.bursts),
                number(bursts.asked_mean, ".3f"),
                number(bursts.delivered_mean, ".3f"),
                number(bursts.z, "+.1f"),
            )
        )
    header = ("sensor", "link", "messages", "lost", *PAIR, "bursts", *PAIR)
    groups = {4: "share lost, %", 8: "mean burst"}
    yield from table("Loss, and messages lost in a row", header, rows, "<" + ">" * 10, groups)


def _bursts(told: LedgerReport) -> Iterator[str]:
    rows = []
    for link in told.links:
        bursts = link.bursts
        if not bursts.bursts:
            continue
        for what, survival in (
            ("asked", bursts.asked_survival),
            ("delivered", bursts.delivered_survival),
        ):
            shares = [percent(share) for share in survival[:BURSTS_SHOWN]]
            shares += [NOTHING] * (BURSTS_SHOWN - len(shares))
            named = (printable(link.sensor), str(link.number)) if what == "asked" else ("", "")
            rows.append((*named, what, *shares))
    if rows:
        header = ("sensor", "link", "", *map(str, range(1, BURSTS_SHOWN + 1)))
        yield from table(
            "Bursts of so many losses or more, %", header, rows, "<><" + ">" * BURSTS_SHOWN
        )


def _copies(told: LedgerReport) -> Iterator[str]:
    rows = [
        (
            printable(link.sensor),
            str(link.number),
            *_share(link.duplicates),
            *_share(link.corrupted),
            *_share(link.overtook)[:2],
        )
        for link in told.links
    ]
    header = ("sensor", "link", *PAIR, *PAIR, *PAIR[:2])
    title = "Duplicates, flipped bits, and messages that left before one handed over earlier"
    groups = {2: "doubled, %", 5: "corrupted, %", 8: "overtook, %"}
    yield from table(title, header, rows, "<" + ">" * 9, groups)


def _other_fates(told: LedgerReport) -> Iterator[str]:
    some = [link for link in told.links if any(link.other_fates.values())]
    if not some:
        return
    header = ("sensor", "link", *(name.replace("_", " ") for name in some[0].other_fates))
    rows = [
        (printable(link.sensor), str(link.number), *map(str, link.other_fates.values()))
        for link in some
    ]
    yield from table("Messages that did not leave otherwise", header, rows, "<" + ">" * 7)


def _detection(told: LedgerReport) -> Iterator[str]:
    rows = [row for sensor in told.sensors for row in _pd_rows(sensor)]
    if rows:
        header = ("sensor", "range km", "looks", "asked", "delivered", "95 % of it", "z")
        yield from table("Detection", header, rows, "<>>>>>>", {3: "probability"})


def _pd_rows(sensor: SensorFigures) -> Iterator[Row]:
    if sensor.looks is None:
        return
    yield printable(sensor.sensor), "all", *_pd(sensor.looks)
    if len(sensor.looks_by_range) > 1:
        for at in sensor.looks_by_range:
            yield "", f"{at.from_m / 1000:.2f}-{at.to_m / 1000:.2f}", *_pd(at)


def _pd(at: PdFigures) -> Row:
    return (
        str(at.looks),
        number(at.asked, ".3f"),
        number(at.delivered, ".3f"),
        f"{number(at.low, '.3f')}-{number(at.high, '.3f')}",
        number(at.z, "+.1f"),
    )


def _errors(told: LedgerReport) -> Iterator[str]:
    rows = [row for sensor in told.sensors for row in _error_rows(sensor)]
    if rows:
        measured = ("sensor", "", "unit", "plots", "mean", "rms", "sigma")
        header = (*measured, "mean", "z", "rms", "z", "within 2")
        groups = {4: "error", 6: "stated", 7: "over sigma: asked 0, 1 and 95.45 %"}
        yield from table("Errors of plots", header, rows, "<<<" + ">" * 9, groups)
    for sensor in told.sensors:
        if sensor.plots:
            where = (
                f"{sensor.joined} found in {sensor.plots_from}"
                if sensor.plots_from
                else ("none was recorded in a format that is read here")
            )
            found = f"of {sensor.plots} plots of drones {where}{_rest(sensor)}"
            yield f"  {printable(sensor.sensor)}: {found}"


def _rest(sensor: SensorFigures) -> str:
    """Plots that are in no row, and why: none is dropped without a word."""
    counts = {
        "in sectors whose plots are not those of the ledger": sensor.contradicted,
        "not compared, since noise decides whether they are there": sensor.not_compared,
        "at another time than asked": sensor.times_off,
    }
    return "".join(f"; {count} {what}" for what, count in counts.items() if count)


def _error_rows(sensor: SensorFigures) -> Iterator[Row]:
    name = printable(sensor.sensor)
    for error in sensor.errors:
        yield name, *_error(error)
        name = ""


def _error(error: ErrorFigures) -> Row:
    return (
        error.quantity,
        error.unit,
        str(error.plots),
        number(error.mean, ".4g"),
        number(error.rms, ".4g"),
        number(error.stated_rms, ".4g"),
        number(error.normalised_mean, "+.3f"),
        number(error.z_mean, "+.1f"),
        number(error.normalised_rms, ".3f"),
        number(error.z_rms, "+.1f"),
        percent(error.within_2),
    )


def _false_alarms(told: LedgerReport) -> Iterator[str]:
    rows = []
    for sensor in told.sensors:
        alarms = sensor.false_alarms
        if not alarms.count and not alarms.asked > 0:
            continue
        rows.append(
            (
                printable(sensor.sensor),
                number(alarms.scans, ".1f"),
                number(alarms.asked, ".1f"),
                str(alarms.count),
                number(alarms.asked_per_scan, ".4g"),
                number(alarms.delivered_per_scan, ".4g"),
                number(alarms.z, "+.1f"),
            )
        )
    if rows:
        header = ("sensor", "scans", *PAIR[:2], *PAIR)
        groups = {2: "in all", 4: "a scan"}
        yield from table("False alarms", header, rows, "<>>>>>>", groups)
    for sensor in told.sensors:
        if sensor.plots_of_others:
            counts = (f"{n} of {printable(what)}" for what, n in sensor.plots_of_others.items())
            told_of = f"  {printable(sensor.sensor)}: plots of no drone and no false alarms: "
            yield told_of + ", ".join(counts)


def _verdicts(found: Verdicts) -> Iterator[str]:
    """What is wrong, last: nobody has to look for it."""
    rows = [
        (
            printable(wrong.sensor),
            str(wrong.link) if wrong.link else "",
            wrong.quantity,
            number(wrong.p, ".2g") if wrong.p else "never",
            wrong.what,
        )
        for wrong in found.wrong
    ]
    if rows:
        header = ("sensor", "link", "what", "by chance", "")
        yield from table("NOT as it was asked", header, rows, "<><>")
    yield ""
    how = "all as it was asked" if not rows else f"{len(rows)} not as they were asked"
    yield (
        f"{found.judged} figures judged: {how}. "
        f"Where all is right, one report in {1 / found.false_rate:.0f} says otherwise."
    )


def _share(share: Share) -> Row:
    return percent(share.asked), percent(share.delivered), number(share.z, "+.1f")


DAMAGED = 2


def print_report(path: Path, *, as_json: bool, chart: Path | None, force: bool = False) -> int:
    """Print what the ledger in a file says, and draw it if there is a place to; the exit code.

    That is 2 if the file is damaged: what is whole of it counts. Raises `PlotfeedError` and
    `OSError`.
    """
    if chart is not None:
        refuse_if_there(chart, force=force)  # before anything is read in vain
        check_picture(chart)
    told = report(path, read(path))
    if chart is not None:
        draw(told, chart)
    if as_json:
        say(json.dumps(as_values(told)))
    else:
        for line in lines(told):
            say(line)
    say_damage(path, told.damage, all_in="; --json has all")
    return DAMAGED if told.damage else 0
