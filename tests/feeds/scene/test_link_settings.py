from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from support.links import link

from plotfeed.feeds.scene.link_keys import FourState, GilbertElliott, LinkSettings
from plotfeed.feeds.scene.problems import problems_of

RANDOM = {"kind": "random", "probability": 0.05}
GILBERT = {"kind": "gilbert-elliott"}
FOUR = {"kind": "four-state", "p13": 0.02}
TABLE = {"distribution": "table", "delays_ms": [1.0]}
REORDER = {"reorder": {"probability": 0.5}}


MEAN_OR_P = "loss: expected mean_loss and mean_burst, or p and r"


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"latency_ms": -1.0}, "latency_ms: input should be greater than or equal to 0, not -1.0"),
        ({"latency_ms": 1e9}, "latency_ms: input should be less than or equal to 600000"),
        ({"jitter_ms": 600_001.0}, "jitter_ms: input should be less than or equal to 600000"),
        ({"distribution": "table"}, 'delays_ms: needed with distribution = "table"'),
        ({"delays_ms": [1.0]}, 'delays_ms: needs distribution = "table"'),
        (TABLE | {"jitter_ms": 2.0}, 'jitter_ms: contradicts distribution = "table"'),
        (TABLE | {"delays_ms": []}, "delays_ms: at least one is needed"),
        ({"delay_correlation": 1.0}, "delay_correlation: input should be less than 1, not 1.0"),
        (REORDER | {"in_order": True}, "reorder: contradicts in_order"),
        (REORDER | {"on_loss": "stall"}, 'reorder: contradicts on_loss = "stall", which keeps'),
        ({"duplicate": 1.1}, "duplicate: input should be less than or equal to 1, not 1.1"),
        ({"latency": 1.0}, "latency: no such key; did you mean latency_ms?"),
        ({"loss": {"kind": "randm"}}, "loss.kind: expected one of"),
        *(({"loss": keys}, told) for keys, told in (
            (RANDOM | {"correlation": -0.2},
             "loss.correlation: with that probability, at least -0.05263"),
            (GILBERT | {"p": 0.1, "mean_loss": 0.1}, MEAN_OR_P),
            (GILBERT | {"p": 0.1}, MEAN_OR_P),
            (GILBERT | {"mean_loss": 0.1, "mean_burst": 2.0, "bad_loss": 0.5}, MEAN_OR_P),
            (GILBERT | {"mean_loss": 0.9, "mean_burst": 2.0},
             "loss.mean_burst: with that mean_loss, at least 9"),
            (GILBERT | {"p": 0.0, "r": 0.0}, "loss.p: must be above 0 where r is 0"),
            (FOUR | {"p14": 0.99}, "loss.p14: with p13, at most 1"),
            (FOUR | {"p31": 0.5, "p32": 0.6}, "loss.p32: with p31, at most 1"),
            (FOUR | {"p13": 1.0}, "loss.p31: must be above 0, or a burst never ends"),
            (FOUR | {"p23": 0.0}, "loss.p23: must be above 0, or a burst never ends"),
        )),
    ],
)  # fmt: skip
def test_what_cannot_be_is_told_in_a_line(keys: dict[str, Any], expected: str) -> None:
    with pytest.raises(ValidationError) as caught:
        LinkSettings.model_validate(keys)
    ((key, text),) = problems_of(caught.value, keys)
    assert f"{key}: {text}".startswith(expected)
    assert "\n" not in text


@given(st.floats(0.0, 0.99), st.floats(1.0, 1000.0))
def test_a_burst_and_a_loss_fix_the_chain(mean_loss: float, longer: float) -> None:
    """From the shortest bursts that such a loss can come in."""
    burst = longer * max(1.0, mean_loss / (1 - mean_loss))
    loss = GilbertElliott(kind="gilbert-elliott", mean_loss=mean_loss, mean_burst=burst)
    p, r, good, bad = loss.probabilities
    assert (r, good, bad) == (1 / burst, 0.0, 1.0)
    assert 0 <= p <= 1
    assert p / (p + r) == pytest.approx(mean_loss, rel=1e-9)


def test_four_states_have_the_defaults_of_netem_and_a_link_without_effect_is_clear() -> None:
    loss = FourState(kind="four-state", p13=0.02)
    assert (loss.ends, loss.p32, loss.p23, loss.p14) == (0.98, 0.0, 1.0, 0.0)
    assert LinkSettings().is_clear
    assert link(in_order=True, distribution="pareto", queue_messages=3).is_clear
    some = dict.fromkeys(("latency_ms", "jitter_ms", "rate_kbit_s"), 1.0)
    some |= dict.fromkeys(("duplicate", "corrupt"), 0.1) | {"loss": RANDOM, "down": True}
    assert not any(link(**{key: value}).is_clear for key, value in some.items())
    assert not link(**TABLE).is_clear
