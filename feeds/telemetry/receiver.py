"""Telemetry messages in, trajectories out; what is not taken comes back as a refusal to publish."""

from __future__ import annotations

from collections import Counter

from google.protobuf import json_format

from plotfeed.feeds.messages.message import Message, attributes
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.telemetry.decode_reports import decode
from plotfeed.feeds.telemetry.position_report import AltitudeDatum, PositionReport, Reason, Refused
from plotfeed.models.state import Signature
from plotfeed.models.truth import Trajectories
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.content_types import JSON
from plotfeed.proto.utc import NS

MAX_DRONE_NAME = 64
NAME_SEPARATORS = frozenset("/+#")
"""Characters that MQTT gives a meaning in topics."""


class Admission:
    """Which reports are taken: those of few enough drones, near now, in the order of time."""

    def __init__(
        self, *, max_ahead_s: float = 2.0, max_age_s: float | None = None, max_drones: int = 10_000
    ) -> None:
        self._max_ahead_ns = round(max_ahead_s * NS)
        self._max_age_ns = None if max_age_s is None else round(max_age_s * NS)
        self._max_drones = max_drones
        self._last_utc_ns: dict[str, int] = {}

    def admit(self, drone: str, report: PositionReport, now_utc_ns: int) -> None:
        """Take the report as the drone's latest; raises `Refused`."""
        self._check_name(drone)
        self._check_now(report.t_utc_ns, now_utc_ns)
        self._check_order(drone, report.t_utc_ns)
        self._last_utc_ns[drone] = report.t_utc_ns

    def _check_name(self, drone: str) -> None:
        shown = ascii(drone[: MAX_DRONE_NAME + 1])
        good = 0 < len(drone) <= MAX_DRONE_NAME and drone.isprintable()
        if not good or NAME_SEPARATORS.intersection(drone):
            expected = f"1 to {MAX_DRONE_NAME} printable characters without / + #"
            raise Refused(Reason.NAME, f"drone name {shown}; expected {expected}")
        if drone not in self._last_utc_ns and len(self._last_utc_ns) >= self._max_drones:
            detail = f"drone {shown} is new, and {self._max_drones} drones are the most taken"
            raise Refused(Reason.TOO_MANY_DRONES, detail)

    def _check_now(self, t_utc_ns: int, now_utc_ns: int) -> None:
        ahead_ns = t_utc_ns - now_utc_ns
        if ahead_ns > self._max_ahead_ns:
            limit_s = self._max_ahead_ns / NS
            detail = f"time_utc is {ahead_ns / NS:.3f} s ahead of now; at most {limit_s:g} s"
            raise Refused(Reason.FUTURE, detail)
        if self._max_age_ns is not None and -ahead_ns > self._max_age_ns:
            limit_s = self._max_age_ns / NS
            detail = f"time_utc is {-ahead_ns / NS:.3f} s old; at most {limit_s:g} s"
            raise Refused(Reason.STALE, detail)

    def _check_order(self, drone: str, t_utc_ns: int) -> None:
        last_utc_ns = self._last_utc_ns.get(drone)
        if last_utc_ns is None or t_utc_ns > last_utc_ns:
            return
        if t_utc_ns == last_utc_ns:
            raise Refused(Reason.DUPLICATE, f"drone {drone!r} has reported for this time before")
        behind_s = (last_utc_ns - t_utc_ns) / NS
        detail = f"time_utc is {behind_s:.3f} s before the last report of drone {drone!r}"
        raise Refused(Reason.BACKWARDS, detail)


MAX_REFUSALS_PER_S = 50
"""Published; every one is counted. Whoever floods the telemetry shall not flood the errors."""


class TelemetryReceiver:
    """Takes telemetry for a session, and counts what is refused and why."""

    def __init__(self, scene: Scene, trajectories: Trajectories) -> None:
        settings = scene.telemetry
        self.taken = 0
        self.last_refusal = ""
        self.refusals: Counter[Reason] = Counter()
        self._admission = Admission(
            max_ahead_s=settings.max_ahead_s,
            max_age_s=settings.max_age_s,
            max_drones=settings.max_drones,
        )
        self._prefix = scene.mqtt.prefix
        self._datum = AltitudeDatum(settings.takeoff_height_m, settings.geoid_undulation_m)
        self._default = Signature(rcs_m2=settings.rcs_m2, sound_power_db=settings.sound_power_db)
        self._scripted = frozenset(d.id for d in scene.drone)
        self._trajectories = trajectories
        self._published_in_second = (0, 0)

    @property
    def topic(self) -> str:
        """The topic filter under which telemetry comes."""
        return f"{self._prefix}/telemetry/+"

    @property
    def refused(self) -> int:
        """How many messages were refused so far."""
        return self.refusals.total()

    def take(
        self, topic: str, payload: bytes, content_type: str | None, now_utc_ns: int
    ) -> Message | None:
        """One telemetry message; the refusal to publish if it was not taken and there is room."""
        drone = topic.rpartition("/")[2]
        try:
            report = decode(payload, content_type, now_utc_ns=now_utc_ns)
            if drone in self._scripted:
                raise Refused(Reason.NAME, f"drone {drone!r} is flown by the scene itself")
            height_m = self._datum.height_m(report)
            self._admission.admit(drone, report, now_utc_ns)
        except Refused as refused:
            return self.refuse(topic, refused, now_utc_ns)
        add_report(self._trajectories, drone, report, height_m, self._default)
        self.taken += 1
        return None

    def refuse(
        self, topic: str, refused: Refused, now_utc_ns: int, number: int = 1
    ) -> Message | None:
        """Count messages that are not taken; the one refusal to publish if there is room."""
        self.refusals[refused.reason] += number
        self.last_refusal = f"{topic}: {refused.detail}"
        # What is taken in late, as of a time before, counts with what is refused now.
        second, published = max(now_utc_ns // NS, self._published_in_second[0]), 0
        if second == self._published_in_second[0]:
            published = self._published_in_second[1]
        if published >= MAX_REFUSALS_PER_S:
            return None
        self._published_in_second = (second, published + 1)
        refusal = pb.Refusal(
            topic=topic,
            drone=topic.rpartition("/")[2] if refused.reason is not Reason.CONTROL else "",
            reason=refused.reason,
            detail=refused.detail,
            count=self.refusals[refused.reason],
        )
        refusal.time_utc.FromNanoseconds(now_utc_ns)
        return Message(
            topic=f"{self._prefix}/errors",
            payload=to_json(refusal),
            content_type=JSON,
            due_utc_ns=now_utc_ns,
            properties=attributes(self._prefix, "errors", str(self.refused), now_utc_ns),
        )


def add_report(
    trajectories: Trajectories,
    drone: str,
    report: PositionReport,
    height_m: float,
    default: Signature,
) -> None:
    """Put a report into the trajectories; `default` stands in for what it does not state."""
    accuracies = (report.horizontal_accuracy_m, report.vertical_accuracy_m)
    trajectories.add_sample(
        drone,
        report.t_utc_ns,
        latitude_deg=report.latitude_deg,
        longitude_deg=report.longitude_deg,
        height_m=height_m,
        velocity_enu_m_s=report.velocity_enu_m_s,
        sigma_m=max((a for a in accuracies if a is not None), default=None),
        signature=Signature(
            rcs_m2=default.rcs_m2 if report.rcs_m2 is None else report.rcs_m2,
            sound_power_db=(
                default.sound_power_db if report.sound_power_db is None else report.sound_power_db
            ),
            emitters=report.emitters or default.emitters,
        ),
    )


def to_json(message: pb.Refusal | pb.SensorStatus) -> bytes:
    """Protobuf's JSON mapping with the schema's own names, zeros included, in one line."""
    text = json_format.MessageToJson(
        message,
        preserving_proto_field_name=True,
        always_print_fields_with_no_presence=True,
        indent=None,
    )
    return text.encode()
