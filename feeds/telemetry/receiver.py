"""Telemetry messages in, trajectories out; what is not taken comes back as a refusal to publish."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Sequence
from math import isnan

import numpy as np
from google.protobuf import json_format

from plotfeed.feeds.messages.message import Message, attributes
from plotfeed.feeds.scene.drones import EchoesByClass
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.telemetry.admission import Admission
from plotfeed.feeds.telemetry.position_report import (
    AltitudeDatum,
    PositionReport,
    Reason,
    Refused,
    decode,
    fast_decode,
)
from plotfeed.models.state import DRONE, Signatures
from plotfeed.models.truth import MAX_FIT_SAMPLES, FlightSamples, Trajectories
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.content_types import JSON
from plotfeed.proto.utc import NS

log = logging.getLogger(__name__)

LOOK_BACK_S = 1.0  # Further back than its own sectors and signals no sensor looks by more than this


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


# So many times the range sound may come from: its drone may have been beyond, the air colder.
TRAVEL = 1.5
# Topics, and of each the payloads and content types that waited, in the order of coming.
Waited = Sequence[tuple[str, Sequence[tuple[bytes, str | None]]]]
# Published; every one is counted. Whoever floods the telemetry shall not flood the errors.
MAX_REFUSALS_PER_S = 50


class TelemetryReceiver:
    """Takes telemetry for a session, and counts what is refused and why."""

    def __init__(self, scene: Scene, trajectories: Trajectories) -> None:
        # Told the topics of drones that become known.
        self.welcome: Callable[[str], object] = lambda _topic: None
        # Told the topics of drones that are forgotten.
        self.part_with: Callable[[str], object] = lambda _topic: None
        settings = scene.telemetry
        self.taken = 0
        # Reports that were good, but later ones came with them and no sensor asks for these.
        self.conflated = 0
        # Drones that were known and are not any more; one that comes again is new.
        self.forgotten = 0
        self.last_refusal = ""
        self.refusals: Counter[str] = Counter()  # By reason
        look_back = look_back_s(scene)
        self._look_back_ns = round(look_back * NS)
        self._admission = Admission(settings, look_back)
        self._prefix = scene.mqtt.prefix
        self._datum = AltitudeDatum(settings.takeoff_height_m, scene.sea_level())
        self._rcs_m2, self._sound_power_db = settings.rcs_m2, settings.sound_power_db
        self._size_m = settings.size_m
        self._scripted = frozenset((*scene.fleet.names, *scene.fleet.waiting_names))
        self._echoes = EchoesByClass(scene.target) if scene.target else None
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
        refusals = self.take_together([(topic, [(payload, content_type)])], now_utc_ns)
        return refusals[0] if refusals else None

    def forget_gone(self, now_utc_ns: int) -> None:
        """Forget the drones whose time is over, and those that gave way to others."""
        gone = self._admission.known.forgotten(now_utc_ns)
        if not gone:
            return
        self.forgotten += len(gone)
        self._trajectories.forget(gone)
        for drone in gone:
            if drone not in self._admission.known:
                self.part_with(f"{self._prefix}/telemetry/{drone}")

    def take_together(
        self, waited: Waited, now_utc_ns: int, why: list[Refused] | None = None
    ) -> list[Message]:
        """Telemetry messages, topic by topic, as of one time; the refusals to publish.

        To `why` is added why each message is refused, whether that is published or not.
        """
        refusals: list[Message] = []
        names: list[str] = []
        rows: list[PositionReport] = []
        starts: list[int] = []
        self.forget_gone(now_utc_ns)
        for topic, messages in waited:
            drone, first = topic.rpartition("/")[2], len(rows)
            is_known = drone in self._admission.known
            for payload, content_type in messages:
                try:
                    row = fast_decode(payload, content_type)
                    row = row or decode(payload, content_type, now_utc_ns=now_utc_ns)
                    if not is_known and drone in self._scripted:
                        detail = f"drone {drone!r} is flown by the scene itself"
                        raise Refused(Reason.NAME, detail)
                    self._datum.check(row.altitude_reference)
                    if self._admission.admit(drone, row, now_utc_ns):
                        starts.append(len(rows))
                except Refused as refused:
                    if why is not None:
                        why.append(refused)
                    refusal = self.refuse(topic, refused, now_utc_ns)
                    if refusal is not None:
                        refusals.append(refusal)
                else:
                    rows.append(row)
            if len(rows) > first:
                if not is_known:
                    self.welcome(topic)
                if len(rows) > first + 1:
                    n = self._unneeded(rows[first:], now_utc_ns)
                    del rows[first : first + n]
                    starts = [max(at - n, first) if at >= first else at for at in starts]
                names += [drone] * (len(rows) - first)
        self.forget_gone(now_utc_ns)
        if rows:
            self._add(names, rows, starts)
        return refusals

    def _unneeded(self, rows: Sequence[PositionReport], now_utc_ns: int) -> int:
        """How many of a drone's first reports make no state that anybody can still ask for.

        Those before the last one that is further back than all look; where velocities are fitted,
        the positions that they are fitted to are kept, too.
        """
        asked_from_ns = now_utc_ns - self._look_back_ns
        needed = len(rows) - 1
        while needed and rows[needed].t_utc_ns > asked_from_ns:
            needed -= 1
        if any(isnan(sum(row.velocity_enu_m_s)) for row in rows):
            needed = max(0, needed - MAX_FIT_SAMPLES + 1)
        self.conflated += needed
        return needed

    def _add(
        self, names: Sequence[str], rows: Sequence[PositionReport], starts: Sequence[int]
    ) -> None:
        columns = zip(*rows, strict=True)
        t, latitude, longitude, altitude, references, velocity, *others = columns
        horizontal, vertical, _, rcs, sound, size, emitters, said = others
        rcs_m2, sound_power_db, size_m = np.array(rcs), np.array(sound), np.array(size)
        classes = [name or DRONE for name in said]
        samples = FlightSamples(
            t_utc_ns=np.array(t, np.int64),
            latitude_deg=np.array(latitude),
            longitude_deg=np.array(longitude),
            height_m=self._datum.heights_m(latitude, longitude, altitude, references),
            velocity_enu_m_s=np.array(velocity),
            sigma_m=np.fmax(horizontal, vertical),
        )
        signatures = Signatures(
            rcs_m2=np.where(np.isnan(rcs_m2), self._rcs_m2, rcs_m2),
            sound_power_db=np.where(np.isnan(sound_power_db), self._sound_power_db, sound_power_db),
            emitters=emitters,
            size_m=np.where(np.isnan(size_m), self._size_m, size_m),
            target_class=np.array(classes, np.object_),
            echoes=self._echoes and self._echoes.of(classes),
        )
        self._trajectories.add_samples(names, samples, signatures, starts)
        self.taken += len(rows)

    def refuse(
        self, topic: str, refused: Refused, now_utc_ns: int, number: int = 1
    ) -> Message | None:
        """Count messages that are not taken; the one refusal to publish if there is room."""
        self.refusals[refused.reason] += number
        if refused.is_told:
            return None
        if refused.reason is Reason.SECOND_SOURCE:
            log.warning("%s: %s", topic, refused.detail)
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


def to_json(message: pb.Refusal | pb.SensorStatus | pb.SensorDescription) -> bytes:
    """Protobuf's JSON mapping with the schema's own names, zeros included, in one line."""
    text = json_format.MessageToJson(
        message,
        preserving_proto_field_name=True,
        always_print_fields_with_no_presence=True,
        indent=None,
    )
    return text.encode()
