from __future__ import annotations

import json

import numpy as np
import pytest
import pytest_asyncio
from support.recordings import block
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.recording.decoded_text import message_lines
from plotfeed.feeds.recording.record_text import Style, categories_of
from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.cat025 import CAT025_HALF_TURN, StatusEncoder025


def test_cursor_on_target_is_its_own_text_on_any_topic() -> None:
    (line,) = message_lines("any/where", b"<event/>", "application/x-cot+xml")
    assert line == "any/where  <event/>"


@pytest.mark.parametrize(
    "payload",
    [b"[" * 100_000, b"9" * 10_000, b'{"a": NaN}', rb'"\ud800"', b'"' + b"x" * 100_000 + b'"'],
)
@pytest.mark.parametrize("style", [Style.JSON, Style.LINE])
def test_awkward_json_is_a_line(payload: bytes, style: Style) -> None:
    lines = list(message_lines("plotfeed/errors", payload, None, style=style))
    assert len(lines) == 1
    lines[0].encode()
    if style is Style.JSON:
        json.loads(lines[0])


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def messages(tmp_path_factory: pytest.TempPathFactory) -> list[Message]:
    text = scene_text(
        start_utc="2026-01-01T12:00:00Z", port=1883, sensors=radar(period_s=0.2, sectors=8)
    )
    scene = load(scene_file(tmp_path_factory.mktemp("scene"), text))
    seen: list[Message] = []
    clock = InstantClock(scene.scene.start_utc_ns)
    tap = lambda message, _t: seen.append(message)  # noqa: E731
    await run(scene, clock=clock, broker="none", duration_s=3.0, tap=tap)
    return seen


def test_every_message_of_a_session_is_readable_and_json_if_asked(messages: list[Message]) -> None:
    for m in messages:
        lines = list(message_lines(m.topic, m.payload, m.content_type))
        assert not any("not what the topic says" in line for line in lines)
        # The topic alone tells what a client of MQTT 3.1.1 needs.
        assert lines == list(message_lines(m.topic, m.payload, None))
        for line in message_lines(m.topic, m.payload, m.content_type, style=Style.JSON):
            found = json.loads(line)
            assert found["topic"] == m.topic
            assert "error" not in found["message"]


def test_every_plot_is_a_line(messages: list[Message]) -> None:
    batches = [m for m in messages if m.topic.endswith("/plots")]
    plots = sum(len(pb.PlotBatch.FromString(m.payload).plots) for m in batches)
    lines = [x for m in batches for x in message_lines(m.topic, m.payload, None)]
    assert len(lines) == plots > 0
    assert all(" 2026-01-01T12:00:0" in line for line in lines)


def test_the_ledger_says_whose_each_plot_is(messages: list[Message]) -> None:
    entries = [m for m in messages if m.topic.endswith("/truth")]
    text = [x for m in entries for x in message_lines(m.topic, m.payload, None)]
    assert any(line.endswith("of visitor") for line in text)
    assert any(line.endswith("of false alarm") for line in text)
    assert any("  look " in line for line in text)


def test_longitudes_of_025_are_read_as_their_sender_wrote_them() -> None:
    encoder = StatusEncoder025(
        1, 2, latitude_deg=40.45, longitude_deg=-3.73, height_m=650.0, category=CAT025_HALF_TURN
    )
    (block,) = encoder.blocks(np.array([0]), np.array([0]))

    def longitude_deg(*editions: str) -> float:
        (line,) = message_lines(
            "r/asterix/025", block, None, style=Style.JSON, categories=categories_of(editions)
        )
        degrees: float = json.loads(line)["message"]["items"]["I025/600"]["LON"]
        return degrees

    assert longitude_deg("025-half-turn") == pytest.approx(-3.73, abs=1e-7)
    assert longitude_deg() == pytest.approx(-7.46, abs=1e-6)


def test_a_time_beyond_the_year_9999_is_one_line() -> None:
    late = pb.Telemetry()
    late.time_utc.seconds = 1 << 62
    (line,) = message_lines(
        "plotfeed/telemetry/d", late.SerializeToString(), "application/x-protobuf"
    )
    assert "not what the topic says" in line


@pytest.mark.parametrize("sent", [-(2**22) * 3 + 1, 2**25 - 1, 12345])
def test_numbers_are_as_exact_as_they_were_sent(sent: int) -> None:
    longitude = sent.to_bytes(4, "big", signed=True).hex()
    data = block(62, "88", "0102", "00000000", longitude)
    (line,) = message_lines("t/asterix/062", data, None)
    assert float(line.partition("LON=")[2]) * 2**25 / 180 == sent


@pytest.mark.parametrize(
    ("octets", "says"),
    [
        ("010180 0023", "380 RAN=0.35"),
        ("94 3c660c 81f4 e0c8",
         "380 ADR=3C660C IAS=(IM=1 IAS=500) SAL=(SAS=1 SRC=3 ALT=5000)"),
    ],
)  # fmt: skip
def test_numbers_are_written_as_everybody_writes_them(octets: str, says: str) -> None:
    (line,) = message_lines("t/asterix/062", block(62, "8110", "0102", octets), None)
    assert line.endswith(says)
