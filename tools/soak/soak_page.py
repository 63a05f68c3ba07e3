"""The page and the pictures of soaks: docs/soak.md, each run between its marks."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "docs" / "commands"))

from pages import between
from radars_page import draw_radars, radars_text, read_radars
from soak_figures import (
    NS,
    Run,
    draw_cores,
    draw_memory,
    dress,
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


def page(run: Run) -> str:
    """In Markdown."""
    faults = [_fault(*row) for row in fault_rows(run)]
    minutes = f"{run.samples['t_s'][-1] / 60:.0f}"
    fate = ", in turns killed, stopped and paused" if faults else ""
    parts = [
        filled(ABOUT, minutes=minutes, broker=f"{run.said['broker']} as the broker{fate}"),
        "![Memory, lateness, queues and processor over the run](soak.png)",
        _table(("", ""), list(_rows(run))),
        filled(MACHINE, **_of_machine(run)),
    ]
    if faults:
        away = filled(AWAY, kept=run.said["queue_messages"])
        parts += ["### The broker away", away, _table(FAULTS, faults)]
    return "\n\n".join(parts)


ABOUT = """
A session of {minutes} minutes under everything at once, written by `tools/soak/soak.py`: the four
sensors of section 4 and three rotating radars of 16 sectors, each over an impaired link of its
own (between them every kind of delay, loss and order); telemetry of ten drones at 5 Hz, one
message in a hundred of it garbage; a command every 17 s, some of them wrong; {broker};
QoS 1; everything recorded, metrics served.
"""
MACHINE = """
Begun {began} UTC, on a machine of two cores that did much else: others took {others} cores on
average, the load average was {load} ({loads}). {nice}Lateness is a message's sending less when
its link was to let it leave, while the broker was there; waits for the processor and for
acknowledgements are in it. The slope of memory is by least squares, of means of a minute, from
minute {warm} on, when the lateness of the last {kept:,} messages, which is kept, had filled its
place.
"""
NICE = """The run had precedence over them (nice {nice}), but for some that ran in real time. """
AWAY = """
Each sensor keeps its {kept} newest messages while nobody takes them (`policy = "drop-oldest"`).
`killed` is SIGKILL, `stopped` SIGTERM, `paused` SIGSTOP. Due meanwhile are the messages that
links let go from then until the first that had waited was sent.
"""
FAULTS = ("broker", "away, s", "due meanwhile", "sent afterwards", "given up", "of the newest")


def _rows(run: Run) -> Iterator[tuple[str, str]]:
    s, said, totals, ledger = run.samples, run.said, run.totals, run.ledger
    slope, error = slope_mb_h(s, run.warm_s)
    settled = s["t_s"] >= run.warm_s
    first, last = late_ms(run, 0, 1 / 3), late_ms(run, 2 / 3, 1)
    yield "memory (RSS), last part, MB", spanned(s["rss_mb"][settled], ".1f")
    yield "of these its own (RssAnon), MB", spanned(s["own_mb"][settled], ".1f")
    yield "slope of its own, MB an hour", f"{slope:+.1f} ± {error:.1f} (standard error)"
    yield (
        "the recording's index, in a file until the end, MB an hour",
        f"{run.index_mb / (s['t_s'][-1] / 3600):.1f}",
    )
    yield "lateness p50, first and last third, ms", f"{first[0]:.2f}, {last[0]:.2f}"
    yield "lateness p99, first and last third, ms", f"{first[1]:.1f}, {last[1]:.1f}"
    yield "processor, cores", f"{rate(s, 'cpu_s'):.2f}"
    yield (
        "file descriptors, broker there",
        spanned(s["descriptors"][settled & run.is_quiet(s["t_s"])]),
    )
    yield "threads", spanned(s["threads"][settled])
    for name, what in WAITING.items():
        yield f"{what}, most seen at once", f"{np.nanmax(s[name]):,.0f}"
    yield "scans missed", f"{totals['missed_scans']:,} of {_scans(run):,.0f}"
    yield "messages that sensors handed over", f"{ledger.handed_over:,}"
    yield "of these, told of in the ledger", f"{int(ledger.first.sum()):,}"
    yield "sent, duplicates included", f"{totals['messages']:,}"
    yield "lost by links, as asked", f"{totals['lost']:,}"
    yield "undelivered", f"{totals['undelivered']:,}"
    yield "of these, with the broker there", f"{outside_faults(run)}"
    taken = f"{said['published']:,}, {totals['telemetry']:,}, {totals['refused']:,}"
    yield "telemetry published; taken; it and commands refused", taken.replace(", ", "; ")
    yield "commands published; done", f"{said['commands']}; {totals['controls']}"
    yield "recording, MB", f"{run.record_mb:.0f}"
    yield "from SIGTERM to the exit, s; exit code", f"{said['exit_s']:.2f}; {said['exit_code']}"


WAITING = {
    "plotfeed_inbox": "telemetry to be taken in",
    "plotfeed_sensor_on_the_way": "messages on links",
    "plotfeed_sensor_waiting": "messages that wait for the broker, all sensors",
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


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = ["| " + " | ".join(row) + " |" for row in (head, *rows)]
    return "\n".join([lines[0], "|---" + "|--:" * (len(head) - 1) + "|", *lines[1:]])


def draw(run: Run, to: Path) -> None:
    """Four pictures over one axis of time."""
    import matplotlib as mpl

    mpl.use("agg")
    from matplotlib import pyplot as plt

    s, minutes = run.samples, run.samples["t_s"] / 60
    figure, axes = plt.subplots(4, 1, figsize=(11, 11), dpi=100, sharex=True, layout="constrained")
    memory_axes, late_axes, queue_axes, cpu_axes = axes
    draw_memory(memory_axes, s)
    _draw_lateness(late_axes, run)
    for name, label, colour in (
        ("plotfeed_sensor_waiting", "for the broker", "#c8651b"),
        ("plotfeed_sensor_on_the_way", "on links", "#3b5bb5"),
        ("plotfeed_inbox", "telemetry, to be taken in", "#a3276f"),
    ):
        queue_axes.plot(minutes, s[name], label=label, color=colour)
    queue_axes.set_yscale("symlog", linthresh=10)
    queue_axes.set_title("Messages that wait, all sensors")
    draw_cores(cpu_axes, s)
    cpu_axes.set_xlabel("minutes; shaded, the broker was away")
    for each in axes:
        for _, from_s, to_s in run.faults_s:
            each.axvspan(from_s / 60, to_s / 60, color="#dde3e6", zorder=0)
        dress(each)
    figure.savefig(to)
    plt.close(figure)


def _draw_lateness(axes: Any, run: Run) -> None:
    ledger = run.ledger
    left = ~np.isnan(ledger.late_ms)
    due_s, late = ledger.due_s[left], ledger.late_ms[left]
    window = (due_s // LATE_EVERY_S).astype(int)
    order = np.argsort(window, kind="stable")
    edges = np.flatnonzero(np.diff(window[order])) + 1
    groups = np.split(late[order], edges)
    at = window[order][np.r_[0, edges]] * LATE_EVERY_S / 60
    for percentile, colour in ((50, "#0a7d6c"), (99, "#c8651b")):
        values = [max(float(np.percentile(group, percentile)), 0.01) for group in groups]
        axes.plot(at, values, label=f"p{percentile}", color=colour)
    axes.set_yscale("log")
    axes.set_title(f"Lateness after the link's own delay, of {LATE_EVERY_S:g} s each, ms")


def write_page(folder: Path, docs: Path) -> None:
    """The part of the page that is of that run, and its picture."""
    page_file = docs / "soak.md"
    docs.mkdir(parents=True, exist_ok=True)
    if not page_file.exists():
        page_file.write_text(EMPTY)
    if (folder / "soak.mcap").exists():
        run = read(folder)
        between(page_file, "everything", page(run))
        draw(run, docs / "soak.png")
    else:
        radars = read_radars(folder)
        between(page_file, "radars", radars_text(radars))
        draw_radars(radars, docs / "soak-radars.png")


EMPTY = """# A long session

Written by `tools/soak/soak.py`.

## Everything at once

<!-- everything: begin --><!-- everything: end -->

## Many radars

<!-- radars: begin --><!-- radars: end -->
"""
