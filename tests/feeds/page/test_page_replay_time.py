"""Recordings that are replayed from the page and moved in time, measured on a broker."""

from __future__ import annotations

import asyncio
import json
from collections import Counter
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from support.page_replays import SESSION_S, TRACKS, Act, Begun, Viewer, of_lab, settled
from support.waiting import until

from plotfeed.feeds.page.updates import SectionKind
from plotfeed.feeds.replaying.replay_settings import Moment, ReplaySettings
from plotfeed.feeds.timing.clock import WallClock
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.replay.mcap.mcap_reader import McapReader
from plotfeed.replay.mcap.mcap_writer import McapWriter
from plotfeed.replay.recorded import Recorded
from plotfeed.testing import MqttMessage, MqttReceiver

NS = 1_000_000_000


@pytest.fixture(scope="module")
def sent(record: Path) -> list[Recorded]:
    """What a replay sends of it."""
    takes = ReplaySettings().takes
    with McapReader(record) as log:
        return [m for m in log.messages() if takes(m.topic, m.content_type, m.stage)]


def recorded_ns(sent: list[Recorded]) -> dict[str, int]:
    """When messages were recorded that nothing else is like, by their ids."""
    return {f"{m.topic} {dict(m.properties)['id']}": m.log_time_ns for m in sent if has_id(m)}


def has_id(message: Recorded) -> bool:
    return message.topic.endswith(("/plots", "/048", "/034"))


def shifts_ns(heard: list[MqttMessage], sent: list[Recorded]) -> list[tuple[int, int]]:
    """When messages were recorded, and by how much later they say that they are now."""
    stamps = {f"{m.topic} {dict(m.properties)['id']}": dict(m.properties)["time"]
              for m in sent if has_id(m)}  # fmt: skip
    times, found = recorded_ns(sent), []
    for message in heard:
        key = f"{message.topic} {message.user_properties.get('id')}"
        if key in times:
            now, then = (
                Moment.parse(t).utc_ns for t in (message.user_properties["time"], stamps[key])
            )
            found.append((times[key], (now or 0) - (then or 0)))
    return found


@pytest.mark.asyncio
async def test_a_recording_is_loaded_and_its_messages_come_as_of_now(
    play: Callable[[Act], Any], sent: list[Recorded]
) -> None:
    async def act(viewer: Viewer, client: MqttReceiver, begun: Begun) -> None:
        await viewer.until(lambda: viewer.session.get("recordings") == ["session.mcap"])
        await viewer.load()
        assert viewer.scene == "lab"
        assert viewer.replay["file"] == "session.mcap"
        assert viewer.replay["duration_s"] == pytest.approx(SESSION_S, abs=0.2)
        await viewer.done(clock={"speed": 20})
        await viewer.until(lambda: viewer.is_at_end)
        await until(lambda: len(of_lab(client)) >= len(sent))
        assert begun.names == ["test"]

    async def checked(viewer: Viewer, client: MqttReceiver, begun: Begun) -> None:
        before_ns = WallClock().now_ns()
        await act(viewer, client, begun)
        heard = of_lab(client)
        assert Counter(m.topic for m in heard) == Counter(m.topic for m in sent)
        shifts = shifts_ns(heard, sent)
        assert len(shifts) > 300
        for was_ns, shift_ns in shifts:
            assert before_ns <= was_ns + shift_ns <= WallClock().now_ns() + NS
        batches = [m.payload for m in heard if m.topic == "lab/lab/plots"]
        batch = next(b for b in map(pb.PlotBatch.FromString, batches) if b.plots)
        assert before_ns - NS < batch.plots[0].time_utc_ns < WallClock().now_ns()
        await viewer.until(lambda: any(len(f.of(SectionKind.PLOTS)) for f in viewer.frames))

    await play(checked)


@pytest.mark.asyncio
async def test_twice_the_speed_is_twice_the_recorded_time(
    play: Callable[[Act], Any], sent: list[Recorded]
) -> None:
    async def act(viewer: Viewer, client: MqttReceiver, _begun: Begun) -> None:
        await viewer.load()
        await viewer.done(replay={"speed": 2})
        since = len(client.heard)
        await viewer.until(lambda: len(shifts_ns(of_lab(client, since), sent)) > 60)
        shifts = shifts_ns(of_lab(client, since), sent)[20:]
        for (was_a, shift_a), (was_b, shift_b) in pairwise(shifts):
            # Half of the recorded time, the rest of it is in the shift.
            assert abs((shift_b - shift_a) + (was_b - was_a) / 2) < 1000
        assert viewer.session["clock"] == {"kind": "replay", "paused": False, "speed": 2.0}

    await play(act)


@pytest.mark.asyncio
async def test_a_seek_back_brings_the_same_again_and_one_ahead_leaves_some_out(
    play: Callable[[Act], Any], sent: list[Recorded]
) -> None:
    async def act(viewer: Viewer, client: MqttReceiver, _begun: Begun) -> None:
        await viewer.load()
        await viewer.until(lambda: viewer.replay["position_s"] >= 2.0)
        await viewer.done(replay={"paused": True})
        since, from_ns = await settled(client), sent[0].log_time_ns + NS
        before = {was_ns for was_ns, _ in shifts_ns(of_lab(client), sent)}
        assert (await viewer.done(replay={"position_s": 1.0}))["paused"]
        await viewer.done(replay={"paused": False})
        await viewer.until(lambda: len(shifts_ns(of_lab(client, since), sent)) > 20)
        again = [was_ns for was_ns, _ in shifts_ns(of_lab(client, since), sent)]
        wanted = sorted(at_ns for at_ns in recorded_ns(sent).values() if at_ns >= from_ns)
        assert again[:20] == wanted[:20]
        assert before >= set(wanted[:20])
        since = len(client.heard)
        to_s = (await viewer.done(replay={"skip_s": 10.0}))["position_s"]  # to a tenth
        first_ns = sent[0].log_time_ns

        def times_s() -> list[float]:
            shifts = shifts_ns(of_lab(client, since), sent)
            return [(was_ns - first_ns) / NS for was_ns, _ in shifts]

        await viewer.until(lambda: [t for t in times_s() if t > to_s])
        assert not [t for t in times_s() if to_s - 9.8 < t < to_s - 0.2]

    await play(act)


@pytest.mark.asyncio
async def test_a_pause_holds_everything_until_it_goes_on(
    play: Callable[[Act], Any], sent: list[Recorded]
) -> None:
    async def act(viewer: Viewer, client: MqttReceiver, _begun: Begun) -> None:
        await viewer.load()
        await viewer.done(clock={"paused": True, "speed": 1})
        await viewer.until(lambda: viewer.session["clock"]["paused"])
        heard, position_s = await settled(client), viewer.replay["position_s"]
        viewer.frames.clear()
        await viewer.until(lambda: len(viewer.frames) > 10)
        assert len(client.heard) == heard
        assert len({frame.now_ms for frame in viewer.frames}) == 1
        assert viewer.replay["position_s"] == position_s
        # It can be moved along, and shows what there was, but sends nothing.
        await viewer.done(replay={"position_s": 8.0})
        await viewer.until(lambda: viewer.replay["position_s"] == 8.0)
        await viewer.until(lambda: viewer.frames[-1].is_snapshot)
        assert len(viewer.frames[-1].column(SectionKind.PLOTS, "sensor")) > 10
        await viewer.until(lambda: len({frame.now_ms for frame in viewer.frames[-5:]}) == 1)
        assert len(client.heard) == heard
        await viewer.done(replay={"paused": False})
        await asyncio.to_thread(client.wait_for, has_id_of, heard)
        times = [was_ns for was_ns, _ in shifts_ns(of_lab(client, heard), sent)]
        assert min(times) >= sent[0].log_time_ns + 8 * NS

    def has_id_of(message: MqttMessage) -> bool:
        return message.topic.startswith("lab/") and "id" in message.user_properties

    await play(act)


@pytest.mark.asyncio
async def test_a_recording_lasts_as_long_as_anything_in_it(
    play: Callable[[Act], Any], folder: Path, record: Path
) -> None:
    """Its last message need not be one that is sent again, as the ledger is not."""
    with McapReader(record) as log:
        attachment, first = log.attachment("scene.toml"), list(log.messages())[:40]
    assert attachment is not None
    last = first[-1]._replace(
        topic="lab/truth", payload=b"", log_time_ns=first[-1].log_time_ns + NS
    )
    with (folder / "silent.mcap").open("wb") as file:
        log_writer = McapWriter(file, attachments=[attachment], library="plotfeed test")
        for message in (*first, last):
            log_writer.write(message)
        log_writer.close()

    async def act(viewer: Viewer, _client: MqttReceiver, _begun: Begun) -> None:
        await viewer.load("silent.mcap")
        await viewer.until(lambda: viewer.is_at_end)
        assert viewer.replay["duration_s"] > 1.0
        await viewer.done(replay={"paused": False})
        await viewer.until(lambda: 0 < viewer.replay["position_s"] < 0.9)

    await play(act)


@pytest.mark.asyncio
async def test_at_its_end_it_stands_and_can_be_moved_back_or_played_again(
    play: Callable[[Act], Any],
) -> None:
    async def act(viewer: Viewer, client: MqttReceiver, _begun: Begun) -> None:
        await viewer.load()
        await viewer.done(replay={"position_s": 1e6})
        await viewer.until(lambda: viewer.is_at_end)
        await settled(client)
        heard = len(of_lab(client))
        await viewer.done(replay={"position_s": 2.0})
        assert viewer.session["clock"]["paused"]
        await viewer.done(replay={"position_s": SESSION_S - 1})
        await viewer.until(lambda: viewer.replay["position_s"] == SESSION_S - 1)
        await viewer.done(replay={"paused": False})
        await viewer.until(lambda: viewer.is_at_end)
        await until(lambda: len(of_lab(client)) > heard)
        await viewer.done(replay={"paused": False})  # once more from the beginning
        await viewer.until(lambda: 0 < viewer.replay["position_s"] < 5)

    await play(act)


@pytest.mark.asyncio
async def test_tracks_that_are_published_now_are_shown_in_recorded_time(
    play: Callable[[Act], Any], sent: list[Recorded]
) -> None:
    async def act(viewer: Viewer, client: MqttReceiver, _begun: Begun) -> None:
        await viewer.load()
        await viewer.done(replay={"position_s": 9.0})
        track = {"track": 4, "latitude_deg": 40.46, "longitude_deg": -3.72}
        shown = lambda: [f for f in viewer.frames if len(f.of(SectionKind.TRACKS))]  # noqa: E731
        while not shown():
            client.publish(TRACKS, json.dumps(track).encode())
            count = len(viewer.frames)
            await viewer.until(lambda: len(viewer.frames) > count)  # noqa: B023
        t_ms = shown()[-1].column(SectionKind.TRACKS, "t_utc_ms")[0] - sent[0].log_time_ns / 1e6
        assert 0 <= t_ms <= SESSION_S * 1e3

    await play(act)
