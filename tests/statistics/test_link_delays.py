"""Delays of impaired links against the laws that were asked for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.special import ndtri
from support.links import START_NS, delays_ms, due_times, link, passed
from support.significance import (
    Array,
    assert_law,
    assert_standard_normal,
    assert_sum,
    assert_uncorrelated,
)

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


def test_correlation_goes_on_over_the_borders_of_seconds() -> None:
    asked = link(latency_ms=50.0, jitter_ms=10.0, delay_correlation=0.8)
    z = scores(asked, delays_ms(asked, 6000, 2, seed=16))
    new = (z[1:] - 0.8 * z[:-1]) / 0.6
    assert_standard_normal(new[1::2], "across a border")
    assert_uncorrelated(new[1::2], z[1:-1:2][: len(new[1::2])], "across a border")


def test_pareto_has_the_figures_measured_on_netem() -> None:
    """Pareto 50 +- 10 ms: mean 49.8, sigma 8.19, p99.9 90.3 ms.

    The table ends at 90.0 ms: what the last figure has beyond that is the measurement's own.
    """
    asked = link(**LAWS["pareto"])
    seen = delays_ms(asked, NETEM_PACKETS, seed=17)
    both = seen.var() * (1 / len(seen) + 1 / NETEM_PACKETS)
    assert_sum(49.8 - float(seen.mean()), 0.0, both, "mean")
    squares = (seen - seen.mean()) ** 2
    of_sigma = squares.var() / (4 * seen.var())  # of sqrt(mean of squares), by the delta method
    both = of_sigma * (1 / len(seen) + 1 / NETEM_PACKETS)
    assert_sum(8.19 - float(seen.std()), 0.0, both, "sigma")
    assert float(np.quantile(seen, 0.999)) == pytest.approx(90.3, abs=0.5)


def test_draws_of_successive_seconds_know_nothing_of_each_other() -> None:
    seen = delays_ms(link(**LAWS["normal"]), 4000, 2, seed=19).reshape(-1, 2)
    assert_uncorrelated(seen[1:, 0], seen[:-1, 0], "first of each second")
    assert_uncorrelated(seen[:, 0], seen[:, 1], "within each second")
    assert START_NS % 10**9 == 0
