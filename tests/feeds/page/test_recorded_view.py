"""What a page shows of recordings: the plots, looks and fates of the ledger, at any position."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.message import DecodeError
from support.command import plotfeed
from support.page_updates import Frame, news_of, read_frame
from support.scene_files import DRONE, radar, scene_file, scene_text

from plotfeed.feeds.engine.scene_drones import SceneSpace, planned
from plotfeed.feeds.page.page_replay import RecordedView
from plotfeed.feeds.page.recorded_sectors import UNKNOWN_DRONE, RecordedSession
from plotfeed.feeds.page.updates import SectionKind
from plotfeed.feeds.page.view import View
from plotfeed.feeds.scene.fields import site_frame
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.ledger import entries_in
from plotfeed.replay.mcap import McapReader, McapWriter
from plotfeed.replay.recorded import SCENE_NAME, Attachment, Recorded, Stage

NS = 1_000_000_000
WHOLE_S = 32.0  # With what links still held when the sessions ended
LINK = """
[sensor.link]
latency_ms = 300
jitter_ms = 90
loss = { kind = "random", probability = 0.2 }
"""
EVENT = """
[[sensor.event]]
from_s = 15.0
set = { link = { latency_ms = 700 } }
"""
SECOND = DRONE.replace('"visitor"', '"other"').replace("1500.0", "-1500.0")


def recorded(folder: Path, *, sensors: str, **more: Any) -> Path:
    """The record of half a minute of a session."""
    text = scene_text(
        start_utc="2026-01-01T12:00:00Z", port=1883, sensors=sensors, drones=DRONE + SECOND, **more
    )
    path = folder / "session.mcap"
    how = ["--broker", "none", "--speed", "max", "--duration", "30"]
    done = plotfeed("run", scene_file(folder, text), "--record", path, *how)
    assert done.returncode == 0, done.stderr
    return path


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of two radars, one of them behind a bad link that gets worse."""
    far = radar("far", period_s=1.0, more="position_enu_m = [500.0, 0.0, 20.0]")
    return recorded(tmp_path_factory.mktemp("shown"), sensors=radar("near") + far + LINK + EVENT)


class Shown:
    """A recording on a view, brought to one time after the other."""

    def __init__(self, path: Path) -> None:
        self.recording = RecordedSession.open(path)
        self.view = View()
        self.frames: list[Frame] = []

    async def at(self, *steps: tuple[float, bool]) -> Shown:
        """Seconds since the beginning, and whether a leap leads there."""
        self.view.scene(self.recording.scene)
        shown = RecordedView(self.recording, self.view)
        self.view.watch([s.id for s in self.recording.scene.sensor])
        with McapReader(self.recording.path) as log, ThreadPoolExecutor(1) as thread:
            shown.open(log)
            for number, (second, leap) in enumerate(steps):
                t_ns = self.recording.start_ns + round(second * NS)
                await shown.go_to(t_ns, thread, leap=leap)
                update = self.view.update(t_ns, float(number))
                self.frames.append(read_frame(update.public + update.truth))
        return self

    def column(self, kind: SectionKind, name: str) -> Any:
        return np.concatenate([frame.column(kind, name) for frame in self.frames])

    @property
    def drones(self) -> list[str]:
        """Their names, by number."""
        told = [news for frame in self.frames for news in frame.of(SectionKind.TRUE_NEWS)]
        found: list[str] = told[-1].news["drones"]
        return found

    @property
    def news(self) -> dict[str, Any]:
        return news_of(self.frames)


def straight(until_s: float, step_s: float = 0.1) -> list[tuple[float, bool]]:
    return [(float(s), False) for s in np.arange(step_s, until_s + step_s / 2, step_s)]


@cache
def messages(path: Path) -> list[Recorded]:
    with McapReader(path) as log:
        return list(log.messages())


def ledger(path: Path) -> list[tuple[int, pb.Ledger]]:
    """With the log times."""
    return [
        (m.log_time_ns, entry)
        for m in messages(path)
        if m.topic == "plotfeed/truth"
        for entry in entries_in(m.payload)
    ]


def expected(path: Path, from_ns: int = 0, until_ns: int = 1 << 62) -> dict[str, list[Any]]:
    """Of plots whose entry was written in that time: sensor, time, range, latency; by fate."""
    batches: dict[Any, pb.PlotBatch] = {}
    for m in messages(path):
        if m.stage is Stage.BEFORE and m.topic.endswith("/plots"):
            batch = pb.PlotBatch.FromString(m.payload)
            batches[batch.sensor, batch.scan, batch.sector] = batch
    found: dict[str, list[Any]] = {"shown": [], "lost": []}
    for at_ns, entry in ledger(path):
        if not from_ns <= at_ns <= until_ns:
            continue
        batch = batches[entry.sensor, entry.scan, entry.sector]
        ends = ("/plots", "/048")
        left = [m.sent_utc_ns for m in entry.messages if m.delivered and m.topic.endswith(ends)]
        for plot, truth in zip(batch.plots, entry.plots, strict=True):
            late_ms = (min(left) - plot.time_utc_ns) / 1e6 if left else None
            row = (int(entry.sensor == "far"), plot.time_utc_ns, plot.range_m, late_ms, truth.drone)
            found["shown" if left else "lost"].append(row)
    return found


def compare(shown: Shown, kind: SectionKind, rows: Sequence[Any]) -> None:
    names = ("sensor", "t_utc_ms", "range_m", "latency_ms")
    got = sorted(zip(*(shown.column(kind, name).tolist() for name in names), strict=True))
    assert len(got) == len(rows)
    for plot, (sensor, t_ns, range_m, late_ms, _) in zip(got, sorted(rows), strict=True):
        assert plot[0] == sensor
        assert abs(plot[1] * 1e6 - t_ns) < 1000
        assert plot[2] == pytest.approx(range_m, rel=1e-6)
        assert late_ms is None or plot[3] == pytest.approx(late_ms, rel=1e-5, abs=1e-3)


@pytest.mark.asyncio
async def test_the_plots_shown_are_those_of_the_ledger_where_and_when_they_were_delivered(
    session: Path,
) -> None:
    shown, wanted = await Shown(session).at(*straight(WHOLE_S, 0.2)), expected(session)
    assert len(wanted["shown"]) > 100
    assert len(wanted["lost"]) > 3
    compare(shown, SectionKind.PLOTS, wanted["shown"])
    compare(shown, SectionKind.LOST_PLOTS, wanted["lost"])
    drones = shown.column(SectionKind.PLOT_TRUTHS, "drone").astype(int)
    names = shown.drones
    order = np.argsort(shown.column(SectionKind.PLOTS, "t_utc_ms"), kind="stable")
    by_time = sorted(wanted["shown"], key=lambda row: row[1])
    assert sorted(names) == ["other", "visitor"]
    assert [names[drones[i]] if drones[i] >= 0 else "" for i in order] == [r[4] for r in by_time]


@pytest.mark.parametrize("steps", [[5.0, 25.0], [12.0, 12.5, 11.0]])
@pytest.mark.asyncio
async def test_a_leap_shows_what_has_not_faded_and_goes_on_from_there(
    session: Path, steps: list[float]
) -> None:
    shown = await Shown(session).at(
        *straight(3.0), *((s, True) for s in steps), (steps[-1] + 1.0, False)
    )
    at_ns = shown.recording.start_ns + round(steps[-1] * NS)
    leapt, after = shown.frames[-2:]
    assert leapt.is_snapshot
    assert leapt.news["generation"] == 1  # it is the same scene, and nobody's zoom is lost
    glow_ns = round(shown.recording.scene.page.afterglow_s * NS)
    wanted = expected(session, at_ns - glow_ns, at_ns)["shown"]
    times_ms = leapt.column(SectionKind.PLOTS, "t_utc_ms")
    wanted_ms = sorted(row[1] / 1e6 for row in wanted if row[1] >= at_ns - glow_ns)
    assert sorted(times_ms[times_ms * 1e6 >= at_ns - glow_ns]) == pytest.approx(wanted_ms, abs=1e-3)
    wanted = expected(session, at_ns + 1, at_ns + NS)
    assert len(after.column(SectionKind.PLOTS, "sensor")) == len(wanted["shown"]) > 0
    assert after.news["totals"]["plots"] == len(wanted["shown"]) + len(wanted["lost"])


@pytest.mark.asyncio
async def test_what_leads_somewhere_makes_no_difference_to_what_is_counted_from_there(
    session: Path,
) -> None:
    once = await Shown(session).at((10.0, True), *((s, False) for s in (12.0, 14.0)))
    often = await Shown(session).at(*straight(2.0), (25.0, True), (10.0, True), (14.0, False))
    for key in ("totals", "settings", "details"):
        assert once.news[key] == often.news[key]


@pytest.mark.asyncio
async def test_looks_and_fates_are_counted_as_the_ledger_has_them(session: Path) -> None:
    shown = await Shown(session).at(*straight(WHOLE_S, 0.5))
    entries = [entry for _, entry in ledger(session)]
    looks = [look for entry in entries if entry.sensor == "near" for look in entry.looks]
    near = shown.news["details"]["near"]["detections"]
    assert sum(near["looks"]) == len(looks) > 0
    assert sum(near["detected"]) == sum(look.detected for look in looks)
    assert sum(near["expected"]) == pytest.approx(sum(look.pd for look in looks), abs=0.1)
    sent = [one for entry in entries for one in entry.messages]
    assert shown.news["totals"]["lost"] == sum(one.fate == pb.LOST for one in sent) > 0
    assert shown.news["totals"]["messages"] == sum(one.delivered for one in sent)
    assert shown.news["totals"]["looks"] == sum(len(entry.looks) for entry in entries)
    false = [plot for entry in entries for plot in entry.plots if not plot.drone]
    assert shown.news["totals"]["false_alarms"] == len(false) > 0


@pytest.mark.parametrize(("second", "latency_ms"), [(5.0, 300), (16.5, 700)])
@pytest.mark.parametrize("leap", [False, True])
@pytest.mark.asyncio
async def test_links_are_in_force_as_the_ledger_says_wherever_it_is(
    session: Path, second: float, latency_ms: int, leap: bool
) -> None:
    steps = [(second, True), (second + 3.0, False)] if leap else straight(second, 0.5)
    shown = await Shown(session).at(*steps)
    assert shown.news["settings"]["far"]["link"]["latency_ms"] == latency_ms
    assert shown.news["settings"]["near"].get("link") is None


@pytest.mark.asyncio
async def test_drones_are_where_they_were(session: Path) -> None:
    shown = await Shown(session).at(*straight(20.0, 0.5))
    scene = shown.recording.scene
    frame, space = site_frame(scene.scene.site), SceneSpace(scene.scene.site)
    flown = {drone.id: planned(space, drone).track for drone in scene.drone}
    compared = 0
    for step, drawn in enumerate(shown.frames[6:], 7):
        names = ("drone", "gone_ms", "east_m", "north_m")
        columns = (drawn.column(SectionKind.DRONES, name) for name in names)
        for drone, gone_ms, *place_m in zip(*columns, strict=True):
            track = flown[shown.drones[drone]]
            path_m = frame.from_ecef(track.position_ecef_m)
            true_m = [np.interp(step * 0.5 * NS, track.t_utc_ns, path_m[:, k]) for k in range(2)]
            assert np.hypot(*np.subtract(place_m, true_m)) < 0.5
            compared += gone_ms == 0
    assert compared > 50


@pytest.mark.asyncio
async def test_plots_are_read_from_asterix_where_there_is_nothing_better(tmp_path: Path) -> None:
    path = recorded(tmp_path, sensors=radar(more='report = ["asterix-048"]'))
    shown = await Shown(path).at(*straight(10.0, 0.5))
    entries = [e for at_ns, e in ledger(path) if at_ns <= shown.recording.start_ns + 10 * NS]
    truths = [plot for entry in entries for plot in entry.plots if plot.drone]
    assert len(shown.column(SectionKind.PLOTS, "range_m")) == sum(len(e.plots) for e in entries)
    mine = shown.column(SectionKind.PLOT_TRUTHS, "drone") >= 0
    off_m = shown.column(SectionKind.PLOTS, "range_m")[mine] - [plot.range_m for plot in truths]
    assert len(off_m) > 10
    assert np.abs(off_m).max() < 60.0
    assert not shown.recording.notes


@pytest.mark.asyncio
async def test_without_a_ledger_plots_are_shown_as_they_left_and_nobody_s(
    session: Path, tmp_path: Path
) -> None:
    path = tmp_path / "public.mcap"
    done = plotfeed("convert", session, path, "--topic", "plotfeed/+/plots", "--stage", "after")
    assert done.returncode == 0, done.stderr
    shown = await Shown(path).at(*straight(29.0, 0.5))
    left = [m for m in messages(path) if m.log_time_ns <= shown.recording.start_ns + 29 * NS]
    batches = [(m, batch) for m in left if (batch := readable(m.payload)) is not None]
    wanted = [
        (int(b.sensor == "far"), p.time_utc_ns, p.range_m, (m.log_time_ns - p.time_utc_ns) / 1e6, 0)
        for m, b in batches
        for p in b.plots
    ]
    compare(shown, SectionKind.PLOTS, wanted)
    assert set(shown.column(SectionKind.PLOT_TRUTHS, "drone")) == {UNKNOWN_DRONE}
    assert any("no ledger" in note for note in shown.recording.notes)


def readable(payload: bytes) -> pb.PlotBatch | None:
    """A batch, unless its link has corrupted it beyond reading."""
    with suppress(DecodeError):
        return pb.PlotBatch.FromString(payload)
    return None


def written(path: Path, recorded: Iterable[Recorded], scene: bytes | None) -> Path:
    attachments = []
    if scene is not None:
        attachments = [Attachment(name=SCENE_NAME, media_type="application/toml", data=scene)]
    with path.open("wb") as file:
        log = McapWriter(file, attachments=attachments, library="plotfeed test")
        for each in recorded:
            log.write(each)
        log.close()
    return path


@pytest.mark.asyncio
async def test_a_sensor_whose_plots_cannot_be_read_is_named(session: Path, tmp_path: Path) -> None:
    kept = [m for m in messages(session) if not m.topic.startswith("plotfeed/far/")]
    path = written(tmp_path / "half.mcap", kept, scene_of(session))
    shown = await Shown(path).at(*straight(5.0))
    assert set(shown.column(SectionKind.PLOTS, "sensor")) == {0}
    assert any("far" in note for note in shown.recording.notes)


def scene_of(path: Path) -> bytes:
    with McapReader(path) as log:
        found = log.attachment(SCENE_NAME)
        assert found is not None
        return found.data


SCENE = scene_text(port=1883).encode()
SENT = Recorded(topic="plotfeed/radar/status", payload=b"{}", log_time_ns=NS, publish_time_ns=NS)
LATE = Recorded(topic="plotfeed/truth", payload=b"", log_time_ns=1 << 63, publish_time_ns=NS)


@pytest.mark.parametrize(
    ("recorded", "scene", "words"),
    [
        ([SENT], None, "holds no scene"),
        ([], SCENE, "it holds none"),
        ([SENT], SCENE, "no plots to show"),
        ([SENT, LATE], SCENE, "2262"),
        ([SENT], b"[scene]\nname = 5", "scene.name"),
        ([SENT], b"\xff", "UTF-8"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_a_line(
    tmp_path: Path, recorded: list[Recorded], scene: bytes | None, words: str
) -> None:
    path = written(tmp_path / "x.mcap", recorded, scene)
    with pytest.raises(PlotfeedError) as error:
        RecordedSession.open(path)
    assert str(error.value).startswith("x.mcap: ")
    assert words in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.asyncio
async def test_damage_is_refused_or_told_and_never_worse(session: Path, tmp_path: Path) -> None:
    data, path = session.read_bytes(), tmp_path / "damaged.mcap"
    shown = 0
    for at in range(0, len(data), len(data) // 7):
        for damaged in (data[:at], data[:at] + bytes(64) + data[at + 64 :]):
            path.write_bytes(damaged)
            try:
                await Shown(path).at((20.0, True), (21.0, False))
                shown += 1
            except PlotfeedError as error:
                assert "\n" not in str(error)
    assert shown > 3


@pytest.mark.asyncio
async def test_entries_that_no_session_wrote_are_passed_over(session: Path, tmp_path: Path) -> None:
    nan, far = float("nan"), 1 << 62
    good = messages(session)
    first = next(m for m in good if m.topic == "plotfeed/truth")
    odd = pb.Look(drone="z", time_utc_ns=first.log_time_ns, range_m=1e300, snr_db=1e9, pd=nan)
    bad = [
        pb.Ledger(sensor="near", looks=[odd]),
        pb.Ledger(sensor="near", looks=[pb.Look(time_utc_ns=far)]),
        pb.Ledger(sensor="near", messages=[pb.Sent(due_utc_ns=-far, sent_utc_ns=far)]),
        pb.Ledger(sensor="nobody", link="{"),
        pb.Ledger(sensor="near", link="{}x", plots=[pb.PlotTruth(drone="z", range_m=nan)]),
    ]
    payloads = [*(entry.SerializeToString() for entry in bad), b"\xff\xff"]
    hostile = [first._replace(payload=payload) for payload in payloads]
    path = written(tmp_path / "hostile.mcap", [*hostile, *good], scene_of(session))
    shown = await Shown(path).at(*straight(WHOLE_S, 0.5))
    compare(shown, SectionKind.PLOTS, expected(session)["shown"])
