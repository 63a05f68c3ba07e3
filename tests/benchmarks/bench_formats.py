"""Processor time of messages a sector: records, blocks, Message objects, and MQTT packets.

    python tests/benchmarks/bench_formats.py

Sectors of 200 sensors with one to two plots each, so many of them in one pass: 64 end in 10 ms
where 200 radars turn once a second, 200 where all are in step. A rotating radar has two messages a
sector, its plots in category 048 and the crossing in 034; the others have one.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.seen_sectors import scene_of, sectors_of, seen_by

from plotfeed.feeds.formats import SceneFormats, Seen
from plotfeed.feeds.transport.mqtt.publish_packet import pack

SENSORS = 200
PASSES = (1, 8, 64, 200, 3200)
REPEATS = 7
SECONDS_A_REPEAT = 0.05
CASES = (
    ("rotating", "asterix-048"),
    ("staring", "asterix-048"),
    ("staring", "asterix-015"),
    ("passive", "asterix-015"),
    ("rf", "asterix-205"),
    ("rotating", "plots"),
    ("rf", "plots"),
)


def us_of(call: Callable[[], object]) -> float:
    """Microseconds of processor time that a call takes, the median of repeats."""
    found = []
    for _ in range(REPEATS):
        calls, start = 0, time.process_time()
        while time.process_time() - start < SECONDS_A_REPEAT:
            call()
            calls += 1
        found.append((time.process_time() - start) / calls * 1e6)
    return statistics.median(found)


def seen_sectors(kind: str, report: str, count: int) -> tuple[SceneFormats, Seen]:
    """So many sectors, one of each sensor after the other, and what makes their messages."""
    rng = np.random.default_rng(1)
    scene = scene_of(kind, SENSORS, [report])
    sensors = np.arange(count) % SENSORS
    # Sectors of a session: 5 in a hundred begin a scan or end ten seconds, but not the first.
    sectors = sectors_of(scene, sensors, 3 + 7 * sensors + np.arange(count) // SENSORS)
    return SceneFormats(scene), seen_by(kind, sectors, rng.integers(1, 3, count), rng)


def main() -> None:
    """Measures and prints a table."""
    print("µs a sector.\n")
    print("| sensor | format | sectors in a pass | messages | MQTT 5 | MQTT 3.1.1 | all |")
    print("|---|---|--:|--:|--:|--:|--:|")
    for kind, report in CASES:
        for count in PASSES:
            formats, seen = seen_sectors(kind, report, count)

            def made() -> list[object]:
                vars(seen).pop("stamps", None)  # noqa: B023 - called at once, as the others are
                return [m for each in formats.messages(seen) for m in each]  # noqa: B023

            def packed(version: int) -> None:
                vars(seen).pop("stamps", None)  # noqa: B023
                pack([m for each in formats.messages(seen) for m in each], version)  # noqa: B023

            alone = us_of(made) / count
            five, four = (us_of(lambda v=v: packed(v)) / count - alone for v in (5, 4))
            print(
                f"| {kind} | {report} | {count} | {alone:.2f} | {five:.2f} | {four:.2f} "
                f"| {alone + five + four:.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
