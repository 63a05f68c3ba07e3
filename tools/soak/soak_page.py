"""The page and the pictures of soaks: docs/soak.md, each run between its marks."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "docs" / "commands"))

from pages import between, table
from soak_figures import (
    NS,
    Array,
    Ledger,
    Run,
    fault_rows,
    filled,
    late_ms,
    outside_faults,
    rate,
    read,
    slope_mb_h,
    spanned,
)

from plotfeed.feeds.link.counters import LATENESS_KEPT

LATE_EVERY_S = 10.0
C_HZ = 100
LATE = {quantile: f"plotfeed_lateness_seconds{quantile}" for quantile in ("0.5", "0.99", "0.999")}
COLOURS = {"p50": "#0a7d6c", "p99": "#c8651b"}


def page(run: Run, picture: str) -> str:
    """In Markdown, with that picture."""
    said = run.said
    fate = ", in turns killed, stopped and paused" if said["faults"] else ""
    words = {
        "minutes": f"{run.samples['t_s'][-1] / 60:.0f}",
        "broker": f"{said['broker']} as the broker{fate}",
        **{name: said.get(name) for name in ("sensors", "drones", "telemetry_hz")},
    }
    parts = [
        filled(RADARS if run.ledger is None else EVERYTHING, **words),
        f"![Memory, lateness, queues and processor over the run]({picture})",
        "\n".join(table(("", ">"), list(_rows(run)))),
        filled(MACHINE + (OF_SAMPLES if run.ledger is None else OF_LEDGER), **_of_machine(run)),
    ]
    if said["faults"] and run.ledger is not None:
        faults = [_fault(*row) for row in fault_rows(run, run.ledger)]
        away = filled(AWAY, kept=said["queue_messages"])
        parts += ["### The broker away", away, "\n".join(table(FAULTS, faults))]
    return "\n\n".join(parts)


EVERYTHING = """
A session of {minutes} minutes under everything at once, written by `tools/soak/soak.py`: the four
sensors of section 4 and three rotating radars of 16 sectors, each over an impaired link of its
own (between them every kind of delay, loss and order); telemetry of ten drones at 5 Hz, one
message in a hundred of it garbage; a command every 17 s, some of them wrong; {broker};
QoS 1; everything recorded, metrics served.
"""
RADARS = """
{sensors} rotating radars of 32 sectors, once a second and all in step, that report in categories
048 and 034; telemetry of {drones} drones at {telemetry_hz:g} Hz in JSON over MQTT; {broker}, and a
subscriber to all that radars send on the same two cores, for {minutes} minutes, with the ledger and
metrics, by `tools/soak/soak.py --radars {sensors}`.
"""
MACHINE = """
Begun {began} UTC, on a machine of two cores, of which others, broker and subscriber too, took
{others} on average; the load average was {load} ({loads}). {nice}The slope of memory is by least
squares, of means of a minute, from minute {warm} on, when the lateness of the last {kept:,}
messages, which is kept, had filled its place.
"""
OF_LEDGER = """
Lateness is a message's sending less when its link was to let it leave, while the broker was there;
waits for the processor and for acknowledgements are in it.
"""
OF_SAMPLES = """
Lateness is a message's sending after it was due: of each sample of those that are kept, some
seconds; beside it, clock_nanosleep in C, with a timer slack of 1 ns, at a hundred deadlines a
second in the same minutes, which tells what the machine itself could do.
"""
NICE = """The run had precedence over them (nice {nice}), but for some that ran in real time. """
AWAY = """
Each sensor keeps its {kept} newest messages while nobody takes them (`policy = "drop-oldest"`).
`killed` is SIGKILL, `stopped` SIGTERM, `paused` SIGSTOP. Due meanwhile are the messages that
links let go from then until the first that had waited was sent.
"""
FAULTS = (
    *("broker", ">away, s", ">due meanwhile", ">sent afterwards"),
    *(">given up", ">of the newest"),
)


def _rows(run: Run) -> Iterator[tuple[str, str]]:
    s, said, totals, ledger = run.samples, run.said, run.totals, run.ledger
    slope, error = slope_mb_h(s, run.warm_s)
    settled = s["t_s"] >= run.warm_s
    yield "memory (RSS), last part, MB", spanned(s["rss_mb"][settled], ".1f")
    yield "of these its own (RssAnon), MB", spanned(s["own_mb"][settled], ".1f")
    yield "slope of its own, MB an hour", f"{slope:+.1f} ± {error:.1f} (standard error)"
    yield from _lateness(run) if ledger is None else _of_ledger(run, ledger)
    yield "processor, cores", f"{rate(s, 'cpu_s'):.2f}"
    there = settled & run.is_quiet(s["t_s"])
    yield "file descriptors, broker there", spanned(s["descriptors"][there])
    yield "threads", spanned(s["threads"][settled])
    for name, (what, _, _) in WAITING.items():
        yield f"{what}, most seen at once", f"{np.nanmax(s[name]):,.0f}"
    yield "scans missed", f"{totals['missed_scans']:,} of {_scans(run):,.0f}"
    yield "sent, duplicates included", f"{totals['messages']:,}"
    if said["arrived"] is not None:
        yield "of these arrived at the subscriber", f"{said['arrived']:,}"
    yield "lost by links, as asked", f"{totals['lost']:,}"
    yield "undelivered", f"{totals['undelivered']:,}"
    taken = (said["published"], totals["telemetry"], totals["refused"])
    yield "telemetry published; taken; it and commands refused", "; ".join(f"{n:,}" for n in taken)
    yield "commands published; done", f"{said['commands']}; {totals['controls']}"
    yield "from SIGTERM to the exit, s; exit code", f"{said['exit_s']:.2f}; {said['exit_code']}"


def _of_ledger(run: Run, ledger: Ledger) -> Iterator[tuple[str, str]]:
    """What a recording tells besides."""
    hours = run.samples["t_s"][-1] / 3600
    first, last = (late_ms(run, ledger, *part) for part in ((0, 1 / 3), (2 / 3, 1)))
    index = "the recording's index, in a file until the end, MB an hour"
    yield index, f"{run.index_mb / hours:.1f}"
    yield "recording, MB", f"{run.record_mb:.0f}"
    yield "lateness p50, first and last third, ms", f"{first[0]:.2f}, {last[0]:.2f}"
    yield "lateness p99, first and last third, ms", f"{first[1]:.1f}, {last[1]:.1f}"
    yield "messages that sensors handed over", f"{ledger.handed_over:,}"
    yield "of these, told of in the ledger", f"{int(ledger.first.sum()):,}"
    yield "undelivered with the broker there", f"{outside_faults(run, ledger)}"


def _lateness(run: Run) -> Iterator[tuple[str, str]]:
    """What the session's metrics told of it, and what C has beside it."""
    for quantile, name in (("0.5", "p50"), ("0.99", "p99"), ("0.999", "p99.9")):
        ms = run.samples[LATE[quantile]][1:] * 1e3
        most = f"{np.nanmedian(ms):.2f}, {np.nanmax(ms):.2f}"
        yield f"lateness {name}, median and most of the samples, ms", most
    if run.nanosleep_us is not None:
        found = np.percentile(run.nanosleep_us, (50, 99, 99.9)) / 1e3
        yield "clock_nanosleep in C, p50, p99, p99.9, ms", ", ".join(f"{x:.2f}" for x in found)
        worst = np.median([np.percentile(w, 99) for w in _windows(run.nanosleep_us)]) / 1e3
        yield f"median of its p99 of {LATE_EVERY_S:g} s each, ms", f"{worst:.2f}"


def _windows(late_us: Array) -> list[Array]:
    """By `LATE_EVERY_S`."""
    return np.array_split(late_us, max(1, round(len(late_us) / C_HZ / LATE_EVERY_S)))


# Of queues: what waits there, and how the picture calls and draws it.
WAITING = {
    "plotfeed_inbox": ("telemetry to be taken in", "telemetry, to be taken in", "#a3276f"),
    "plotfeed_sensor_on_the_way": ("messages on links", "on links", "#3b5bb5"),
    "plotfeed_sensor_waiting": (
        "messages that wait for the broker, all sensors",
        "for the broker",
        "#c8651b",
    ),
}


def _of_machine(run: Run) -> dict[str, Any]:
    s, said = run.samples, run.said
    ours = rate(s, "cpu_s")
    return {
        "began": f"{datetime.fromtimestamp(said['began']['utc_ns'] // NS, UTC):%Y-%m-%d %H:%M}",
        "others": f"{rate(s, 'machine_cpu_s') - ours:.2f}",
        "load": f"{np.median(s['load']):.1f}",
        "loads": spanned(s["load"], ".1f"),
        "nice": NICE.format(nice=said["nice"]) if said.get("nice") else "",
        "warm": f"{run.warm_s / 60:.0f}",
        "kept": LATENESS_KEPT,
    }


def _scans(run: Run) -> float:
    """Of all sensors, each of which has one a second."""
    return float(run.samples["t_s"][-1] * np.nanmax(run.samples["plotfeed_sensor_enabled"]))


def _fault(what: str, away_s: float, *counts: int) -> tuple[str, ...]:
    return what, f"{away_s:.1f}", *(f"{count:,}" for count in counts)


def draw(run: Run, to: Path) -> None:
    """Four pictures over one axis of time."""
    import matplotlib as mpl

    mpl.use("agg")
    from matplotlib import pyplot as plt

    s, minutes = run.samples, run.samples["t_s"] / 60
    figure, axes = plt.subplots(4, 1, figsize=(11, 11), dpi=100, sharex=True, layout="constrained")
    memory_axes, late_axes, queue_axes, cpu_axes = axes
    memory_axes.plot(minutes, s["rss_mb"], color="#3b5bb5", label="resident (RSS)")
    memory_axes.plot(minutes, s["own_mb"], color="#0a7d6c", label="its own (RssAnon)")
    memory_axes.set_ylim(0, s["rss_mb"].max() * 1.3)
    memory_axes.set_title("Memory of the session, MB")
    for at_s, values, label, colour in _late_lines(run):
        late_axes.plot(at_s / 60, np.maximum(values, 1e-3), label=label, color=colour)
    late_axes.set_yscale("log")
    late_axes.set_title("Lateness after the link's own delay, ms")
    for name, (_, label, colour) in WAITING.items():
        queue_axes.plot(minutes, s[name], label=label, color=colour)
    queue_axes.set_yscale("symlog", linthresh=10)
    queue_axes.set_title("Messages that wait, all sensors")
    step_s = np.diff(s["t_s"])
    ours = np.diff(s["cpu_s"]) / step_s
    cpu_axes.plot(minutes[1:], ours, label="the session", color="#0a7d6c")
    others = np.diff(s["machine_cpu_s"]) / step_s - ours
    cpu_axes.plot(minutes[1:], others, label="everybody else", color="#9aa5ab")
    cpu_axes.set_title("Processor, cores of two")
    cpu_axes.set_ylim(0, 2.1)
    cpu_axes.set_xlabel("minutes; shaded, the broker was away" if run.faults_s else "minutes")
    for each in axes:
        for _, from_s, to_s in run.faults_s:
            each.axvspan(from_s / 60, to_s / 60, color="#dde3e6", zorder=0)
        each.grid(color="#dde3e6")
        each.set_axisbelow(True)
        each.spines[["top", "right"]].set_visible(False)
        if each.get_legend_handles_labels()[0]:
            each.legend(frameon=False, ncols=3, loc="upper right")
    figure.savefig(to)
    plt.close(figure)


def _late_lines(run: Run) -> Iterator[tuple[Array, Array, str, str]]:
    """Seconds, milliseconds, name and colour of each line of lateness."""
    if run.ledger is None:
        for quantile, name in (("0.5", "p50"), ("0.99", "p99")):
            yield run.samples["t_s"], run.samples[LATE[quantile]] * 1e3, name, COLOURS[name]
        if run.nanosleep_us is not None:
            windows = _windows(run.nanosleep_us)
            p99_ms = np.array([np.percentile(window, 99) / 1e3 for window in windows])
            at_s = (np.arange(len(windows)) + 0.5) * LATE_EVERY_S
            yield at_s, p99_ms, "p99 of clock_nanosleep in C", "#9aa5ab"
        return
    left = ~np.isnan(run.ledger.late_ms)
    due_s, late = run.ledger.due_s[left], run.ledger.late_ms[left]
    window = (due_s // LATE_EVERY_S).astype(int)
    order = np.argsort(window, kind="stable")
    edges = np.flatnonzero(np.diff(window[order])) + 1
    groups, at_s = np.split(late[order], edges), window[order][np.r_[0, edges]] * LATE_EVERY_S
    for percentile, (name, colour) in zip((50, 99), COLOURS.items(), strict=True):
        yield at_s, np.array([np.percentile(group, percentile) for group in groups]), name, colour


def write_page(folder: Path, docs: Path) -> None:
    """The part of the page that is of that run, and its picture."""
    page_file, run = docs / "soak.md", read(folder)
    docs.mkdir(parents=True, exist_ok=True)
    if not page_file.exists():
        page_file.write_text(EMPTY)
    mark, picture = (
        ("radars", "soak-radars.png") if run.ledger is None else ("everything", "soak.png")
    )
    between(page_file, mark, page(run, picture))
    draw(run, docs / picture)


EMPTY = """# A long session

Written by `tools/soak/soak.py`.

## Everything at once

<!-- everything: begin --><!-- everything: end -->

## Many radars

<!-- radars: begin --><!-- radars: end -->
"""
