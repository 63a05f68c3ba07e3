"""The page and the picture of a soak: docs/soak.md, docs/soak.png."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from soak_figures import (
    NS,
    WARM_S,
    Array,
    Run,
    fault_rows,
    late_ms,
    memory,
    outside_faults,
    read,
)

LATE_EVERY_S = 10.0


def page(run: Run) -> str:
    """In Markdown."""
    s, said, totals, ledger = run.samples, run.said, run.totals, run.ledger
    minutes, quiet = s["t_s"][-1] / 60, run.is_quiet(s["t_s"])
    slope, error = memory(run)
    settled = s["rss_mb"][s["t_s"] >= min(WARM_S, s["t_s"][-1] / 3)]
    first, last = late_ms(run, 0, 1 / 3), late_ms(run, 2 / 3, 1)
    span_s = s["t_s"][-1] - s["t_s"][0]
    ours = (s["cpu_s"][-1] - s["cpu_s"][0]) / span_s
    others = (s["machine_cpu_s"][-1] - s["machine_cpu_s"][0]) / span_s - ours
    told = int(ledger.first.sum())
    began = datetime.fromtimestamp(said["began"]["utc_ns"] // NS, UTC)
    rows = [
        ("memory (RSS) settled, MB", f"{settled.min():.1f} to {settled.max():.1f}"),
        ("memory, slope after warm-up, MB an hour", f"{slope:+.2f} ± {error:.2f} (standard error)"),
        ("lateness p50, first and last third, ms", f"{first[0]:.2f}, {last[0]:.2f}"),
        ("lateness p99, first and last third, ms", f"{first[1]:.1f}, {last[1]:.1f}"),
        ("processor, cores", f"{ours:.2f}"),
        ("file descriptors, broker there", _range(s["descriptors"][quiet])),
        ("threads", _range(s["threads"])),
        ("telemetry that waited to be taken in, most seen", f"{s['plotfeed_inbox'].max():.0f}"),
        ("messages on links, most seen", f"{s['plotfeed_sensor_on_the_way'].max():.0f}"),
        (
            "messages that waited for the broker, all sensors, most seen",
            f"{s['plotfeed_sensor_waiting'].max():.0f}",
        ),
        ("scans missed", f"{totals['missed_scans']}"),
        ("messages that sensors handed over", f"{ledger.handed_over:,}"),
        ("of these, told of in the ledger", f"{told:,}"),
        ("sent; lost by links, as asked", f"{totals['messages']:,}; {totals['lost']:,}"),
        ("undelivered; with the broker there", f"{totals['undelivered']:,}; {outside_faults(run)}"),
        (
            "telemetry published, taken, refused",
            f"{said['published']:,}, {totals['telemetry']:,}, {totals['refused']:,}",
        ),
        ("commands published, done", f"{said['commands']}, {totals['controls']}"),
        ("recording, MB", f"{run.record_mb:.0f}"),
        ("end after SIGTERM, s; exit code", f"{said['exit_s']:.2f}; {said['exit_code']}"),
    ]
    lines = [
        "# A long session",
        "",
        f"A session of {minutes:.0f} minutes under everything at once, by `tests/soak.py`: the four "
        "sensors of section 4 and three",
        "rotating radars of 16 sectors, each over an impaired link of its own (between them every "
        "kind of loss, delay",
        "and order); telemetry of ten drones at 5 Hz, one message in a hundred of it garbage; a "
        "command every 17 s;",
        f"{said['broker']} as the broker, in turns killed, stopped and paused; all of it recorded, "
        "and metrics served.",
        f'QoS 1, `queue = {{ policy = "drop-oldest", messages = {said["queue_messages"]} }}`.',
        "",
        "![Memory, processor, lateness and queues over the run](soak.png)",
        "",
        *_table(("", ""), rows),
        "",
        f"Begun {began:%Y-%m-%d %H:%M} UTC on a machine of two cores that did much else: others "
        f"took {others:.2f} cores on average,",
        f"and the load average was {np.median(s['load']):.1f} ({_range(s['load'], '.1f')}). "
        "Lateness is of messages that left while the broker",
        "was there; it includes the waits that the load, and the acknowledgements of QoS 1, brought "
        "about.",
        f"The slope of memory leaves out the first {WARM_S / 60:.0f} minutes, in which what is kept "
        "up to a bound (the lateness of the last",
        "100,000 messages, for one) grows to it. What still grows is the index of the recording, "
        "which is",
        "written when it ends.",
        "",
        "## The broker away",
        "",
        "Each sensor keeps its newest messages while nobody takes them. `killed` is SIGKILL, "
        "`stopped` SIGTERM,",
        "`paused` SIGSTOP. Due are the messages that links let go from the fault until the first "
        "that had waited was sent.",
        "",
        *_table(
            (
                "broker",
                "away, s",
                "due meanwhile",
                "sent afterwards",
                "given up",
                "of the newest, given up",
            ),
            [
                (what, f"{away:.1f}", f"{due:,}", f"{sent:,}", f"{lost:,}", f"{newest}")
                for what, away, due, sent, lost, newest in fault_rows(run)
            ],
        ),
        "",
    ]
    return "\n".join(lines)


def _range(values: Array, form: str = ".0f") -> str:
    low, high = format(values.min(), form), format(values.max(), form)
    return low if low == high else f"{low} to {high}"


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    lines = ["| " + " | ".join(row) + " |" for row in (head, *rows)]
    return [lines[0], "|---" + "|--:" * (len(head) - 1) + "|", *lines[1:]]


def draw(run: Run, to: Path) -> None:
    """Four pictures over one axis of time."""
    import matplotlib as mpl  # noqa: PLC0415 - an extra

    mpl.use("agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415

    s, minutes = run.samples, run.samples["t_s"] / 60
    figure, axes = plt.subplots(4, 1, figsize=(11, 11), dpi=100, sharex=True, layout="constrained")
    memory_axes, late_axes, queue_axes, cpu_axes = axes
    memory_axes.plot(minutes, s["rss_mb"], color="#0a7d6c")
    memory_axes.set_ylim(0, s["rss_mb"].max() * 1.15)
    memory_axes.set_title("Memory of the session (RSS), MB")
    _draw_lateness(late_axes, run)
    for name, label, colour in (
        ("plotfeed_sensor_waiting", "wait for the broker", "#c8651b"),
        ("plotfeed_sensor_on_the_way", "on links", "#3b5bb5"),
        ("plotfeed_inbox", "telemetry to be taken in", "#a3276f"),
    ):
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
    cpu_axes.set_xlabel("minutes; shaded, the broker was away")
    for each in axes:
        _dress(each, run)
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


def _dress(axes: Any, run: Run) -> None:
    for _, from_s, to_s in run.faults_s:
        axes.axvspan(from_s / 60, to_s / 60, color="#dde3e6", zorder=0)
    axes.grid(color="#dde3e6")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, ncols=3, loc="upper right")


def write_page(folder: Path, docs: Path) -> None:
    """Page and picture."""
    run = read(folder)
    (docs / "soak.md").write_text(page(run))
    draw(run, docs / "soak.png")
