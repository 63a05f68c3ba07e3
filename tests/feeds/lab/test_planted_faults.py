"""Whatever is wrong in a recording is named: the sensor, and the quantity that is off.

One recording has a sensor for each fault beside those that are right. What the running process did
wrong is named too: the judge asks the scene.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from support.every_kind import MICROPHONES, SENSORS
from support.ledgers import changed, record_session, told

from plotfeed.feeds.lab.gathering import FeedReport
from plotfeed.feeds.lab.judge import Against
from plotfeed.models.sensors.acoustic import MicrophoneArray
from plotfeed.models.sensors.polar_radar import PolarRadar
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.content_types import LEDGER, protobuf_content_type
from plotfeed.proto.ledger import entries_in
from plotfeed.replay.recorded import Recorded
from plotfeed.testing import held, radar, rotating, scene, staring

Keys = dict[str, Any]
Change = Callable[[pb.PlotBatch], None]
SEVERAL = Path(__file__).parents[3] / "examples" / "scenes" / "several-receivers.toml"
SECONDS = 90.0
LINK = {
    "latency_ms": 200.0,
    "jitter_ms": 60.0,
    "duplicate": 0.05,
    "loss": {"kind": "random", "probability": 0.1},
}
RADAR = radar(
    power_w=3.0, gain_tx_dbi=25.0, gain_rx_dbi=30.0, integration_s=0.02, pfa=1e-5,
    range_max_m=6000.0, elevation_max_deg=60.0, scan=rotating(0.5, 4),
    **dict.fromkeys(("range_floor_m", "azimuth_floor_deg", "elevation_floor_deg")),
)  # fmt: skip
RIGHT = [
    RADAR
    | {"id": "fine", "sic": 1, "report": ["plots"], "link": LINK, "doppler": {}}
    | {"bias": {"azimuth_offset_deg": 2.0, "range_offset_m": 30.0, "time_offset_s": 0.5}},
    RADAR | {"id": "coarse", "sic": 2, "report": ["asterix-048"]},
    MICROPHONES
    | {"id": "ears", "sic": 3, "noise_db": 20.0, "sensitivity_db": 3.0, "microphones": 32}
    | {"range_max_m": 2500.0, "report": ["plots"], "scan": staring(0.5)}
    | dict.fromkeys(("azimuth_beamwidth_deg", "elevation_beamwidth_deg"), 10.0),
]
DRONES = [
    {
        "id": f"drone-{n}",
        "rcs_m2": 0.02,
        "sound_power_db": 105.0,
        "speed_m_s": 20.0,
        "repeat": True,
        "path": [
            {"east_m": -1200.0 + 900 * n, "north_m": 900.0 - 300 * n, "above_site_m": 150.0},
            {"east_m": 1300.0, "north_m": 1400.0 - 500 * n, "above_site_m": 250.0},
        ],
    }
    for n in range(3)
]


def of_plots(field: str, value: Callable[[Any], Any], *, every: int = 1) -> Change:
    """What becomes of a field of all plots, of some scans."""

    def change(batch: pb.PlotBatch) -> None:
        for plot in batch.plots if batch.scan % every == 0 else ():
            setattr(plot, field, value(getattr(plot, field)))

    return change


def one_short(batch: pb.PlotBatch) -> None:
    del batch.plots[1:]


ON_THE_WIRE: dict[str, tuple[Change, set[str]]] = {
    "azimuth off by 0.3 degrees": (
        of_plots("azimuth_deg", lambda deg: (deg + 0.3) % 360),
        {"azimuth"},
    ),
    "ranges one per cent too long": (of_plots("range_m", lambda m: 1.01 * m), {"range"}),
    "times a second late": (of_plots("time_utc_ns", lambda ns: ns + 10**9), {"time"}),
    "sigma two and a half times too small": (
        of_plots("sigma_azimuth_deg", lambda deg: deg / 2.5),
        {"azimuth spread", "azimuth sigma"},
    ),
    "heights above the sea for the ellipsoid": (
        of_plots("height_m", lambda m: m - 51.0),
        {"height"},
    ),
    "range rates of the other sign": (of_plots("range_rate_m_s", lambda m_s: -m_s), {"range rate"}),
    "plots that are not sent": (one_short, {"plots"}),
    "a few plots half a kilometre off": (
        of_plots("range_m", lambda m: m + 500.0, every=50),
        {"range spread"},
    ),
}


def seldom(entry: pb.Ledger, rng: np.random.Generator) -> None:
    for look in entry.looks:
        look.detected &= bool(rng.random() < 0.6)


def scans_are_missed(entry: pb.Ledger, _: np.random.Generator) -> None:
    if entry.scan % 20 == 0:
        entry.Clear()


IN_THE_LEDGER: dict[str, tuple[Any, set[str]]] = {
    "three in five are detected": (seldom, {"Pd"}),
    "scans are missed": (scans_are_missed, {"missed scans"}),
}


IN_THE_SESSION: dict[str, tuple[str, Keys, set[str]]] = {
    "bias of the other sign": (
        "fine",
        {"bias": {"azimuth_offset_deg": -2.0, "range_offset_m": 30.0, "time_offset_s": 0.5}},
        {"azimuth"},
    ),
    "four times the false alarms": ("fine", {"pfa": 4e-5}, {"false alarms"}),
    "errors that are larger than stated": (
        "fine",
        {"degradation": {"error_factor": 2.0}},
        {f"{q} spread" for q in ("range", "azimuth", "elevation", "height", "range rate")},
    ),
    "more clutter": ("fine", {"degradation": {"false_alarm_factor": 4.0}}, {"false alarms"}),
    "another north": ("coarse", {"bias": {"azimuth_offset_deg": 0.3}}, {"azimuth"}),
    "a clock that is ahead": ("coarse", {"bias": {"time_offset_s": 1.0}}, {"time"}),
}
FAULTS = [*ON_THE_WIRE, *IN_THE_LEDGER, *IN_THE_SESSION]


def id_of(fault: str) -> str:
    """The sensor that has it."""
    return f"fault-{FAULTS.index(fault)}"


def sensors_with(changes: dict[str, Keys]) -> list[Keys]:
    """Right sensors and one for each fault, and what some of those do otherwise."""
    sensors, of_id = [*RIGHT], {sensor["id"]: sensor for sensor in RIGHT}
    for fault in FAULTS:
        like = of_id[IN_THE_SESSION[fault][0] if fault in IN_THE_SESSION else "fine"]
        of_its_own: Keys = {"id": id_of(fault), "sic": 10 + FAULTS.index(fault)}
        if fault not in IN_THE_LEDGER:  # as often, in one sector for four
            of_its_own["scan"] = staring(0.5)
        sensors.append(like | of_its_own | changes.get(fault, {}))
    return sensors


def recorded(
    does: list[Keys], says: list[Keys], folder: Path, seconds: float = SECONDS, sea_m: float = 51.0
) -> Path:
    """What a session of the one scene did, as if it had been one of the other."""
    did, asked = (
        scene(sensors, DRONES, seed=5, telemetry={"geoid_undulation_m": level_m})
        for sensors, level_m in ((does, sea_m), (says, 51.0))
    )
    return record_session(did, folder / "record.mcap", seconds, says=asked)


def of_batch(change: Change, payload: bytes) -> bytes:
    """A batch with that change."""
    batch = pb.PlotBatch.FromString(payload)
    change(batch)
    return batch.SerializeToString()


def planted(messages: Iterable[Recorded]) -> Iterator[Recorded]:
    """With the faults of the wire and of the ledger."""
    on_the_wire = {f"plotfeed/{id_of(f)}/plots": change for f, (change, _) in ON_THE_WIRE.items()}
    in_the_ledger = {id_of(f): change for f, (change, _) in IN_THE_LEDGER.items()}
    rngs = {name: np.random.default_rng(3) for name in in_the_ledger}
    for each in messages:
        if each.topic in on_the_wire:
            yield each._replace(payload=of_batch(on_the_wire[each.topic], each.payload))
        elif each.topic.endswith("/truth"):
            for entry in entries_in(each.payload):
                if entry.sensor in in_the_ledger:
                    in_the_ledger[entry.sensor](entry, rngs[entry.sensor])
                if entry.sensor:
                    payload, kind = entry.SerializeToString(), protobuf_content_type(LEDGER)
                    yield each._replace(payload=payload, content_type=kind)
        else:
            yield each


def wrong_in(report: FeedReport) -> dict[str, set[str]]:
    """What is named, by sensor, in the order of what is worse: bias, spread, outliers."""
    wrong: dict[str, set[str]] = {}
    for check in report.verdicts.wrong:
        name = "Pd" if check.name.startswith("Pd") else check.name
        wrong.setdefault(check.sensor, set()).add(name)
    for names in wrong.values():  # a systematic error that grows with range scatters too
        names -= {f"{name.removesuffix(' spread')} outliers" for name in names}
        names -= {f"{name} spread" for name in names}
    return wrong


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> FeedReport:
    folder = tmp_path_factory.mktemp("faults")
    does = sensors_with({fault: keys for fault, (_, keys, _) in IN_THE_SESSION.items()})
    record = recorded(does, sensors_with({}), folder)
    return told(changed(record, folder / "planted.mcap", planted))


def test_nothing_is_wrong_where_all_is_right(report: FeedReport) -> None:
    assert wrong_in(report).keys() == {id_of(fault) for fault in FAULTS}
    ids = {sensor["id"] for sensor in RIGHT}
    right = [sensor for sensor in report.sensors if sensor.sensor in ids]
    assert len(right) == len(RIGHT)
    assert report.verdicts.judged > 20 * len(report.sensors)
    assert {sensor.joined == sensor.plots > 100 for sensor in right} == {True}
    assert {s.plots_from.partition(",")[0] for s in right} == {"plots", "asterix/048"}
    contradicted = {sensor.sensor: sensor.contradicted for sensor in report.sensors}
    assert [contradicted[each] for each in ids] == [0, 0, 0]
    (short,) = (s for s in report.sensors if s.sensor == id_of("plots that are not sent"))
    assert 0 < short.contradicted == short.plots - short.joined


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_wrong_is_named(fault: str, report: FeedReport) -> None:
    found = wrong_in(report)[id_of(fault)]
    assert found == (ON_THE_WIRE | IN_THE_LEDGER | IN_THE_SESSION)[fault][-1]


def test_mean_sea_level_taken_for_the_ellipsoid_is_named(tmp_path: Path) -> None:
    record = recorded(RIGHT, RIGHT, tmp_path, 30.0, sea_m=0.0)
    assert wrong_in(told(record)) == {"coarse": {"height"}}


SIGMAS = {f"{quantity} sigma" for quantity in ("range", "azimuth", "elevation")}
IN_THE_PROCESS: dict[str, tuple[type, str, str, float, set[str]]] = {
    "MIMO radar sees less": (PolarRadar, "pd", "mimo", 0.6, {"Pd"}),
    "microphones hear less": (MicrophoneArray, "pd", "microphones", 0.6, {"Pd"}),
    "radar errs and says so": (PolarRadar, "sigmas", "active", 2.5, SIGMAS),
}


@pytest.mark.parametrize("fault", IN_THE_PROCESS)
def test_a_fault_of_the_running_process_is_named(
    fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In 40 s; what works too well for chance is named with all ranges that show it."""
    kind, method, sensor, factor, named = IN_THE_PROCESS[fault]
    right: Callable[..., Any] = getattr(kind, method)
    scale = 0.05 if sensor == "microphones" else 1.0
    drones = [held(f"d{i}", 60 * i + 5.0, 12.0, 2000.0 * scale, rcs_m2=1.0) for i in range(5)]
    made = scene([SENSORS[sensor] | {"report": ["plots"], "sic": 1}], drones, seed=4)
    with monkeypatch.context() as patched:
        patched.setattr(kind, method, lambda self, *of: factor * right(self, *of))
        record = record_session(made, tmp_path / "record.mcap", 40.0)
    for against in get_args(Against):
        wrong = {each.name for each in FeedReport(record, against).verdicts.wrong}
        assert named <= wrong
        assert all(name.startswith("Pd") for name in wrong - named)


SPREADS = {f"{quantity} spread" for quantity in ("range", "azimuth", "elevation", "height")}
LEVEL = {"range spread", "azimuth spread"}
OF_SEVERAL: dict[str, tuple[Keys, Change | None, set[str]]] = {
    "none": ({}, None, set()),
    "azimuth": ({}, of_plots("azimuth_deg", lambda deg: (deg + 2) % 360), {"azimuth"}),
    "height datum": ({}, of_plots("height_m", lambda m: m - 51.0), {"height"}),
    "a second late": ({"bias": {"time_offset_s": 1.0}}, None, {"time"}),
    "sigma x 2.5": ({"degradation": {"error_factor": 2.5}}, None, LEVEL),
    "sigma / 2": ({"degradation": {"error_factor": 0.5}}, None, SPREADS),
    "Pd x 0.6": ({"degradation": {"pd_factor": 0.6}}, None, {"Pd"}),
    "sigma that lies": ({}, of_plots("sigma_range_m", lambda m: m / 2), {"range sigma"}),
}


@pytest.mark.parametrize("sensor", ["masts", "spread"])
def test_faults_of_several_receivers_are_named(sensor: str, tmp_path: Path) -> None:
    """Their places are off by what the expected height leaves of them, which is no fault."""
    tree = tomllib.loads(SEVERAL.read_text())
    right = next(own for own in tree["sensor"] if own["id"] == sensor) | {"report": ["plots"]}
    says = [right | {"id": f"{n}", "sic": n + 1} for n in range(len(OF_SEVERAL))]
    does = [own | change for own, (change, *_) in zip(says, OF_SEVERAL.values(), strict=True)]
    did, asked = (scene(sensors, tree["drone"], seed=5) for sensors in (does, says))
    record = record_session(did, tmp_path / "did.mcap", 40.0, says=asked)
    on_the_way = {f"plotfeed/{n}/plots": of for n, (_, of, _) in enumerate(OF_SEVERAL.values())}

    def plant(messages: Iterable[Recorded]) -> Iterator[Recorded]:
        for each in messages:
            change = on_the_way.get(each.topic)
            yield each if change is None else each._replace(payload=of_batch(change, each.payload))

    record = changed(record, tmp_path / "planted.mcap", plant)
    for against in get_args(Against):
        wrong = wrong_in(FeedReport(record, against))
        found = {fault: wrong.get(f"{n}", set()) for n, fault in enumerate(OF_SEVERAL)}
        # Detections that err by so much are seldom joined: by heights there may be too few plots.
        found["sigma x 2.5"] -= {"elevation spread", "height spread"}
        assert found == {fault: named for fault, (*_, named) in OF_SEVERAL.items()}
