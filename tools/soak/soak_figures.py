"""What a soak came to: figures from its samples and from the ledger that it recorded."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from plotfeed.feeds.link.counters import LATENESS_KEPT
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger import tables_of
from plotfeed.replay.mcap import FOOTER, McapReader
from plotfeed.replay.recorded import Stage

NS = 1_000_000_000
BLOCK_S = 60.0
WARM_S = 300.0
COLUMNS = 104
AGAIN_S = 10.0  # After a broker is back: links connect again within 4 s, and send what has waited
Array = NDArray[Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Ledger:
    """What became of every message that sensors handed over, and when; in columns."""

    sensor: Array
    due_s: Array  # When the link was to let it leave, after the first sample
    late_ms: Array  # NaN for what did not leave
    fate: Array
    first: Array  # Whether it is no duplicate
    handed_over: int  # By sensors, as the recording has it


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """All that is known of a soak."""

    said: dict[str, Any]
    samples: dict[str, Array]
    totals: dict[str, Any]
    ledger: Ledger | None  # None of many radars, which record nothing
    record_mb: float = 0.0
    index_mb: float = 0.0  # Of the recording's summary, which is kept in memory until its end
    # How late C woke beside many radars, a hundred times a second; None without a compiler.
    nanosleep_us: Array | None = None

    @property
    def warm_s(self) -> float:
        """By then all that is kept up to a bound has grown to it: the lateness of many messages."""
        t_s = self.samples["t_s"]
        full = self.samples["plotfeed_messages_total"] >= LATENESS_KEPT
        third_s = float(t_s[-1]) / 3
        return max(float(t_s[full][0]), min(WARM_S, third_s)) if full.any() else third_s

    @property
    def faults_s(self) -> list[tuple[str, float, float]]:
        """What happened to the broker, from when to when."""
        zero_ns = self.said["began"]["utc_ns"]
        return [
            (f["what"], (f["from_ns"] - zero_ns) / NS, (f["to_ns"] - zero_ns) / NS)
            for f in self.said["faults"]
        ]

    def is_quiet(self, t_s: Array) -> Array:
        """Whether the broker was there, and links had caught up."""
        quiet = np.ones(len(t_s), bool)
        for _, from_s, to_s in self.faults_s:
            quiet &= (t_s < from_s - 1) | (t_s > to_s + AGAIN_S)
        return quiet


def read(folder: Path) -> Run:
    """From what a soak has left in its folder."""
    said = json.loads((folder / "run.json").read_text())
    rows = [json.loads(line) for line in (folder / "samples.jsonl").read_text().splitlines()]
    run = Run(
        said=said,
        samples={name: np.array([row.get(name, np.nan) for row in rows]) for name in rows[-1]},
        totals=json.loads((folder / "out").read_text().splitlines()[-1]),
        ledger=None,
    )
    record, beside = folder / "soak.mcap", folder / "nanosleep.npy"
    if not record.exists():
        return replace(run, nanosleep_us=np.load(beside) if beside.exists() else None)
    return replace(
        run,
        ledger=ledger_of(record, said["began"]["utc_ns"]),
        record_mb=record.stat().st_size / 1e6,
        index_mb=summary_octets(record) / 1e6,
    )


def rate(samples: dict[str, Array], name: str) -> float:
    """How much of that came in a second."""
    return float(np.ptp(samples[name]) / np.ptp(samples["t_s"]))


def filled(text: str, **words: Any) -> str:
    """A paragraph with those words, in lines as long as the page has them."""
    return textwrap.fill(" ".join(text.format(**words).split()), COLUMNS, break_long_words=False)


def spanned(values: Array, form: str = ".0f") -> str:
    """The least to the most."""
    low, high = format(values.min(), form), format(values.max(), form)
    return low if low == high else f"{low} to {high}"


def summary_octets(record: Path) -> int:
    """From where the footer says that it begins to the end of the file."""
    size = record.stat().st_size
    with record.open("rb") as file:
        file.seek(size - FOOTER.size)
        _, _, start, *_ = FOOTER.unpack(file.read())
    return size - int(start)


def ledger_of(record: Path, zero_ns: int) -> Ledger:
    """The ledger in a recording."""
    with McapReader(record) as log:
        handed_over = sum(1 for _ in log.messages(stages=[Stage.BEFORE]))
        entries = log.messages(topics=["plotfeed/truth"], stages=[Stage.AFTER])
        rows = [row for entry in entries for row in _rows(entry.payload, zero_ns)]
    sensor, due_s, late_ms, fate, first = (np.array(column) for column in zip(*rows, strict=True))
    return Ledger(
        sensor=sensor, due_s=due_s, late_ms=late_ms, fate=fate, first=first, handed_over=handed_over
    )


def _rows(payload: bytes, zero_ns: int) -> Iterator[tuple[str, float, float, int, bool]]:
    told = tables_of([payload])
    sent = told.messages
    late_ms = np.where(
        sent.fate == pb.SENT, (sent.sent_utc_ns - sent.link_due_utc_ns) / 1e6, np.nan
    )
    due_s = (sent.link_due_utc_ns - zero_ns) / NS
    sensor = told.entries.sensor[sent.entry]
    yield from zip(sensor, due_s, late_ms, sent.fate, sent.copy == 0, strict=True)


def slope_mb_h(samples: dict[str, Array], warm_s: float) -> tuple[float, float]:
    """Slope of the session's own memory after the warm-up, MB an hour, and its standard error.

    Of means of a minute, since neighbouring samples are not independent.
    """
    t_s, own_mb = samples["t_s"], samples["own_mb"]
    blocks = (t_s // BLOCK_S).astype(int)
    whole = range(math.ceil(warm_s / BLOCK_S), math.floor(t_s[-1] / BLOCK_S))
    means = [float(own_mb[blocks == b].mean()) for b in whole]
    if len(whole) < 3:
        return float("nan"), float("nan")
    fit = stats.linregress([b * BLOCK_S / 3600 for b in whole], means)
    return float(fit.slope), float(fit.stderr)


def late_ms(run: Run, ledger: Ledger, from_share: float, to_share: float) -> tuple[float, float]:
    """p50 and p99 in a part of the run, while the broker was there."""
    t_s = run.samples["t_s"]
    within = (ledger.due_s >= from_share * t_s[-1]) & (ledger.due_s < to_share * t_s[-1])
    chosen = ledger.late_ms[within & run.is_quiet(ledger.due_s) & ~np.isnan(ledger.late_ms)]
    if not len(chosen):
        return float("nan"), float("nan")
    p50, p99 = np.percentile(chosen, (50, 99))
    return float(p50), float(p99)


def fault_rows(run: Run, ledger: Ledger) -> Iterator[tuple[str, float, int, int, int, int]]:
    """Of each fault: kind, seconds, due meanwhile, sent afterwards, undelivered, and newest lost.

    The last counts what was given up though it was among the newest that the queue had room for.
    """
    kept = run.said["queue_messages"] * 19 // 20  # statuses wait there too
    for what, from_s, to_s in run.faults_s:
        back_s = _back_s(ledger, from_s, to_s)
        due = (ledger.due_s >= from_s) & (ledger.due_s < back_s)
        due &= np.isin(ledger.fate, (pb.SENT, pb.UNDELIVERED))
        given_up = due & (ledger.fate == pb.UNDELIVERED)
        newest_lost = 0
        for sensor in np.unique(ledger.sensor):
            mine = np.flatnonzero(due & (ledger.sensor == sensor))
            newest = mine[np.argsort(ledger.due_s[mine])][-kept:]
            newest_lost += int(given_up[newest].sum())
        sent = int(due.sum() - given_up.sum())
        yield what, to_s - from_s, int(due.sum()), sent, int(given_up.sum()), newest_lost


def _back_s(ledger: Ledger, from_s: float, to_s: float) -> float:
    """When the first of what had waited was sent again."""
    sent_s = ledger.due_s + np.nan_to_num(ledger.late_ms, nan=-1e9) / 1e3
    waited = (ledger.due_s >= from_s) & (ledger.due_s < to_s) & (sent_s >= to_s)
    return float(sent_s[waited].min()) if waited.any() else to_s


def outside_faults(run: Run, ledger: Ledger) -> int:
    """Messages that were given up though the broker was there."""
    return int(((ledger.fate == pb.UNDELIVERED) & run.is_quiet(ledger.due_s)).sum())
