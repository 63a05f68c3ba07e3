"""What drones of a scene say of themselves, rightly or not, and what of it is true."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from plotfeed.feeds.engine.scene_drones import SceneDrones
from plotfeed.feeds.messages.message import Message, attributes
from plotfeed.feeds.scene.claim_keys import CLAIMED, COOPERATIVE, ClaimFault, CooperativeKeys
from plotfeed.feeds.scene.fields import Site, geodetic
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.telemetry.position_report import LIMITS, PositionReport
from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.frames import LocalFrame, ecef_to_geodetic, geodetic_to_ecef
from plotfeed.models.state import AltitudeReference, Floats
from plotfeed.models.truth import Trajectories
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.cat129 import TargetEncoder129
from plotfeed.proto.content_types import (
    JSON,
    TELEMETRY,
    asterix_content_type,
    protobuf_content_type,
)
from plotfeed.proto.utc import NS

# Radius that holds half of a circular normal distribution, in standard deviations.
HALF_OF_POSITIONS = (2 * np.log(2)) ** 0.5
# Content type and encoder of what is said as telemetry is.
AS_TELEMETRY: dict[str, tuple[str, Callable[[PositionReport], bytes]]] = {
    "json": (JSON, PositionReport.to_json),
    "protobuf": (protobuf_content_type(TELEMETRY), PositionReport.to_protobuf),
}


WALK, DROP_OUT = 1, 2  # Streams of draws beside those of the positions' errors


@dataclass(slots=True)
class _Speaker:
    """A drone that says where it is."""

    row: int
    chance: Chance
    first_ns: int = 0  # When it sets out
    # When each begins and ends, UTC, by its scene.
    faults: list[tuple[int, int | None, ClaimFault]] = field(default_factory=list)
    controlled: tuple[int, int | None, ClaimFault] | None = None
    # When a walk began, the number of its last step, and how far it is.
    walked: tuple[int, int, Floats] | None = None

    def fault_at(self, t_utc_ns: int) -> tuple[int, ClaimFault | None]:
        """What makes it speak otherwise then, and since when."""
        controlled = () if self.controlled is None else (self.controlled,)
        for begin_ns, end_ns, fault in (*controlled, *reversed(self.faults)):
            if begin_ns <= t_utc_ns and (end_ns is None or t_utc_ns < end_ns):
                return begin_ns, fault
        return t_utc_ns, None


class CooperativeDrones:
    """What the cooperative drones say at the k-th period since 1970, in the scene's formats.

    A claim is a report of a position above the ellipsoid, as telemetry is.
    """

    def __init__(
        self,
        scene: Scene,
        settings: CooperativeKeys,
        trajectories: Trajectories,
        drones: SceneDrones,
    ) -> None:
        """Have them say it as [cooperative] has it; raises `PlotfeedError` without sea level."""
        self.period_ns = round(settings.period_s * NS)
        self._settings = settings
        self._trajectories, self._drones = trajectories, drones
        self._site: Site = scene.scene.site
        self._faults = {d.id: d.claim for d in scene.fleet.drones}
        row_of = {name: row for row, name in enumerate(trajectories.names)}
        self._speakers = {
            name: _Speaker(row_of[name], Chance(scene.scene.seed, f"{COOPERATIVE}/{name}"))
            for name in sorted(set(scene.fleet.cooperative_names), key=row_of.__getitem__)
        }
        self._sea_level = scene.sea_level()
        self._encoder = TargetEncoder129(settings.sac, settings.sic, country=settings.country)
        self._prefix, self._qos = scene.mqtt.prefix, scene.mqtt.qos

    def start(self, start_utc_ns: int) -> None:
        """Faults of the scene count from that time."""
        first_ns = self._trajectories.spans_ns[:, 0].tolist()
        for name, speaker in self._speakers.items():
            speaker.first_ns = first_ns[speaker.row]
            speaker.faults = [
                (
                    start_utc_ns + round((fault.from_s or 0.0) * NS),
                    None if fault.to_s is None else start_utc_ns + round(fault.to_s * NS),
                    fault,
                )
                for fault in self._faults[name]
            ]

    def __contains__(self, drone: object) -> bool:
        return drone in self._speakers

    def control(self, drone: str, fault: ClaimFault | None, at_utc_ns: int) -> None:
        """Have a drone speak so from then on; as its scene wants it, with None."""
        self._speakers[drone].controlled = None if fault is None else (at_utc_ns, None, fault)

    def said(self, number: int) -> tuple[list[Message], list[pb.Claim]]:
        """Messages that are due then, and what is true of what is said or not said."""
        due_utc_ns, claims, truths = number * self.period_ns, {}, []
        for name, speaker in self._speakers.items():
            begin_ns, fault = speaker.fault_at(due_utc_ns)
            at_ns = due_utc_ns - (0 if fault is None else round(fault.delay_s * NS))
            true = self._state(speaker.row, at_ns)
            if true is None:
                continue
            truth = pb.Claim(
                drone=name,
                time_utc_ns=at_ns,
                latitude_deg=true.latitude_deg,
                longitude_deg=true.longitude_deg,
                height_m=true.altitude_m,
                faults=() if fault is None else fault.names,
                contingency=self._drones.doing(name, at_ns),
            )
            truths.append(truth)
            told = true
            if fault is not None:
                rng = speaker.chance.rng(Purpose.COOPERATION, number, DROP_OUT)
                is_dropped = fault.drop_out and rng.random() < fault.drop_out
                if is_dropped or at_ns < begin_ns:  # or still on its way
                    continue
                told = self._faulty(speaker, true, fault, begin_ns)
            claims[name] = told = self._erring(speaker, told, number)
            place = geodetic_to_ecef(told.latitude_deg, told.longitude_deg, told.altitude_m)
            error_m = _frame(true).from_ecef(place).tolist()
            truth.error_east_m, truth.error_north_m, truth.error_up_m = error_m
        return self._messages(number, due_utc_ns, claims), truths

    def _messages(
        self, number: int, due_utc_ns: int, claims: Mapping[str, PositionReport]
    ) -> list[Message]:
        """All of one time, in the order of drones."""
        source = f"{self._prefix}/{COOPERATIVE}"
        by_format = []
        for name in self._settings.report if claims else ():
            if name == "asterix-129":
                head = ("asterix/129", f"{source}/asterix/129", asterix_content_type(129))
                by_format.append([(*head, block) for block in self._as_129(claims)])
            else:
                content_type, encode = AS_TELEMETRY[name]
                by_format.append(
                    [
                        (CLAIMED, f"{self._prefix}/{CLAIMED}/{drone}", content_type, encode(claim))
                        for drone, claim in claims.items()
                    ]
                )
        found = []
        for drone, *said in zip(claims, *by_format, strict=True):
            for kind, topic, content_type, payload in said:
                what = attributes(source, kind, f"{number}-{drone}", due_utc_ns, drone=drone)
                found.append(Message(topic, payload, content_type, due_utc_ns, what, qos=self._qos))
        return found

    def _as_129(self, claims: Mapping[str, PositionReport]) -> list[bytes]:
        reports, accuracy_m = list(claims.values()), self._settings.accuracy_m
        places = [(each.latitude_deg, each.longitude_deg, each.altitude_m) for each in reports]
        latitude_deg, longitude_deg, height_m = np.array(places).T
        half_within_m = np.full(len(reports), accuracy_m * HALF_OF_POSITIONS)
        return self._encoder.blocks(
            list(claims),
            np.array([each.t_utc_ns for each in reports], np.int64),
            latitude_deg,
            longitude_deg,
            altitude_m=height_m - self._sea_level.undulation_m(latitude_deg, longitude_deg),
            accuracy_m=half_within_m if accuracy_m else None,
            velocity_m_s=np.array([each.velocity_enu_m_s for each in reports]),
        )

    def _state(self, row: int, t_utc_ns: int) -> PositionReport | None:
        """Where a drone truly is, and how it flies; None if it is not there."""
        state = self._trajectories.state_at(t_utc_ns, np.array([row]))
        if not len(state):
            return None
        at = (float(x[0]) for x in ecef_to_geodetic(state.position_ecef_m))
        latitude_deg, longitude_deg, height_m = at
        frame = LocalFrame(latitude_deg, longitude_deg, height_m)
        east, north, up = frame.rotate_from_ecef(state.velocity_ecef_m_s[0]).tolist()
        accuracy_m = self._settings.accuracy_m or np.nan
        place = latitude_deg, longitude_deg, height_m, AltitudeReference.ELLIPSOID
        return PositionReport(t_utc_ns, *place, (east, north, up), accuracy_m, accuracy_m)

    def _faulty(
        self, speaker: _Speaker, true: PositionReport, fault: ClaimFault, begin_ns: int
    ) -> PositionReport:
        """The claim of a drone that takes what is wrong for true."""
        told, since_s = true, (true.t_utc_ns - begin_ns) / NS
        error_m = np.array(fault.bias_enu_m)
        if fault.freeze:
            told = self._state(speaker.row, max(begin_ns, speaker.first_ns)) or true
        velocity = np.array(told.velocity_enu_m_s)
        if fault.spoof is not None:
            place = geodetic_to_ecef(*geodetic(self._site, fault.spoof))
            way_m = _frame(true).from_ecef(place)
            length_m = float(np.linalg.norm(way_m))
            drag_m_s = fault.spoof.drag_m_s
            gone_m = length_m if drag_m_s is None else min(length_m, drag_m_s * since_s)
            if drag_m_s is None or gone_m == length_m:
                velocity = np.zeros(3)
            else:
                velocity = velocity + drag_m_s * way_m / length_m
            error_m = error_m + way_m * (gone_m / length_m if length_m else 0.0)
        if fault.walk_m:
            error_m = error_m + fault.walk_m * self._walk(speaker, begin_ns, true.t_utc_ns)
        east, north, up = velocity.tolist()
        told = told._replace(t_utc_ns=true.t_utc_ns, velocity_enu_m_s=(east, north, up))
        return _moved(told, error_m)

    def _walk(self, speaker: _Speaker, begin_ns: int, t_utc_ns: int) -> Floats:
        """A random walk of 1 m after a second, step by step of the period; (3,)."""
        first, last = begin_ns // self.period_ns + 1, t_utc_ns // self.period_ns
        walked = speaker.walked
        if walked is None or walked[0] != begin_ns or walked[1] > last:
            walked = begin_ns, first - 1, np.zeros(3)
        done, at_m = walked[1], walked[2]
        for number in range(done + 1, last + 1):
            before_ns = max(begin_ns, (number - 1) * self.period_ns)
            step_s = (number * self.period_ns - before_ns) / NS
            rng = speaker.chance.rng(Purpose.COOPERATION, number, WALK)
            at_m = at_m + step_s**0.5 * rng.standard_normal(3)
        speaker.walked = begin_ns, max(last, done), at_m
        return at_m

    def _erring(self, speaker: _Speaker, told: PositionReport, number: int) -> PositionReport:
        """The claim with the error that every report has, at an altitude that reports may have."""
        if self._settings.accuracy_m:
            rng = speaker.chance.rng(Purpose.COOPERATION, number)
            told = _moved(told, self._settings.accuracy_m * rng.standard_normal(3))
        least_m, greatest_m = LIMITS["altitude_m"]
        return told._replace(altitude_m=min(max(told.altitude_m, least_m), greatest_m))


def _frame(claim: PositionReport) -> LocalFrame:
    return LocalFrame(claim.latitude_deg, claim.longitude_deg, claim.altitude_m)


def _moved(claim: PositionReport, by_enu_m: Floats) -> PositionReport:
    """The claim of a place so far off."""
    latitude_deg, longitude_deg, height_m = (float(x) for x in _frame(claim).to_geodetic(by_enu_m))
    return claim._replace(
        latitude_deg=latitude_deg, longitude_deg=longitude_deg, altitude_m=height_m
    )
