"""Impaired links against the laws that were asked for: delays, losses, order, copies, queues."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.special import log_ndtr, ndtri
from support.links import OCTETS, START_NS, bursts, delays_ms, due_times, link, losses, passed
from support.significance import (
    Array,
    assert_counts,
    assert_law,
    assert_mean,
    assert_standard_normal,
    assert_sum,
    assert_uncorrelated,
)

from plotfeed.feeds.link.delays import DelayLaw, waits_ns
from plotfeed.feeds.link.impairment import LinkExpectation
from plotfeed.feeds.scene.link_keys import LinkSettings

N = 10_000
# Taken for the figures measured on netem, whose number of packets is not known.
NETEM_PACKETS = 10_000
SAMPLE = [12.0, 3.5, 3.5, 80.0, 20.0, 21.0, 22.0, 40.0]
LAWS: dict[str, dict[str, Any]] = {
    "normal": {"latency_ms": 50.0, "jitter_ms": 10.0},
    "normal, often 0": {"latency_ms": 10.0, "jitter_ms": 10.0},
    "uniform": {"latency_ms": 50.0, "jitter_ms": 10.0, "distribution": "uniform"},
    "pareto": {"latency_ms": 50.0, "jitter_ms": 10.0, "distribution": "pareto"},
    "paretonormal": {"latency_ms": 50.0, "jitter_ms": 10.0, "distribution": "paretonormal"},
    "table": {"latency_ms": 5.0, "distribution": "table", "delays_ms": SAMPLE},
}
EVERY_LAW = pytest.mark.parametrize("law", LAWS)


def assert_asked(asked: LinkSettings, seen: Array, of: str) -> None:
    """Delays are drawn from the law: between its ends by Kolmogorov and Smirnov, at them by z.

    Where the law is clipped the tail's probability is at one point, which that test knows nothing
    of.
    """
    law = LinkExpectation(asked)
    low, high = (float(q) for q in law.delay.quantile_ms([0.0, 1.0]))
    assert seen.min() >= low - 1e-6
    assert seen.max() <= high + 1e-6
    inside = (seen > low + 1e-6) & (seen < high - 1e-6)
    below, above = law.delay.cdf([low + 1e-6, high - 1e-6])
    for at_end, probability in ((seen <= low + 1e-6, below), (seen >= high - 1e-6, 1 - above)):
        variance = len(seen) * probability * (1 - probability)
        if variance > 10:
            assert_sum(float(at_end.sum()), len(seen) * probability, variance, f"{of} end")
    assert_law(seen[inside], lambda x: (law.delay.cdf(x) - below) / (above - below), of)


@EVERY_LAW
def test_delays_of_copies_follow_the_law_on_their_own(law: str) -> None:
    asked = link(**LAWS[law], duplicate=1.0)
    dues = due_times(N, 1000)
    outcomes = passed(asked, dues, seed=13)
    first, second = (
        np.array([(o.copies[i].due_utc_ns - d) / 1e6 for o, d in zip(outcomes, dues, strict=True)])
        for i in (0, 1)
    )
    assert_asked(asked, second, law)
    assert_uncorrelated(stats.rankdata(first), stats.rankdata(second), law)


def scores(asked: LinkSettings, seen: Array) -> Array:
    """Normal scores of delays, by the law."""
    return ndtri(np.clip(LinkExpectation(asked).delay.cdf(seen), 1e-12, 1 - 1e-12))


@pytest.mark.parametrize("rho", [0.9, 0.25, -0.6])
@pytest.mark.parametrize("shape", ["normal", "uniform"])
def test_delays_are_an_autoregression_of_the_first_order(shape: str, rho: float) -> None:
    asked = link(latency_ms=50.0, jitter_ms=10.0, distribution=shape, delay_correlation=rho)
    z = scores(asked, delays_ms(asked, N, seed=14))
    new = (z[1:] - rho * z[:-1]) / np.sqrt(1 - rho**2)
    assert_standard_normal(new, f"{shape} {rho} innovations")
    assert_uncorrelated(new, z[:-1], f"{shape} {rho} last")
    assert_uncorrelated(new[1:], new[:-1], f"{shape} {rho} successive")
    assert_uncorrelated(new[1:], z[:-2], f"{shape} {rho} last but one")


def test_a_copy_is_correlated_as_the_next_message_is() -> None:
    rho = 0.8
    asked = link(latency_ms=50.0, jitter_ms=10.0, delay_correlation=rho, duplicate=1.0)
    dues = due_times(N, 1000)
    outcomes = passed(asked, dues, seed=15)
    own, copy = (
        scores(asked, np.array([(o.copies[i].due_utc_ns - due) / 1e6
                                for o, due in zip(outcomes, dues, strict=True)]))
        for i in (0, 1)
    )  # fmt: skip
    new = (copy - rho * own) / np.sqrt(1 - rho**2)
    assert_standard_normal(new, "copies")
    assert_uncorrelated(new, own, "copies and messages")
    assert_uncorrelated(new[:-1], (own[1:] - rho * own[:-1]), "copies and next messages")


# Losses of impaired links: how many, in what bursts, and against what netem was seen to do.


MANY = 101_000
BATCH = 100  # Messages: long beside every burst, so that batches are as good as independent
GE: dict[str, Any] = {"kind": "gilbert-elliott"}
MODELS: dict[str, dict[str, Any]] = {
    "random": {"kind": "random", "probability": 0.05},
    "random, correlated": {"kind": "random", "probability": 0.05, "correlation": 0.5},
    "random, alternating": {"kind": "random", "probability": 0.4, "correlation": -0.6},
    "bursts": GE | {"mean_loss": 0.05, "mean_burst": 4.0},
    "gemodel 1 30": GE | {"p": 0.01, "r": 0.3},
    "gemodel 2 25 80 0.1": GE | {"p": 0.02, "r": 0.25, "bad_loss": 0.8, "good_loss": 0.001},
    "state 2 30 10 50 1": {
        "kind": "four-state", "p13": 0.02, "p31": 0.3, "p32": 0.1, "p23": 0.5, "p14": 0.01
    },
    "state 5": {"kind": "four-state", "p13": 0.05},
}  # fmt: skip
GEOMETRIC = ["random", "random, correlated", "random, alternating", "bursts", "gemodel 1 30"]
EVERY_MODEL = pytest.mark.parametrize("model", MODELS)
NETEM = {
    # Share lost and mean burst, as measured on it.
    "gemodel 1 30": (0.0342, 3.49),
    "gemodel 2 25 80 0.1": (0.0587, 2.66),
    "state 2 30 10 50 1": (0.0716, 2.15),
}


@cache
def of(model: str, n: int = MANY) -> tuple[LinkExpectation, Array]:
    asked = link(loss=MODELS[model])
    return LinkExpectation(asked), losses(asked, n, seed=21)


def batches(values: Array) -> Array:
    """Sums over successive batches of messages."""
    return values[: len(values) // BATCH * BATCH].reshape(-1, BATCH).sum(axis=1)


@EVERY_MODEL
def test_the_spread_of_what_is_lost_is_that_of_the_chain(model: str) -> None:
    asked, lost = of(model)
    sums = batches(lost.astype(float)) - BATCH * asked.loss.mean_loss
    # A batch is not quite long beside the chain's memory: its ends cost 4 % of the variance.
    ratio = sums.var() / (BATCH * asked.loss.spread_of_loss(1) ** 2)
    spread = np.sqrt(stats.kurtosis(sums, fisher=False) / len(sums))
    assert abs(ratio - 1) < 4 * spread + 0.06, f"{model}: {ratio:.3f}"


@pytest.mark.parametrize("model", GEOMETRIC)
def test_bursts_of_two_states_have_a_geometric_law(model: str) -> None:
    asked, lost = of(model)
    goes_on = 1 - 1 / asked.loss.mean_burst
    together = int(np.ceil(np.log(0.5) / np.log(goes_on)))  # lengths in a class: half end in it
    classes = (bursts(lost) + together - 1) // together
    assert_counts(classes, stats.geom(1 - goes_on**together), model)


@pytest.mark.parametrize("model", NETEM)
def test_losses_are_those_measured_on_netem(model: str) -> None:
    asked, lost = of(model, NETEM_PACKETS)
    share, mean_burst = NETEM[model]
    variance = 2 * asked.loss.spread_of_loss(NETEM_PACKETS) ** 2
    assert_sum(share - float(lost.mean()), 0.0, variance, f"{model} share")
    ours = bursts(lost)
    assert_sum(mean_burst - float(ours.mean()), 0.0, 2 * ours.var() / len(ours), f"{model} burst")


def test_what_a_stall_repeats_is_lost_as_often_as_the_chain_has_it() -> None:
    """Each sending of a message, first or not, is lost alike: the number of them is geometric."""
    probability = 0.3
    asked = link(loss={"kind": "random", "probability": probability}, on_loss="stall")
    dues = due_times(20_000, 1 / 1000)  # so far apart that none waits for another
    outcomes = passed(asked, dues, seed=22)
    waits = {wait: n for n, wait in enumerate(waits_ns(DelayLaw(0.0)))}
    repeats = np.array(
        [waits[o.copies[0].due_utc_ns - due] for o, due in zip(outcomes, dues, strict=True)]
    )
    assert_counts(repeats + 1, stats.geom(1 - probability), "sendings")


# What it costs to forbid overtaking, who leaves at once, and the queue of a rate.


SOME = 25_000


def waiting_law(x: Array, jitter_ms: float, gap_ms: float) -> Array:
    """Of the delay on a normal link of 50 ms in order: all before have left by then.

    P(D <= x) is the product of Phi((x + k gap - 50) / sigma) over k = 0, 1, ...
    """
    k = np.arange(int(12 * jitter_ms / gap_ms) + 2)[:, None]
    return np.exp(log_ndtr((x + k * gap_ms - 50) / jitter_ms).sum(axis=0))


def test_a_link_in_order_never_overtakes_and_its_mean_rises() -> None:
    """At 700 messages a second, 50 +- 10 ms: from 50.0 to 60.5 ms."""
    gap_ms, keys = 1000 / 700, {"latency_ms": 50.0, "jitter_ms": 10.0}
    free = delays_ms(link(**keys), SOME, 700, seed=32)
    kept = delays_ms(link(**keys, in_order=True), SOME, 700, seed=32)
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
    at_once = np.flatnonzero(delays_ms(asked, SOME, seed=33) == 0)
    between = np.diff(at_once) - (gap - 1)
    assert between.min() >= 1
    assert_mean(between.astype(float), 1 / probability, f"{probability} {gap}")


def test_a_rate_is_a_queue_with_one_server() -> None:
    """Poisson arrivals at 80 % of the rate, by Lindley: free after all that came and stood idle."""
    load, service_ns = 0.8, 1_000_000
    gaps_ns = np.random.default_rng(36).exponential(service_ns / load, SOME)
    arrivals_ns = START_NS + np.cumsum(np.rint(gaps_ns).astype(np.int64))
    asked = link(rate_kbit_s=OCTETS * 8 / 1.0, queue_messages=1_000_000)
    left_ns = [o.copies[0].due_utc_ns for o in passed(asked, arrivals_ns.tolist())]
    index = np.arange(SOME)
    free_ns = np.maximum.accumulate(arrivals_ns - index * service_ns) + (index + 1) * service_ns
    np.testing.assert_array_equal(left_ns, free_ns)
