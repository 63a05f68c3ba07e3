"""JSON of other systems becomes telemetry by a mapping, and what is wrong is told by its key."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from pydantic import ValidationError

from plotfeed.feeds.scene.telemetry_keys import TelemetryMapping
from plotfeed.feeds.telemetry.live.mapped_reports import MappedReports
from plotfeed.feeds.telemetry.position_report import PositionReport, Reason, Refused
from plotfeed.models.state import AltitudeReference

NOW = 1_767_225_600_000_000_000
KEYS: dict[str, Any] = {
    "topic": "fleet/{drone}/state",
    "time": "stamp",
    "time_format": "ms",
    "latitude": "pos.lat",
    "longitude": "pos.lon",
    "altitude": "pos.alt.1",
    "altitude_unit": "ft",
    "altitude_reference": "above_takeoff",
    "speed": "speed",
    "course": "track",
    "speed_unit": "kn",
    "velocity_down": "down",
}
SAID = {
    "stamp": 1_767_225_600_125,
    "pos": {"lat": 40.45, "lon": "-3.73", "alt": ["ft", 100]},
    "speed": 10,
    "track": 90.0,
    "down": 1,
}


def said(tree: Any, at: str = "fleet/uav 1/state", **keys: object) -> PositionReport | Refused:
    heard = MappedReports([TelemetryMapping.model_validate({**KEYS, **keys})]).hear(
        at, tree if isinstance(tree, bytes) else json.dumps(tree).encode(), NOW
    )
    assert heard is not None
    assert heard.drone == "uav-1"
    return heard.said


def test_units_paths_and_times_are_those_of_the_mapping() -> None:
    found = said(SAID)
    assert isinstance(found, PositionReport)
    assert found.t_utc_ns == NOW + 125_000_000
    assert (found.latitude_deg, found.longitude_deg) == (40.45, -3.73)
    assert found.altitude_m == pytest.approx(30.48)
    assert found.altitude_reference is AltitudeReference.ABOVE_TAKEOFF
    assert found.velocity_enu_m_s == pytest.approx((5.1444, 0, -0.51444), abs=1e-4)
    tree = {**SAID, "pos": {"lat": 0.5, "lon": -0.1, "alt": [0, 5]}, "at": "2026-01-01T00:00:01Z"}
    units = {"angle_unit": "rad", "time_format": "iso", "altitude_unit": "m"}
    for key, since_ns in (("at", 1_000_000_000), (None, 0)):
        other = said(tree, time=key, **units)
        assert isinstance(other, PositionReport)
        assert other.latitude_deg == pytest.approx(math.degrees(0.5))
        assert (other.altitude_m, other.t_utc_ns) == (5.0, NOW + since_ns)


@pytest.mark.parametrize(
    ("tree", "reason", "detail"),
    [
        (b"{", Reason.UNDECODABLE, "payload is not JSON"),
        ([], Reason.MISSING, "stamp is missing"),
        ({**SAID, "pos": {}}, Reason.MISSING, "pos.lat is missing"),
        ({**SAID, "pos": {"lat": "n/a"}}, Reason.UNDECODABLE, "pos.lat is 'n/a'; expected"),
        ({**SAID, "speed": True}, Reason.UNDECODABLE, "speed is True; expected a number"),
        ({**SAID, "track": None}, Reason.MISSING, "track is null"),
        ({**SAID, "stamp": "soon"}, Reason.UNDECODABLE, "stamp is 'soon'"),
        ({**SAID, "pos": {**SAID["pos"], "alt": [1]}}, Reason.MISSING, "pos.alt.1 is missing"),  # type: ignore[dict-item]
        ({**SAID, "pos": {**SAID["pos"], "lat": 91}}, Reason.OUT_OF_RANGE, "latitude_deg is 91"),  # type: ignore[dict-item]
        (b'{"stamp": NaN}', Reason.NOT_FINITE, "stamp is nan"),
        (b" " * 70_000, Reason.OVERSIZED, "70000 octets"),
    ],
)
def test_what_is_wrong_is_told_by_its_key(tree: Any, reason: Reason, detail: str) -> None:
    found = said(tree)
    assert isinstance(found, Refused)
    assert found.reason is reason
    assert detail in found.detail


def test_the_name_may_stand_in_the_message_and_other_topics_are_not_mapped() -> None:
    tree = {**SAID, "who": {"id": "uav/1"}}
    assert isinstance(said(tree, "a/b", topic="a/+", drone="who.id"), PositionReport)
    mapped = MappedReports([TelemetryMapping.model_validate(KEYS)])
    assert mapped.topics == ["fleet/+/state"]
    for topic in ("fleet/a", "fleet/a/other", "fleet/a/state/b", "plotfeed/telemetry/a"):
        assert mapped.hear(topic, b"{}", NOW) is None


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"topic": "fleet/x/state"}, "drone: either"),
        ({"drone": "id"}, "drone: either"),
        ({"topic": "fleet/{drone}x/state"}, "expected levels"),
        ({"topic": "fleet/{drone}/#"}, "no #"),
        ({"latitude": "a..b"}, "expected keys with dots"),
        ({"course": None}, "belong together"),
        ({"velocity_up": "up"}, "either it or velocity_up"),
    ],
)
def test_a_mapping_that_says_too_little_or_too_much_is_told(keys: Any, says: str) -> None:
    with pytest.raises(ValidationError, match=says):
        TelemetryMapping.model_validate({**KEYS, **keys})
