"""Recordings made of others: in every format of every other, and of several of one session."""

from __future__ import annotations

import csv
import json
import os
import subprocess
from collections import Counter
from collections.abc import Iterable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from support.asterix_input import plots as plots_of
from support.command import PLOTFEED, plotfeed_here
from support.given_recordings import EVERY_RECORDING
from support.recordings import (
    MS,
    SCENE,
    START_NS,
    block,
    block_048,
    mcap_of,
    message,
    messages,
    plots,
    stored,
)
from support.scene_files import radar, scene_file, scene_text
from support.waiting import PATIENCE_S, wait_until

from plotfeed.feeds.recording.convert import convert_recording
from plotfeed.feeds.recording.foreign_recordings import ForeignReader
from plotfeed.feeds.recording.recording_settings import ConvertSettings
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.cat015 import PlotEncoder015
from plotfeed.proto.content_types import (
    JSON,
    PLOT_BATCH,
    asterix_content_type,
    protobuf_content_type,
)
from plotfeed.proto.errors import PlotfeedError
from plotfeed.replay.files import FileFormat, format_of
from plotfeed.replay.mcap import McapReader
from plotfeed.replay.recorded import Attachment, Recorded, Stage

Capture = pytest.CaptureFixture[str]
BATCH = protobuf_content_type(PLOT_BATCH)
DAY_NS = START_NS - 43_200_000_000_000
DAY = datetime(2026, 1, 1)  # noqa: DTZ001 - as click gives it
BOTH_WAYS = [FileFormat.MCAP, FileFormat.PCAP, FileFormat.FINAL, FileFormat.RAW, FileFormat.JSON]


def read(path: Path, date_utc_ns: int = 0) -> list[Recorded]:
    with ForeignReader(path, date_utc_ns=date_utc_ns) as recording:
        found = list(recording.messages())
        assert recording.damage == []
        assert 0 <= recording.at <= recording.octets == path.stat().st_size
        assert (recording.format, recording.skipped) == (format_of(path), 0)
    return found


def convert(source: Path, target: Path, **settings: Any) -> int:
    return convert_recording(source, target, ConvertSettings(**settings))


def totals(capsys: Capture, source: Path, target: Path, **settings: Any) -> Any:
    assert convert(source, target, as_json=True, **settings) == 0
    return json.loads(capsys.readouterr().out)


def test_every_format_becomes_every_other_and_payloads_stay(
    tmp_path: Path, capsys: Capture
) -> None:
    sent = plots(20, step_ns=250 * MS)
    for origin in BOTH_WAYS:
        source = stored(tmp_path / f"in.{origin}", sent, origin)
        for to in BOTH_WAYS:
            target = tmp_path / f"{origin}.{to}"
            found = totals(capsys, source, target, date=DAY, to_format=to)
            assert (found["from"], found["to"], found["messages"]) == (origin, to, 20)
            assert (found["left_out"], found["damage"]) == ({}, [])
            got = read(target, DAY_NS)
            assert [each.payload for each in got] == [each.payload for each in sent]
            assert [each.log_time_ns for each in got] == [each.log_time_ns for each in sent]


@EVERY_RECORDING
@pytest.mark.parametrize("by_way_of", [None, "mcap", "jsonl"])
def test_a_recording_of_others_comes_back_to_the_octet(
    recording: Path, by_way_of: str | None, tmp_path: Path
) -> None:
    source = between = recording
    again = tmp_path / f"again{source.suffix}"
    if by_way_of is not None:
        between = tmp_path / f"between.{by_way_of}"
        assert convert(source, between) == 0
    assert convert(between, again) == 0
    assert again.read_bytes() == source.read_bytes()


def session() -> list[Recorded]:
    (plot,) = plots(1)
    telemetry, batch = "plotfeed/telemetry/d", "plotfeed/radar/plots"
    asked = {"content_type": JSON, "stage": Stage.TELEMETRY}
    return [
        message(b"{}", START_NS, topic=telemetry, **asked),
        message(plot.payload, START_NS + 1, stage=Stage.BEFORE),
        message(plot.payload, START_NS + 2, stage=Stage.AFTER),
        message(b"", START_NS + 3, topic=batch, content_type=BATCH, stage=Stage.AFTER),
    ]


def test_what_a_format_cannot_hold_is_counted_with_its_reason(
    tmp_path: Path, capsys: Capture
) -> None:
    source = stored(tmp_path / "in.mcap", session())
    found = totals(capsys, source, tmp_path / "out.pcap")
    assert found["messages"] == 1
    assert found["left_out"] == {
        "of stage telemetry; --stage takes them": 1,
        "of stage before; --stage takes them": 1,
        "neither UDP nor ASTERIX": 1,
    }
    assert found["notes"] == [
        "pcap: it has one time of each message, and no topics, content types or stages",
        "pcap: plotfeed/radar/asterix/048 became 127.1.0.0:8600",
    ]
    found = totals(capsys, source, tmp_path / "before.pcap", stages=["before"])
    assert (found["messages"], found["left_out"]) == (1, {})
    assert read(tmp_path / "before.pcap")[0].log_time_ns == START_NS + 1
    found = totals(capsys, source, tmp_path / "out.jsonl")
    assert (found["messages"], found["left_out"], found["notes"]) == (4, {}, [])
    assert read(tmp_path / "out.jsonl") == session()
    assert convert(source, tmp_path / "text.pcap") == 0
    out = capsys.readouterr().out.splitlines()
    assert out[0].endswith("text.pcap (pcap): 1 messages, 14 octets")
    assert out[1] == "  left out 1 messages: of stage telemetry; --stage takes them"


def several_formats() -> list[Recorded]:
    """Two plots of one radar, each in 015, 048 and a batch, a track in 062, and 048 by UDP.

    Another radar reports in 048 alone, by MQTT and by UDP; a third one by UDP.
    """
    sent = []
    for n in range(2):
        t_ns = START_NS + n * 1000 * MS
        batch = pb.PlotBatch(sensor="radar", scan=n)
        batch.plots.add(time_utc_ns=t_ns, range_m=1000.0)
        (in_015,) = PlotEncoder015(25, 1).blocks(plots_of(t_utc_ns=np.array([t_ns])))
        first, second, third = (block_048(43_200 + n, sic=sic) for sic in (1, 2, 3))
        sent += [
            message(payload, t_ns, topic=topic, content_type=asterix_content_type(payload[0]))
            for topic, payload in (
                ("plotfeed/radar/asterix/048", first),
                ("plotfeed/radar/asterix/015", in_015),
                ("udp/127.0.0.1/8600", first),
                ("udp/127.0.0.1/8600", second),
                ("plotfeed/other/asterix/048", second),
                ("udp/127.0.0.1/8601", third),
            )
        ]
        told = batch.SerializeToString()
        sent.append(message(told, t_ns, topic="plotfeed/radar/plots", content_type=BATCH))
    return sent


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_table_of_plots_has_each_plot_once_and_others_have_one_format(
    suffix: str, tmp_path: Path, capsys: Capture
) -> None:
    source = stored(tmp_path / "in.mcap", several_formats())

    def rows_of(name: str, **settings: Any) -> Counter[tuple[str, str]]:
        path = tmp_path / f"{name}.{suffix}"
        assert convert(source, path, force=True, **settings) == 0
        if suffix == "csv":
            rows = list(csv.DictReader(path.read_text().splitlines()))
        else:
            rows = pq.read_table(path).to_pylist()
        return Counter((row["topic"], str(row["category"] or "").zfill(3)) for row in rows)

    assert rows_of("all") == {
        ("plotfeed/radar/plots", "000"): 2,
        ("plotfeed/other/asterix/048", "048"): 2,
        ("udp/127.0.0.1/8601", "048"): 2,
    }
    told = capsys.readouterr().out
    assert "left out 6 messages: plots that are there in another format; x-asterix-048" in told
    assert rows_of("site-asterix-015") == {("plotfeed/radar/asterix/015", "015"): 2}
    assert sum(rows_of("any-asterix-048").values()) == 10
    assert rows_of("chosen", topics=["plotfeed/radar/asterix/048"]) == {
        ("plotfeed/radar/asterix/048", "048"): 2
    }


def test_tracks_are_no_plots(tmp_path: Path) -> None:
    track = block(62, "90", "190d", "01", "546000")
    source = stored(tmp_path / "in.mcap", [message(track, topic="p/a/asterix/062"), *plots(1)])
    for name, category in (("out.csv", "048"), ("asterix-062.csv", "062")):
        assert convert(source, tmp_path / name) == 0
        (row,) = csv.DictReader((tmp_path / name).read_text().splitlines())
        assert (row["category"], row["sic"]) == (category, "13")


NONE_IS_ASKED = "none is of the topics, stages and times asked for"


@pytest.mark.parametrize(
    ("target", "settings", "why"),
    [
        ("a.csv", {"topics": ["no/such"]}, NONE_IS_ASKED),
        ("a.mcap", {"topics": ["no/such"]}, NONE_IS_ASKED),
        ("a.mcap", {"start": "3600"}, NONE_IS_ASKED),
        ("a.pcap", {"topics": ["plotfeed/session"]}, "1 left out: neither UDP nor ASTERIX"),
        ("fates.parquet", {}, "3 left out: no fates"),
        ("a.csv", {"stages": ["telemetry"]}, "1 left out: no plots"),
        ("out.txt", {}, "expected one of the suffixes"),
        ("out.pcapng", {}, "pcapng is only read"),
        ("no/where/out.mcap", {}, "a folder that is there"),
        (".", {}, "expected one of the suffixes"),
        ("in.mcap", {}, "is what is read"),
        *(("a.mcap", {"topics": [wrong]}, "is a whole level")
          for wrong in ("a#", "#/a", "a+/b", "##")),
        *(("a.jsonl", {"from_format": form}, "in.mcap") for form in ("pcap", "final", "raw")),
    ],
)  # fmt: skip
def test_a_conversion_of_nothing_fails_in_one_line_and_writes_no_file(
    target: str, settings: dict[str, Any], why: str, tmp_path: Path
) -> None:
    begun = message(b"{}", topic="plotfeed/session", content_type="application/json", retain=True)
    source = stored(tmp_path / "in.mcap", [begun, *session()])
    with pytest.raises(PlotfeedError) as error:
        convert(source, tmp_path / target, **settings)
    assert why in str(error.value)
    assert "\n" not in str(error.value)
    if why is NONE_IS_ASKED:
        assert "not written: nothing of 5 messages" in str(error.value)
    assert [path.name for path in tmp_path.iterdir()] == ["in.mcap"]


def test_messages_are_chosen_by_topic_stage_and_time(tmp_path: Path, capsys: Capture) -> None:
    sent = [
        message(b"", START_NS + n * 1000 * MS, topic=f"a/{n % 2}/x", stage=Stage.AFTER)
        for n in range(10)
    ]
    source = stored(tmp_path / "in.jsonl", sent)
    target = tmp_path / "out.jsonl"
    cases = [
        ({"topics": ["a/+/x"]}, sent),
        ({"topics": ["a/1/#", "b"]}, sent[1::2]),
        ({"topics": ["a/0/x/#"]}, sent[::2]),
        ({"topics": ["#"]}, sent),
        ({"start": "2"}, sent[2:]),
        ({"end": "2026-01-01T12:00:02Z"}, sent[:2]),
    ]
    for settings, expected in cases:
        assert totals(capsys, source, target, force=True, **settings)["read"] == 10
        assert read(target) == expected


def test_a_file_without_a_date_takes_it_from_the_command_or_says_so(
    tmp_path: Path, capsys: Capture
) -> None:
    source = stored(tmp_path / "in.ast", plots(3))
    note = "raw has no date: its first day is 1970-01-01"
    for date, day, notes in ((DAY, "2026-01-01", []), (None, "1970-01-01", [note])):
        found = totals(capsys, source, tmp_path / f"{day}.jsonl", date=date)
        assert (found["notes"], found["first_utc"]) == (notes, f"{day}T12:00:00.000000000Z")


@pytest.mark.parametrize("form", BOTH_WAYS)
def test_what_is_whole_of_a_damaged_file_is_converted_and_the_rest_told(
    form: FileFormat, tmp_path: Path, capsys: Capture
) -> None:
    source = stored(tmp_path / "in", plots(400), form)
    os.truncate(source, source.stat().st_size * 9 // 10 - 3)
    found = totals(capsys, source, tmp_path / "out.mcap", from_format=form)
    assert 300 <= found["messages"] <= 400 or form is FileFormat.MCAP
    assert found["damage"] != []
    assert convert(source, tmp_path / "again.mcap", from_format=form) == 0
    assert capsys.readouterr().err.startswith(f"plotfeed: {source}: octet ")
    assert len(read(tmp_path / "again.mcap")) == found["messages"]


def test_a_log_that_was_never_ended_is_recovered_with_its_attachments(
    tmp_path: Path, capsys: Capture
) -> None:
    source, target = tmp_path / "killed.mcap", tmp_path / "recovered.mcap"
    source.write_bytes(mcap_of(plots(50), close=False))
    found = totals(capsys, source, target)
    assert found["messages"] == 50
    assert found["damage"] != []
    assert read(target) == plots(50)
    with McapReader(target) as log:
        assert log.attachment(SCENE.name) == SCENE
        assert log.is_indexed
    assert totals(capsys, target, tmp_path / "out.jsonl")["notes"] == [
        "the attachment 'scene.toml' was left out"
    ]


def test_a_file_that_is_there_is_replaced_only_when_asked_and_only_when_it_is_done(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, target = stored(tmp_path / "in.mcap", plots(3)), tmp_path / "out.jsonl"
    target.write_text("mine")
    with pytest.raises(PlotfeedError, match="--force"):
        convert(source, target)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as broken:
        broken.setattr("plotfeed.replay.files.JsonLinesWriter.write", full)
        with pytest.raises(OSError, match="No space"):
            convert(source, target, force=True)
    assert target.read_text() == "mine"
    totals(capsys, source, target, force=True)
    assert read(target) == plots(3)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in.mcap", "out.jsonl"]


def test_a_conversion_that_is_terminated_leaves_nothing(tmp_path: Path) -> None:
    source, target = tmp_path / "in.jsonl", tmp_path / "out.mcap"
    os.mkfifo(source)
    held_open = os.open(source, os.O_RDWR)
    command = [*PLOTFEED, "convert", str(source), str(target), "--from", "jsonl"]
    with subprocess.Popen(command, stderr=subprocess.PIPE) as process:
        try:
            wait_until(lambda: any(tmp_path.glob(".out.mcap.*")))
            process.terminate()
            _, said = process.communicate(timeout=PATIENCE_S)
        finally:
            process.kill()
    os.close(held_open)
    assert (process.returncode, said) == (143, b"")
    assert [path.name for path in tmp_path.iterdir()] == ["in.jsonl"]


def test_the_command_takes_all_of_it(tmp_path: Path) -> None:
    source = stored(tmp_path / "in.ast", plots(9, step_ns=1000 * MS))
    target = tmp_path / "out.whatever"
    done = plotfeed_here(
        "convert", source, target, "--to", "jsonl", "--date", "2026-01-01", "--start", "2",
        "--end", "2026-01-01T12:00:05Z", "--topic", "asterix/+", "--stage", "received", "--json",
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["messages"] == 3
    sent = plots(9, step_ns=1000 * MS)[2:5]
    assert [each.log_time_ns for each in read(target)] == [each.log_time_ns for each in sent]
    again = plotfeed_here("convert", source, target, "--to", "jsonl")
    assert again.returncode == 2
    assert again.stderr.startswith(f"plotfeed: {target}: is there already")


# Recordings of one session's workers made one, which all commands read as if of one process.

SENSORS = ("north", "south", "west")


@pytest.fixture(scope="module")
def single(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording of one process that served all sensors."""
    folder = tmp_path_factory.mktemp("session")
    link = "link = { latency_ms = 40.0, jitter_ms = 9.0, duplicate = 0.3 }\n"
    sensors = "".join(radar(name, more=link) for name in SENSORS)
    text = scene_text(sensors=sensors, start_utc="2026-01-01T12:00:00Z", port=1)
    scene, path = scene_file(folder, text), folder / "single.mcap"
    how = ("--broker", "none", "--speed", "max", "--duration", "6", "--json")
    assert plotfeed_here("run", scene, "--record", path, *how).returncode == 0
    return path


def whole(path: Path) -> tuple[list[Recorded], list[Attachment]]:
    with McapReader(path) as log:
        found = [log.attachment(entry.name) for entry in log.attachments()]
        return list(log.messages()), [each for each in found if each is not None]


def log_of(path: Path, recorded: Iterable[Recorded], *attachments: Attachment) -> Path:
    path.write_bytes(mcap_of(recorded, attachments=attachments))
    return path


def in_order(recorded: Sequence[Recorded]) -> list[tuple[object, ...]]:
    """Messages by time, and those of one time in some order."""
    return sorted((m.log_time_ns, str(m.stage), *m) for m in recorded)


def test_workers_recordings_become_that_of_one_process(single: Path, tmp_path: Path) -> None:
    expected, attachments = whole(single)

    def sensor_of(m: Recorded) -> str:
        named = dict(m.properties).get("sensor", "") or m.topic.split("/")[1]
        return named if named in SENSORS else ""  # of the whole session

    workers = []
    for name in SENSORS:
        own = [m for m in expected if sensor_of(m) in ("", name)]
        workers.append(log_of(tmp_path / f"{name}.mcap", own, *attachments))
    target = tmp_path / "all.mcap"
    done = plotfeed_here("merge", *workers, target, "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    found, with_it = whole(target)
    assert in_order(found) == in_order(expected)
    assert [each.data for each in with_it] == [each.data for each in attachments]
    shared = sum(not sensor_of(m) for m in expected)
    assert shared > 0
    assert (told["messages"], told["twice"]) == (len(expected), 2 * shared)
    assert sum(told["of"].values()) == len(expected) + 2 * shared
    times = [each.log_time_ns for each in found]
    assert times == sorted(times)


def test_a_message_that_both_hold_comes_once_and_one_that_came_twice_comes_twice(
    tmp_path: Path,
) -> None:
    def later(m: Recorded) -> Recorded:
        """The same message, recorded later by somebody else."""
        return m._replace(log_time_ns=m.log_time_ns + 500 * MS)

    one, two, three = messages(3)
    # And telemetry that several workers took in.
    came = [message(b"%d" % n, START_NS + n * MS, stage=Stage.TELEMETRY) for n in range(5)]
    for first, second, expected in (
        ([one, two, two], [later(one), later(two), three], [one, two, two, three]),
        (came[:4], [later(each) for each in came[2:]], [*came[:4], later(came[4])]),
    ):
        sources = [
            log_of(tmp_path / f"{n}.mcap", each, SCENE) for n, each in enumerate((first, second))
        ]
        done = plotfeed_here("merge", *sources, tmp_path / "all.mcap", "--force")
        assert "left out 2 messages that another recording has" in done.stdout
        assert in_order(whole(tmp_path / "all.mcap")[0]) == in_order(expected)


def test_what_is_not_of_one_session_is_refused_in_a_line(single: Path, tmp_path: Path) -> None:
    recorded, (scene, *_) = whole(single)
    other = Attachment(name=scene.name, media_type="", data=scene.data + b"# other\n")
    paths = {
        "other": log_of(tmp_path / "other.mcap", recorded[:9], other),
        "bare": log_of(tmp_path / "bare.mcap", recorded[:9]),
        "copy": log_of(tmp_path / "copy.mcap", recorded[:9], scene),
    }
    (tmp_path / "broken.mcap").write_bytes(b"no recording")
    out = tmp_path / "out.mcap"
    for arguments, said in (
        ((single, paths["other"], out), "holds another scene than"),
        ((single, paths["bare"], out), "holds no scene"),
        ((single, out), "expected two recordings or more"),
        ((single, single, out), "a recording is there twice"),
        ((single, paths["copy"], single), "is what is read"),
        ((single, paths["other"], tmp_path / "out.ast"), "expected a name that ends in .mcap"),
        ((single, tmp_path / "broken.mcap", out), "expected an MCAP file"),
        ((single, tmp_path / "none.mcap", out), "No such file"),
    ):
        done = plotfeed_here("merge", *arguments)
        assert done.returncode != 0, said
        assert said in done.stderr
        assert len(done.stderr.splitlines()) == 1
        assert not out.exists()
    again = plotfeed_here("merge", single, paths["copy"], log_of(out, recorded[:5], scene))
    assert "is there already; --force" in again.stderr
