"""How often messages overtake each other, what it costs to forbid it, copies, bits and queues."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.special import log_ndtr
from support.links import NS, OCTETS, START_NS, delays_ms, due_times, link, passed
from support.significance import Array, assert_chance, assert_law, assert_mean, assert_sum

from plotfeed.feeds.link.impairment import Impairment
from plotfeed.proto import plotfeed_pb2 as pb

N = 25_000


@pytest.mark.parametrize(("jitter_ms", "gap_ms"), [(1.0, 1.0), (5.0, 10.0), (10.0, 2.0)])
def test_neighbours_change_places_as_often_as_two_normal_delays_do(
    jitter_ms: float, gap_ms: float
) -> None:
    """The later one is earlier with the probability Phi(-gap / (sigma sqrt 2))."""
    seen = delays_ms(link(latency_ms=60.0, jitter_ms=jitter_ms), N, 1000 / gap_ms, seed=31)
    overtakes = np.diff(seen) < -gap_ms
    assert_chance(
        float(
            stats.binomtest(
                int(overtakes[::2].sum()),  # pairs that share no message
                len(overtakes[::2]),
                float(stats.norm.sf(gap_ms / (jitter_ms * np.sqrt(2)))),
            ).pvalue
        ),
        f"{jitter_ms} ms, every {gap_ms} ms",
    )


def waiting_law(x: Array, jitter_ms: float, gap_ms: float) -> Array:
    """Of the delay on a normal link of 50 ms in order: all before have left by then.

    P(D <= x) is the product of Phi((x + k gap - 50) / sigma) over k = 0, 1, ...
    """
    k = np.arange(int(12 * jitter_ms / gap_ms) + 2)[:, None]
    return np.exp(log_ndtr((x + k * gap_ms - 50) / jitter_ms).sum(axis=0))


def test_a_link_in_order_never_overtakes_and_its_mean_rises() -> None:
    """At 700 messages a second, 50 +- 10 ms: from 50.0 to 60.5 ms."""
    gap_ms, keys = 1000 / 700, {"latency_ms": 50.0, "jitter_ms": 10.0}
    free = delays_ms(link(**keys), N, 700, seed=32)
    kept = delays_ms(link(**keys, in_order=True), N, 700, seed=32)
    assert (kept >= free).all()
    assert (np.diff(kept) >= -gap_ms - 1e-6).all()
    batch = 25  # 36 ms: as long as any of them waits, and nearly independent
    assert_mean(free.reshape(-1, batch).mean(axis=1), 50.0, "mean without order")
    x = np.linspace(0, 130, 130_001)
    mean_ms = float((1 - waiting_law(x, 10.0, gap_ms)).sum() * (x[1] - x[0]))
    assert mean_ms == pytest.approx(60.5, abs=0.05)
    assert_mean(kept.reshape(-1, batch).mean(axis=1), mean_ms, "mean in order")
    assert_law(kept[::batch], lambda at: waiting_law(at, 10.0, gap_ms), "delay in order")


@pytest.mark.parametrize(("probability", "gap"), [(0.25, 1), (0.25, 4), (0.9, 3)])
def test_reordered_messages_leave_at_once_as_often_as_asked(probability: float, gap: int) -> None:
    """After gap - 1 others each one has the probability: 1/p + gap - 1 messages from one on."""
    asked = link(latency_ms=50.0, reorder={"probability": probability, "gap": gap})
    at_once = np.flatnonzero(delays_ms(asked, N, seed=33) == 0)
    between = np.diff(at_once) - (gap - 1)
    assert between.min() >= 1
    assert_mean(between.astype(float), 1 / probability, f"{probability} {gap}")


def test_a_rate_is_a_queue_with_one_server() -> None:
    """Poisson arrivals at 80 % of the rate: the mean wait of M/D/1, rho s / (2 (1 - rho))."""
    rng = np.random.default_rng(36)
    load, service_ms, n = 0.8, 1.0, 50_000
    arrivals_ns = START_NS + np.cumsum(
        np.rint(rng.exponential(service_ms / load, n) * 1e6).astype(np.int64)
    )
    asked = link(rate_kbit_s=OCTETS * 8 / service_ms, queue_messages=1_000_000)
    outcomes = passed(asked, arrivals_ns.tolist())
    left_ns = np.array([o.copies[0].due_utc_ns for o in outcomes])
    # Lindley: the queue is free after all that came, less the time it stood idle.
    index = np.arange(n)
    service_ns = 1_000_000
    free_ns = np.maximum.accumulate(arrivals_ns - index * service_ns) + (index + 1) * service_ns
    np.testing.assert_array_equal(left_ns, free_ns)
    waits_ms = (left_ns - arrivals_ns) / 1e6 - service_ms
    batches = waits_ms.reshape(100, -1).mean(axis=1)  # of 0.6 s each: independent
    expected_ms = load * service_ms / (2 * (1 - load))
    variance = 100 * float(batches.var(ddof=1))
    assert_sum(float(batches.sum()), 100 * expected_ms, variance, "M/D/1")


def test_a_queue_without_room_to_wait_drops_by_the_formula_of_erlang() -> None:
    """One place: whoever comes while a message is being sent is dropped; load / (1 + load)."""
    rng = np.random.default_rng(37)
    load, n = 0.5, N
    gaps_ns = np.rint(rng.exponential(1e6 / load, n)).astype(np.int64)
    impairment = Impairment(link(rate_kbit_s=480.0, queue_messages=1), 1, "radar")
    fates = [impairment.pass_on(due, 60).fate for due in (START_NS + np.cumsum(gaps_ns)).tolist()]
    full = np.array([fate == pb.QUEUE_FULL for fate in fates], dtype=float)
    batches = full.reshape(1000, -1).mean(axis=1)
    assert_mean(batches, load / (1 + load), "dropped")


def test_an_outage_lasts_as_long_as_it_is_asked_for() -> None:
    impairment = Impairment(link(latency_ms=5.0), 1, "radar")
    down = impairment.link.model_copy(update={"down": True})
    fates = []
    for due in due_times(90, 1):
        at_s = (due - START_NS) // NS
        if at_s in (60, 75):
            impairment.change(down if at_s == 60 else link(latency_ms=5.0))
        fates.append(impairment.pass_on(due, OCTETS).fate)
    assert fates == [pb.SENT] * 60 + [pb.OUTAGE] * 15 + [pb.SENT] * 15
