"""Names that would move a terminal's cursor, turn its writing round or run in a spreadsheet."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.command import plotfeed, plotfeed_here
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.console.printed import printable, say
from plotfeed.feeds.recording.recorder import Recorder
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.replay.recorded import Attachment, Recorded, Stage

EVIL = "\x1b]0;owned\x07\x1b[2J\u202egnp.exe\u2066\r\n\x9b1mx\u200f"
NOT_OBEYED = {*map(chr, range(0x20)), "\x7f", *map(chr, range(0x80, 0xA0))} - {"\n"}
BATCH = "application/x-protobuf; messageType=plotfeed.v1.PlotBatch"
TURNED = set("\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")


def is_harmless(text: str) -> bool:
    return not set(text) & (NOT_OBEYED | TURNED)


@given(st.text())
def test_whatever_is_printed_is_harmless_and_ordinary_text_is_as_it_was(text: str) -> None:
    assert is_harmless(printable(text))
    assert "\n" not in printable(text)
    assert (printable(text) == text) == text.isprintable()


def test_lines_stay_lines(capsys: pytest.CaptureFixture[str]) -> None:
    say(f"one {EVIL}\ntwo")
    out = capsys.readouterr().out
    assert is_harmless(out)
    assert out.splitlines()[-1] == "two"


def recorded(path: Path) -> Path:
    """What a stranger sent, as it was recorded."""
    batch = pb.PlotBatch(sensor=EVIL, scan=1)
    batch.plots.add(time_utc_ns=10**18, range_m=1000.0, azimuth_deg=10.0, identity=f"={EVIL}")
    payloads = {
        "a/plots": (batch.SerializeToString(), BATCH),
        f"b{EVIL}": (EVIL.encode(), "text/plain"),
        "c": (f'{{"{EVIL!r}": "\x1b[2J"}}'.encode(), "application/json"),
        "d": (b"\x30\x00\x05\x80\x1b", f"application/x-{EVIL}"),
    }
    attached = [Attachment(name=EVIL, media_type=EVIL, data=b"", log_time_ns=0)]
    with Recorder(path, attachments=attached, waits=True) as recorder:
        for n, (topic, (payload, content_type)) in enumerate(payloads.items()):
            told = ((EVIL, EVIL),)
            one = Recorded(
                topic, payload, 10**18 + n, 10**18, content_type, told, stage=Stage.AFTER
            )
            recorder.write(one)
    return path


@pytest.mark.parametrize("options", [(), ("--list",), ("--json",), ("--list", "--json")], ids=str)
def test_show_prints_none_of_it(tmp_path: Path, options: tuple[str, ...]) -> None:
    done = plotfeed_here("show", recorded(tmp_path / "x.mcap"), *options)
    assert done.stdout
    assert is_harmless(done.stdout)
    assert is_harmless(done.stderr)


def test_neither_does_what_reads_a_recording(tmp_path: Path) -> None:
    source = recorded(tmp_path / "x.mcap")
    for words in (
        ("report", source),
        ("run", source),
        ("convert", source, tmp_path / "y.ast"),
        ("show", tmp_path / EVIL.replace("/", "").replace("\0", "")),
    ):
        done = plotfeed(*words)
        assert done.stdout + done.stderr
        assert is_harmless(done.stdout + done.stderr), words


def test_a_scene_with_such_names_is_told_of_in_plain_text(tmp_path: Path) -> None:
    evil = EVIL.encode("unicode_escape").decode().replace("\\x", "\\u00")
    scene = scene_text(port=1883, sensors=radar(id=evil)).replace(
        'name = "test"', f'name = "{evil}"'
    )
    done = plotfeed("run", scene_file(tmp_path, scene), "--broker", "none", "--duration", "1")
    assert is_harmless(done.stdout + done.stderr)


def test_no_cell_is_a_formula(tmp_path: Path) -> None:
    for n, start in enumerate("=+-@\t\r"):
        name, record = f'{start}HYPERLINK("x")', tmp_path / f"{n}.mcap"
        table = record.with_suffix(".csv")
        batch = pb.PlotBatch(sensor=name, scan=1)
        batch.plots.add(time_utc_ns=10**18, range_m=1000.0, azimuth_deg=10.0, identity=name)
        with Recorder(record, waits=True) as recorder:
            recorder.write(
                Recorded(f"{name}/plots", batch.SerializeToString(), 10**18, 10**18, BATCH)
            )
        assert plotfeed_here("convert", record, table).returncode == 0
        heads, *rows = csv.reader(io.StringIO(table.read_bytes().decode(), newline=""))
        assert len(rows) == 1
        row = dict(zip(heads, rows[0], strict=True))
        assert row["sensor"] == row["identity"] == f"'{name}"
        assert not any(cell.startswith(("=", "+", "@", "\t", "\r")) for cell in rows[0])
