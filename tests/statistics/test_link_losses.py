"""Losses of impaired links: how many, in what bursts, and against what netem was seen to do."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import stats
from support.links import bursts, due_times, link, losses, passed
from support.significance import Array, assert_counts, assert_mean, assert_sum

from plotfeed.feeds.link.delays import DelayLaw, waits_ns
from plotfeed.feeds.link.impairment import LinkExpectation

N = 101_000
BATCH = 100  # Messages: long beside every burst, so that batches are as good as independent
# Taken for the figures measured on netem, whose number of packets is not known.
NETEM_PACKETS = 10_000
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
def of(model: str, n: int = N) -> tuple[LinkExpectation, Array]:
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


@EVERY_MODEL
def test_successive_losses_have_the_correlation_of_the_chain(model: str) -> None:
    asked, lost = of(model)
    loss, rho = asked.loss.mean_loss, asked.loss.lag_1_correlation
    excess = lost - loss
    product = np.append(excess[1:] * excess[:-1], 0.0)
    assert_mean(batches(product - rho * loss * (1 - loss)), 0.0, model)


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
