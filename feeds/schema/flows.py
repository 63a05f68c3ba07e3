"""What flows over MQTT: every topic, what is on it, and when. The AsyncAPI document says it on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from plotfeed.feeds.formats import FORMATS
from plotfeed.feeds.messages.message import type_of
from plotfeed.feeds.scene.changes import Command
from plotfeed.feeds.scene.claim_keys import CLAIMED, COOPERATIVE
from plotfeed.feeds.scene.report_formats import CUE_TOPIC
from plotfeed.feeds.scene.sensors import SENSORS
from plotfeed.feeds.scene.sensors.mount_keys import Cue
from plotfeed.feeds.scene.sensors.sensor_keys import SensorGeometry
from plotfeed.proto.content_types import JSON, PROTOBUF, asterix_content_type

OURS = "plotfeed.v1"
OF_SENSOR = ("sensor",)
OF_SECTOR = ("sensor", "scan", "sector")
# Without which telemetry is refused.
REQUIRED = ("time_utc", "latitude_deg", "longitude_deg", "altitude_m", "altitude_reference")


@dataclass(frozen=True, slots=True, kw_only=True)
class Flow:
    """One kind of message on one topic."""

    name: str
    address: str  # The topic; {prefix}, {sensor} and {drone} stand for what differs
    content_type: str
    summary: str
    message: str = ""  # The protobuf message that it is, in protobuf or in JSON
    attributes: tuple[str, ...] = ()  # User properties besides those that CloudEvents demands
    kind: str = ""  # Its CloudEvents type
    qos: int | None = None  # None is what the scene says
    retain: bool = False
    needs: str = ""  # What must be so that there are any, if there need not be
    sensors: tuple[str, ...] = ()  # Types of sensors that publish it
    inbound: bool = False
    required: tuple[str, ...] | None = None  # Keys of JSON; None is what protobuf always writes
    schema: Mapping[str, Any] | None = None  # Of JSON that is no protobuf message


def flows() -> list[Flow]:
    """Everything that flows, from sensors first."""
    found: dict[str, Flow] = {}
    for name in sorted(FORMATS):
        for flow in _of_format(name):
            before = found.get(flow.name, flow)
            sensors = sorted({*flow.sensors, *before.sensors})
            found[flow.name] = replace(flow, sensors=tuple(sensors))
    return [*found.values(), *_of_session(), *_telemetry(), _control(), _cue()]


def types_that_report(name: str) -> tuple[str, ...]:
    """Sensor types whose scene may ask for that format."""
    return tuple(kind for kind, keys in SENSORS.items() if name in keys.formats)


def _of_format(name: str) -> Iterator[Flow]:
    sensors = types_that_report(name)
    facts = FORMATS[name].facts
    if facts.categories:
        for category, sent in facts.categories.items():
            yield _asterix(
                category,
                sent.summary,
                address=f"{{prefix}}/{{sensor}}/asterix/{category:03d}",
                attributes=OF_SECTOR,
                sensors=tuple(
                    kind
                    for kind in sensors
                    if SENSORS[kind].geometry is SensorGeometry.BISTATIC
                    or not sent.has_illuminators
                ),
            )
        return
    announces = FORMATS[name].announcer is not None
    plots = Flow(
        name=f"{name}Detections" if announces else name,
        address=f"{{prefix}}/{{sensor}}/{facts.topic}",
        content_type=facts.content_type,
        summary=facts.summary,
        message=facts.message,
        attributes=OF_SECTOR,
        kind=type_of(facts.topic),
        sensors=sensors,
        schema=facts.schema,
    )
    yield plots
    for what in ("registration", "status", "goodbye", "answer") if announces else ():
        yield replace(
            plots,
            name=f"{name}{what.capitalize()}",
            summary=plots.summary.replace("detections", what),
            attributes=OF_SENSOR,
            kind=f"plotfeed.{name}.{what}",
            qos=1,
            retain=what in {"registration", "goodbye"},
            needs="somebody asked something" if what == "answer" else "",
        )
    if facts.inbox:
        yield Flow(
            name=f"{name}Task",
            address=f"{{prefix}}/{{sensor}}/{facts.inbox}",
            content_type=facts.content_type,
            summary=plots.summary.replace("detections", "something that a sensor is asked to do"),
            message=facts.message,
            sensors=sensors,
            inbound=True,
        )


def _asterix(category: int, summary: str, *, address: str, **more: object) -> Flow:
    return Flow(
        name=f"asterix{category:03d}",
        address=address,
        content_type=asterix_content_type(category),
        summary=f"An ASTERIX data block of category {category:03d}: {summary}.",
        kind=f"plotfeed.asterix.{category:03d}",
        **more,  # type: ignore[arg-type]
    )


def _of_session() -> Iterator[Flow]:
    yield Flow(
        name="status",
        address="{prefix}/{sensor}/status",
        content_type=JSON,
        summary="A sensor's state, every 5 s, at the end, and as a last will.",
        message=f"{OURS}.SensorStatus",
        attributes=OF_SENSOR,
        kind="plotfeed.status",
        qos=1,
        retain=True,
    )
    yield Flow(
        name="settings",
        address="{prefix}/{sensor}/settings",
        content_type=JSON,
        summary="What the keys of a sensor are at the moment, and which control has changed.",
        attributes=OF_SENSOR,
        kind="plotfeed.settings",
        qos=1,
        retain=True,
        schema=_object(sensor="string", time_utc="string", controlled="object", in_force="object"),
    )
    yield Flow(
        name="description",
        address="{prefix}/{sensor}/description",
        content_type=JSON,
        summary="What a sensor is, where it stands, what it covers, how well and where it reports.",
        message=f"{OURS}.SensorDescription",
        attributes=OF_SENSOR,
        kind="plotfeed.description",
        qos=1,
        retain=True,
    )
    yield Flow(
        name="session",
        address="{prefix}/session",
        content_type=JSON,
        summary="Which scene runs, or has run: at the start, at the end, as a last will, when "
        "another session is heard, and when a clock faster than the world's reaches another speed.",
        kind="plotfeed.session",
        qos=1,
        retain=True,
        schema=_object(
            session="string",
            state="string",
            heard="array",
            scene="string",
            seed="integer",
            start_utc="string",
            start_utc_ns="integer",
            tick_ms="integer",
            sensors="array",
            site="object",
            plotfeed="string",
            speed="number?",
            speed_reached="number?",
        ),
    )
    yield Flow(
        name="truth",
        address="{prefix}/truth",
        content_type=f"{PROTOBUF}; messageType={OURS}.LedgerBatch",
        summary="The ledger of sectors: whose plot is whose, what was missed. Not for trackers.",
        message=f"{OURS}.LedgerBatch",
        kind="plotfeed.truth",
        qos=0,
        needs="mqtt.truth is not false",
    )
    yield Flow(
        name="score",
        address="{prefix}/score",
        content_type=JSON,
        summary="How the tracker under test and the feed do, once a second. Not for trackers.",
        kind="plotfeed.score",
        qos=0,
        needs="page.tracks_topic says where a tracker publishes, and mqtt.truth is not false",
        schema=_object(
            time_utc="string",
            tracks_topic="string",
            cutoff_m="number",
            drones="integer",
            tracks="integer",
            reports="integer",
            unreadable="integer",
            problem="string",
            now="object",
            window_s="integer",
            window="object",
            feed_false_rate="number",
            feed="array",
        ),
    )
    yield Flow(
        name="errors",
        address="{prefix}/errors",
        content_type=JSON,
        summary="Telemetry or a command that was refused, and why.",
        message=f"{OURS}.Refusal",
        kind="plotfeed.errors",
        qos=0,
        needs="something was refused",
    )
    yield _asterix(
        129,
        "what a cooperative drone says of itself",
        address=f"{{prefix}}/{COOPERATIVE}/asterix/129",
        attributes=("drone",),
        needs="[cooperative] has asterix-129 in its report",
    )
    for name, content_type in (
        ("claimedJson", JSON),
        ("claimedProtobuf", f"{PROTOBUF}; messageType={OURS}.Telemetry"),
    ):
        yield Flow(
            name=name,
            address=f"{{prefix}}/{CLAIMED}/{{drone}}",
            content_type=content_type,
            summary="What a cooperative drone says of itself, as telemetry.",
            message=f"{OURS}.Telemetry",
            attributes=("drone",),
            kind="plotfeed.claimed",
            needs=f"[cooperative] has {name.removeprefix('claimed').lower()} in its report",
            required=REQUIRED,
        )


def _object(**types: str) -> dict[str, Any]:
    """The schema of an object that has all of those keys but those whose type ends with "?"."""
    properties = {name: {"type": kind.removesuffix("?")} for name, kind in types.items()}
    required = [name for name, kind in types.items() if not kind.endswith("?")]
    return {"type": "object", "properties": properties, "required": required}


def _inlined(schema: dict[str, Any]) -> dict[str, Any]:
    """A schema of pydantic's with its definitions where they are referred to."""
    definitions = schema.pop("$defs", {})

    def inlined(value: Any) -> Any:
        if isinstance(value, list):
            return [inlined(inner) for inner in value]
        if not isinstance(value, dict):
            return value
        if "$ref" in value:
            return inlined(definitions[value["$ref"].rpartition("/")[2]])
        # OpenAPI's discriminator is an object; AsyncAPI's is another thing, and refuses it.
        return {key: inlined(inner) for key, inner in value.items() if key != "discriminator"}

    inside: dict[str, Any] = inlined(schema)
    return inside


def _control() -> Flow:
    return Flow(
        name="control",
        address="{prefix}/control",
        content_type=JSON,
        summary="What is to be otherwise from now on: keys of a sensor, or a simulated clock.",
        inbound=True,
        schema=_inlined(Command.model_json_schema()),
    )


def _cue() -> Flow:
    return Flow(
        name="cue",
        address=f"{{prefix}}/{{sensor}}/{CUE_TOPIC}",
        content_type=JSON,
        summary="Where the mount of a sensor is to look, for a while.",
        sensors=tuple(kind for kind, keys in SENSORS.items() if "mount" in keys.model_fields),
        inbound=True,
        schema=_inlined(Cue.model_json_schema()),
    )


def _telemetry() -> Iterator[Flow]:
    for name, content_type, message in (
        ("telemetryProtobuf", PROTOBUF, f"{OURS}.Telemetry"),
        ("telemetryJson", JSON, f"{OURS}.Telemetry"),
        ("telemetryAsterix129", asterix_content_type(129), ""),
    ):
        yield Flow(
            name=name,
            address="{prefix}/telemetry/{drone}",
            content_type=content_type,
            summary="Where a drone is.",
            message=message,
            inbound=True,
            required=REQUIRED,
        )
