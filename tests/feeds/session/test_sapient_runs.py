"""Scenes flown in simulated time: every SAPIENT message of every kind of sensor and preset."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sapient_msg.bsi_flex_335_v2_0.registration_pb2 import Registration
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from sapient_msg.bsi_flex_335_v2_0.status_report_pb2 import StatusReport
from support.every_kind import FAR_SENSORS, GATE, MICROPHONES, MIMO, PASSIVE
from support.sapient_rules import assert_declared, checked, checked_together

from plotfeed.feeds.formats import Batch
from plotfeed.feeds.formats.sapient.sapient_node import SapientReports
from plotfeed.feeds.scene.presets.preset import names
from plotfeed.models.beam import Timetable
from plotfeed.models.state import Plots
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS
from plotfeed.testing import START_NS, Feed, fly, held, radar, rotating, scene, staring

FOR_S = 6.0
EMISSIONS = ("control", "video", "remote-id", "wifi")
EMITTERS = [
    {"frequency_hz": f, "bandwidth_hz": 1e5, "eirp_dbm": 30.0, "kind": k, "identity": f"{k}-1"}
    for k in EMISSIONS
    for f in (433.5e6, 915e6, 2.437e9, 5.8e9)
] + [{"frequency_hz": 2.44e9, "bandwidth_hz": 1e5, "eirp_dbm": 30.0}]
FINDER = {
    "type": "rf", "scan": staring(), "frequency_min_hz": 400e6, "frequency_max_hz": 6e9,
    "channel_bandwidth_hz": 1e6, "integration_s": 1e-4, "range_max_m": 20e3, "baseline_m": 0.06,
    "pfa": 1e-3,
}  # fmt: skip
OF_WIFI = FINDER | {
    "frequency_min_hz": 2.40e9, "frequency_max_hz": 2.48e9, "integration_s": 1e-3, "pfa": 1e-6,
    "decodes": ["remote-id"],
}  # fmt: skip
KINDS: dict[str, dict[str, Any]] = {
    "turning": radar(scan=rotating(1.0, 32), pfa=1e-5),
    "staring": radar(measures_elevation=True),
    "flat": radar(measures_elevation=False),
    "hasty": radar(scan=staring(0.025), integration_s=0.01),
    "rates": radar(measures_elevation=False, doppler={}),
    "gate": GATE | {"range_max_m": 5e3, "sigma_m": 5.0},
    "mimo": MIMO,
    "passive": PASSIVE | {"doppler": {}},
    "microphone": MICROPHONES | {"noise_db": 20.0, "kind": "multirotor"},
    "camera": FAR_SENSORS["camera"] | {"pan_deg": 30.0},
    "finder": FINDER,
    "names-all": FINDER | {"classifies": True},
    "names-all-and-reads-two": FINDER | {"classifies": True, "decodes": ["remote-id", "wifi"]},
    "reads-one": OF_WIFI,
    "omni": OF_WIFI | {"measures_azimuth": False},
}
# They look at the first of the drones.
ZOOMED_OUT = {
    name: {"horizontal_fov_deg": 15.0, "vertical_fov_deg": 10.0, "tilt_deg": 6.0}
    for name in ("axis-q6215-le", "droneopt", "indra-arms-optronic", "triton-pt")
}
PRESETS = {name: {"preset": name} | ZOOMED_OUT.get(name, {}) for name in names()}
# The nearest have all emissions.
DRONES = [
    held("high", 45.0, 20.0, 800.0, rcs_m2=0.1),
    held("zenith", 0.0, 89.99, 300.0, rcs_m2=0.1),
] + [
    held(
        f"d{i}", 30.0 * i, 6.0, range_m, rcs_m2=1.0, sound_power_db=110.0,
        emitters=EMITTERS if range_m == 90.0 else EMITTERS[:1],
    )
    for i, range_m in enumerate((90.0, 200.0, 400.0, 1000.0) * 3)
]  # fmt: skip
MANNERS: dict[str, dict[str, Any]] = {
    "plain": {},
    "on Earth": {
        "default_class": "Air Vehicle", "default_class_confidence": 0.8, "location": "location",
        "detection_confidence": 0.625,
    },
}  # fmt: skip
SENSORS = {"plain": KINDS | PRESETS, "on Earth": KINDS}
RUNS = [(manner, sensor) for manner, sensors in SENSORS.items() for sensor in sensors]


@cache
def flown(manner: str) -> Feed:
    sensors = [
        keys | {"id": name, "report": ["sapient", "plots"]}
        for name, keys in SENSORS[manner].items()
    ]
    return fly(scene(sensors, DRONES, seed=9, sapient=MANNERS[manner]), FOR_S)


@cache
def messages_of(sensor: str, manner: str = "plain") -> list[SapientMessage]:
    return [checked(payload) for payload in flown(manner).payloads(f"{sensor}/sapient")]


def detections(sensor: str, manner: str = "plain") -> list[Any]:
    told = messages_of(sensor, manner)
    return [m.detection_report for m in told if m.HasField("detection_report")]


def plots_of(sensor: str, manner: str = "plain") -> list[pb.Plot]:
    payloads = flown(manner).payloads(f"{sensor}/plots")
    return [plot for payload in payloads for plot in pb.PlotBatch.FromString(payload).plots]


@pytest.mark.parametrize(("manner", "sensor"), RUNS)
def test_every_message_is_valid_and_every_plot_is_in_one_as_was_registered(
    manner: str, sensor: str
) -> None:
    """Detections are in order and 80 ms apart, and stamps are of the time of sending."""
    found, reported = messages_of(sensor, manner), detections(sensor, manner)
    assert [m.WhichOneof("content") for m in found[:2]] == ["registration", "status_report"]
    checked_together(found)
    for report in reported:
        assert_declared(found[0].registration, report)
    # Of the last, some are not sent yet.
    times_ns = [plot.time_utc_ns for plot in plots_of(sensor, manner)]
    long_ago = sum(t_ns < START_NS + (FOR_S - 2) * NS for t_ns in times_ns)
    assert max(long_ago, 1) <= len(reported) <= len(times_ns)
    ids = {report.object_id for report in reported} | {report.report_id for report in reported}
    assert len(ids) == 2 * len(reported)
    stamps = [m.timestamp.ToNanoseconds() for m in found]
    of_detections = [
        t for t, m in zip(stamps, found, strict=True) if m.HasField("detection_report")
    ]
    assert all(b == a or b - a >= 80_000_000 for a, b in pairwise(of_detections))
    sent = flown(manner).messages
    due_ns = [m.due_utc_ns for m in sent if m.topic == f"plotfeed/{sensor}/sapient"]
    assert all(0 <= due - stamp < 1000 for due, stamp in zip(due_ns, stamps, strict=True))


def test_detections_say_what_the_plots_say() -> None:
    pairs = {
        "azimuth": "azimuth_deg",
        "elevation": "elevation_deg",
        "range": "range_m",
        "azimuth_error": "sigma_azimuth_deg",
        "range_error": "sigma_range_m",
    }
    for sensor in ("staring", "flat", "reads-one"):
        for report, plot in zip(detections(sensor), plots_of(sensor), strict=True):
            for theirs, ours in pairs.items():
                assert report.range_bearing.HasField(theirs) == plot.HasField(ours), theirs
                assert getattr(report.range_bearing, theirs) == getattr(plot, ours)


def test_ages_tell_the_time_of_measurement() -> None:
    times_ns = {plot.time_utc_ns for plot in plots_of("turning")}
    for message in messages_of("turning"):
        if message.HasField("detection_report"):
            (age,) = (i.value for i in message.detection_report.object_info if i.type == "age")
            measured_ns = message.timestamp.ToNanoseconds() - float(age) * 1e9
            assert min(abs(measured_ns - t) for t in times_ns) < 2000
            assert 0 <= float(age) <= 0.094


def test_places_on_earth_are_those_of_the_plots_where_they_have_one() -> None:
    plots = plots_of("staring", "on Earth")
    for report, plot in zip(detections("staring", "on Earth"), plots, strict=True):
        assert report.location.z == pytest.approx(plot.height_m, abs=1e-6)
    of_gate = [report.location for report in detections("gate", "on Earth")]
    high = [place for place in of_gate if place.z > 850 and place.x > -3.729]
    # 800 m at 20 degrees: 751.8 m to the north-east, 273.6 m up; a range gate errs by 5 m each way.
    assert np.mean([p.z for p in high]) == pytest.approx(650 + 273.6, abs=8)
    assert np.mean([p.y for p in high]) == pytest.approx(40.45 + 531.6 / 111_035, abs=8 / 111e3)
    assert np.mean([p.x for p in high]) == pytest.approx(-3.73 + 531.6 / 84_830, abs=8 / 84e3)
    assert high[0].z_error == pytest.approx(5.0, rel=0.2)
    assert high[0].y_error * 111_035 == pytest.approx(5.0, rel=0.2)
    for sensor in ("flat", "finder"):
        kinds = {r.WhichOneof("location_oneof") for r in detections(sensor, "on Earth")}
        assert kinds == {"range_bearing"}
    for report in detections("omni"):  # which tells of its surroundings
        assert report.location.x == pytest.approx(-3.73)
        assert report.location.y == pytest.approx(40.45)
        assert report.location.y_error * 111_000 == pytest.approx(10e3, rel=0.01)


def classes_of(sensor: str, manner: str) -> set[tuple[str, ...]]:
    """Classes of detections, with their sub-classes."""
    return {
        tuple(
            name for c in report.classification for name in [c.type, *(s.type for s in c.sub_class)]
        )
        for report in detections(sensor, manner)
    }


def test_classes_and_identities_are_those_of_the_emissions_of_the_scene() -> None:
    assert classes_of("names-all", "plain") == {(), *((kind,) for kind in EMISSIONS)}
    assert classes_of("reads-one", "plain") == {(), ("remote-id",)}
    above = {("Air Vehicle",), *(("Air Vehicle", kind) for kind in EMISSIONS)}
    assert classes_of("names-all", "on Earth") == above
    assert classes_of("turning", "on Earth") == {("Air Vehicle",)}
    registered = messages_of("names-all-and-reads-two")[0].registration.mode_definition[0]
    (definition,) = registered.detection_definition[0].detection_class_definition
    assert {each.type for each in definition.class_definition} == set(EMISSIONS)
    report = next(r for r in detections("reads-one", "on Earth") if r.id)
    assert report.id == "remote-id-1"
    assert report.classification[0].sub_class[0].type == "remote-id"
    assert report.classification[0].confidence == pytest.approx(0.8)
    assert report.signal[0].centre_frequency == pytest.approx(2.44e9, rel=1e-6)


def test_nodes_register_as_what_they_are() -> None:
    types = {
        "gate": Registration.NODE_TYPE_OTHER,
        "finder": Registration.NODE_TYPE_PASSIVE_RF,
        "turning": Registration.NODE_TYPE_RADAR,
        "mimo": Registration.NODE_TYPE_RADAR,
        "passive": Registration.NODE_TYPE_RADAR,
        "microphone": Registration.NODE_TYPE_ACOUSTIC,
    }
    for sensor, expected in types.items():
        assert messages_of(sensor)[0].registration.node_definition[0].node_type == expected


def test_statuses_come_at_their_interval_and_end_with_goodbye() -> None:
    statuses = [m for m in messages_of("staring") if m.HasField("status_report")]
    told = [
        (
            round((m.timestamp.ToNanoseconds() - START_NS) / NS),
            m.status_report.system,
            m.status_report.info,
        )
        for m in statuses
    ]
    assert told == [
        (0, StatusReport.SYSTEM_OK, StatusReport.INFO_NEW),
        (5, StatusReport.SYSTEM_OK, StatusReport.INFO_UNCHANGED),
        (6, StatusReport.SYSTEM_GOODBYE, StatusReport.INFO_NEW),
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


def confidences(sensor: str, manner: str = "plain") -> tuple[NDArray[Any], NDArray[Any]]:
    """Of detections of drones, and of false alarms, as the ledger tells them apart, in order."""
    entries = [entry for entry in flown(manner).ledgers if entry.sensor == sensor]
    told = np.array([report.detection_confidence for report in detections(sensor, manner)])
    drones = [bool(plot.drone) for entry in entries for plot in entry.plots]
    is_drone = np.array(drones)[: len(told)]
    return told[is_drone], told[~is_drone]


def test_detections_of_drones_are_surer_than_false_alarms_unless_a_scene_states_one() -> None:
    for sensor in ("turning", "names-all"):
        drones, alarms = confidences(sensor)
        assert min(len(drones), len(alarms)) > 10
        assert np.mean(drones) > 0.8
        assert np.mean(alarms) < 0.3
    of_gate, none = confidences("gate")
    assert (len(none), {*of_gate}) == (0, {1.0})
    assert {*np.concatenate(confidences("turning", "on Earth"))} == {0.625}
