"""Content types of payloads, as MQTT 5 and recordings name them."""

from __future__ import annotations

PROTOBUF = "application/x-protobuf"
JSON = "application/json"
GEOJSON = "application/geo+json"
COT = "application/x-cot+xml"  # Cursor on Target has no registered name
ASTERIX = "application/x-asterix"
SCHEMA = "schema="
MESSAGE_TYPE = "messageType="
TELEMETRY = "plotfeed.v1.Telemetry"
LEDGER_BATCH, LEDGER = "plotfeed.v1.LedgerBatch", "plotfeed.v1.Ledger"
PLOT_BATCH, TRACK_BATCH = "plotfeed.v1.PlotBatch", "plotfeed.v1.TrackBatch"
# Full names of messages of protobuf.
SAPIENT_MESSAGE = "sapient_msg.bsi_flex_335_v2_0.SapientMessage"


def asterix_content_type(category: int) -> str:
    """The content type of a data block."""
    return f"{ASTERIX}; cat={category}"


def protobuf_content_type(message: str) -> str:
    """The content type of a protobuf message of that full name."""
    return f"{PROTOBUF}; {MESSAGE_TYPE}{message}"


def json_content_type(schema: str, kind: str = JSON) -> str:
    """The content type of JSON that follows a schema of `proto.json_schemas`."""
    return f"{kind}; {SCHEMA}{schema}"


def schema_name(content_type: str) -> str:
    """The schema that a content type of JSON names; empty if it names none."""
    return content_type.partition(SCHEMA)[2].partition(";")[0].strip(' "')


def message_type(content_type: str) -> str:
    """The full name of the protobuf message that a content type names; empty if it names none."""
    return content_type.partition(MESSAGE_TYPE)[2].partition(";")[0].strip(' "')


def is_asterix_topic(topic: str) -> bool:
    """Whether messages of a topic are ASTERIX, unless their content type says otherwise."""
    return "asterix" in topic.split("/")[-2:]
