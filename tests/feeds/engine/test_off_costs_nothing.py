"""What a scene does not name is not computed: by the instructions that a sector executes.

Of each sensor's report, nothing of an effect's own modules runs, no array is made for one, and to
ask whether there is any takes less than a fiftieth of all instructions.
"""

from __future__ import annotations

import linecache
import re
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from support.every_kind import EMITTER, GATE, MICROPHONES, MIMO, PASSIVE, RF
from support.hills import write_ridge

from plotfeed import Engine
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.scene import sensors
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, held, radar, rotating, scene

Place = tuple[str, int]  # A file and a line
ROOMS = tuple(f"{Path(__file__).parents[3] / room}/" for room in ("feeds", "models", "proto"))
QUESTIONS = re.compile(
    r"is_in_free_space|self\.jammers|surroundings is|\bmultipath is|\bdoppler is|\bmerging is"
    r"|groups is|echo_effects is|strengths|intervals is|_with_effects"
    r"|readings is|\.errs\b|bias is|drift is|degradation is"
    r"|pd_factor|if self._sidelobes|held_ns|own_axes is not|layout is|classifier is"
    r"|elevation_baseline_m is|measures_range_rate"
    r"|velocity_enu_m_s=?|readings="
    r"|true_geometry|true_position_enu_m is not|range_rate_m_s is None|merged_drones is None"
)
SENSORS: dict[str, dict[str, Any]] = {
    "staring": radar(),
    "rotating": radar(scan=rotating(1.0, 8)),
    "mimo": MIMO | {
        "transmitters": [{"power_w": 2e3, "east_m": 9.0, "north_m": 0.0, "above_site_m": 0.0}],
    },
    "passive": PASSIVE,
    "acoustic": MICROPHONES | {
        "sensitivity_db": -60.0, "range_max_m": 9000.0, "azimuth_beamwidth_deg": 40.0,
        "microphones": 8, "frequency_hz": 200.0,
    },
    "gate": GATE,
    "rf": RF,
}  # fmt: skip
EVERYTHING = {
    "bias": {"range_offset_m": 1.0, "azimuth_offset_deg": 1.0, "time_offset_s": 0.1},
    "drift": {"sigma_range_m": 1.0, "time_constant_s": 60.0},
    "degradation": {"pd_factor": 0.99, "error_factor": 2.0},
    "multipath": {"antenna_height_m": 5.0},
    "doppler": {"notch_m_s": 1e-6},
    "merging": {},
    "classifier": {"claims": ["drone"], "confusion": {"drone": [1.0]}},
    "layout": {"shape": "circle", "spacing_m": 0.4},
    "antenna": {"receive": {"elevation": {"kind": "gaussian", "beamwidth_deg": 60.0}}},
    "straddling": {"range": "hann"},
    "pulses": {"prf_hz": [5000.0]},
    "decorrelation_s": 1.0,
}


def instructions_of(call: Callable[[], object]) -> Counter[Place]:
    """How many of the interpreter's instructions each line of ours executes."""
    counts: Counter[Place] = Counter()

    def trace(frame: FrameType, event: str, _argument: Any) -> Any:
        if event == "call":
            if not frame.f_code.co_filename.startswith(ROOMS):
                return None
            frame.f_trace_opcodes, frame.f_trace_lines = True, False
        elif event == "opcode":
            counts[frame.f_code.co_filename, frame.f_lineno or 0] += 1
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        call()
    finally:
        sys.settrace(before)
    return counts


def text_of(place: Place) -> str:
    """The line itself."""
    return linecache.getline(*place).strip()


def engine_of(sensor: dict[str, Any]) -> Engine:
    """With drones in its first octant that are detected."""
    near_m = 200.0 if sensor["type"] == "acoustic" else 2000.0  # sound takes its time
    keys = {"rcs_m2": 1.0, "sound_power_db": 120.0, "emitters": [EMITTER]}
    flown = [held(f"d{i}", 10.0 + i, 12.0, near_m * (1 + 0.1 * i), **keys) for i in range(3)]
    return Engine(scene([sensor], flown, seed=1), START_NS)


def next_sector(engine: Engine) -> Batch:
    assert engine.next_end_ns is not None
    (batch,) = engine.until(engine.next_end_ns)
    return batch


def executed(kind: str) -> Counter[Place]:
    """By a second scan, when what is made once has been made."""
    engine = engine_of(SENSORS[kind])
    assert [*engine.until(START_NS + 2 * NS)]
    found: list[Batch] = []
    counts = instructions_of(lambda: found.append(next_sector(engine)))
    assert len(found[0].looks)
    return counts


@pytest.mark.parametrize("kind", SENSORS)
def test_nothing_runs_of_what_is_not_named_and_to_ask_takes_less_than_a_fiftieth(kind: str) -> None:
    counts = executed(kind)
    effects = [one for one in counts if Path(one[0]).parts[-3:-1] == ("models", "effects")]
    assert not {text_of(place) for place in effects}
    asking = sum(n for place, n in counts.items() if QUESTIONS.search(text_of(place)))
    assert 0 < asking < counts.total() / 50, f"{asking} of {counts.total()}"


@pytest.mark.parametrize("kind", SENSORS)
def test_the_test_sees_what_is_named(kind: str) -> None:
    """With everything on, the same count finds the effects' modules."""
    known = EVERYTHING.keys() & sensors.SENSORS[SENSORS[kind]["type"]].model_fields
    engine = engine_of(SENSORS[kind] | {key: EVERYTHING[key] for key in known})
    counts = instructions_of(lambda: next_sector(engine))
    modules = {
        "doppler": {"doppler", "merging"},
        "classifier": {"classification"},
        "layout": {"microphone_layout"},
        "pulses": {"pulse_intervals"},
        "decorrelation_s": {"target_echoes"},
        "antenna": {"echo_effects"},
        "multipath": {"surroundings"},
    }
    wanted = {"readings"}.union(*(modules[key] for key in known & modules.keys()))
    assert wanted <= {Path(file).stem for file, _ in counts}


def test_what_stands_in_the_way_is_seen_too(tmp_path: Path) -> None:
    terrain = {"elevation": [write_ridge(tmp_path, height_m=700)]}
    drones = [held("d", 10.0, 12.0, 2000.0)]
    made = scene([radar()], drones, seed=1, folder=tmp_path, terrain=terrain)
    engine = Engine(made, START_NS)
    counts = instructions_of(lambda: next_sector(engine))
    assert {"line_of_sight", "surroundings"} <= {Path(file).stem for file, _ in counts}
