"""Processor time of messages a sector: records, blocks, Message objects, and MQTT packets.

    python tools/benchmarks/bench_formats.py

Sectors of sensors with one or two plots each: 64 end in 10 ms where 200 radars turn once a second,
each at its own time, and all 200 where they are in step. A rotating radar has two messages
a sector, its plots in category 048 and the crossing in 034; the others have one.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np
from aims import YARDSTICK, ratios, spread, yardstick_us
from support.every_kind import scene_of, seen

from plotfeed.feeds.cli.run import GARBAGE_OF_SESSION
from plotfeed.feeds.console.process import keep_freed, undisturbed
from plotfeed.feeds.formats import Batch, SceneFormats
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.transport.mqtt.packets import publish_packet

SENSORS = 200
PASSES = (1, 64, 200)
REPEATS, RUNS = 5, 3
SECONDS_A_REPEAT = 0.03
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


def seen_sectors(kind: str, report: str, count: int) -> tuple[SceneFormats, Batch]:
    """So many sectors of as many sensors, and what makes their messages."""
    turns = kind == "rotating"
    scene = scene_of(kind, SENSORS, [report], drones=45 if turns else 2)
    sectors = seen(scene, scans=1)
    of_each = len(sectors) // SENSORS
    numbers = np.arange(count)
    apart = 0 if count == SENSORS else numbers
    return SceneFormats(scene), sectors.rows(numbers * of_each + apart % of_each)


def packets(messages: list[Message], version: int) -> list[bytes]:
    """What a link would make of them ahead of time."""
    return [publish_packet(message, version) for message in messages]


def main() -> None:
    """Measures and prints a table."""
    keep_freed()
    with undisturbed(GARBAGE_OF_SESSION):  # both as a session does
        table()


def table() -> None:
    """Measures and prints each line."""
    print(f"µs of processor time a sector: medians of {REPEATS}; a packet's is on top of the "
          f"message's.\n{YARDSTICK} Median (least to most) of {RUNS} runs.\n")  # fmt: skip
    print("| sensor | format | sectors in a pass | messages | MQTT 5 | MQTT 3.1.1 | all "
          "| sectors a yardstick |")  # fmt: skip
    print("|---|---|--:|--:|--:|--:|--:|--:|")
    for kind, report in CASES:
        for count in PASSES:
            formats, found = seen_sectors(kind, report, count)

            def made(formats: SceneFormats = formats, seen: Batch = found) -> list[Message]:
                vars(seen).pop("stamps", None)  # each pass has its own
                return [m for each in formats.messages(seen) for m in each]

            runs = []
            for _ in range(RUNS):
                alone, five, four = (
                    us_of(call) / count
                    for call in (made, lambda: packets(made(), 5), lambda: packets(made(), 4))
                )
                runs.append((alone, five - alone, four - alone, five + four - alone))
            columns = (*zip(*runs, strict=True),)
            cells = [*map(spread, columns)]
            yardsticks = [yardstick_us() for _ in range(RUNS)]
            cells.append(spread(ratios(yardsticks, columns[-1]), ".1f"))
            print(f"| {kind} | {report} | {count} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
