from __future__ import annotations

import io
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.recordings import MS, START_NS, block, block_048, message, plots, stored
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.console import printed
from plotfeed.feeds.console.printed import with_progress
from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.recording.decoded_text import message_lines
from plotfeed.feeds.recording.record_text import Style, categories_of
from plotfeed.feeds.recording.recording_settings import ShowSettings
from plotfeed.feeds.recording.show import MAX_SERIES, OTHERS, Lateness, Summary, show_file
from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.cat025 import CAT025_HALF_TURN, status_025
from plotfeed.proto.asterix.codec.decode import decode_lenient
from plotfeed.proto.content_types import protobuf_content_type
from plotfeed.proto.utc import NS
from plotfeed.replay.files import FileFormat
from plotfeed.replay.recorded import Recorded, Stage

Capture = pytest.CaptureFixture[str]


def shown(path: Path, **settings: Any) -> int:
    return show_file(path, ShowSettings(**settings))


def lines_of(capsys: Capture, path: Path, **settings: Any) -> list[str]:
    """What is printed of a whole file."""
    assert shown(path, **settings) == 0
    out, err = capsys.readouterr()
    assert err == ""
    return out.splitlines()


def summary_of(messages: list[Recorded]) -> Summary:
    summary = Summary()
    for each in messages:
        summary.add(each)
    return summary


def session() -> list[Recorded]:
    """Plots of two sensors 10 ms apart, due 5 ms before they left, and a status."""
    left = [
        message(
            block_048(43_200),
            START_NS + n * 10 * MS,
            topic=f"plotfeed/{name}/asterix/048",
            publish_time_ns=START_NS + n * 10 * MS - 5 * MS,
            stage=Stage.AFTER,
        )
        for n in range(100)
        for name in ("a", "b")
    ]
    status = message(
        b'{"state": "ONLINE"}',
        START_NS + 3_000 * MS,
        topic="plotfeed/a/status",
        content_type="application/json",
    )
    return [*left, status]


def test_a_summary_tells_counts_times_gaps_and_lateness(tmp_path: Path, capsys: Capture) -> None:
    path = stored(tmp_path / "a.mcap", session())
    assert lines_of(capsys, path) == [
        f"{path}: mcap, 201 messages, 200 records of ASTERIX, 2819 octets, 3.000 s",
        "  first        2026-01-01T12:00:00.000000000Z",
        "  last         2026-01-01T12:00:03.000000000Z",
        "  longest gap  2.010 s from 2026-01-01T12:00:00.990000000Z",
        "  lateness     p50 5 ms, p99 5 ms of 200 (after)",
        "  topic                   stage     kind  messages   1/s  records  octets",
        "  plotfeed/a/asterix/048  after     048        100  33.3      100    1400",
        "  plotfeed/a/status       received  json         1   0.3               19",
        "  plotfeed/b/asterix/048  after     048        100  33.3      100    1400",
    ]
    (line,) = lines_of(capsys, path, as_json=True)
    found = json.loads(line)
    assert found["longest_gap_s"] == pytest.approx(2.01)
    assert found["lateness"]["after"]["p50_us"] == pytest.approx(5000, rel=0.0006)
    assert [row["messages"] for row in found["series"]] == [100, 1, 100]
    told = ("messages", "first_utc", "duration_s", "damage")
    assert [found[name] for name in told] == [201, "2026-01-01T12:00:00.000000000Z", 3.0, []]
    undated = lines_of(capsys, stored(tmp_path / "a.ff", plots(3, step_ns=1000 * MS)))
    assert "  first        12:00:00.000000000Z" in undated
    assert "1970" not in "".join(undated)
    assert undated[-1] == "  final has no date"


def both_sides_of_a_link() -> list[Recorded]:
    return [
        message(
            block_048(43_200), START_NS + n * MS, topic=f"plotfeed/{name}/asterix/048", stage=stage
        )
        for n, stage in enumerate((Stage.BEFORE, Stage.AFTER))
        for name in ("a", "b")
    ]


@pytest.mark.parametrize("suffix", ["mcap", "jsonl"])
def test_stages_are_told_and_chosen_as_topics_are(
    suffix: str, tmp_path: Path, capsys: Capture
) -> None:
    path = stored(tmp_path / f"a.{suffix}", both_sides_of_a_link())
    lines = lines_of(capsys, path, listed=True)
    assert [line.split("  ")[1:3] for line in lines] == [
        [stage, f"plotfeed/{name}/asterix/048"] for stage in ("before", "after") for name in "ab"
    ]
    objects = map(json.loads, lines_of(capsys, path, listed=True, as_json=True))
    assert [each["stage"] for each in objects] == ["before", "before", "after", "after"]
    chosen = {"stages": ("after",), "topics": ("plotfeed/b/#", "no/such")}
    (line,) = lines_of(capsys, path, listed=True, **chosen)
    assert line.startswith("2026-01-01T12:00:00.001000000Z  plotfeed/b/asterix/048  CAT048")
    (line,) = lines_of(capsys, path, as_json=True, stages=("before",), topics=("+/a/#",))
    (row,) = json.loads(line)["series"]
    told = [row[name] for name in ("topic", "stage", "records")]
    assert told == ["plotfeed/a/asterix/048", "before", 1]


def test_blocks_of_a_raw_file_are_chosen_by_their_topic(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "both.ast"
    path.write_bytes(block_048(1) + block(34, "f0", "190d", "01", "546000", "00"))
    (line,) = lines_of(capsys, path, listed=True, topics=("asterix/034",))
    assert line.startswith("CAT034")
    assert shown(path, listed=True, stages=("before",)) == 1
    assert capsys.readouterr().out == ""


def test_records_are_counted_as_far_as_they_are_whole() -> None:
    two = block(48, "f0190d5460000120005a4000"[:14], "f0190d01")
    whole = block_048(1)
    twice = block(48, *[whole[3:].hex()] * 2)
    broken = block(48, whole[3:].hex(), "f019")
    summary = summary_of([message(data) for data in (whole, twice, broken, twice + whole, two)])
    (series,) = summary.series.values()
    assert series.records == summary.records == 1 + 2 + 1 + 3 + 0
    unknown = summary_of([message(block(99, "f0190d"))])
    (series,) = unknown.series.values()
    assert (series.records, unknown.records) == (None, 0)


def test_a_trailer_is_no_error_and_a_topic_moves_no_cursor(tmp_path: Path, capsys: Capture) -> None:
    trailed = message(block_048(1) + b"\xca\xfe\0\1", topic="a/\x1b[2J/asterix/048")
    path = stored(tmp_path / "a.mcap", [trailed])
    (line,) = lines_of(capsys, path, listed=True)
    assert "CAT048" in line
    assert all(each.isprintable() for each in (line, *lines_of(capsys, path)))


@pytest.mark.parametrize(
    "form", [FileFormat.PCAP, FileFormat.FINAL, FileFormat.JSON, FileFormat.MCAP]
)
def test_a_damaged_file_is_shown_as_far_as_it_is_whole(
    form: FileFormat, tmp_path: Path, capsys: Capture
) -> None:
    path = stored(tmp_path / "a", plots(400), form)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 9 // 10 - 3])
    assert shown(path) == 2
    out, err = capsys.readouterr()
    assert " messages, " in out
    assert err.startswith(f"plotfeed: {path}: octet ")
    assert shown(path, as_json=True) == 2
    assert json.loads(capsys.readouterr().out)["damage"] != []


def test_the_octet_of_a_broken_record_is_that_of_the_file(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "broken.ast"
    path.write_bytes(block_048(1) + block(48, "f0", "19") + block_048(2))
    assert shown(path, listed=True) == 2
    out, err = capsys.readouterr()
    assert len(out.splitlines()) == 2
    assert err == (
        f"plotfeed: {path}: octet 18: I048/010 needs 2 octets, 1 are left of its block\n"
    )


@given(st.lists(st.binary(max_size=20).map(lambda body: block(48, body.hex())), max_size=5))
def test_records_and_errors_of_a_raw_file_are_those_of_its_octets(blocks: list[bytes]) -> None:
    from plotfeed.feeds.recording.show import _raw_lines
    from plotfeed.replay.asterix_files import RawReader

    data = b"".join(blocks)
    records, errors = decode_lenient(data)
    reader = RawReader(io.BytesIO(data))
    lines = list(_raw_lines(reader, ShowSettings(as_json=True)))
    assert [json.loads(line)["category"] for line in lines] == [r.category for r in records]
    assert [each.offset for each in reader.damage] == [error.at_octet for error in errors]


def test_raw_asterix_is_shown_without_what_others_need(tmp_path: Path) -> None:
    # Each of them takes longer to load than the rest of the command.
    path = tmp_path / "few.ast"
    path.write_bytes(block_048(1) * 2)
    code = (
        "import sys; from plotfeed.feeds.cli.main import main\n"
        f"sys.argv = ['plotfeed', 'show', {str(path)!r}, '--list']\n"
        "try: main()\n"
        "finally: print(*{'numpy', 'pydantic', 'google.protobuf', 'asyncio'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert [line[:6] for line in done.stdout.splitlines()] == ["CAT048", "CAT048", ""]


def test_percentiles_of_lateness_are_within_0_05_percent() -> None:
    rng = np.random.default_rng(1)
    late_ns = np.concatenate([rng.lognormal(14, 2, 5000), -rng.lognormal(10, 1, 500), np.zeros(9)])
    late = Lateness()
    for each in late_ns.astype(np.int64):
        late.add(int(each))
    for percent in (1, 5, 50, 90, 99, 100):
        exact = np.percentile(late_ns.astype(np.int64), percent, method="inverted_cdf")
        assert late.percentile_ns(percent) == pytest.approx(exact, rel=0.00051)
    assert math.isnan(Lateness().percentile_ns(50))


def test_gaps_and_lateness_are_of_messages_in_order_and_of_so_many_topics() -> None:
    """Not of the ledger."""
    summary = summary_of([message(b"", 1000 + t) for t in (10, 30, 20, 40, 5)])
    assert (summary.first_ns, summary.last_ns, summary.disordered) == (1005, 1040, 2)
    assert (summary.gap_ns, summary.gap_from_ns) == (20, 1010)
    early = summary_of([message(b"", 1000, publish_time_ns=2000, stage=Stage.AFTER)])
    assert early.lateness[Stage.AFTER].percentile_ns(50) == pytest.approx(-1000, rel=0.0006)
    kind = protobuf_content_type("plotfeed.v1.Ledger")  # which is told when there is time
    ledger = message(b"", NS, publish_time_ns=0, stage=Stage.AFTER, content_type=kind)
    assert summary_of([ledger]).lateness == summary_of([message(b"", 1000)]).lateness == {}
    many = summary_of([message(b"", n, topic=f"t/{n}") for n in range(MAX_SERIES + 50)])
    assert len(many.series) == MAX_SERIES + 1
    assert many.series[(OTHERS, Stage.RECEIVED, "")].messages == 50


def test_a_bar_shows_on_a_terminal_alone_and_loses_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    things = list(range(1000))
    assert list(with_progress(things, "x", lambda: 0, 1000)) == things
    assert capsys.readouterr().err == ""
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    assert list(with_progress(things, "x", lambda: 0, 1000)) == things
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(printed, "PATIENCE_S", 0.0)
    assert list(with_progress(things, "recording.mcap", lambda: 500, 1000)) == things
    assert "recording.mcap" in capsys.readouterr().err


def test_many_bad_lines_are_told_in_a_few(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "many.jsonl"
    path.write_bytes(b'{"bad"\n' * 900)
    assert shown(path) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 6
    assert lines[-1] == (
        f"plotfeed: {path}: and 895 more, the last at octet 6293: a line that is no JSON"
        "; --json without --list has all"
    )
    shown(path, as_json=True)
    assert len(json.loads(capsys.readouterr().out)["damage"]) == 900


@pytest.mark.parametrize("how", [{}, {"listed": True}, {"as_json": True}, {"count": 3}])
@pytest.mark.parametrize("chosen", [{"topics": ("no/such",)}, {"stages": ("telemetry",)}])
def test_a_choice_that_fits_no_message_fails_and_says_so(
    how: dict[str, Any], chosen: dict[str, Any], tmp_path: Path, capsys: Capture
) -> None:
    path = stored(tmp_path / "a.mcap", session())
    assert shown(path, **how, **chosen) == 1
    told = f"plotfeed: {path}: no message is of the topics and stages asked for\n"
    assert capsys.readouterr().err == told
    assert shown(path, **how) == 0


@pytest.mark.parametrize(
    "payload",
    [b"[" * 100_000, b"9" * 10_000, b'{"a": NaN}', rb'"\ud800"', b'"' + b"x" * 100_000 + b'"'],
)
def test_awkward_json_is_a_line(payload: bytes) -> None:
    for style in (Style.JSON, Style.LINE):
        (line,) = message_lines("plotfeed/errors", payload, None, style=style)
        line.encode()
        assert style is Style.LINE or json.loads(line)


def test_what_others_send_is_one_line() -> None:
    (line,) = message_lines("any/where", b"<event/>", "application/x-cot+xml")
    assert line == "any/where  <event/>"
    late = pb.Telemetry()
    late.time_utc.seconds = 1 << 62  # beyond the year 9999
    sent = late.SerializeToString()
    (line,) = message_lines("plotfeed/telemetry/d", sent, "application/x-protobuf")
    assert "not what the topic says" in line


@pytest.mark.asyncio
async def test_every_message_of_a_session_is_readable_and_json_if_asked(tmp_path: Path) -> None:
    text = scene_text(
        start_utc="2026-01-01T12:00:00Z", port=1883, sensors=radar(period_s=0.2, sectors=8)
    )
    scene = load(scene_file(tmp_path, text))
    clock, seen = InstantClock(scene.scene.start_utc_ns), list[Message]()
    tap = lambda message, _t: seen.append(message)  # noqa: E731
    await run(scene, clock=clock, broker="none", duration_s=3.0, tap=tap)
    told: dict[str, list[str]] = {"plots": [], "truth": []}
    for m in seen:
        lines = list(message_lines(m.topic, m.payload, m.content_type))
        assert not any("not what the topic says" in line for line in lines)
        # The topic alone tells what a client of MQTT 3.1.1 needs.
        assert lines == list(message_lines(m.topic, m.payload, None))
        told.setdefault(m.topic.rpartition("/")[2], []).extend(lines)
        for line in message_lines(m.topic, m.payload, m.content_type, style=Style.JSON):
            found = json.loads(line)
            assert found["topic"] == m.topic
            assert "error" not in found["message"]
    batches = [pb.PlotBatch.FromString(m.payload) for m in seen if m.topic.endswith("/plots")]
    assert len(told["plots"]) == sum(len(batch.plots) for batch in batches) > 0
    assert all(" 2026-01-01T12:00:0" in line for line in told["plots"])
    for whose in ("of visitor", "of false alarm"):
        assert any(line.endswith(whose) for line in told["truth"])
    assert any("  look " in line for line in told["truth"])


def test_longitudes_of_025_are_read_as_their_sender_wrote_them() -> None:
    encoder = status_025(1, 2, (40.45, -3.73, 650.0), category=CAT025_HALF_TURN)
    (block,) = encoder.one_each([0], np.array([0]))

    def longitude_deg(*editions: str) -> float:
        (line,) = message_lines(
            "r/asterix/025", block, None, style=Style.JSON, categories=categories_of(editions)
        )
        degrees: float = json.loads(line)["message"]["items"]["I025/600"]["LON"]
        return degrees

    assert longitude_deg("025-half-turn") == pytest.approx(-3.73, abs=1e-7)
    assert longitude_deg() == pytest.approx(-7.46, abs=1e-6)


@pytest.mark.parametrize(
    ("octets", "says"),
    [
        ("010180 0023", "380 RAN=0.35"),
        ("94 3c660c 81f4 e0c8",
         "380 ADR=3C660C IAS=(IM=1 IAS=500) SAL=(SAS=1 SRC=3 ALT=5000)"),
    ],
)  # fmt: skip
def test_numbers_are_as_exact_as_they_were_sent_and_written_as_everybody_writes_them(
    octets: str, says: str
) -> None:
    (line,) = message_lines("t/asterix/062", block(62, "8110", "0102", octets), None)
    assert line.endswith(says)
    for sent in (-(2**22) * 3 + 1, 2**25 - 1, 12345):
        longitude = sent.to_bytes(4, "big", signed=True).hex()
        data = block(62, "88", "0102", "00000000", longitude)
        (line,) = message_lines("t/asterix/062", data, None)
        assert float(line.partition("LON=")[2]) * 2**25 / 180 == sent
