"""What autopilots say becomes reports: whose, where, above what, and when."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plotfeed.feeds.telemetry.live.heard import HeardReport
from plotfeed.feeds.telemetry.live.mavlink import MAX_PEERS, MavlinkReports, SenderClock
from plotfeed.feeds.telemetry.position_report import PositionReport, Reason, Refused
from plotfeed.models.state import AltitudeReference

common = pytest.importorskip("pymavlink.dialects.v20.common")
v10 = pytest.importorskip("pymavlink.dialects.v10.common")
S = 1_000_000_000
NOW = 1_767_225_600 * S
PEER = "127.0.0.1:5000"


class Vehicle:
    """One that says what it is told to, in frames of one version."""

    def __init__(self, system: int = 1, dialect: Any = common) -> None:
        self.mav: Any = dialect.MAVLink(None, srcSystem=system, srcComponent=1)

    def says(self, name: str, *values: object) -> bytes:
        return bytes(getattr(self.mav, f"{name}_encode")(*values).pack(self.mav))

    def at(self, boot_ms: int, lat: int = 404500000, lon: int = -37300000) -> bytes:
        place = (lat, lon, 750_000, 100_000, 300, -400, 50, 9000)
        return self.says("global_position_int", boot_ms, *place)

    def raw(self, time_us: int, fix: int = 3, more: tuple[int, ...] = ()) -> bytes:
        place = (404500000, -37300000, 751_000)
        return self.says("gps_raw_int", time_us, fix, *place, 80, 120, 500, 9000, 14, *more)


def report(heard: list[HeardReport]) -> PositionReport:
    (only,) = heard
    assert isinstance(only.said, PositionReport)
    return only.said


def reason(heard: list[HeardReport]) -> Reason:
    (only,) = heard
    assert isinstance(only.said, Refused)
    return only.said.reason


def hear(
    listener: MavlinkReports, data: bytes, now_ns: int = NOW, peer: str = PEER
) -> list[HeardReport]:
    return list(listener.hear(peer, data, now_ns))


@pytest.mark.parametrize("dialect", [v10, common], ids=["v1", "v2"])
def test_a_position_is_taken_with_its_units_and_signs(dialect: Any) -> None:
    heard = hear(MavlinkReports("mav-{system}"), Vehicle(7, dialect).at(5000))
    assert heard[0].drone == "mav-7"
    found = report(heard)
    assert (found.latitude_deg, found.longitude_deg) == pytest.approx((40.45, -3.73))
    assert found.altitude_m == 750.0
    assert found.altitude_reference is AltitudeReference.MEAN_SEA_LEVEL
    assert found.velocity_enu_m_s == pytest.approx((-4.0, 3.0, -0.5))
    assert found.t_utc_ns == NOW
    above = report(hear(MavlinkReports("a", "above_takeoff"), Vehicle(dialect=dialect).at(5000)))
    assert (above.altitude_m, above.altitude_reference) == (100.0, AltitudeReference.ABOVE_TAKEOFF)
    listener, vehicle = MavlinkReports("a"), Vehicle(dialect=dialect)
    hear(listener, vehicle.raw(1_000_000))
    found = report(hear(listener, vehicle.raw(5_000_000), NOW + 4 * S))
    # Accuracies that are not sent are unknown.
    assert np.isnan([found.horizontal_accuracy_m, found.velocity_accuracy_m_s]).all()


def test_positions_bear_the_time_of_the_sender_where_it_is_right() -> None:
    listener, vehicle = MavlinkReports("{system}"), Vehicle()
    hear(listener, vehicle.says("system_time", (NOW - S // 10) // 1000, 5000))
    assert report(hear(listener, vehicle.at(5100), NOW + 30_000_000)).t_utc_ns == NOW
    assert listener.notes() == []
    listener = MavlinkReports("{system}")  # of a clock that is off, which is told once
    hear(listener, vehicle.says("system_time", (NOW - 3600 * S) // 1000, 5000))
    for i in range(3):
        found = report(hear(listener, vehicle.at(5000 + 100 * i), NOW + i * S // 10))
        assert found.t_utc_ns == NOW + i * S // 10
    told = "1: its clock is 3600.000 s behind: positions are of when they come"
    assert [listener.notes(), listener.notes()] == [[told], []]


def test_the_estimate_is_preferred_and_the_receiver_stands_in() -> None:
    listener, vehicle = MavlinkReports("{system}"), Vehicle()
    assert hear(listener, vehicle.raw(5_000_000)) == []  # the estimate may follow
    report(hear(listener, vehicle.at(5100), NOW + S // 10))
    assert hear(listener, vehicle.raw(6_000_000), NOW + S) == []
    accuracies = (0, 900, 1500, 300)
    found = report(hear(listener, vehicle.raw(9_200_000, more=accuracies), NOW + 42 * S // 10))
    assert found.altitude_m == 751.0
    assert found.velocity_enu_m_s[:2] == pytest.approx((5.0, 0.0))
    assert (found.horizontal_accuracy_m, found.vertical_accuracy_m) == (0.9, 1.5)
    assert found.velocity_accuracy_m_s == 0.3
    report(hear(listener, vehicle.at(9_300), NOW + 43 * S // 10))
    assert hear(listener, vehicle.raw(9_400_000), NOW + 44 * S // 10) == []


def test_the_receivers_altitude_above_home_needs_home() -> None:
    listener, vehicle = MavlinkReports("a", "above_takeoff"), Vehicle()
    hear(listener, vehicle.raw(1_000_000))
    assert reason(hear(listener, vehicle.raw(5_000_000), NOW + 4 * S)) is Reason.ALTITUDE
    home = (404500000, -37300000, 650_000, 0, 0, 0, (1, 0, 0, 0), 0, 0, 0)
    hear(listener, vehicle.says("home_position", *home), NOW + 4 * S)
    assert report(hear(listener, vehicle.raw(6_000_000), NOW + 5 * S)).altitude_m == 101.0
    for data in (vehicle.at(1000, 0, 0), vehicle.raw(9_000_000, fix=2)):  # without a fix
        assert reason(hear(listener, data, NOW + 8 * S)) is Reason.NO_POSITION


def test_several_systems_and_peers_are_several_drones() -> None:
    listener = MavlinkReports("{system}@{port}")
    data = Vehicle(1).at(1000) + Vehicle(2).at(99_000)
    heard = hear(listener, data) + hear(listener, data, peer="10.0.0.2:77")
    assert [each.drone for each in heard] == ["1@5000", "2@5000", "1@77", "2@77"]


def location(address: bytes, past_hour_s: float) -> tuple[object, ...]:
    place = (404512345, -37298765, 712.0, 761.5, 0, 60.0)
    moves, sigmas = (2, 21500, 2500, -100), (11, 4, 3, 3)
    return (0, 0, address.ljust(20, b"\0"), *moves, *place, *sigmas, past_hour_s, 2)


def test_remote_id_of_others_is_theirs_by_their_identity() -> None:
    listener, vehicle = MavlinkReports("mav-{system}"), Vehicle()
    other = bytes.fromhex("60601f000001")
    identity = (0, 0, other.ljust(20, b"\0"), 1, 2, b"1581F4XF".ljust(20, b"\0"))
    hear(listener, vehicle.says("open_drone_id_basic_id", *identity))
    heard = hear(listener, vehicle.says("open_drone_id_location", *location(other, 3599.5)))
    assert heard[0].drone == "1581F4XF"
    found = report(heard)
    assert found.altitude_reference is AltitudeReference.ELLIPSOID
    assert (found.altitude_m, found.t_utc_ns) == (761.5, NOW - S // 2)
    assert found.horizontal_accuracy_m == pytest.approx(3 / 2.4477, rel=1e-4)
    assert found.velocity_enu_m_s == pytest.approx((-14.339, -20.479, -1.0), abs=1e-3)
    nameless = bytes.fromhex("60601f000002")
    heard = hear(listener, vehicle.says("open_drone_id_location", *location(nameless, 0.0)))
    assert heard[0].drone == "60601f000002"
    untold = hear(listener, vehicle.says("open_drone_id_location", *location(nameless, 0xFFFF)))
    assert report(untold).t_utc_ns == NOW
    # A v2 system after a v1 system is understood: the first octet must not pick a dialect.
    report(hear(listener, Vehicle(3, v10).at(1000)))
    frame = Vehicle(2).says("open_drone_id_location", *location(nameless, 0.0))
    assert len(hear(listener, frame)) == 1


def test_its_own_remote_id_stands_in_for_an_autopilot_that_says_nothing_else() -> None:
    listener, vehicle = MavlinkReports("mav-{system}"), Vehicle()
    own = vehicle.says("open_drone_id_location", *location(b"", 0.0))
    assert hear(listener, own) == []
    heard = hear(listener, own, NOW + 4 * S)
    assert heard[0].drone == "mav-1"
    report(heard)
    # A pack is taken apart.
    message = bytes.fromhex("12222364fe595e1c18b3ddc6fd600dc30d48084b33aa470200")
    identity = bytes([2, 0x12]) + b"SERIAL".ljust(20, b"\0") + bytes(3)
    pack = (0, 0, b"\x01\x02".ljust(20, b"\0"), 25, 2, (identity + message).ljust(225, b"\0"))
    frame = vehicle.says("open_drone_id_message_pack", *pack)
    assert hear(MavlinkReports("a"), frame)[0].drone == "SERIAL"


def traffic(**changes: int) -> bytes:
    """An airliner at 40.5, -3.7, 3 km above the sea, to the east at 200 m/s and down at 5."""
    fields = {
        "icao": 0x3C6589,
        "lat": 405_000_000,
        "lon": -37_000_000,
        "altitude_type": 0,
        "altitude": 3_000_000,
        "heading": 9000,
        "speed": 20_000,
        "climb": -500,
        "callsign": b"DLH1234\0\0",
        "emitter": 3,
        "tslc": 1,
        "flags": 1 | 2 | 4 | 8 | 16 | 128,
        "squawk": 0o1234,
    }
    return Vehicle().says("adsb_vehicle", *(fields | changes).values())


def test_aircraft_that_an_autopilot_hears_are_aircraft() -> None:
    heard = hear(MavlinkReports("mav-{system}"), traffic())
    found = report(heard)
    assert heard[0].drone == "3c6589"
    assert (found.latitude_deg, found.longitude_deg) == pytest.approx((40.5, -3.7))
    assert (found.altitude_m, found.altitude_reference) == (3000, AltitudeReference.MEAN_SEA_LEVEL)
    assert found.velocity_enu_m_s == pytest.approx((200.0, 0.0, -5.0), abs=1e-9)
    assert found.t_utc_ns == NOW - S
    assert (found.target_class, found.rcs_m2, found.size_m) == ("aircraft", 20.0, 35.8)
    by_gnss = report(hear(MavlinkReports("a"), traffic(altitude_type=1, flags=1 | 2)))
    assert by_gnss.altitude_reference is AltitudeReference.ELLIPSOID
    assert np.isnan(by_gnss.velocity_enu_m_s).all()
    unmanned = report(hear(MavlinkReports("a"), traffic(emitter=14)))
    assert (unmanned.target_class, str(unmanned.rcs_m2)) == ("", "nan")
    # One without a place, or of none that is of now, is none.
    for changes in ({"flags": 1}, {"flags": 2}, {"tslc": 6}, {"altitude_type": 7}):
        assert hear(MavlinkReports("a"), traffic(**changes)) == []


def test_octets_that_are_no_frames_are_refused_in_one_and_their_peers_not_remembered() -> None:
    (heard,) = hear(MavlinkReports("a"), b"hello, world " * 50)
    assert isinstance(heard.said, Refused)
    assert heard.said.reason is Reason.UNDECODABLE
    assert "650 octets that are no MAVLink frame" in heard.said.detail
    listener = MavlinkReports("a")
    for i in range(3 * MAX_PEERS):
        hear(listener, b"\xfd\xff\x00", peer=f"10.0.0.1:{i}")
    assert len(listener._peers) == MAX_PEERS


# What senders say of their time becomes UTC, however wrong their clocks or ours are.


@given(st.integers(-(10**6), 10**6).filter(lambda s: abs(s) > 1), st.integers(0, 400))
def test_a_wrong_utc_is_not_and_positions_are_of_the_least_delay(off_s: int, seed: int) -> None:
    clock = SenderClock()
    clock.declare(NOW + off_s * S, 0)
    delays = np.random.default_rng(seed).exponential(0.2, 50)
    delays[0] = 0.05
    arrivals_ns = np.maximum.accumulate([i * S // 10 + round(d * S) for i, d in enumerate(delays)])
    for i, arrival_ns in enumerate(arrivals_ns.tolist()):
        t_ns = NOW + i * S // 10
        found = clock.utc_ns(i * S // 10, NOW + arrival_ns)
        assert 0 <= found - t_ns <= 50_000_000
    assert clock.is_off
    assert abs(clock.off_s + off_s) < 1


def test_a_clock_that_begins_anew_is_learned_anew() -> None:
    clock = SenderClock()
    clock.declare(NOW - 500 * S, 500 * S)
    clock.utc_ns(500 * S, NOW)
    assert clock.utc_ns(2 * S, NOW + 10 * S) == NOW + 10 * S  # it has said nothing of its UTC yet
    clock.declare(NOW + 8 * S, 3 * S)
    assert clock.utc_ns(3 * S, NOW + 11 * S + 20_000_000) == NOW + 11 * S


@given(st.integers(-7200, 7200), st.booleans())
def test_when_a_clock_jumps_positions_are_of_now_again_within_seconds(
    jump_s: int, ours: bool
) -> None:
    clock = SenderClock()
    late = []
    for i in range(300):
        jumped = jump_s * S * (i >= 100)
        now_ns = NOW + i * S // 10 + jumped * ours
        count_ns = 10_000 * S + i * S // 10 + jumped * (not ours)
        late.append(abs(clock.utc_ns(count_ns, now_ns) - now_ns))
    assert max(late[:100]) == 0
    assert max(late[-80:]) == 0


def test_drift_is_followed() -> None:
    """A clock that loses 100 ppm is not off by more after an hour than after ten seconds."""
    clock = SenderClock()
    for i in range(7_200):
        now_ns = NOW + i * S // 2
        late_ns = now_ns - clock.utc_ns(round(i * S / 2 * (1 - 1e-4)), now_ns)
        assert 0 <= late_ns <= 1_100_000
