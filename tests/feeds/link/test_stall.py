from __future__ import annotations

import numpy as np
import pytest
from support.links import OCTETS, START_NS, due_times, link, passed

from plotfeed.feeds.link.delays import MOST_REPEATS, DelayLaw, waits_ns
from plotfeed.feeds.link.impairment import Impairment
from plotfeed.proto import plotfeed_pb2 as pb

MS = 1_000_000


def test_repeats_wait_twice_as_long_each_time_up_to_two_minutes() -> None:
    waits = np.diff(waits_ns(DelayLaw(20.0))) / MS
    expected = [min(240.0 * 2**n, 120_000.0) for n in range(MOST_REPEATS)]
    np.testing.assert_allclose(waits, expected)


def test_the_first_wait_of_a_quick_link_is_that_of_linux() -> None:
    assert waits_ns(DelayLaw(0.0))[1] == 200 * MS


def test_much_jitter_makes_the_first_wait_longer() -> None:
    # Mean deviation of a normal law: sigma sqrt(2/pi), and there and back sqrt(2) of it.
    wait_ms = waits_ns(DelayLaw(1000.0, 100.0))[1] / MS
    assert wait_ms == pytest.approx(2000 + 4 * np.sqrt(2) * 100 * np.sqrt(2 / np.pi), rel=1e-3)


@pytest.mark.parametrize(
    "loss",
    [
        {"kind": "random", "probability": 0.3},
        {"kind": "gilbert-elliott", "p": 0.1, "r": 0.3, "bad_loss": 0.8},
        {"kind": "four-state", "p13": 0.1, "p31": 0.3, "p32": 0.1, "p23": 0.5},
        {"kind": "random", "probability": 1.0},
    ],
)
def test_nothing_is_lost_and_nothing_overtakes(loss: dict[str, object]) -> None:
    asked = link(latency_ms=20.0, jitter_ms=15.0, loss=loss, on_loss="stall")
    outcomes = passed(asked, due_times(2000, 100))
    assert {o.fate for o in outcomes} == {pb.SENT}
    left = [o.copies[0].due_utc_ns for o in outcomes]
    assert left == sorted(left)


def test_a_lost_message_comes_after_its_time_out_and_what_is_behind_with_it() -> None:
    asked = link(latency_ms=20.0, loss={"kind": "random", "probability": 0.01}, on_loss="stall")
    dues = due_times(3000, 100)
    outcomes = passed(asked, dues)
    delays = np.array([o.copies[0].due_utc_ns - d for o, d in zip(outcomes, dues, strict=True)])
    dropped = link(loss={"kind": "random", "probability": 0.01})
    lost = np.flatnonzero([o.fate == pb.LOST for o in passed(dropped, dues)])
    alone = [i for i in lost if np.count_nonzero(abs(lost - i) < 100) == 1 and i < 2970]
    assert len(alone) >= 3
    for i in alone:
        repeats = waits_ns(DelayLaw(20.0)).index(delays[i] - 20 * MS)
        assert repeats >= 1
        if repeats == 1:  # all of the next 240 ms come when it does
            np.testing.assert_array_equal(delays[i : i + 24], (260 - 10 * np.arange(24)) * MS)


def test_a_link_that_loses_everything_lets_a_message_through_at_last() -> None:
    asked = link(loss={"kind": "random", "probability": 1.0}, on_loss="stall")
    (copy,) = Impairment(asked, 1, "radar").pass_on(START_NS, OCTETS).copies
    assert copy.due_utc_ns - START_NS == waits_ns(DelayLaw(0.0))[-1]
    assert waits_ns(DelayLaw(0.0))[-1] == round(804.6e9)
