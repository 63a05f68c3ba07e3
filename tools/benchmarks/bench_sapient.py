"""Microseconds per SAPIENT detection, ours and made from its parts, taken in turns.

    python tools/benchmarks/bench_sapient.py

A detection has range, azimuth, elevation and their errors, a class, a confidence, SNR and age.
"From its parts" is what one writes first: a new message and two ULIDs of python-ulid every time.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from aims import by_size, in_turns, ratios, us_per_call
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from ulid import ULID

from plotfeed.feeds.formats import Batch
from plotfeed.feeds.formats.sapient.sapient_node import SapientReports, node_of
from plotfeed.feeds.scene.scene import example
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.models.beam import Timetable
from plotfeed.models.state import Plots
from plotfeed.proto.sapient.encode_sapient import DetectionEncoder

REPEATS = 5
SECONDS_A_REPEAT = 0.05
SIZES = (1, 10, 100, 1000)
T_NS = InstantClock().now_ns() // 10**9 * 10**9


def plots(n: int) -> Plots:
    """Such as a radar makes."""
    rng = np.random.default_rng(1)
    limits = {
        "azimuth_deg": (0, 359),
        "elevation_deg": (0, 30),
        "range_m": (100, 5000),
        "snr": (20, 1000),
        "sigma_azimuth_deg": (0.1, 1),
        "sigma_elevation_deg": (0.1, 1),
        "sigma_range_m": (1, 5),
    }
    columns = {name: rng.uniform(low, high, n) for name, (low, high) in limits.items()}
    return Plots.of(t_utc_ns=np.full(n, T_NS - 10**7), **columns)


def from_parts(node_id: str, found: Plots) -> list[bytes]:
    """One message after the other."""
    return [
        SapientMessage(
            timestamp={"seconds": T_NS // 10**9, "nanos": 0},
            node_id=node_id,
            detection_report={
                "report_id": str(ULID()),
                "object_id": str(ULID()),
                "range_bearing": {
                    "azimuth": found.azimuth_deg[i],
                    "elevation": found.elevation_deg[i],
                    "range": found.range_m[i],
                    "azimuth_error": found.sigma_azimuth_deg[i],
                    "elevation_error": found.sigma_elevation_deg[i],
                    "range_error": found.sigma_range_m[i],
                    "coordinate_system": 1,
                    "datum": 1,
                },
                "detection_confidence": 0.999999,
                "object_info": [
                    {"type": "SNR", "value": f"{10 * np.log10(found.snr[i]):.2f}"},
                    {"type": "age", "value": f"{(T_NS - found.t_utc_ns[i]) / 1e9:.6f}"},
                ],
                "classification": [{"type": "Air Vehicle", "confidence": 1.0}],
            },
        ).SerializeToString()
        for i in range(len(found))
    ]


def main() -> None:
    """Measures and prints a table."""
    scene = example("section-4")
    scene = scene.model_copy(
        update={"sapient": scene.sapient.model_copy(update={"default_class": "Air Vehicle"})}
    )
    on_earth = scene.model_copy(
        update={"sapient": scene.sapient.model_copy(update={"location": "location"})}
    )
    sensor = scene.sensor[0]
    node = node_of(scene, sensor)
    encoder = DetectionEncoder(node)
    reports = {
        "range-bearing": SapientReports(scene, sensor),
        "location": SapientReports(on_earth, sensor),
    }
    found = {n: plots(n) for n in SIZES}
    sector = Timetable(10**9, 32).sector(T_NS // 10**9, 31)

    def seen(n: int) -> Batch:
        return Batch.of_one(sector, found[n])

    while not reports["range-bearing"].messages_of(seen(1)):
        sector = Timetable(10**9, 32).sector(sector.scan, sector.index - 1)
    ways: dict[str, Callable[[int], object]] = {
        "encoder alone": lambda n: encoder.messages(T_NS, found[n]),
        "with topics, range-bearing": lambda n: reports["range-bearing"].messages_of(seen(n)),
        "with topics, location": lambda n: reports["location"].messages_of(seen(n)),
        "from its parts": lambda n: from_parts(node.node_id, found[n]),
    }
    times = in_turns(
        SIZES,
        REPEATS,
        lambda n: {
            name: lambda way=way: us_per_call(lambda: way(n), SECONDS_A_REPEAT) / n
            for name, way in ways.items()
        },
    )
    octets = len(encoder.messages(T_NS, found[1])[0])
    print(f"{octets} octets a message; µs a message: median (least to most) of {REPEATS}")
    print("repeats in turns, by the number of detections in a group.\n")
    each = {name: [times[name, n] for n in SIZES] for name in ways}
    by_size("", SIZES, each)
    print("\nFrom its parts, times what ours takes, by turns:\n")
    theirs = each.pop("from its parts")
    by_size("", SIZES, {name: map(ratios, theirs, row) for name, row in each.items()})


if __name__ == "__main__":
    main()
