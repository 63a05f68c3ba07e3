from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import ulid
from hypothesis import given
from hypothesis import strategies as st
from support.sapient_rules import ULID, UUID4, checked

from plotfeed.models.state import Plots
from plotfeed.proto.errors import EncodeError
from plotfeed.proto.sapient.decode_sapient import decode
from plotfeed.proto.sapient.encode_sapient import (
    DetectionEncoder,
    FieldOfView,
    Manner,
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


def one(manner: Manner | None = None, positions: Positions | None = None, **columns: Any) -> Any:
    """The only DetectionReport of one plot."""
    encoder = DetectionEncoder(NODE, manner or Manner())
    (payload,) = encoder.messages(T_NS, plots(**columns), positions)
    return checked(payload).detection_report


def test_ids_have_the_forms_that_a_strict_middleware_asks_for() -> None:
    names = {node_id(seed, sensor) for seed in range(20) for sensor in ("a", "b", "ä")}
    assert len(names) == 60
    assert all(UUID4.fullmatch(name) for name in names)
    ulids = Ulids(3, "a", "detections", T_NS)
    assert ULID.fullmatch(ulids[0])
    assert ulid.ULID.from_str(ulids[0]).milliseconds == T_NS // 10**6
    with pytest.raises(IndexError):
        ulids[MAX_IDS]


@given(st.sets(st.integers(0, MAX_IDS - 1), min_size=2))
def test_ulids_of_one_time_are_in_order_and_all_different(numbers: set[int]) -> None:
    ulids = Ulids(3, "a", "detections", T_NS)
    given_ids = [ulids[n] for n in sorted(numbers)]
    assert given_ids == sorted(set(given_ids))


def test_ulids_differ_by_seed_sensor_purpose_and_time() -> None:
    ids = {
        Ulids(seed, sensor, purpose, t)[0]
        for seed in (1, 2)
        for sensor in "ab"
        for purpose in "de"
        for t in (T_NS, T_NS + 1000)
    }
    assert len(ids) == 16


def test_a_registration_says_all_that_is_mandatory() -> None:
    told = checked(registration(NODE, T_NS)).registration
    assert told.icd_version == "BSI Flex 335 v2.0"
    mode = told.mode_definition[0]
    assert mode.HasField("settle_time")
    assert mode.task.region_definition.region_type
    assert (
        decode(registration(NODE, T_NS))["registration"]["mode_definition"][0]["tracking_type"]
        == "TRACKING_TYPE_NONE"
    )


@pytest.mark.parametrize(
    ("changes", "field"), [({"capabilities": ()}, "capabilities"), ({"sensor": ""}, "name")]
)
def test_a_registration_that_lacks_something_is_refused(changes: Any, field: str) -> None:
    with pytest.raises(EncodeError) as caught:
        registration(replace(NODE, **changes), T_NS)
    assert caught.value.field == field


def test_a_status_has_longitude_first() -> None:
    report = checked(status(NODE, T_NS, new=True)).status_report
    assert (report.node_location.x, report.node_location.y) == (-3.73, 40.45)
    assert decode(status(NODE, T_NS))["status_report"]["info"] == "INFO_UNCHANGED"
    goodbye = decode(status(NODE, T_NS, system="GOODBYE", new=True))["status_report"]
    assert (goodbye["system"], goodbye["info"]) == ("SYSTEM_GOODBYE", "INFO_NEW")


def test_a_bearing_alone_is_legal_and_nothing_else_is_made_up() -> None:
    report = one(azimuth_deg=12.5)
    set_fields = {field.name for field, _ in report.range_bearing.ListFields()}
    assert set_fields == {"azimuth", "coordinate_system", "datum"}
    assert {field.name for field, _ in report.ListFields()} == {
        "report_id",
        "object_id",
        "range_bearing",
    }


def test_what_was_measured_comes_back() -> None:
    report = one(
        Manner(detection_confidence=0.75, default_class="Air Vehicle", tells_age=True),
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
    assert {info.type: info.value for info in report.object_info} == {
        "SNR": "20.00",
        "age": "0.010000",
    }
    assert report.detection_confidence == 0.75
    (found,) = report.classification
    assert (found.type, found.sub_class[0].type, found.sub_class[0].level) == (
        "Air Vehicle",
        "quadcopter",
        1,
    )
    assert report.id == "1596F3"


@pytest.mark.parametrize("above", [None, "Air Vehicle"])
def test_a_class_that_was_not_registered_is_not_named(above: str | None) -> None:
    """Telemetry may bring emissions of any kind."""
    report = one(Manner(default_class=above), azimuth_deg=1.0, kind="video")
    assert [found.type for found in report.classification] == ([above] if above else [])
    assert not any(found.sub_class for found in report.classification)


def test_a_bistatic_range_comes_with_its_error_and_its_transmitter() -> None:
    report = one(
        Manner(transmitters=("north", "south")),
        azimuth_deg=1.0,
        bistatic_range_m=5000.0,
        sigma_bistatic_range_m=20.0,
        channel=1,
    )
    told = {info.type: info for info in report.object_info}
    assert told["bistatic range"].value == "5000.00"
    assert told["bistatic range"].error == 20.0
    assert told["transmitter"].value == "south"
    assert not told["transmitter"].HasField("error")


def test_a_range_rate_comes_with_its_error_and_says_of_what_it_is() -> None:
    rate = {"azimuth_deg": 1.0, "range_rate_m_s": -12.3456, "sigma_range_rate_m_s": 0.5}
    for manner, name in (
        (Manner(), "range rate"),
        (Manner(transmitters=("a",)), "bistatic range rate"),
    ):
        told = {info.type: info for info in one(manner, **rate).object_info}
        assert told[name].value == "-12.346"
        assert told[name].error == pytest.approx((0.25 + 1e-6 / 12) ** 0.5, rel=1e-7)


def test_a_signal_has_amplitude_and_frequency() -> None:
    (signal,) = one(Manner(band_hz=(2.4e9, 2.5e9)), azimuth_deg=1.0, amplitude_dbm=-80.0).signal
    assert signal.amplitude == -80.0
    assert signal.centre_frequency == pytest.approx(2.45e9, rel=1e-7)


def test_nothing_of_a_plot_is_left_for_the_next() -> None:
    """One message is filled in again and again: whatever was in it must be gone."""
    full: dict[str, Any] = {
        "azimuth_deg": 10.0,
        "elevation_deg": 5.0,
        "range_m": 100.0,
        "sigma_range_m": 1.0,
        "snr": 10.0,
        "bistatic_range_m": 7.0,
        "sigma_bistatic_range_m": 2.0,
        "range_rate_m_s": 3.0,
        "sigma_range_rate_m_s": 1.0,
        "amplitude_dbm": -50.0,
        "kind": "a",
        "identity": "b",
    }
    manner = Manner(band_hz=(1e9, 2e9))
    mixed = Plots.joined([plots(**full), plots(azimuth_deg=20.0), plots(**full)])
    positions = Positions(
        longitude_deg=np.array([1.0, np.nan, np.nan]),
        latitude_deg=np.array([2.0, np.nan, np.nan]),
        height_m=np.array([np.nan, np.nan, 3.0]),
        sigma_longitude_deg=np.full(3, np.nan),
        sigma_latitude_deg=np.full(3, np.nan),
        sigma_height_m=np.full(3, np.nan),
    )
    encoder = DetectionEncoder(NODE, manner)
    for _ in range(2):
        reports = [checked(p).detection_report for p in encoder.messages(T_NS, mixed, positions)]
        assert [r.WhichOneof("location_oneof") for r in reports] == [
            "location",
            "range_bearing",
            "range_bearing",
        ]
        assert not reports[0].location.HasField("z")
        assert {f.name for f, _ in reports[1].ListFields()} == {
            "report_id",
            "object_id",
            "range_bearing",
        }
        assert not reports[1].range_bearing.HasField("range")
        assert [len(r.object_info) for r in reports] == [3, 0, 3]
        assert reports[2].range_bearing.range == 100.0


def test_every_detection_has_an_object_of_its_own_and_the_time_of_all() -> None:
    encoder = DetectionEncoder(NODE, Manner())
    found = [checked(p) for p in encoder.messages(T_NS, plots(500, azimuth_deg=1.0))]
    ids = {x for m in found for x in (m.detection_report.report_id, m.detection_report.object_id)}
    assert len(ids) == 1000
    assert {m.timestamp.ToNanoseconds() for m in found} == {STAMP_NS}


@pytest.mark.parametrize(
    ("columns", "field"),
    [
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
    ],
)
def test_nonsense_is_refused_by_name(columns: dict[str, Any], field: str) -> None:
    encoder = DetectionEncoder(NODE, Manner())
    with pytest.raises(EncodeError) as caught:
        encoder.messages(T_NS, plots(**columns))
    assert caught.value.field == field


@pytest.mark.parametrize(
    "manner",
    [
        Manner(detection_confidence=1.4),
        Manner(class_confidence=-0.1, default_class="x"),
        Manner(detection_confidence=float("nan")),
        Manner(default_class=""),
        Manner(band_hz=(2.0, 1.0)),
    ],
)
def test_nonsense_for_all_detections_is_refused_before_any(manner: Manner) -> None:
    with pytest.raises(EncodeError):
        DetectionEncoder(NODE, manner)


@pytest.mark.parametrize(
    "changes",
    [
        {"latitude_deg": 90.1},
        {"longitude_deg": float("nan")},
        {"height_m": float("inf")},
        {"field": replace(NODE.field, azimuth_deg=999.0)},
    ],
)
def test_a_node_stands_on_the_earth(changes: dict[str, Any]) -> None:
    with pytest.raises(EncodeError):
        status(replace(NODE, **changes), T_NS)


def test_places_are_on_the_earth() -> None:
    wrong = Positions(
        longitude_deg=np.array([181.0]),
        **{
            name: np.zeros(1)
            for name in (
                "latitude_deg",
                "height_m",
                "sigma_longitude_deg",
                "sigma_latitude_deg",
                "sigma_height_m",
            )
        },
    )
    with pytest.raises(EncodeError, match="x"):
        DetectionEncoder(NODE, Manner()).messages(T_NS, plots(azimuth_deg=1.0), wrong)


@pytest.mark.parametrize("t_utc_ns", [-1, 2**63])
def test_times_are_within_the_years_of_the_project(t_utc_ns: int) -> None:
    with pytest.raises(EncodeError, match="timestamp"):
        registration(NODE, t_utc_ns)
