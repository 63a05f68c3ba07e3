"""Scenes flown in simulated time: every SAPIENT message of every kind of sensor."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sapient_msg.bsi_flex_335_v2_0.registration_pb2 import Registration
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from sapient_msg.bsi_flex_335_v2_0.status_report_pb2 import StatusReport
from support.every_kind import GATE, MICROPHONES, PASSIVE
from support.sapient_rules import assert_declared, checked, checked_together

from plotfeed.feeds.formats import Batch
from plotfeed.feeds.formats.sapient.sapient_node import SapientReports
from plotfeed.feeds.scene.presets.preset import names
from plotfeed.feeds.scene.scene import example, from_tree
from plotfeed.models.beam import Timetable
from plotfeed.models.state import Plots
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.testing import START_NS, Feed, fly, held, radar, rotating, scene, staring

EMITTER = {
    "frequency_hz": 2.437e9, "bandwidth_hz": 1e6, "eirp_dbm": 20.0, "kind": "remote-id",
    "identity": "1596F3",
}  # fmt: skip
FINDER = {
    "type": "rf", "scan": staring(), "frequency_min_hz": 2.40e9, "frequency_max_hz": 2.48e9,
    "channel_bandwidth_hz": 1e6, "integration_s": 1e-3, "range_max_m": 20e3,
    "decodes": ["remote-id"],
}  # fmt: skip
SENSORS = [
    radar(id="turning", scan=rotating(1.0, 32), pfa=1e-5),
    radar(id="staring", measures_elevation=True),
    radar(id="flat", measures_elevation=False),
    radar(id="hasty", scan=staring(0.025), integration_s=0.01),
    GATE | {"id": "gate", "range_max_m": 5e3, "sigma_m": 5.0},
    FINDER | {"id": "finder", "baseline_m": 0.06},
    FINDER | {"id": "omni", "measures_azimuth": False},
]
DRONES = [
    held("near", 45.0, 20.0, 800.0, rcs_m2=0.1, sound_power_db=95.0, emitters=[EMITTER]),
    held("zenith", 0.0, 89.99, 300.0, rcs_m2=0.1),
]
OF_THE_PAPER = ("active", "mimo", "passive", "microphone")


def built(seed: int = 5, **settings: Any) -> Feed:
    sensors = [{**sensor, "report": ["sapient", "plots"]} for sensor in SENSORS]
    return fly(scene(sensors, DRONES, seed=seed, sapient=settings), 12.0)


@cache
def plain() -> Feed:
    return built()


@cache
def on_earth() -> Feed:
    return built(location="location", default_class="Air Vehicle", default_class_confidence=0.8)


@cache
def section_4() -> Feed:
    """The paper's sensors, and a drone that each of them finds."""
    usual = example("section-4")
    tree = usual.model_dump(exclude_none=True, exclude_defaults=True)
    for sensor in tree["sensor"]:
        sensor["report"] = ["sapient", "plots"]
    tree["drone"] = [held("near", 20.0, 20.0, 400.0, rcs_m2=1.0, sound_power_db=95.0)]
    return fly(from_tree(tree, usual.folder / "section-4.toml"), 30.0)


RUNS = [
    *((run, sensor["id"]) for run in (plain, on_earth) for sensor in SENSORS),
    *((section_4, sensor) for sensor in OF_THE_PAPER),
]


@cache
def messages_of(run: Callable[[], Feed], sensor: str) -> list[SapientMessage]:
    return [checked(payload) for payload in run().payloads(f"{sensor}/sapient")]


def detections(run: Callable[[], Feed], sensor: str) -> list[SapientMessage]:
    return [m for m in messages_of(run, sensor) if m.HasField("detection_report")]


def plots_of(run: Callable[[], Feed], sensor: str) -> list[pb.Plot]:
    batches = [pb.PlotBatch.FromString(p) for p in run().payloads(f"{sensor}/plots")]
    return [plot for batch in batches for plot in batch.plots]


@pytest.mark.parametrize(("run", "sensor"), RUNS)
def test_every_message_is_valid_and_every_plot_is_in_one(
    run: Callable[[], Feed], sensor: str
) -> None:
    """Detections are in order and 80 ms apart, and stamps are of the time of sending."""
    found = messages_of(run, sensor)
    assert [m.WhichOneof("content") for m in found[:2]] == ["registration", "status_report"]
    checked_together(found)
    reported = [m.detection_report for m in found if m.HasField("detection_report")]
    plots, late = len(plots_of(run, sensor)), 60 if sensor == "turning" else 0
    assert max(plots - late, 1) <= len(reported) <= plots
    ids = {report.object_id for report in reported} | {report.report_id for report in reported}
    assert len(ids) == 2 * len(reported)
    stamps = [m.timestamp.ToNanoseconds() for m in detections(run, sensor)]
    assert all(b == a or b - a >= 80_000_000 for a, b in pairwise(stamps))
    sent = [m.due_utc_ns for m in run().messages if m.topic == f"plotfeed/{sensor}/sapient"]
    for due_ns, message in zip(sent, found, strict=True):
        assert 0 <= due_ns - message.timestamp.ToNanoseconds() < 1000


def test_detections_say_what_the_plots_say() -> None:
    pairs = {
        "azimuth": "azimuth_deg",
        "elevation": "elevation_deg",
        "range": "range_m",
        "azimuth_error": "sigma_azimuth_deg",
        "range_error": "sigma_range_m",
    }
    for sensor in ("staring", "flat", "finder"):
        reports = [m.detection_report.range_bearing for m in detections(plain, sensor)]
        for report, plot in zip(reports, plots_of(plain, sensor), strict=True):
            for theirs, ours in pairs.items():
                assert report.HasField(theirs) == plot.HasField(ours), (sensor, theirs)
                assert getattr(report, theirs) == getattr(plot, ours)


def test_ages_tell_the_time_of_measurement() -> None:
    times_ns = {plot.time_utc_ns for plot in plots_of(plain, "turning")}
    for message in detections(plain, "turning"):
        (age,) = (i.value for i in message.detection_report.object_info if i.type == "age")
        measured_ns = message.timestamp.ToNanoseconds() - float(age) * 1e9
        assert min(abs(measured_ns - t) for t in times_ns) < 2000
        assert 0 <= float(age) <= 0.094


def test_places_on_earth_are_those_of_the_plots() -> None:
    plots = plots_of(on_earth, "staring")
    for message, plot in zip(detections(on_earth, "staring"), plots, strict=True):
        place = message.detection_report.location
        assert place.z == pytest.approx(plot.height_m, abs=1e-6)
    near = [
        m.detection_report.location
        for m in detections(on_earth, "gate")
        if m.detection_report.location.x > -3.727
    ]
    # 800 m at 20 degrees: 751.8 m to the north-east, 273.6 m up; a range gate errs by 5 m each way.
    assert np.mean([p.z for p in near]) == pytest.approx(650 + 273.6, abs=8)
    assert np.mean([p.y for p in near]) == pytest.approx(40.45 + 531.6 / 111_035, abs=8 / 111e3)
    assert np.mean([p.x for p in near]) == pytest.approx(-3.73 + 531.6 / 84_830, abs=8 / 84e3)
    assert near[0].z_error == pytest.approx(5.0, rel=0.2)
    assert near[0].y_error * 111_035 == pytest.approx(5.0, rel=0.2)


def test_sensors_without_a_place_keep_to_range_and_bearing() -> None:
    for sensor in ("flat", "finder"):
        kinds = {
            m.detection_report.WhichOneof("location_oneof") for m in detections(on_earth, sensor)
        }
        assert kinds == {"range_bearing"}


def test_a_detector_without_directions_tells_of_its_surroundings() -> None:
    for message in detections(plain, "omni"):
        place = message.detection_report.location
        assert place.x == pytest.approx(-3.73)
        assert place.y == pytest.approx(40.45)
        assert place.y_error * 111_000 == pytest.approx(10e3, rel=0.01)


def test_classes_and_identities() -> None:
    (kinds,) = {
        m.detection_report.classification[0].type
        for m in detections(plain, "finder")
        if m.detection_report.classification
    }
    assert kinds == "remote-id"
    report = next(
        m.detection_report for m in detections(on_earth, "finder") if m.detection_report.id
    )
    assert report.id == "1596F3"
    assert report.classification[0].type == "Air Vehicle"
    assert report.classification[0].sub_class[0].type == "remote-id"
    assert report.classification[0].confidence == pytest.approx(0.8)
    assert report.signal[0].centre_frequency == pytest.approx(2.44e9, rel=1e-6)
    assert all(m.detection_report.classification for m in detections(on_earth, "turning"))


def test_nodes_register_as_what_they_are() -> None:
    types = {
        sensor: messages_of(run, sensor)[0].registration.node_definition[0].node_type
        for run, sensors in ((plain, ("gate", "finder")), (section_4, OF_THE_PAPER))
        for sensor in sensors
    }
    assert types == {
        "gate": Registration.NODE_TYPE_OTHER,
        "finder": Registration.NODE_TYPE_PASSIVE_RF,
        "active": Registration.NODE_TYPE_RADAR,
        "mimo": Registration.NODE_TYPE_RADAR,
        "passive": Registration.NODE_TYPE_RADAR,
        "microphone": Registration.NODE_TYPE_ACOUSTIC,
    }


def test_statuses_come_at_their_interval_and_end_with_goodbye() -> None:
    statuses = [m for m in messages_of(plain, "staring") if m.HasField("status_report")]
    times_s = [round((m.timestamp.ToNanoseconds() - START_NS) / 1e9) for m in statuses]
    assert times_s == [0, 5, 10, 12]
    assert [(m.status_report.system, m.status_report.info) for m in statuses] == [
        (StatusReport.SYSTEM_OK, StatusReport.INFO_NEW),
        (StatusReport.SYSTEM_OK, StatusReport.INFO_UNCHANGED),
        (StatusReport.SYSTEM_OK, StatusReport.INFO_UNCHANGED),
        (StatusReport.SYSTEM_GOODBYE, StatusReport.INFO_NEW),
    ]


def test_what_was_not_finished_is_not_sent_later() -> None:
    """Behind by more than a scan, a session goes on with the present."""
    turning = scene([radar(report=["sapient"], scan=rotating(1.0, 32))], seed=1)
    reports = SapientReports(turning, turning.sensor[0])

    def sent(index: int, scan: int) -> int:
        sector = Timetable(10**9, 32).sector(scan, index)
        plot = Plots.of(t_utc_ns=np.array([sector.start_ns]), azimuth_deg=np.array([1.0]))
        return len(reports.messages_of(Batch.of_one(sector, plot)))

    scan = 3 * 10**8
    for index, expected in ((0, 0), (1, 0), (2, 3), (3, 0), (4, 0)):
        assert sent(index, scan) == expected
    assert [sent(index, scan + 3) for index in (0, 1, 2)] == [0, 0, 3]


# What detections tell of is what Registrations declare, of every kind of sensor and preset.

KINDS = ("control", "video", "remote-id", "wifi")
BANDS_HZ = (433.5e6, 915e6, 2.437e9, 5.8e9)
EMITTERS = [
    {"frequency_hz": f, "bandwidth_hz": 1e5, "eirp_dbm": 30.0, "kind": k, "identity": f"{k}-1"}
    for k in KINDS
    for f in BANDS_HZ
] + [{"frequency_hz": 2.44e9, "bandwidth_hz": 1e5, "eirp_dbm": 30.0}]
WIDE_FINDER = {
    "type": "rf", "scan": staring(), "frequency_min_hz": 400e6, "frequency_max_hz": 6e9,
    "channel_bandwidth_hz": 1e6, "integration_s": 1e-4, "range_max_m": 20e3, "baseline_m": 0.06,
    "pfa": 1e-3,
}  # fmt: skip
# They look at the first of the drones.
ZOOMED_OUT = {
    name: {"horizontal_fov_deg": 15.0, "vertical_fov_deg": 10.0, "tilt_deg": 6.0}
    for name in ("axis-q6215-le", "droneopt", "indra-arms-optronic", "triton-pt")
}
OF_EACH_KIND: dict[str, dict[str, Any]] = {
    "turning": radar(scan=rotating(1.0, 32), pfa=1e-5),
    "rates": radar(measures_elevation=False, doppler={}),
    "gate": GATE,
    "microphone": MICROPHONES | {"noise_db": 20.0, "kind": "multirotor"},
    "camera": {
        "type": "camera", "scan": staring(), "horizontal_fov_deg": 90.0, "pixels_across": 8000,
        "pixels_down": 4000, "range_max_m": 5000.0, "pan_deg": 30.0,
    },
    "finder": WIDE_FINDER,
    "names all": WIDE_FINDER | {"classifies": True},
    "reads one": WIDE_FINDER | {"decodes": ["remote-id"]},
    "names all and reads two": WIDE_FINDER | {"classifies": True, "decodes": ["remote-id", "wifi"]},
    "passive": PASSIVE | {"doppler": {}},
}  # fmt: skip
PRESETS = {name: {"preset": name} | ZOOMED_OUT.get(name, {}) for name in names()}
# The nearest have all emissions.
ALL_AROUND = [
    held(
        f"d{i}", 30.0 * i, 6.0, range_m, rcs_m2=1.0, sound_power_db=110.0,
        emitters=EMITTERS if range_m == 90.0 else EMITTERS[:1],
    )
    for i, range_m in enumerate((90.0, 200.0, 400.0, 1000.0) * 3)
]  # fmt: skip
MANNERS: dict[str, dict[str, Any]] = {
    "plain": {},
    "of a class on the Earth": {
        "default_class": "Air Vehicle", "default_class_confidence": 0.8, "location": "location",
    },
}  # fmt: skip
TOLD = [
    *(("plain", name) for name in OF_EACH_KIND | PRESETS),
    *(("of a class on the Earth", name) for name in OF_EACH_KIND),
]


@cache
def told_by(manner: str) -> dict[str, list[SapientMessage]]:
    """Of every sensor; twelve drones and four kinds of emission are near all of them."""
    keys = {name: (OF_EACH_KIND | PRESETS)[name] for told, name in TOLD if told == manner}
    ids = {name: name.replace(" ", "-") for name in keys}
    sensors = [keys[name] | {"id": ids[name], "report": ["sapient"]} for name in keys]
    road = fly(scene(sensors, ALL_AROUND, seed=9, sapient=MANNERS[manner]), 4.0)
    return {
        name: [SapientMessage.FromString(payload) for payload in road.payloads(f"{its_id}/sapient")]
        for name, its_id in ids.items()
    }


@pytest.mark.parametrize(("manner", "sensor"), TOLD)
def test_whatever_a_detection_tells_of_was_registered(sensor: str, manner: str) -> None:
    first, *others = told_by(manner)[sensor]
    assert first.HasField("registration")
    detections = [m for m in others if m.HasField("detection_report")]
    for message in (first, *detections[:5]):
        checked(message.SerializeToString())
    assert detections
    for detection in detections:
        assert_declared(first.registration, detection.detection_report)


def classes_of(sensor: str, manner: str) -> set[tuple[str, ...]]:
    """Classes of detections, with their sub-classes."""
    found = set()
    for message in told_by(manner)[sensor]:
        if message.HasField("detection_report"):
            classes = message.detection_report.classification
            found.add(
                tuple(name for c in classes for name in [c.type, *(s.type for s in c.sub_class)])
            )
    return found


def test_a_sensor_that_names_emissions_registers_those_of_the_scene() -> None:
    assert classes_of("names all", "plain") == {(), *((kind,) for kind in KINDS)}
    assert classes_of("reads one", "plain") == {(), ("remote-id",)}
    above = {("Air Vehicle",), *(("Air Vehicle", kind) for kind in KINDS)}
    assert classes_of("names all", "of a class on the Earth") == above
    registration = told_by("plain")["names all and reads two"][0].registration
    assert set(_declared(registration)) == set(KINDS)


def _declared(registration: Registration) -> list[str]:
    (definition,) = (
        registration.mode_definition[0].detection_definition[0].detection_class_definition
    )
    return [each.type for each in definition.class_definition]


@pytest.mark.parametrize("sensor", ["turning", "names all", "gate"])
def test_detections_of_drones_are_surer_than_false_alarms(sensor: str) -> None:
    """As the ledger tells them apart, in the order of reports; a gate has no false alarms."""
    drones, alarms = confidences(sensor)
    assert len(drones) > 20
    assert np.mean(drones) > 0.8
    if sensor == "gate":
        assert (drones == 1).all()
    else:
        assert len(alarms) > 10
        assert np.mean(alarms) < 0.3


def test_a_scene_may_state_one_confidence_for_all() -> None:
    drones, alarms = confidences("turning", detection_confidence=0.625)
    assert {*drones, *alarms} == {0.625}


def confidences(name: str, **settings: Any) -> tuple[NDArray[Any], NDArray[Any]]:
    """Of detections of drones, and of false alarms."""
    sensor = OF_EACH_KIND[name] | {"id": "one", "report": ["sapient"]}
    if "pfa" in sensor:
        sensor["pfa"] = 1e-3 if name == "names all" else 1e-5
    road = fly(scene([sensor], ALL_AROUND, seed=10, sapient=settings), 4.0)
    plots = [plot for entry in road.ledgers for plot in entry.plots]
    reports = [SapientMessage.FromString(p) for p in road.payloads("one/sapient")]
    told = np.array(
        [m.detection_report.detection_confidence for m in reports if m.HasField("detection_report")]
    )
    is_drone = np.array([bool(plot.drone) for plot in plots])[: len(told)]
    return told[is_drone], told[~is_drone]
