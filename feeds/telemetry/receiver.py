"""Telemetry messages in, trajectories out; what is not taken comes back as a refusal to publish."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from math import isnan

import numpy as np
from google.protobuf import json_format

from plotfeed.feeds.messages.message import Message, attributes
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sea_level import SeaLevel
from plotfeed.feeds.telemetry.decode_reports import decode
from plotfeed.feeds.telemetry.fast_decode import ReportRow, fast_decode
from plotfeed.feeds.telemetry.position_report import AltitudeDatum, Reason, Refused
from plotfeed.models.live_samples import MAX_FIT_SAMPLES
from plotfeed.models.state import Signatures
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
        self,
        *,
        max_ahead_s: float = 2.0,
        max_age_s: float | None = None,
        max_late_s: float | None = None,
        max_drones: int = 10_000,
    ) -> None:
        """`max_late_s` is the age from which a report shows nobody anything any more."""
        self._max_ahead_ns = round(max_ahead_s * NS)
        self._max_age_ns = None if max_age_s is None else round(max_age_s * NS)
        self._max_late_ns = None if max_late_s is None else round(max_late_s * NS)
        self._max_drones = max_drones
        self._last_utc_ns: dict[str, int] = {}

    def knows(self, drone: str) -> bool:
        """Whether a report of that drone was taken."""
        return drone in self._last_utc_ns

    def admit(self, drone: str, t_utc_ns: int, now_utc_ns: int) -> None:
        """Take a report of that time as the drone's latest; raises `Refused`."""
        last_utc_ns = self._last_utc_ns.get(drone)
        if last_utc_ns is None:
            self._check_name(drone)
        self._check_now(t_utc_ns, now_utc_ns)
        if last_utc_ns is not None and t_utc_ns <= last_utc_ns:
            self._check_order(drone, t_utc_ns, last_utc_ns)
        self._check_late(now_utc_ns - t_utc_ns)
        self._last_utc_ns[drone] = t_utc_ns

    def _check_name(self, drone: str) -> None:
        shown = ascii(drone[: MAX_DRONE_NAME + 1])
        good = 0 < len(drone) <= MAX_DRONE_NAME and drone.isprintable()
        if not good or NAME_SEPARATORS.intersection(drone):
            expected = f"1 to {MAX_DRONE_NAME} printable characters without / + #"
            raise Refused(Reason.NAME, f"drone name {shown}; expected {expected}")
        if len(self._last_utc_ns) >= self._max_drones:
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

    def _check_order(self, drone: str, t_utc_ns: int, last_utc_ns: int) -> None:
        if t_utc_ns == last_utc_ns:
            raise Refused(Reason.DUPLICATE, f"drone {drone!r} has reported for this time before")
        behind_s = (last_utc_ns - t_utc_ns) / NS
        detail = f"time_utc is {behind_s:.3f} s before the last report of drone {drone!r}"
        raise Refused(Reason.BACKWARDS, detail)

    def _check_late(self, age_ns: int) -> None:
        if self._max_late_ns is not None and age_ns > self._max_late_ns:
            limit_s = self._max_late_ns / NS
            detail = (
                f"time_utc is {age_ns / NS:.3f} s old; after {limit_s:g} s no sensor can still see "
                "the drone there"
            )
            raise Refused(Reason.LATE, detail)


LOOK_BACK_S = 1.0
"""Further back than its own sectors and signals no sensor looks by more than this."""


def look_back_s(scene: Scene) -> float:
    """How far back from now any sensor of a scene can ask where a drone is, seconds.

    A sector is worked out when it is over, and sound has left its drone long before.
    """
    found_s, speeds = 0.0, dict[str, float | None]()
    for sensor in scene.sensor:
        if sensor.type not in speeds:
            speeds[sensor.type] = sensor.model(scene.scene.site).signal_speed_m_s
        speed_m_s = speeds[sensor.type]
        sector_s = sensor.scan.period_s / sensor.scan.sectors
        travel_s = 0.0 if speed_m_s is None else TRAVEL * sensor.range_max_m / speed_m_s
        found_s = max(found_s, sector_s + travel_s)
    return LOOK_BACK_S + found_s


TRAVEL = 1.5
"""Sound of a drone that comes from beyond the range, or through colder air, is older."""
Waited = Sequence[tuple[str, Sequence[tuple[bytes, str | None]]]]
"""Topics, and of each the payloads and content types that waited, in the order of coming."""
MAX_REFUSALS_PER_S = 50
"""Published; every one is counted. Whoever floods the telemetry shall not flood the errors."""


class TelemetryReceiver:
    """Takes telemetry for a session, and counts what is refused and why."""

    def __init__(
        self,
        scene: Scene,
        trajectories: Trajectories,
        *,
        welcome: Callable[[str], object] = lambda _topic: None,
    ) -> None:
        """`welcome` is told the topic of a drone of which something is taken for the first time."""
        settings = scene.telemetry
        self.taken = 0
        self.conflated = 0
        """Reports that were good, but later ones came with them and no sensor asks for these."""
        self.last_refusal = ""
        self.refusals: Counter[Reason] = Counter()
        look_back = look_back_s(scene)
        self._look_back_ns = round(look_back * NS)
        self._admission = Admission(
            max_ahead_s=settings.max_ahead_s,
            max_age_s=settings.max_age_s,
            max_late_s=settings.stale_after_s + look_back,
            max_drones=settings.max_drones,
        )
        self._prefix = scene.mqtt.prefix
        self._datum = AltitudeDatum(settings.takeoff_height_m, SeaLevel.of(scene))
        self._rcs_m2, self._sound_power_db = settings.rcs_m2, settings.sound_power_db
        self._scripted = frozenset(d.id for d in scene.drone)
        self._trajectories = trajectories
        self._welcome = welcome
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
        refusals = self.take_together([(topic, [(payload, content_type)])], now_utc_ns)
        return refusals[0] if refusals else None

    def take_together(self, waited: Waited, now_utc_ns: int) -> list[Message]:
        """Telemetry messages, topic by topic, as of one time; the refusals to publish."""
        refusals: list[Message] = []
        names: list[str] = []
        rows: list[ReportRow] = []
        for topic, messages in waited:
            drone, first = topic.rpartition("/")[2], len(rows)
            is_known = self._admission.knows(drone)
            for payload, content_type in messages:
                try:
                    row = self._decoded(payload, content_type, now_utc_ns)
                    if not is_known and drone in self._scripted:
                        detail = f"drone {drone!r} is flown by the scene itself"
                        raise Refused(Reason.NAME, detail)
                    self._datum.check(row.altitude_reference)
                    self._admission.admit(drone, row.t_utc_ns, now_utc_ns)
                except Refused as refused:
                    refusal = self.refuse(topic, refused, now_utc_ns)
                    if refusal is not None:
                        refusals.append(refusal)
                else:
                    rows.append(row)
            if len(rows) > first:
                if not is_known:
                    self._welcome(topic)
                if len(rows) > first + 1:
                    unneeded = self._unneeded(rows[first:], now_utc_ns)
                    del rows[first : first + unneeded]
                names += [drone] * (len(rows) - first)
        if rows:
            self._add(names, rows)
        return refusals

    @staticmethod
    def _decoded(payload: bytes, content_type: str | None, now_utc_ns: int) -> ReportRow:
        row = fast_decode(payload, content_type)
        return row or ReportRow.of(decode(payload, content_type, now_utc_ns=now_utc_ns))

    def _unneeded(self, rows: Sequence[ReportRow], now_utc_ns: int) -> int:
        """How many of a drone's first reports make no state that anybody can still ask for.

        Those before the last one that is further back than all look; where velocities are fitted,
        the positions that they are fitted to are kept, too.
        """
        asked_from_ns = now_utc_ns - self._look_back_ns
        needed = len(rows) - 1
        while needed and rows[needed].t_utc_ns > asked_from_ns:
            needed -= 1
        if any(isnan(r.velocity_east_m_s + r.velocity_north_m_s + r.velocity_up_m_s) for r in rows):
            needed = max(0, needed - MAX_FIT_SAMPLES + 1)
        self.conflated += needed
        return needed

    def _add(self, names: Sequence[str], rows: Sequence[ReportRow]) -> None:
        t, latitude, longitude, altitude, references, *velocity, sigma, rcs, sound, emitters = zip(
            *rows, strict=True
        )
        rcs_m2, sound_power_db = np.array(rcs), np.array(sound)
        self._trajectories.add_samples(
            names,
            np.array(t, np.int64),
            latitude_deg=np.array(latitude),
            longitude_deg=np.array(longitude),
            height_m=self._datum.heights_m(latitude, longitude, altitude, references),
            velocity_enu_m_s=np.array(velocity).T,
            sigma_m=np.array(sigma),
            signatures=Signatures(
                rcs_m2=np.where(np.isnan(rcs_m2), self._rcs_m2, rcs_m2),
                sound_power_db=np.where(
                    np.isnan(sound_power_db), self._sound_power_db, sound_power_db
                ),
                emitters=emitters,
            ),
        )
        self.taken += len(rows)

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


def to_json(message: pb.Refusal | pb.SensorStatus) -> bytes:
    """Protobuf's JSON mapping with the schema's own names, zeros included, in one line."""
    text = json_format.MessageToJson(
        message,
        preserving_proto_field_name=True,
        always_print_fields_with_no_presence=True,
        indent=None,
    )
    return text.encode()
