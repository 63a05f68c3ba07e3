"""The part of docs/soak.md on many radars, and docs/soak-radars.png."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from soak_figures import (
    NS,
    Array,
    draw_cores,
    draw_memory,
    dress,
    filled,
    rate,
    slope_mb_h,
    spanned,
)

WARM_S = 300.0  # By then all that is kept up to a bound has grown to it; a third of a shorter run
C_HZ = 100
C_EVERY_S = 10.0
LATE = {quantile: f"plotfeed_lateness_seconds{quantile}" for quantile in ("0.5", "0.99", "0.999")}


@dataclass(frozen=True, slots=True, kw_only=True)
class RadarsRun:
    """All that is known of a soak of many radars."""

    said: dict[str, Any]
    samples: dict[str, Array]
    totals: dict[str, Any]
    nanosleep_us: Array | None  # How late C woke, a hundred times a second; None without a compiler

    @property
    def warm_s(self) -> float:
        """From then on memory is looked at."""
        return min(WARM_S, float(self.samples["t_s"][-1]) / 3)


def read_radars(folder: Path) -> RadarsRun:
    """From what a soak has left in its folder."""
    rows = [json.loads(line) for line in (folder / "samples.jsonl").read_text().splitlines()]
    beside = folder / "nanosleep.npy"
    return RadarsRun(
        said=json.loads((folder / "run.json").read_text()),
        samples={name: np.array([row.get(name, np.nan) for row in rows]) for name in rows[-1]},
        totals=json.loads((folder / "out").read_text().splitlines()[-1]),
        nanosleep_us=np.load(beside) if beside.exists() else None,
    )


ABOUT = """
{sensors} rotating radars of 32 sectors, once a second and all in step, that report in categories
048 and 034; telemetry of {drones} drones at {hz:g} Hz in JSON over MQTT; {broker} and a subscriber
to all that radars send on the same two cores, for {minutes:.0f} minutes, with the ledger and
metrics, by `tools/soak/soak.py --radars {sensors}`. {faults}
"""
MACHINE = """
Begun {began} UTC, {load}. Lateness is a message's sending after it was due: of each sample of the
last 100,000 messages, some seconds; beside it, clock_nanosleep in C, with a timer slack of 1 ns, at
a hundred deadlines a second in the same minutes, which tells what the machine itself could do.
"""


def radars_text(run: RadarsRun) -> str:
    """In Markdown."""
    s, said = run.samples, run.said
    faults = f"The broker was taken away {len(said['faults'])} times."
    about = filled(
        ABOUT,
        sensors=said["sensors"],
        drones=said["drones"],
        hz=said["telemetry_hz"],
        broker=said["broker"],
        minutes=s["t_s"][-1] / 60,
        faults=faults if said["faults"] else "",
    )
    begun = datetime.fromtimestamp(said["began"]["utc_ns"] // NS, UTC)
    others = rate(s, "machine_cpu_s") - rate(s, "cpu_s")
    load = (
        f"on a machine of two cores, of which others, broker and subscriber too, took {others:.2f}"
    )
    parts = [
        about,
        "![Memory, lateness and processor over the run](soak-radars.png)",
        "\n".join(["|  |  |", "|---|--:|", *(f"| {a} | {b} |" for a, b in _rows(run))]),
        filled(MACHINE, began=f"{begun:%Y-%m-%d %H:%M}", load=load),
    ]
    return "\n\n".join(parts)


def _rows(run: RadarsRun) -> Iterator[tuple[str, str]]:
    s, said, totals = run.samples, run.said, run.totals
    settled = s["t_s"] >= run.warm_s
    slope, error = slope_mb_h(s, run.warm_s)
    yield "its own memory (RssAnon) after the warm-up, MB", spanned(s["own_mb"][settled], ".1f")
    yield "its slope, MB an hour", f"{slope:+.1f} ± {error:.1f} (standard error)"
    yield "resident (RSS), MB", spanned(s["rss_mb"][settled], ".1f")
    for quantile, name in (("0.5", "p50"), ("0.99", "p99"), ("0.999", "p99.9")):
        late_ms = s[LATE[quantile]][1:] * 1e3
        yield (
            f"lateness {name}, median and most of the samples, ms",
            (f"{np.nanmedian(late_ms):.2f}, {np.nanmax(late_ms):.2f}"),
        )
    if run.nanosleep_us is not None:
        found = np.percentile(run.nanosleep_us, (50, 99, 99.9)) / 1e3
        yield "clock_nanosleep in C, p50, p99, p99.9, ms", ", ".join(f"{x:.2f}" for x in found)
        worst = np.median([np.percentile(w, 99) for w in _windows(run.nanosleep_us)]) / 1e3
        yield f"median of its p99 of {C_EVERY_S:g} s each, ms", f"{worst:.2f}"
    yield "scans missed", f"{totals['missed_scans']:,} of {s['t_s'][-1] * said['sensors']:,.0f}"
    yield "messages sent by radars", f"{totals['messages']:,}"
    yield "of these arrived at the subscriber", f"{said['arrived']:,}"
    yield "undelivered", f"{totals['undelivered']:,}"
    yield (
        "telemetry published; taken; refused",
        (f"{said['published']:,}; {totals['telemetry']:,}; {totals['refused']:,}"),
    )
    yield "telemetry to be taken in, most seen at once", f"{np.nanmax(s['plotfeed_inbox']):,.0f}"
    yield "processor, cores", f"{rate(s, 'cpu_s'):.2f}"
    yield "threads, most", f"{s['threads'].max():.0f}"
    yield "from SIGTERM to the exit, s; exit code", f"{said['exit_s']:.2f}; {said['exit_code']}"


def _windows(late_us: Array) -> list[Array]:
    """By `C_EVERY_S`."""
    return np.array_split(late_us, max(1, round(len(late_us) / C_HZ / C_EVERY_S)))


def draw_radars(run: RadarsRun, to: Path) -> None:
    """Three pictures over one axis of time."""
    import matplotlib as mpl

    mpl.use("agg")
    from matplotlib import pyplot as plt

    s, minutes = run.samples, run.samples["t_s"] / 60
    figure, axes = plt.subplots(3, 1, figsize=(11, 8.5), dpi=100, sharex=True, layout="constrained")
    memory, late, cpu = axes
    draw_memory(memory, s)
    for quantile, name, color in (("0.5", "p50", "#0a7d6c"), ("0.99", "p99", "#c8651b")):
        late.plot(minutes, np.maximum(s[LATE[quantile]] * 1e3, 1e-3), label=name, color=color)
    if run.nanosleep_us is not None:
        windows = _windows(run.nanosleep_us)
        at = (np.arange(len(windows)) + 0.5) * C_EVERY_S / 60
        p99_ms = [np.percentile(window, 99) / 1e3 for window in windows]
        late.plot(at, p99_ms, label="p99 of clock_nanosleep in C", color="#9aa5ab", lw=1)
    late.set_yscale("log")
    late.set_title("Lateness, ms")
    draw_cores(cpu, s)
    cpu.set_xlabel("minutes")
    for each in axes:
        dress(each)
    figure.savefig(to)
    plt.close(figure)
