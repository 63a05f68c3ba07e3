from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.scene_files import DRONE, scene_file, scene_text

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.drones import EchoesByClass, TargetKeys
from plotfeed.feeds.scene.scene import Scene, load
from plotfeed.feeds.telemetry.position_report import Reason
from plotfeed.feeds.telemetry.receiver import MAX_REFUSALS_PER_S, TelemetryReceiver
from plotfeed.models.truth import Trajectories
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.cat129 import TargetEncoder129

S = 1_000_000_000
NOW = 1_767_268_800 * S  # 2026-01-01T12:00:00Z


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    folder = tmp_path_factory.mktemp("scene")
    return load(scene_file(folder, scene_text(telemetry="max_drones = 2", drones=DRONE, port=1883)))


def make(scene: Scene) -> tuple[TelemetryReceiver, Trajectories]:
    trajectories = Trajectories(stale_after_s=scene.telemetry.stale_after_s)
    return TelemetryReceiver(scene, trajectories), trajectories


def report(seconds: float = 0.0, **changes: Any) -> bytes:
    message = pb.Telemetry(
        latitude_deg=40.0, longitude_deg=-3.0, altitude_m=700.0, altitude_reference=pb.ELLIPSOID
    )
    message.time_utc.FromNanoseconds(NOW + round(seconds * S))
    for name, value in changes.items():
        if value is None:
            message.ClearField(name)
        else:
            setattr(message, name, value)
    return message.SerializeToString()


Case = tuple[str, bytes, str | None]
PROTOBUF = "application/x-protobuf"
REFUSED: dict[Reason, Case] = {
    Reason.OVERSIZED: ("a", b"{" + b" " * 5000, None),
    Reason.UNDECODABLE: ("a", b"\xff\xff\xff", PROTOBUF),
    Reason.CONTENT_TYPE: ("a", report(), "image/png"),
    Reason.MISSING: ("a", report(latitude_deg=None), PROTOBUF),
    Reason.NOT_FINITE: ("a", report(altitude_m=float("nan")), PROTOBUF),
    Reason.OUT_OF_RANGE: ("a", report(latitude_deg=91.0), PROTOBUF),
    Reason.ALTITUDE: ("a", report(altitude_reference=pb.ABOVE_TAKEOFF), PROTOBUF),
    Reason.BACKWARDS: ("known", report(-2.0), PROTOBUF),
    Reason.DUPLICATE: ("known", report(-1.0), PROTOBUF),
    Reason.FUTURE: ("a", report(2.1), PROTOBUF),
    Reason.STALE: ("a", report(-60.1), PROTOBUF),
    Reason.LATE: ("a", report(-59.9), PROTOBUF),
    Reason.IMPLAUSIBLE_MOTION: ("known", report(latitude_deg=40.1), PROTOBUF),
    Reason.TOO_MANY_DRONES: ("third", report(), PROTOBUF),
    Reason.NAME: ("visitor", report(), PROTOBUF),
}


def test_every_reason_has_its_case() -> None:
    not_of_reports = {Reason.FLOOD, Reason.CONTROL}
    not_of_reports.add(Reason.NO_POSITION)  # which live sources find: test_mavlink_reports
    of_several = {Reason.SECOND_SOURCE, Reason.TOO_MANY_NEW_DRONES}  # motion_gate, known_drones
    assert set(REFUSED) == set(Reason) - not_of_reports - of_several


@pytest.mark.parametrize("reason", REFUSED, ids=str)
def test_a_refusal_is_published_with_its_reason(reason: Reason, scene: Scene) -> None:
    receiver, trajectories = make(scene)
    receiver.take("plotfeed/telemetry/known", report(-1.0), PROTOBUF, NOW)
    if reason is Reason.TOO_MANY_DRONES:
        receiver.take("plotfeed/telemetry/second", report(-1.0), PROTOBUF, NOW)
    names, version = list(trajectories.names), trajectories.version
    drone, payload, content_type = REFUSED[reason]
    topic = f"plotfeed/telemetry/{drone}"
    refusal = receiver.take(topic, payload, content_type, NOW)
    assert refusal is not None
    assert refusal.topic == "plotfeed/errors"
    assert refusal.content_type == "application/json"
    told = json.loads(refusal.payload)
    assert told["reason"] == reason.value
    assert told["topic"] == topic
    assert told["drone"] == drone
    assert told["detail"].isprintable()
    assert (reason is Reason.NAME) == ("flown by the scene itself" in told["detail"])
    assert told["count"] == "1"
    assert told["time_utc"] == "2026-01-01T12:00:00Z"
    assert receiver.refused == 1
    assert (trajectories.names, trajectories.version) == (names, version)


def test_the_datum_of_the_scene_is_added(tmp_path: Path) -> None:
    text = scene_text(telemetry="takeoff_height_m = 650.0\ngeoid_undulation_m = 51.0", port=1883)
    receiver, trajectories = make(load(scene_file(tmp_path, text)))
    for drone, reference, altitude_m in (
        ("a", pb.ELLIPSOID, 751.0),
        ("b", pb.MEAN_SEA_LEVEL, 700.0),
        ("c", pb.ABOVE_TAKEOFF, 101.0),
    ):
        payload = report(altitude_m=altitude_m, altitude_reference=reference)
        assert receiver.take(f"plotfeed/telemetry/{drone}", payload, None, NOW) is None
    positions = trajectories.state_at(NOW).position_ecef_m
    assert abs(positions - positions[0]).max() < 1e-8
    (block,) = TargetEncoder129(country="ES").blocks(["d"], [NOW], [40], [-3], altitude_m=[700])
    for drone in ("d", "e"):  # by its content type, and by its looks
        content_type = "application/x-asterix; cat=129" if drone == "d" else None
        assert receiver.take(f"plotfeed/telemetry/{drone}", block, content_type, NOW) is None
    positions = trajectories.state_at(NOW).position_ecef_m
    assert abs(positions - positions[0]).max() < 0.05
    assert (receiver.taken, trajectories.names) == (5, [*"abcde"])


def test_refusals_are_published_up_to_a_rate_and_all_are_counted(scene: Scene) -> None:
    receiver, _ = make(scene)
    take: Callable[[int], Message | None] = lambda t: receiver.take(  # noqa: E731
        "plotfeed/telemetry/a", b"\xff", PROTOBUF, t
    )
    published = [take(NOW + i) for i in range(500)]
    assert sum(m is not None for m in published) == MAX_REFUSALS_PER_S
    assert receiver.refused == 500
    later = take(NOW + S)
    assert later is not None
    assert json.loads(later.payload)["count"] == "501"


TEXTS = st.text(max_size=20)


@given(
    TEXTS,
    st.binary(max_size=200) | st.text(max_size=50).map(str.encode),
    st.none() | st.sampled_from([PROTOBUF, "application/json", "a/b"]) | TEXTS,
    st.integers(0, 2**62),
)
def test_arbitrary_messages_are_refused_in_json(
    scene: Scene, topic: str, payload: bytes, content_type: str | None, now_ns: int
) -> None:
    receiver, _ = make(scene)
    refusal = receiver.take(topic, payload, content_type, now_ns)
    assert refusal is not None
    assert json.loads(refusal.payload)["reason"] in set(Reason)


def test_a_class_and_a_size_that_are_reported_are_those_of_the_drone(scene: Scene) -> None:
    receiver, trajectories = make(scene)
    said = report(-0.1, target_class="aircraft", size_m=35.8, rcs_m2=20.0)
    assert receiver.take("t/telemetry/airliner", said, PROTOBUF, NOW) is None
    assert receiver.take("t/telemetry/own", report(-0.1), PROTOBUF, NOW) is None
    signatures = trajectories.signatures
    rows = np.array([list(trajectories.names).index(name) for name in ("airliner", "own")])
    assert signatures.target_class[rows].tolist() == ["aircraft", "drone"]
    assert signatures.size_m[rows].tolist() == [35.8, scene.telemetry.size_m]
    assert signatures.rcs_m2[rows].tolist() == [20.0, scene.telemetry.rcs_m2]


def test_echoes_are_those_of_the_class_that_is_reported() -> None:
    targets = (TargetKeys(target_class="aircraft", swerling=3), TargetKeys(swerling=1))
    echoes = EchoesByClass(targets).of(["aircraft", "drone", "bird"])
    assert [None if n < 0 else echoes.kinds[n].swerling for n in echoes.kind] == [3, 1, None]
