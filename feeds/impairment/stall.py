"""How long a lost segment holds up a TCP connection until it is repeated.

The time-out is that of RFC 6298 with the bounds of Linux: the round trip, and four of its mean
deviations but at least 200 ms; twice as long at each repeat, at most 120 s, 15 times.
"""

from __future__ import annotations

import math

from plotfeed.feeds.impairment.delays import DelayLaw

LEAST_MARGIN_MS = 200.0
MOST_MS = 120_000.0
MOST_REPEATS = 15
"""As Linux, which then gives up; here the last of them arrives, since nothing is to be lost."""


def waits_ns(law: DelayLaw) -> tuple[int, ...]:
    """From a message's first sending to its n-th repeat, for n from 0 to the most.

    The way back is taken to be like the way there, and to vary on its own.
    """
    deviation_ms = math.sqrt(2) * law.mean_deviation_ms()
    time_out_ms = 2 * law.mean_ms() + max(LEAST_MARGIN_MS, 4 * deviation_ms)
    waits, total_ms = [0], 0.0
    for n in range(MOST_REPEATS):
        total_ms += min(time_out_ms * 2**n, MOST_MS)
        waits.append(round(total_ms * 1e6))
    return tuple(waits)
