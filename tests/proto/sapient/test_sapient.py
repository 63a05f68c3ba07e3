from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
import ulid
from hypothesis import assume, given
from hypothesis import strategies as st
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage
from support.sapient_rules import ULID, UUID4, checked

from plotfeed.models.state import Plots
from plotfeed.proto.errors import DecodeError, EncodeError
from plotfeed.proto.sapient.decode_sapient import decode, retime_sapient
from plotfeed.proto.sapient.encode_sapient import (
    DetectionEncoder,
    FieldOfView,
    Node,
    Positions,
    SapientQuantity,
    registration,
    status,
)
from plotfeed.proto.sapient.envelope import MAX_IDS, Ulids, node_id

T_NS = 1_700_000_000_123_456_789
STAMP_NS = T_NS // 1000 * 1000
NODE = Node(
    seed=3,
    sensor="radar",
    node_id=node_id(3, "radar"),
    node_type="RADAR",
    sub_type="active radar",
    latitude_deg=40.45,
    longitude_deg=-3.73,
    height_m=650.0,
    steers=False,
    field=FieldOfView(
        azimuth_deg=0.0,
        horizontal_extent_deg=360.0,
        elevation_deg=10.0,
        vertical_extent_deg=20.0,
        range_max_m=20e3,
    ),
    scanning=True,
    settle_s=1.0,
    latency_s=0.09,
    status_interval_s=5.0,
    tells_location=False,
    has_threshold=True,
    capabilities=(SapientQuantity(name="range", units="m", value="20000"),),
    objects=(SapientQuantity(name="SNR", units="dB"),),
    classes=("quadcopter",),
    model="test",
    software_version="1",
)


def plots(n: int = 1, **columns: Any) -> Plots:
    given_columns = {name: np.full(n, value) for name, value in columns.items()}
    return Plots.of(t_utc_ns=np.full(n, STAMP_NS - 10_000_000), **given_columns)


def detected(node: Node = NODE, positions: Positions | None = None, **columns: Any) -> list[bytes]:
    return DetectionEncoder(node).messages(T_NS, plots(**columns), positions)


def one(node: Node = NODE, **columns: Any) -> Any:
    """The only DetectionReport of one plot."""
    (payload,) = detected(node, **columns)
    return checked(payload).detection_report


def places(**columns: Any) -> Positions:
    """Positions with those columns, and not known in the others."""
    n = len(next(iter(columns.values())))
    unknown = {field.name: np.full(n, np.nan) for field in fields(Positions)}
    return Positions(**unknown | {name: np.array(column) for name, column in columns.items()})


def names_in(message: Any) -> set[str]:
    return {field.name for field, _ in message.ListFields()}


BEYOND = places(longitude_deg=[181.0], latitude_deg=[0.0])
BARE = {"report_id", "object_id", "range_bearing"}


@given(st.sets(st.integers(0, MAX_IDS - 1), min_size=2))
def test_ids_have_the_forms_and_order_that_a_strict_middleware_asks_for(numbers: set[int]) -> None:
    names = {node_id(seed, sensor) for seed in range(9) for sensor in ("a", "b", "ä")}
    assert len(names) == 27
    assert all(UUID4.fullmatch(name) for name in names)
    ulids = Ulids(3, "a", "detections", T_NS)
    given_ids = [ulids[n] for n in sorted(numbers)]
    assert given_ids == sorted(set(given_ids))
    assert all(ULID.fullmatch(each) for each in given_ids)
    assert ulid.ULID.from_str(ulids[0]).milliseconds == T_NS // 10**6
    with pytest.raises(IndexError):
        ulids[MAX_IDS]
    keys = itertools.product((1, 2), "ab", "de", (T_NS, T_NS + 1000))
    assert len({Ulids(*key)[0] for key in keys}) == 16


def test_a_node_says_all_that_is_mandatory_with_longitude_first() -> None:
    told = checked(registration(NODE, T_NS)).registration
    assert told.icd_version == "BSI Flex 335 v2.0"
    mode = told.mode_definition[0]
    assert mode.HasField("settle_time")
    assert mode.task.region_definition.region_type
    shown = decode(registration(NODE, T_NS))["registration"]["mode_definition"][0]
    assert shown["tracking_type"] == "TRACKING_TYPE_NONE"
    place = checked(status(NODE, T_NS, new=True)).status_report.node_location
    assert (place.x, place.y) == (-3.73, 40.45)
    assert decode(status(NODE, T_NS))["status_report"]["info"] == "INFO_UNCHANGED"
    goodbye = decode(status(NODE, T_NS, system="GOODBYE", new=True))["status_report"]
    assert (goodbye["system"], goodbye["info"]) == ("SYSTEM_GOODBYE", "INFO_NEW")


def test_a_bearing_alone_is_legal_and_nothing_else_is_made_up() -> None:
    report = one(azimuth_deg=12.5)
    assert names_in(report) == BARE
    assert names_in(report.range_bearing) == {"azimuth", "coordinate_system", "datum"}


def test_what_was_measured_comes_back() -> None:
    report = one(
        replace(NODE, detection_confidence=0.75, above="Air Vehicle", tells_age=True),
        azimuth_deg=359.9,
        elevation_deg=-1.5,
        range_m=1234.5,
        sigma_azimuth_deg=0.5,
        sigma_elevation_deg=0.25,
        sigma_range_m=3.0,
        snr=100.0,
        kind="quadcopter",
        identity="1596F3",
    )
    place = report.range_bearing
    assert (place.azimuth, place.elevation, place.range) == (359.9, -1.5, 1234.5)
    assert (place.azimuth_error, place.elevation_error, place.range_error) == (0.5, 0.25, 3.0)
    infos = {info.type: info.value for info in report.object_info}
    assert infos == {"SNR": "20.00", "age": "0.010000"}
    assert report.detection_confidence == 0.75
    (found,) = report.classification
    (below,) = found.sub_class
    assert (found.type, below.type, below.level) == ("Air Vehicle", "quadcopter", 1)
    assert report.id == "1596F3"


@pytest.mark.parametrize("above", [None, "Air Vehicle"])
def test_a_class_that_was_not_registered_is_not_named(above: str | None) -> None:
    """Telemetry may bring emissions of any kind."""
    report = one(replace(NODE, above=above), azimuth_deg=1.0, kind="video")
    assert [found.type for found in report.classification] == ([above] if above else [])
    assert not any(found.sub_class for found in report.classification)


SOUTH = replace(NODE, transmitters=("north", "south"))
RATE = {"range_rate_m_s": -12.3456, "sigma_range_rate_m_s": 0.5}
RATE_ERROR = pytest.approx((0.25 + 1e-6 / 12) ** 0.5, rel=1e-7)


@pytest.mark.parametrize(
    ("node", "columns", "told"),
    [
        (SOUTH, {"bistatic_range_m": 5000.0, "sigma_bistatic_range_m": 20.0, "channel": 1},
         {"bistatic range": ("5000.00", 20.0), "transmitter": ("south", None)}),
        (NODE, RATE, {"range rate": ("-12.346", RATE_ERROR)}),
        (replace(NODE, transmitters=("a",)), RATE | {"channel": 0},
         {"bistatic range rate": ("-12.346", RATE_ERROR), "transmitter": ("a", None)}),
    ],
)  # fmt: skip
def test_what_has_no_field_is_told_of_by_name_with_its_error(
    node: Node, columns: dict[str, Any], told: dict[str, Any]
) -> None:
    found = one(node, azimuth_deg=1.0, **columns).object_info
    assert {i.type: (i.value, i.error if i.HasField("error") else None) for i in found} == told


def test_a_signal_has_amplitude_and_frequency() -> None:
    node = replace(NODE, band_hz=(2.4e9, 2.5e9))
    (signal,) = one(node, azimuth_deg=1.0, amplitude_dbm=-80.0).signal
    assert signal.amplitude == -80.0
    assert signal.centre_frequency == pytest.approx(2.45e9, rel=1e-7)


def test_nothing_of_a_plot_is_left_for_the_next() -> None:
    """One message is filled in again and again: whatever was in it must be gone."""
    full: dict[str, Any] = {
        "azimuth_deg": 10.0, "elevation_deg": 5.0, "range_m": 100.0, "sigma_range_m": 1.0,
        "snr": 10.0, "bistatic_range_m": 7.0, "sigma_bistatic_range_m": 2.0, "kind": "a",
        "range_rate_m_s": 3.0, "sigma_range_rate_m_s": 1.0, "amplitude_dbm": -50.0,
        "identity": "b",
    }  # fmt: skip
    mixed = Plots.joined([plots(**full), plots(azimuth_deg=20.0), plots(**full)])
    known_once = places(
        longitude_deg=[1.0, np.nan, np.nan],
        latitude_deg=[2.0, np.nan, np.nan],
        height_m=[np.nan, np.nan, 3.0],
    )
    encoder = DetectionEncoder(replace(NODE, band_hz=(1e9, 2e9)))
    for _ in range(2):
        reports = [checked(p).detection_report for p in encoder.messages(T_NS, mixed, known_once)]
        kinds = [r.WhichOneof("location_oneof") for r in reports]
        assert kinds == ["location", "range_bearing", "range_bearing"]
        assert not reports[0].location.HasField("z")
        assert names_in(reports[1]) == BARE
        assert not reports[1].range_bearing.HasField("range")
        assert [len(r.object_info) for r in reports] == [3, 0, 3]
        assert reports[2].range_bearing.range == 100.0


def test_an_error_of_a_plot_is_not_that_of_the_next() -> None:
    """Of two plots with one info each, of which the second has no error."""
    mixed = Plots.joined([
        plots(azimuth_deg=1.0, bistatic_range_m=7.0, sigma_bistatic_range_m=2.0),
        plots(azimuth_deg=1.0, snr=10.0),
    ])  # fmt: skip
    found = DetectionEncoder(NODE).messages(T_NS, mixed)
    infos = [checked(payload).detection_report.object_info for payload in found]
    assert [[info.HasField("error") for info in told] for told in infos] == [[True], [False]]


def test_every_detection_has_an_object_of_its_own_and_the_time_of_all() -> None:
    encoder = DetectionEncoder(NODE)
    found = [checked(p) for p in encoder.messages(T_NS, plots(500, azimuth_deg=1.0))]
    ids = {x for m in found for x in (m.detection_report.report_id, m.detection_report.object_id)}
    assert len(ids) == 1000
    assert {m.timestamp.ToNanoseconds() for m in found} == {STAMP_NS}


@pytest.mark.parametrize(
    ("make", "field"),
    [
        *((lambda c=columns: detected(**c), field) for columns, field in (
            ({"azimuth_deg": 360.0}, "azimuth"),
            ({"azimuth_deg": -0.1}, "azimuth"),
            ({"azimuth_deg": np.inf}, "azimuth"),
            ({"elevation_deg": 90.5}, "elevation"),
            ({"range_m": -1.0}, "range"),
            ({"range_m": np.inf}, "range"),
            ({"sigma_range_m": -1.0}, "range_error"),
            ({"sigma_azimuth_deg": np.inf}, "azimuth_error"),
            ({"snr": -1.0}, "SNR"),
            ({"snr": np.inf}, "SNR"),
            ({"bistatic_range_m": -5.0}, "bistatic range"),
        )),
        *((lambda m=more: detected(replace(NODE, **m), azimuth_deg=1.0), field) for more, field in (
            ({"detection_confidence": 1.4}, "detection_confidence"),
            ({"detection_confidence": np.nan}, "detection_confidence"),
            ({"class_confidence": -0.1, "above": "x"}, "class confidence"),
            ({"above": ""}, "class"),
            ({"band_hz": (2.0, 1.0)}, "start_frequency"),
        )),
        *((lambda n=node: status(replace(NODE, **n), T_NS), field) for node, field in (
            ({"latitude_deg": 90.1}, "latitude"),
            ({"longitude_deg": np.nan}, "longitude"),
            ({"height_m": np.inf}, "height"),
            ({"field": replace(NODE.field, azimuth_deg=999.0)}, "azimuth"),
        )),
        (lambda: detected(positions=BEYOND, azimuth_deg=1.0), "x"),
        (lambda: registration(replace(NODE, capabilities=()), T_NS), "capabilities"),
        (lambda: registration(replace(NODE, sensor=""), T_NS), "name"),
        *((lambda t=t: registration(NODE, t), "timestamp") for t in (-1, 2**63)),
    ],
)  # fmt: skip
def test_nonsense_is_refused_by_name(make: Callable[[], object], field: str) -> None:
    with pytest.raises(EncodeError) as caught:
        make()
    assert caught.value.field == field


def stamped(content: str, t_ns: int) -> SapientMessage:
    """A message with that content, and that time wherever it can have one."""
    message = SapientMessage(node_id=NODE.node_id)
    stamps = [message.timestamp]
    if content == "task":
        stamps += [message.task.task_start_time, message.task.task_end_time]
    elif content == "alert":
        stamps.append(message.alert.associated_detection.add().timestamp)
    else:
        report = message.detection_report
        report.detection_confidence = 0.0
        others = report.associated_detection.add(), report.derived_detection.add()
        stamps += [*(each.timestamp for each in others)]
        stamps.append(report.prediction_location.predicted_timestamp)
    for stamp in stamps:
        stamp.FromNanoseconds(t_ns)
    return message


@pytest.mark.parametrize("content", ["task", "alert", "detection_report"])
@given(st.integers(0, 4_000_000_000_000_000), st.integers(-(2**60), 2**60))
def test_every_timestamp_moves_by_whole_microseconds_and_nothing_else(
    content: str, t_us: int, shift_ns: int
) -> None:
    """Down, so that none is ahead of the time at which its message leaves."""
    moved_ns = t_us * 1000 + shift_ns // 1000 * 1000
    assume(moved_ns >= 0)
    data = retime_sapient(stamped(content, t_us * 1000).SerializeToString(), shift_ns)
    assert data == stamped(content, moved_ns).SerializeToString()


def test_other_octets_are_refused() -> None:
    with pytest.raises(DecodeError):
        retime_sapient(b"\xff\xff\xff", 1)
