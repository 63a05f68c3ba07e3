"""The record of a session, replayed: the same messages, spaced as they were."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.command import plotfeed
from support.replays import REPLAYED, simulated
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.replaying.replay_settings import LinkRule, ReplaySettings, Stamps
from plotfeed.feeds.replaying.replayer import READY_NS
from plotfeed.feeds.scene.scene import load
from plotfeed.proto.asterix.codec.decode import decode
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.recorded import Recorded, Stage

LINK = """
[sensor.link]
latency_ms = 40
jitter_ms = 15
duplicate = 0.1
loss = { kind = "gilbert-elliott", mean_loss = 0.2, mean_burst = 3 }
"""
REPORTS = 'report = ["asterix-048", "plots", "sapient"]'


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Recorded]]:
    """A scene of two radars, one of them on a bad link, and its record."""
    folder = tmp_path_factory.mktemp("session")
    bad = radar("far", period_s=0.5, more=REPORTS) + LINK
    text = scene_text(start_utc="2026-01-01T12:00:00.05Z", port=1883, sensors=radar("near") + bad)
    scene, record = scene_file(folder, text), folder / "session.mcap"
    how = ["--broker", "none", "--speed", "max", "--duration", "10"]
    done = plotfeed("run", scene, "--record", record, *how)
    assert done.returncode == 0, done.stderr
    with McapReader(record) as log:
        return scene, list(log.messages())


def is_truth(recorded: Recorded) -> bool:
    return recorded.topic.endswith("/truth")


@pytest.mark.asyncio
async def test_the_same_octets_leave_on_the_same_topics_with_the_same_spacing(
    session: tuple[Path, list[Recorded]],
) -> None:
    _, recorded = session
    after = [r for r in recorded if r.stage is Stage.AFTER and not is_truth(r)]
    ears, _ = await simulated(recorded)
    assert [(m.topic, m.payload) for _, m in ears.heard] == [(r.topic, r.payload) for r in after]
    assert ears.times() == [r.log_time_ns - after[0].log_time_ns for r in after]
    for (_, got), was in zip(ears.heard, after, strict=True):
        assert (got.content_type, got.properties, got.retain) == (
            was.content_type, was.properties, was.retain)  # fmt: skip


@pytest.mark.asyncio
async def test_what_was_handed_to_a_link_meets_the_same_fate_on_the_same_link(
    session: tuple[Path, list[Recorded]],
) -> None:
    scene_path, recorded = session
    scene = load(scene_path)
    links = tuple(LinkRule(f"plotfeed/{s.id}", s.link) for s in scene.sensor if s.link)
    before = [r for r in recorded if r.stage is Stage.BEFORE]
    ears, totals = await simulated(
        recorded, ReplaySettings(stage="before", links=links, seed=scene.scene.seed)
    )
    begin_ns = min(r.publish_time_ns for r in before)
    # Status and registrations went past the link, and were not handed to it.
    handed = {(r.topic, r.payload) for r in before}
    after = [r for r in recorded if r.stage is Stage.AFTER and (r.topic, r.payload) in handed]
    assert totals.lost > 0
    assert totals.duplicated > 0
    replayed = [(t - REPLAYED - READY_NS, m.topic, m.payload) for t, m in ears.heard]
    left = [(r.log_time_ns - begin_ns, r.topic, r.payload) for r in after]
    assert sorted(replayed) == sorted(left)


@pytest.mark.asyncio
async def test_times_of_day_are_as_old_as_they_were_when_they_left(
    session: tuple[Path, list[Recorded]],
) -> None:
    _, recorded = session
    after = [r for r in recorded if r.stage is Stage.AFTER and not is_truth(r)]
    ears, totals = await simulated(recorded, ReplaySettings(stamps=Stamps(to_now=True)))
    assert not totals.left
    plots = 0
    for (now_ns, got), was in zip(ears.heard, after, strict=True):
        if not got.topic.endswith("asterix/048"):
            continue
        for new, old in zip(decode(got.payload), decode(was.payload), strict=True):
            age_s = [
                (t_ns / 1e9 - float(record.items["I048/140"])) % 86_400  # type: ignore[arg-type]
                for t_ns, record in ((now_ns, new), (was.log_time_ns, old))
            ]
            assert abs(age_s[0] - age_s[1]) < 1 / 128
            plots += 1
    assert plots > 10
