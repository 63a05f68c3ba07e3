"""Microseconds per message of an impaired link, by what it is asked to do.

    python tools/benchmarks/bench_impairment.py

Random numbers are drawn in a block for each second of due time, so that a message costs more where
few of them share a block: 32 a second are the sectors of a radar that turns once in it.
"""

from __future__ import annotations

import statistics
import time
from functools import partial
from typing import Any

from aims import aim, by_size, in_turns, ratios

from plotfeed.feeds.link.impairment import Impairment
from plotfeed.feeds.scene.link_keys import LinkSettings

NS = 10**9
START_NS = 1_800_000_000 * NS
REPEATS = 5
MESSAGES = 4000
OCTETS = 60
RATES_HZ = (32, 1000, 10_000)
AIM_US = 2.0
BURSTS = {"kind": "gilbert-elliott", "mean_loss": 0.03, "mean_burst": 3.3}
NORMAL = {"latency_ms": 50.0, "jitter_ms": 10.0}
OF_THE_AIM = "Gilbert-Elliott and a normal delay"
CASES: dict[str, dict[str, Any]] = {
    "nothing": {},
    "latency": {"latency_ms": 50.0},
    "normal delay": NORMAL,
    "correlated Pareto delay": NORMAL | {"distribution": "pareto", "delay_correlation": 0.5},
    "Gilbert-Elliott": {"loss": BURSTS},
    OF_THE_AIM: NORMAL | {"loss": BURSTS},
    "the same, in order": NORMAL | {"loss": BURSTS, "in_order": True},
    "the same, as a stall": NORMAL | {"loss": BURSTS, "on_loss": "stall"},
    "all of it": NORMAL
    | {
        "distribution": "paretonormal",
        "delay_correlation": 0.5,
        "loss": {"kind": "four-state", "p13": 0.02, "p31": 0.3, "p32": 0.1, "p23": 0.5},
        "duplicate": 0.01,
        "corrupt": 0.01,
        "reorder": {"probability": 0.1, "gap": 2},
        "rate_kbit_s": 1e6,
    },
}


def us_per_message(keys: dict[str, Any], rate_hz: int) -> float:
    """Mean over so many evenly spaced messages, of which the first second is not counted."""
    impairment = Impairment(LinkSettings.model_validate(keys), 1, "radar")
    gap_ns = NS // rate_hz
    pass_on = impairment.pass_on
    for i in range(rate_hz):
        pass_on(START_NS + i * gap_ns, OCTETS)
    dues = [START_NS + NS + i * gap_ns for i in range(MESSAGES)]
    start = time.perf_counter()
    for due in dues:
        pass_on(due, OCTETS)
    return (time.perf_counter() - start) / MESSAGES * 1e6


def main() -> None:
    """Measures and prints a table."""
    found = in_turns(
        RATES_HZ,
        REPEATS,
        lambda rate_hz: {n: partial(us_per_message, keys, rate_hz) for n, keys in CASES.items()},
    )
    rates = [f"{rate:,}" for rate in RATES_HZ]
    print(f"µs a message: median (least to most) of {REPEATS} repeats in turns, of {MESSAGES:,}")
    print("messages each.\n")
    each = {name: [found[name, rate] for rate in RATES_HZ] for name in CASES}
    by_size("messages a second", rates, each)
    print("\nTimes what a message takes that nothing is asked of, by turns:\n")
    plain = each.pop("nothing")
    times = {name: map(ratios, row, plain) for name, row in each.items()}
    by_size("messages a second", rates, times)
    median = statistics.median(found[OF_THE_AIM, 1000])
    what, told = f"{OF_THE_AIM} at 1,000 a second", f"{median:.2f} µs"
    print("\n" + aim(what, f"{AIM_US:g} µs", told, is_met=median <= AIM_US))


if __name__ == "__main__":
    main()
