"""What detections tell of is what Registrations declare, of every kind of sensor and preset."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sapient_msg.bsi_flex_335_v2_0.registration_pb2 import Registration
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from support.every_kind import GATE, MICROPHONES, PASSIVE
from support.sapient_rules import assert_declared, checked

from plotfeed.feeds.scene.presets.preset import names
from plotfeed.testing import fly, held, radar, rotating, scene, staring

KINDS = ("control", "video", "remote-id", "wifi")
BANDS_HZ = (433.5e6, 915e6, 2.437e9, 5.8e9)
EMITTERS = [
    {"frequency_hz": f, "bandwidth_hz": 1e5, "eirp_dbm": 30.0, "kind": k, "identity": f"{k}-1"}
    for k in KINDS
    for f in BANDS_HZ
] + [{"frequency_hz": 2.44e9, "bandwidth_hz": 1e5, "eirp_dbm": 30.0}]
FINDER = {
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
    "finder": FINDER,
    "names all": FINDER | {"classifies": True},
    "reads one": FINDER | {"decodes": ["remote-id"]},
    "names all and reads two": FINDER | {"classifies": True, "decodes": ["remote-id", "wifi"]},
    "passive": PASSIVE | {"doppler": {}},
}  # fmt: skip
PRESETS = {name: {"preset": name} | ZOOMED_OUT.get(name, {}) for name in names()}
# The nearest have all emissions.
DRONES = [
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
def messages(manner: str) -> dict[str, list[SapientMessage]]:
    """Of every sensor; twelve drones and four kinds of emission are near all of them."""
    keys = {name: (OF_EACH_KIND | PRESETS)[name] for told, name in TOLD if told == manner}
    ids = {name: name.replace(" ", "-") for name in keys}
    sensors = [keys[name] | {"id": ids[name], "report": ["sapient"]} for name in keys]
    road = fly(scene(sensors, DRONES, seed=9, sapient=MANNERS[manner]), 4.0)
    return {
        name: [SapientMessage.FromString(payload) for payload in road.payloads(f"{its_id}/sapient")]
        for name, its_id in ids.items()
    }


@pytest.mark.parametrize(("manner", "sensor"), TOLD)
def test_whatever_a_detection_tells_of_was_registered(sensor: str, manner: str) -> None:
    first, *others = messages(manner)[sensor]
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
    for message in messages(manner)[sensor]:
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
    registration = messages("plain")["names all and reads two"][0].registration
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
    road = fly(scene([sensor], DRONES, seed=10, sapient=settings), 4.0)
    plots = [plot for entry in road.ledgers for plot in entry.plots]
    reports = [SapientMessage.FromString(p) for p in road.payloads("one/sapient")]
    told = np.array(
        [m.detection_report.detection_confidence for m in reports if m.HasField("detection_report")]
    )
    is_drone = np.array([bool(plot.drone) for plot in plots])[: len(told)]
    return told[is_drone], told[~is_drone]
