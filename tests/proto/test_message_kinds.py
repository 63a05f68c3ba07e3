"""A message's content type says what it holds, and where it has none, its topic does."""

from __future__ import annotations

import pytest

from plotfeed.proto.content_types import (
    ASTERIX,
    COT,
    GEOJSON,
    JSON,
    LEDGER,
    PLOT_BATCH,
    PROTOBUF,
    SAPIENT_MESSAGE,
    TELEMETRY,
    TRACK_BATCH,
    asterix_content_type,
    json_content_type,
    protobuf_content_type,
)
from plotfeed.proto.message_kinds import OUR_MESSAGES, kind_of

TOLD_BY_TYPE = {
    asterix_content_type(48): ASTERIX,
    ASTERIX: ASTERIX,
    json_content_type("plotfeed.AirTraffic"): JSON,
    json_content_type("plotfeed.TrackFeatures", GEOJSON): GEOJSON,
    COT: COT,
    protobuf_content_type(SAPIENT_MESSAGE): SAPIENT_MESSAGE,
    protobuf_content_type("sapient_msg.bsi_flex_335_v3_0.SapientMessage"): SAPIENT_MESSAGE,
    f'{PROTOBUF};messageType="{PLOT_BATCH}"; charset=x': PLOT_BATCH,
    **{protobuf_content_type(name): name for name in OUR_MESSAGES},
}
TOLD_BY_TOPIC = {
    "p/radar/asterix/048": ASTERIX,
    "p/radar/plots": PLOT_BATCH,
    "p/radar/tracks": TRACK_BATCH,
    "p/truth": LEDGER,
    "p/radar/sapient": SAPIENT_MESSAGE,
    "p/radar/sapient/task": SAPIENT_MESSAGE,
    "p/radar/cot": COT,
    "p/errors": JSON,
    "p/radar/description": JSON,
    "p/session": JSON,
    "p/telemetry/plots": TELEMETRY,
    "p/telemetry/asterix": TELEMETRY,
    "asterix/truth/more/plots": PLOT_BATCH,
    "udp/10.0.0.1/8600": "",
    "plots/of/others": "",
    "": "",
}


@pytest.mark.parametrize(("content_type", "kind"), TOLD_BY_TYPE.items())
@pytest.mark.parametrize("topic", TOLD_BY_TOPIC)
def test_a_content_type_says_what_a_message_is_on_any_topic(
    topic: str, content_type: str, kind: str
) -> None:
    assert kind_of(topic, content_type) == kind


@pytest.mark.parametrize(("topic", "kind"), TOLD_BY_TOPIC.items())
@pytest.mark.parametrize(
    "content_type", ["", PROTOBUF, protobuf_content_type("no.such.Thing"), "image/png"]
)
def test_a_content_type_that_says_nothing_leaves_it_to_the_topic(
    topic: str, content_type: str, kind: str
) -> None:
    assert kind_of(topic, content_type) == kind
