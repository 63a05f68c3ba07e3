"""Impaired links, and what becomes of evenly spaced messages on them."""

from __future__ import annotations

from typing import Any

import numpy as np
from support.significance import Array

from plotfeed.feeds.link.impairment import Impairment, Outcome
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.proto import plotfeed_pb2 as pb

NS = 10**9
START_NS = 1_800_000_000 * NS
OCTETS = 60


def link(**keys: Any) -> LinkSettings:
    """As a scene has it."""
    return LinkSettings.model_validate(keys)


def due_times(n: int, rate_hz: float, start_ns: int = START_NS) -> list[int]:
    """Of so many messages."""
    return [start_ns + round(i * NS / rate_hz) for i in range(n)]


def passed(
    asked: LinkSettings, dues: list[int], *, seed: int = 1, name: str = "radar"
) -> list[Outcome]:
    """Outcomes of messages due then."""
    impairment = Impairment(asked, seed, name)
    return [impairment.pass_on(due, OCTETS) for due in dues]


def delays_ms(asked: LinkSettings, n: int, rate_hz: float = 1000.0, *, seed: int = 1) -> Array:
    """Of the first copy of each message; NaN where there is none; (n,)."""
    dues = due_times(n, rate_hz)
    return np.array(
        [
            (outcome.copies[0].due_utc_ns - due) / 1e6 if outcome.copies else np.nan
            for outcome, due in zip(passed(asked, dues, seed=seed), dues, strict=True)
        ]
    )


def losses(asked: LinkSettings, n: int, *, seed: int = 1) -> Array:
    """Which messages are lost; (n,) booleans."""
    outcomes = passed(asked, due_times(n, 10_000.0), seed=seed)
    return np.array([outcome.fate == pb.LOST for outcome in outcomes])


def bursts(lost: Array) -> Array:
    """Lengths of the runs of losses, but for one that begins or ends with the messages."""
    edges = np.flatnonzero(np.diff(lost.astype(np.int8)))
    first = 1 if lost[0] else 0
    whole = edges[first : first + (len(edges) - first) // 2 * 2]
    return whole[1::2] - whole[::2]
