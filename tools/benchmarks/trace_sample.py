"""The way of one sample: the files and functions of ours that it runs through.

    python tools/benchmarks/trace_sample.py [--list]

One rotating radar and one drone that reports ten times a second. A report goes in by
`Engine.receive`; what ends until the next one comes out of `Engine.until` as octets of ASTERIX 048
and 034, which leave at once, and `ledger_messages` tells of them. Counted are the functions that
run in a second of that, after five in which all is made that is kept; comprehensions and lambdas
count for the function that holds them.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import FrameType
from typing import Any

from aims import aim
from bench_engine import radars

from plotfeed import Engine
from plotfeed.feeds.link.ledger_messages import ledger_messages
from plotfeed.feeds.messages.message import Message
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.ledger import tables_of
from plotfeed.proto.utc import NS, iso_utc
from plotfeed.testing import scene

START_NS, STEP_NS, WARM_S, COUNTED_S = 1_767_225_600 * NS, NS // 10, 5, 1
AIM_FILES, AIM_FUNCTIONS = 30, 150
OURS = Path(__file__).parents[2]
PACKAGES = ("face", "feeds", "models", "proto", "replay")
Place = tuple[str, str]  # A file, and a function in it


def report(step: int) -> bytes:
    """The drone's telemetry: it flies north, 2 km off."""
    said = {
        "time_utc": iso_utc(START_NS + step * STEP_NS),
        "latitude_deg": 40.46 + 1e-5 * step,
        "longitude_deg": -3.71,
        "altitude_m": 850.0,
        "altitude_reference": "ELLIPSOID",
    }
    return json.dumps(said).encode()


def fly(engine: Engine, steps: range) -> list[Message]:
    """Ledger entries of all that is said from report to report."""
    entries = []
    for step in steps:
        refused = engine.receive("plotfeed/telemetry/d0", report(step), START_NS + step * STEP_NS)
        assert refused is None, refused
        for batch in engine.until(START_NS + (step + 1) * STEP_NS):
            for one in [one for each in batch.messages for one in each]:
                one.fate, one.sent_utc_ns = pb.SENT, one.leaves_utc_ns
            entries += ledger_messages("plotfeed", [(batch, row) for row in range(len(batch))])
    return entries


def traced(call: Any) -> tuple[set[Place], Any]:
    """The functions of ours that a call runs, and what it gives."""
    codes: dict[Any, str] = {}

    def see(frame: FrameType, event: str, _argument: Any) -> None:
        if event == "call" and frame.f_code not in codes:
            codes[frame.f_code] = frame.f_code.co_filename

    sys.setprofile(see)
    try:
        found = call()
    finally:
        sys.setprofile(None)
    places = set()
    for code, file in codes.items():
        if not file.startswith("<"):
            path = Path(file).resolve()
            name = code.co_qualname.partition(".<locals>.<")[0]
            if path.is_relative_to(OURS) and not name.startswith("<"):
                held = path.relative_to(OURS)
                if held.parts[0] in PACKAGES:
                    places.add((str(held), name))
    return places, found


def main() -> None:
    """Prints a table."""
    engine = Engine(scene(radars(1), seed=1), START_NS)
    a_second = NS // STEP_NS
    fly(engine, range(WARM_S * a_second))
    counted = range(WARM_S * a_second, (WARM_S + COUNTED_S) * a_second)
    places, entries = traced(lambda: fly(engine, counted))
    told = tables_of(entry.payload for entry in entries)
    assert min(len(told.looks), len(told.messages)), "the beam has met no drone"
    files = sorted({file for file, _ in places})
    if "--list" in sys.argv:
        for file in files:
            print(f"{file}: {', '.join(sorted(name for at, name in places if at == file))}")
        print()
    for what, most, found in (
        ("files on the way of one sample", AIM_FILES, len(files)),
        ("functions on the way of one sample", AIM_FUNCTIONS, len(places)),
    ):
        print(aim(what, str(most), str(found), is_met=found <= most))


if __name__ == "__main__":
    main()
