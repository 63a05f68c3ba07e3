"""Recordings of one session's workers made one, which all commands read as if of one process."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import pytest
from support.command import plotfeed_here
from support.recordings import MS, SCENE, START_NS, mcap_of, message, messages
from support.scene_files import radar, scene_file, scene_text

from plotfeed.replay.mcap import McapReader
from plotfeed.replay.recorded import Attachment, Recorded, Stage

SENSORS = ("north", "south", "west")
SECONDS = 6


@pytest.fixture(scope="module")
def single(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording of one process that served all sensors."""
    folder = tmp_path_factory.mktemp("session")
    link = "link = { latency_ms = 40.0, jitter_ms = 9.0, duplicate = 0.3 }\n"
    sensors = "".join(radar(name, more=link) for name in SENSORS)
    scene = scene_file(
        folder, scene_text(sensors=sensors, start_utc="2026-01-01T12:00:00Z", port=1)
    )
    path = folder / "single.mcap"
    how = ("--broker", "none", "--speed", "max", "--duration", SECONDS, "--json")
    assert plotfeed_here("run", scene, "--record", path, *how).returncode == 0
    return path


def read(path: Path) -> tuple[list[Recorded], list[Attachment]]:
    with McapReader(path) as log:
        found = [log.attachment(entry.name) for entry in log.attachments()]
        return list(log.messages()), [each for each in found if each is not None]


def stored(path: Path, recorded: Iterable[Recorded], *attachments: Attachment) -> Path:
    path.write_bytes(mcap_of(recorded, attachments=attachments))
    return path


def parts(single: Path, folder: Path, takes: Sequence[Callable[[Recorded], bool]]) -> list[Path]:
    """What workers would have recorded of it."""
    recorded, attachments = read(single)
    return [
        stored(folder / f"worker-{n}.mcap", filter(take, recorded), *attachments)
        for n, take in enumerate(takes)
    ]


def is_of(*sensors: str) -> Callable[[Recorded], bool]:
    """What a worker of those sensors records, what is of the whole session among it."""

    def take(recorded: Recorded) -> bool:
        sensor = dict(recorded.properties).get("sensor", "") or recorded.topic.split("/")[1]
        return sensor not in SENSORS or sensor in sensors

    return take


def in_order(recorded: Sequence[Recorded]) -> list[tuple[object, ...]]:
    """Messages by time, and those of one time in some order."""
    return sorted((m.log_time_ns, str(m.stage), *m) for m in recorded)


def test_workers_recordings_become_that_of_one_process(single: Path, tmp_path: Path) -> None:
    workers = parts(single, tmp_path, [is_of("north"), is_of("south"), is_of("west")])
    target = tmp_path / "all.mcap"
    done = plotfeed_here("merge", *workers, target, "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    expected, attachments = read(single)
    found, with_it = read(target)
    assert in_order(found) == in_order(expected)
    assert [each.data for each in with_it] == [each.data for each in attachments]
    assert told["messages"] == len(expected)
    shared = sum(is_of()(each) for each in expected)
    assert shared > 0
    assert told["twice"] == 2 * shared
    assert sum(told["of"].values()) == len(expected) + 2 * shared
    times = [each.log_time_ns for each in found]
    assert times == sorted(times)


def test_a_message_that_both_hold_comes_once_and_one_that_came_twice_comes_twice(
    tmp_path: Path,
) -> None:
    (one, two, three) = messages(3)
    found, said = merged(tmp_path, [one, two, two], [later(one), later(two), three])
    assert "left out 2 messages that another recording has" in said
    assert in_order(found) == in_order([one, two, two, three])
    (tmp_path / "all.mcap").unlink()
    topic, stage = "plotfeed/telemetry/a", Stage.TELEMETRY  # which several workers took in
    came = [message(b"%d" % n, START_NS + n * MS, topic=topic, stage=stage) for n in range(5)]
    found, _ = merged(tmp_path, came[:4], map(later, came[2:]))
    assert [each.payload for each in found] == [b"0", b"1", b"2", b"3", b"4"]


def later(recorded: Recorded) -> Recorded:
    """The same message, recorded later by somebody else."""
    return recorded._replace(log_time_ns=recorded.log_time_ns + 500 * MS)


def merged(folder: Path, *recordings: Iterable[Recorded]) -> tuple[list[Recorded], str]:
    """What is in the recording that is made of these, and what is said of it."""
    sources = [stored(folder / f"{n}.mcap", each, SCENE) for n, each in enumerate(recordings)]
    done = plotfeed_here("merge", *sources, folder / "all.mcap")
    return read(folder / "all.mcap")[0], done.stdout


def test_what_is_not_of_one_session_is_refused_in_a_line(single: Path, tmp_path: Path) -> None:
    recorded, (scene, *_) = read(single)
    other = Attachment(name=scene.name, media_type="", data=scene.data + b"# other\n")
    paths = {
        "other": stored(tmp_path / "other.mcap", recorded[:9], other),
        "bare": stored(tmp_path / "bare.mcap", recorded[:9]),
        "copy": stored(tmp_path / "copy.mcap", recorded[:9], scene),
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
    again = plotfeed_here("merge", single, paths["copy"], stored(out, recorded[:5], scene))
    assert "is there already; --force" in again.stderr
