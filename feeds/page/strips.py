"""What the strips of a page show of each sensor: Pd against range, what its link did."""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

import numpy as np

from plotfeed.feeds.link.delays import DelayLaw
from plotfeed.feeds.link.losses import LossChain, chain_of
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.models.residuals import LookTally
from plotfeed.models.state import Floats
from plotfeed.models.tail_chances import p_of_trials

RANGE_BINS = 25
OFF_BELOW = 1e-4  # Probability by chance below which a strip says that something is not as asked
LOOKS_AT_ONCE = 256  # That are counted together: the session must not wait for many


def new_looks(range_max_m: float) -> LookTally:
    """A tally of a sensor's looks, in `RANGE_BINS` over its range."""
    return LookTally(range_max_m / RANGE_BINS, RANGE_BINS, at_once=LOOKS_AT_ONCE)


def looks_summary(looks: LookTally) -> dict[str, Any]:
    """Looks, detections, sum and variance expected, by range from 0 in steps of `width_m`.

    `off` says that so many detections hardly come by chance.
    """
    cells = looks.cells()[:4]
    count, expected, variance, detected = np.pad(cells, ((0, 0), (0, RANGE_BINS - cells.shape[1])))
    mean_pd = np.divide(expected, count, out=np.zeros_like(count), where=count > 0)
    by_chance = p_of_trials(count, mean_pd, round(detected.sum())) if count.any() else 1.0
    return {
        "width_m": looks.cell_m,
        "looks": count.astype(int).tolist(),
        "detected": detected.astype(int).tolist(),
        "expected": np.round(expected, 3).tolist(),
        "variance": np.round(variance, 3).tolist(),
        "off": by_chance < OFF_BELOW,
    }


class Loss(NamedTuple):
    """A message that was lost; it counts when it would have come, beside those that did."""

    told_utc_ns: int
    sensor: int
    number: int
    due_utc_ns: int
    by_chain: bool  # The link's model of loss took it, not an outage or a queue


LATENCIES_KEPT = 3000
LOSSES_KEPT = 3000
BINS = 40
QUANTILES = 201


class LinkRecord:
    """What a link did since its settings last changed."""

    def __init__(self) -> None:
        self.begin()

    def begin(self, asked: LinkSettings | None = None, since_utc_ns: int = 0) -> None:
        """The link is so since then; nothing is asked of it where that is not told."""
        self._since_utc_ns = since_utc_ns
        self._loss: LossChain | None = None  # That decides on losses, if they are losses
        self._asked_ms: Floats = np.zeros(0)  # Delays at equal steps of probability
        if asked is not None:
            self._asked_ms = DelayLaw.of(asked).quantile_ms(np.linspace(0, 1, QUANTILES))
            self._loss = None if asked.on_loss == "stall" else chain_of(asked.loss)
        self._decided = self._lost_by_chain = 0
        self._judged: tuple[int, int] = (0, 0)
        self._is_off = False
        # The median of what the link asks for: a message that it loses would have come by then.
        self.usual_delay_ns = round(1e6 * np.median(self._asked_ms)) if asked is not None else 0
        self._latency_ms: deque[float] = deque(maxlen=LATENCIES_KEPT)
        self._messages = self._lost = self._bursts = self._duplicates = 0
        self._lost_numbers: deque[int] = deque()
        self._lost_lately: set[int] = set()

    def sent(self, due_utc_ns: int, sent_utc_ns: int, *, duplicate: bool) -> None:
        """A message, or a duplicate of one, that was handed over then left at that time."""
        if due_utc_ns < self._since_utc_ns:
            return
        if duplicate:
            self._duplicates += 1
            return
        self._decided += 1
        self._latency_ms.append((sent_utc_ns - due_utc_ns) / 1e6)
        self._messages += 1

    def lost(self, number: int, due_utc_ns: int, *, by_chain: bool = True) -> None:
        """A message did not leave; numbers may come in any order.

        `by_chain` says that the link's model of loss took it, not an outage or a queue.
        """
        if due_utc_ns < self._since_utc_ns:
            return
        self._decided += by_chain
        self._lost_by_chain += by_chain
        self._messages += 1
        self._lost += 1
        lately = self._lost_lately
        # A burst of its own, or a part of one, or what joins two.
        self._bursts += 1 - (number - 1 in lately) - (number + 1 in lately)
        lately.add(number)
        self._lost_numbers.append(number)
        if len(self._lost_numbers) > LOSSES_KEPT:
            lately.discard(self._lost_numbers.popleft())

    def summary(self) -> dict[str, Any]:
        """Shares and moments, and the histogram of latencies beside the one asked for."""
        latency_ms = np.array(self._latency_ms)
        return {
            "messages": self._messages,
            "lost": self._lost,
            "duplicates": self._duplicates,
            "loss_off": self._loss_is_off(),
            "mean_burst": self._lost / self._bursts if self._bursts else None,
            "mean_ms": float(latency_ms.mean()) if len(latency_ms) else None,
            "sigma_ms": float(latency_ms.std()) if len(latency_ms) else None,
            "asked_mean_ms": float(np.mean(self._asked_ms)) if len(self._asked_ms) else None,
            **_histogram(latency_ms, self._asked_ms),
        }

    def _loss_is_off(self) -> bool:
        """Tell whether so many losses hardly come by chance; worked out where it is in doubt."""
        chain, of, lost = self._loss, self._decided, self._lost_by_chain
        if chain is None or not of or (of, lost) == self._judged:
            return self._is_off
        self._judged, mean = (of, lost), chain.mean_loss
        if not 0 < mean < 1:
            self._is_off = lost != round(of * mean)
        else:
            spread = of * chain.spread_of_loss(of)
            is_far = abs(lost - of * mean) > IN_DOUBT * spread
            self._is_off = bool(is_far) and chain.p_of(lost, of) < OFF_BELOW
        return self._is_off


IN_DOUBT = 3.0  # Standard deviations within which nothing is so improbable as to be called off


def _histogram(latency_ms: Floats, asked_ms: Floats) -> dict[str, Any]:
    """Shares of both in the same bins: from `low_ms`, each of `width_ms`."""
    both = np.concatenate([latency_ms, asked_ms])
    low_ms, high_ms = np.quantile(both, (0.003, 0.997)) if len(both) else (0.0, 1.0)
    low_ms, width_ms = _nice_bins(float(low_ms), float(high_ms))
    edges_ms: Floats = low_ms + width_ms * np.arange(BINS + 1, dtype=np.float64)
    below = np.searchsorted(np.sort(latency_ms), edges_ms, side="left")
    return {
        "low_ms": low_ms,
        "width_ms": width_ms,
        "delivered": _shares(below / len(latency_ms) if len(latency_ms) else np.zeros(0)),
        "asked": _shares(_below_quantiles(asked_ms, edges_ms)),
    }


def _shares(below: Floats) -> list[float]:
    """The share within each bin, of those below its edges."""
    return [round(float(x), 5) for x in np.diff(below)]


def _below_quantiles(quantiles_ms: Floats, edges_ms: Floats) -> Floats:
    """The share of a distribution below each edge, by its quantiles at equal steps."""
    if not len(quantiles_ms):
        return np.zeros(0)
    probability = np.linspace(0, 1, len(quantiles_ms))
    just_below_ms = edges_ms - 1e-9 * (edges_ms[1] - edges_ms[0])
    below: Floats = np.interp(just_below_ms, quantiles_ms, probability, 0.0, 1.0)
    return below


def _nice_bins(low_ms: float, high_ms: float) -> tuple[float, float]:
    """Bins of a round width that hold an interval: the first edge, and the width."""
    least = max((high_ms - low_ms) * 1.1, high_ms * 0.02, 0.04) / BINS
    decade = 10.0 ** np.floor(np.log10(least))
    width_ms = next(float(step * decade) for step in (1, 2, 2.5, 5, 10) if step * decade >= least)
    slack_ms = (BINS * width_ms - (high_ms - low_ms)) / 2
    first_ms = np.floor(max(low_ms - slack_ms, 0.0) / width_ms) * width_ms
    return float(first_ms), width_ms


HISTORY_S = 120
MAX_LATENESS = 20_000  # Messages of a second whose lateness is taken; what comes on top is not


class Rates:
    """Counts of the second under way, and of those before it.

    Seconds are those of the wall clock: what a tracker has to cope with.
    """

    def __init__(self, sensors: int) -> None:
        self.history: deque[dict[str, Any]] = deque(maxlen=HISTORY_S)
        self._sensors = sensors
        self._second: int | None = None
        self._begin()

    def plots(self, sensor: int, count: int) -> None:
        """Count that many plots of a sensor, by its number, as delivered."""
        self._plots[sensor] += count

    def sent(self, lateness_ns: int) -> None:
        """A message left so long after its link let it."""
        self._messages += 1
        if len(self._lateness_ns) < MAX_LATENESS:
            self._lateness_ns.append(lateness_ns)

    def lost(self) -> None:
        """A message did not leave."""
        self._lost += 1

    def over(self, monotonic_s: float, now_utc_ns: int) -> list[dict[str, Any]]:
        """The second that is over since the last call; empty ones after it are left out.

        It has ended at that time of the session.
        """
        second = int(monotonic_s)
        if self._second is None:
            self._second = second
        if second == self._second:
            return []
        late_us: list[float | None] = [None, None]
        if self._lateness_ns:  # else nothing left, neither late nor in time
            late_us = np.round(np.percentile(self._lateness_ns, (50, 99)) / 1e3, 1).tolist()
        ended = {
            "t_utc_ms": now_utc_ns / 1e6,
            "plots": self._plots,
            "messages": self._messages,
            "lost": self._lost,
            "late_p50_us": late_us[0],
            "late_p99_us": late_us[1],
        }
        self._second = second
        self._begin()
        self.history.append(ended)
        return [ended]

    def _begin(self) -> None:
        self._plots = [0] * self._sensors
        self._messages = self._lost = 0
        self._lateness_ns: list[int] = []
