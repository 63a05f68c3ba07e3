"""Recordings from strangers are read by a process of their own, and come here as they are."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.recordings import MESSAGES, mcap_of, message, plots, stored, written
from support.waiting import PATIENCE_S

from plotfeed.feeds.recording import foreign_recordings
from plotfeed.feeds.recording.foreign_recordings import ForeignReader
from plotfeed.feeds.telemetry.foreign_files import process_apart
from plotfeed.proto.errors import PlotfeedError
from plotfeed.replay.files import FileFormat, reading, writer_to
from plotfeed.replay.recorded import LATEST_NS, Attachment, Recorded

CONFINED = """
import json, os, resource, socket
from plotfeed.feeds.console.posix import confine_process
from plotfeed.feeds.recording import foreign_recordings as f
def told(*_, together):
    facts = {name: resource.getrlimit(getattr(resource, name))[0]
             for name in ("RLIMIT_AS", "RLIMIT_CPU", "RLIMIT_NOFILE")}
    facts["secrets"] = [value for value in os.environ.values() if "secret" in value]
    try:
        socket.create_connection(("127.0.0.1", PORT), 5).close()
        facts["network"] = True
    except OSError:
        facts["network"] = False
    raise f.PlotfeedError(json.dumps(facts))
f._write = told
f.main()
"""
# What a process that was taken over could write in place of what it read.
LIES = [
    *(b"", b"[1]\n", b"{}\n", b"[" * 100_000 + b"\n"),
    b'{"at": 0, "skipped": 0, "damage": [7], "octets": 1, "attachments": []}\n',
    b'{"at": 0, "skipped": 0, "damage": [], "octets": 1e999, "attachments": []}\n',
]
HEAD = b'{"at": 0, "skipped": 0, "damage": [], "octets": 9, "attachments": []}\n'
FRAME = (
    b'{"at": 0, "skipped": 0, "damage": [], "messages": %d, "series": %s, "names": %s, '
    b'"values": []}\n'
)
LATER_LIES = [
    *(b"", b"null\n"),
    FRAME % (1, b"[]", b"[]"),
    FRAME % (1 << 62, b"[]", b"[]"),
    FRAME % (-1, b"[]", b"[]") + bytes(400),
    FRAME % (1, b"[]", b"[]") + bytes(40),
    FRAME % (1, b'[["t", "k", true, 0, "elsewhere"]]', b"[]") + bytes(40),
    FRAME % (1, b'[["t", "k", true, 0, "after"]]', b"[1]") + bytes(40),
    FRAME % (1, b'[["t", "k", true, 0, "after"]]', b"[]") + bytes(24) + b"\xff" * 8 + bytes(8),
    FRAME % (1, b'[["t", "k", true, 0, "after"]]', b"[]") + bytes(24) + b"\xff" * 5 + bytes(11),
]


NOISE = np.random.default_rng(1).bytes(1 << 20)  # zeros would be taken for what fills a memory


@given(st.lists(MESSAGES, max_size=8))
@settings(max_examples=20)
def test_what_another_process_reads_is_what_this_one_would(
    tmp_path_factory: pytest.TempPathFactory, messages: list[Recorded]
) -> None:
    path = stored(tmp_path_factory.mktemp("foreign") / "log.mcap", messages)
    with (
        path.open("rb") as file,
        reading(file, FileFormat.MCAP) as (here, octets),
        ForeignReader(path) as apart,
    ):
        assert list(apart.messages()) == list(here.messages())
        assert (apart.octets, apart.damage) == (octets, here.damage)


def test_many_messages_come_in_more_than_one_frame_and_long_ones_alone(tmp_path: Path) -> None:
    sent = plots(1300) + [message(NOISE * 3, LATEST_NS - n) for n in (2, 1)]
    with ForeignReader(stored(tmp_path / "log.mcap", sent)) as reader:
        assert list(reader.messages()) == sent


def test_a_pipe_is_read_as_it_is_written(tmp_path: Path) -> None:
    path, first_came = tmp_path / "pipe.jsonl", threading.Event()
    os.mkfifo(path)
    lines = written(lambda file: writer_to(file, FileFormat.JSON), plots(2)).splitlines(True)

    def write() -> None:
        with path.open("wb", buffering=0) as pipe:
            pipe.write(lines[0])
            first_came.wait(PATIENCE_S)  # the second is not there before the first was read
            pipe.write(lines[1])

    writer = threading.Thread(target=write)
    writer.start()
    with ForeignReader(path, FileFormat.JSON) as recording:
        messages = recording.messages()
        found = [next(messages)]
        first_came.set()
        assert found + list(messages) == plots(2)
    writer.join()


def test_an_attachment_is_found_and_what_is_wrong_with_it_told(tmp_path: Path) -> None:
    path, scene = tmp_path / "log.mcap", Attachment(name="a", media_type="b", data=b"text" * 9)
    path.write_bytes(mcap_of([], attachments=[scene]))
    with ForeignReader(path) as recording:
        assert recording.attachment("a") == scene
        assert recording.attachment("other") is None
        assert recording.damage == []
        path.write_bytes(path.read_bytes().replace(b"texttext", b"texttexu", 1))
        assert recording.attachment("a") is None
        (damage,) = recording.damage
        assert "its CRC is wrong" in damage.what


def test_it_has_limits_no_network_and_none_of_our_secrets(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("resource")
    import socket

    with socket.create_server(("127.0.0.1", 0)) as listener:
        start = CONFINED.replace("PORT", str(listener.getsockname()[1]))
        monkeypatch.setattr(foreign_recordings, "_START", start)
        monkeypatch.setenv("PLOTFEED_MQTT_PASSWORD", "secret")
        with (
            pytest.raises(PlotfeedError) as told,
            ForeignReader(stored(tmp_path / "a.mcap", plots(1))),
        ):
            pass
    facts = json.loads(str(told.value).partition(": ")[2])
    network = facts.pop("network")
    assert [*facts.values()] == [2048 << 20, 24 * 3600, 64, []]
    own = "import ctypes, sys; sys.exit(ctypes.CDLL(None).unshare(0x50000000) != 0)"
    may_have_own = subprocess.run([sys.executable, "-c", own], check=False).returncode == 0
    assert network is not may_have_own


@pytest.mark.parametrize("lie", [*LIES, *(HEAD + later for later in LATER_LIES)])
def test_whatever_a_process_says_is_messages_or_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lie: bytes
) -> None:
    start = f"import sys; sys.stdout.buffer.write({lie!r})"
    monkeypatch.setattr(foreign_recordings, "_START", start)
    with (
        pytest.raises(PlotfeedError, match=r"a\.mcap: reading it takes more than 2048 MiB"),
        ForeignReader(stored(tmp_path / "a.mcap", plots(1))) as recording,
    ):
        list(recording.messages())


def test_a_process_ends_with_who_asked_and_not_by_ctrl_c(tmp_path: Path) -> None:
    # More than a pipe holds, so that none of these processes has ended by itself.
    sent = [message(NOISE, n) for n in range(1, 9)]
    path = stored(tmp_path / "a.mcap", sent)
    reader = ForeignReader(path, FileFormat.MCAP)
    process = reader._process
    assert os.getpgid(process.pid) != os.getpgrp()
    messages = reader.messages()
    next(messages)
    reader.close()
    assert process.returncode == -signal.SIGKILL
    with ForeignReader(path) as other:
        next(other.messages())
        first = other._process
        next(other.messages())  # as a replay does that goes elsewhere
        assert first.returncode == -signal.SIGKILL
    assert other._process.returncode == -signal.SIGKILL
    # Whose parent is gone finds nobody to write to.
    asked = json.dumps(foreign_recordings.Wanted(FileFormat.MCAP))
    with path.open("rb") as file:
        orphan = subprocess.Popen(
            **process_apart(foreign_recordings._START, asked), stdin=file, stdout=subprocess.PIPE
        )
    assert orphan.stdout is not None
    orphan.stdout.close()
    assert orphan.wait(PATIENCE_S) != -signal.SIGKILL
