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
from support.recordings import MS, START_NS, block, block_048, message, plots, written

from plotfeed.feeds.console import printed
from plotfeed.feeds.console.printed import with_progress
from plotfeed.feeds.recording.recording_settings import ShowSettings
from plotfeed.feeds.recording.show import MAX_SERIES, OTHERS, Lateness, Summary, show_file
from plotfeed.proto.asterix.codec.decode import decode_lenient
from plotfeed.proto.content_types import protobuf_content_type
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS
from plotfeed.replay.files import FileFormat, writer_to
from plotfeed.replay.recorded import Recorded, Stage

Capture = pytest.CaptureFixture[str]


def stored(folder: Path, messages: list[Recorded], form: FileFormat = FileFormat.MCAP) -> Path:
    path = folder / f"recording.{form}"
    path.write_bytes(written(lambda file: writer_to(file, form), messages))
    return path


def shown(path: Path, **settings: Any) -> int:
    return show_file(path, ShowSettings(**settings))


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
    path = stored(tmp_path, session())
    assert shown(path) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert out.splitlines() == [
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
    assert shown(path, as_json=True) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["messages"] == 201
    assert found["first_utc"] == "2026-01-01T12:00:00.000000000Z"
    assert found["duration_s"] == 3.0
    assert found["longest_gap_s"] == pytest.approx(2.01)
    assert found["lateness"]["after"]["p50_us"] == pytest.approx(5000, rel=0.0006)
    assert {row["topic"]: row["messages"] for row in found["series"]} == {
        "plotfeed/a/asterix/048": 100,
        "plotfeed/a/status": 1,
        "plotfeed/b/asterix/048": 100,
    }
    assert found["damage"] == []


def test_a_file_without_a_date_is_shown_without_one(tmp_path: Path, capsys: Capture) -> None:
    path = stored(tmp_path, plots(3, step_ns=1000 * MS), FileFormat.FINAL)
    assert shown(path) == 0
    out = capsys.readouterr().out
    assert "  first        12:00:00.000000000Z\n" in out
    assert "1970" not in out
    assert out.splitlines()[-1] == "  final has no date"


def both_sides_of_a_link() -> list[Recorded]:
    return [
        message(
            block_048(43_200), START_NS + n * MS, topic=f"plotfeed/{name}/asterix/048", stage=stage
        )
        for n, stage in enumerate((Stage.BEFORE, Stage.AFTER))
        for name in ("a", "b")
    ]


@pytest.mark.parametrize("form", [FileFormat.MCAP, FileFormat.JSON])
def test_what_is_before_a_link_is_told_from_what_is_after_it(
    form: FileFormat, tmp_path: Path, capsys: Capture
) -> None:
    path = stored(tmp_path, both_sides_of_a_link(), form)
    shown(path, listed=True)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("  ")[1:3] for line in lines] == [
        [stage, f"plotfeed/{name}/asterix/048"] for stage in ("before", "after") for name in "ab"
    ]
    shown(path, listed=True, as_json=True)
    objects = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [each["stage"] for each in objects] == ["before", "before", "after", "after"]


def test_stages_and_topics_are_chosen(tmp_path: Path, capsys: Capture) -> None:
    path = stored(tmp_path, both_sides_of_a_link())
    shown(path, listed=True, stages=("after",), topics=("plotfeed/b/#", "no/such"))
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("2026-01-01T12:00:00.001000000Z  plotfeed/b/asterix/048  CAT048")
    shown(path, as_json=True, stages=("before",), topics=("+/a/#",))
    found = json.loads(capsys.readouterr().out)
    assert [(row["topic"], row["stage"], row["records"]) for row in found["series"]] == [
        ("plotfeed/a/asterix/048", "before", 1)
    ]


def test_blocks_of_a_raw_file_are_chosen_by_their_topic(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "both.ast"
    path.write_bytes(block_048(1) + block(34, "f0", "190d", "01", "546000", "00"))
    shown(path, listed=True, topics=("asterix/034",))
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("CAT034")
    shown(path, listed=True, stages=("before",))
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
    assert shown(stored(tmp_path, [trailed]), listed=True) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert line.isprintable()
    assert "CAT048" in line
    assert shown(stored(tmp_path, [trailed])) == 0
    assert all(line.isprintable() for line in capsys.readouterr().out.splitlines())


@pytest.mark.parametrize(
    "form", [FileFormat.PCAP, FileFormat.FINAL, FileFormat.JSON, FileFormat.MCAP]
)
def test_a_damaged_file_is_shown_as_far_as_it_is_whole(
    form: FileFormat, tmp_path: Path, capsys: Capture
) -> None:
    path = stored(tmp_path, plots(400), form)
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
    lines = list(_raw_lines(reader.blocks(), reader.damage, ShowSettings(as_json=True)))
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


def test_what_is_no_recording_is_an_error_that_names_it(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_bytes(b"hello, this is no recording")
    with pytest.raises(PlotfeedError, match="its content is no recording"):
        shown(path)
    path = tmp_path / "broken.mcap"
    path.write_bytes(b"hello, this is no MCAP")
    with pytest.raises(PlotfeedError, match="octet 0: expected an MCAP file"):
        shown(path)


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


def test_a_summary_of_many_topics_is_bounded() -> None:
    summary = summary_of([message(b"", n, topic=f"t/{n}") for n in range(MAX_SERIES + 50)])
    assert len(summary.series) == MAX_SERIES + 1
    assert summary.series[(OTHERS, Stage.RECEIVED, "")].messages == 50


def test_messages_out_of_order_are_counted_and_make_no_gap() -> None:
    summary = summary_of([message(b"", 1000 + t) for t in (10, 30, 20, 40, 5)])
    assert (summary.first_ns, summary.last_ns, summary.disordered) == (1005, 1040, 2)
    assert (summary.gap_ns, summary.gap_from_ns) == (20, 1010)


def test_a_message_that_left_before_it_was_due_is_early() -> None:
    summary = summary_of([message(b"", 1000, publish_time_ns=2000, stage=Stage.AFTER)])
    assert summary.lateness[Stage.AFTER].percentile_ns(50) == pytest.approx(-1000, rel=0.0006)
    assert summary_of([message(b"", 1000)]).lateness == {}


def test_the_ledger_is_told_when_there_is_time_and_late_for_nobody() -> None:
    kind = protobuf_content_type("plotfeed.v1.Ledger")
    ledger = message(b"", NS, publish_time_ns=0, stage=Stage.AFTER, content_type=kind)
    assert summary_of([ledger]).lateness == {}


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
    path = stored(tmp_path, session())
    assert shown(path, **how, **chosen) == 1
    told = f"plotfeed: {path}: no message is of the topics and stages asked for\n"
    assert capsys.readouterr().err == told
    assert shown(path, **how) == 0
