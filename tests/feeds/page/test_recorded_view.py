"""What a page shows of recordings: what that of the session was told, at any position."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from support.command import plotfeed
from support.page_updates import Frame, news_of, read_frame
from support.recordings import mcap_of
from support.scene_files import DRONE, radar, scene_file, scene_text

from plotfeed.feeds.engine.scene_drones import SceneSpace, planned
from plotfeed.feeds.page.page_replay import RecordedView
from plotfeed.feeds.page.page_sessions import PageSessions
from plotfeed.feeds.page.recorded_sectors import UNKNOWN_DRONE, RecordedSession
from plotfeed.feeds.page.updates import LAYOUTS, SectionKind, Update
from plotfeed.feeds.page.view import View
from plotfeed.feeds.recording.recorder import Recorder, SessionRecorder, attachments_of
from plotfeed.feeds.scene.fields import site_frame
from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.session.session import run
from plotfeed.feeds.timing.clock import InstantClock
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import PlotfeedError
from plotfeed.replay.mcap import McapReader
from plotfeed.replay.recorded import SCENE_NAME, Attachment, Recorded

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
TWIN = DRONE.replace('"visitor"', '"twin"').replace("1500.0", "1503.0")  # whose echoes merge
SECOND = DRONE.replace('"visitor"', '"other"').replace("1500.0", "-1500.0")


class Played(NamedTuple):
    """The record of half a minute of a session, and all that its page was told meanwhile."""

    path: Path
    frames: list[Frame]
    drones: list[str]


def played(folder: Path, sensors: str) -> Played:
    text = scene_text(
        start_utc="2026-01-01T12:00:00Z", port=1883, sensors=sensors, drones=DRONE + TWIN + SECOND
    )
    scene, view, path = load(scene_file(folder, text)), View(), folder / "session.mcap"
    start_ns = scene.scene.start_utc_ns or 0
    with Recorder(path, attachments=attachments_of(scene, start_ns), waits=True) as recorder:
        kept, page = (
            SessionRecorder(recorder, ledger_is_sent=True),
            PageSessions(scene, view, folder),
        )
        how: Any = {"clock": InstantClock(start_ns), "broker": "none", "duration_s": 30.0}
        view.totals(asyncio.run(run(scene, observers=[page, kept], **how)))
    view.watch([sensor.id for sensor in scene.sensor])
    end_ns = start_ns + round(WHOLE_S * NS)
    for second in (0.0, 1.0):
        view.update(end_ns, second)
    return Played(path, [both(view.snapshot(end_ns))], [drone.id for drone in scene.drone])


def both(update: Update) -> Frame:
    """What who sees the truth is told."""
    return read_frame(update.public + update.truth)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Played:
    """Of two radars, one of them behind a bad link that gets worse."""
    far = radar("far", period_s=1.0, more="position_enu_m = [500.0, 0.0, 20.0]")
    return played(
        tmp_path_factory.mktemp("shown"), radar("near", more="merging = {}") + far + LINK + EVENT
    )


class Shown:
    """A recording on a view, brought to one time after the other."""

    def __init__(self, path: Path) -> None:
        self.recording = RecordedSession.open(path)
        self.view = View()
        self.frames: list[Frame] = []

    def at(self, *steps: tuple[float, bool]) -> Shown:
        """Seconds since the beginning, and whether a leap leads there."""
        asyncio.run(self._go(steps))
        return self

    async def _go(self, steps: Sequence[tuple[float, bool]]) -> None:
        self.view.scene(self.recording.scene)
        shown = RecordedView(self.recording, self.view)
        self.view.watch([s.id for s in self.recording.scene.sensor])
        with McapReader(self.recording.path) as log, ThreadPoolExecutor(1) as thread:
            shown.open(log)
            for number, (second, leap) in enumerate(steps):
                t_ns = self.recording.start_ns + round(second * NS)
                await shown.go_to(t_ns, thread, leap=leap)
                self.frames.append(both(self.view.update(t_ns, float(number))))

    @property
    def drones(self) -> list[str]:
        """Their names, by number."""
        told = [news for frame in self.frames for news in frame.of(SectionKind.TRUE_NEWS)]
        found: list[str] = told[-1].news["drones"]
        return found

    @property
    def news(self) -> dict[str, Any]:
        return news_of(self.frames)


def straight(until_s: float, step_s: float = 0.5) -> list[tuple[float, bool]]:
    return [(float(s), False) for s in np.arange(step_s, until_s + step_s / 2, step_s)]


Columns = dict[str, NDArray[Any]]
DELIVERED, LOST = (SectionKind.PLOTS, SectionKind.PLOT_TRUTHS), (SectionKind.LOST_PLOTS,)


def plots(of: Shown | Played, kinds: Sequence[SectionKind], frames: slice = slice(None)) -> Columns:
    """Columns of plots in those frames, in the order of their times, and whose they are by name."""
    columns = {
        name: np.concatenate([frame.column(kind, name) for frame in of.frames[frames]])
        for kind in kinds
        for name, _ in LAYOUTS[kind]
    }
    numbers = columns["drone"].astype(int).tolist()
    columns["drone"] = np.array([of.drones[n] if n >= 0 else str(n) for n in numbers])
    order = np.lexsort((columns["range_m"], columns["t_utc_ms"]))
    return {name: column[order] for name, column in columns.items()}


def assert_same(found: Columns, expected: Columns) -> None:
    assert found["drone"].tolist() == expected["drone"].tolist()
    for name in found.keys() - {"drone"}:
        np.testing.assert_allclose(found[name], expected[name], 1e-5, 1e-3, err_msg=name)


COUNTED = ("looks", "plots", "false_alarms", "messages", "lost")


def test_a_recording_shows_what_the_page_of_the_session_was_told(session: Played) -> None:
    shown = Shown(session.path).at(*straight(WHOLE_S))
    for kinds, least in ((DELIVERED, 100), (LOST, 3)):
        found = plots(shown, kinds)
        assert len(found["drone"]) > least
        assert_same(found, plots(session, kinds))
    told, live = shown.news, session.frames[0].news
    assert told["covers"] == live["covers"]
    totals = {name: told["totals"][name] for name in COUNTED}
    assert totals == {name: live["totals"][name] for name in COUNTED}
    assert all(totals.values())
    for sensor, details in told["details"].items():
        for name in ("looks", "detected", "expected", "variance"):
            expected = live["details"][sensor]["detections"][name]
            assert details["detections"][name] == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("steps", [[5.0, 25.0], [12.0, 12.5, 11.0]])
def test_a_leap_shows_what_has_not_faded_and_goes_on_from_there(
    session: Played, steps: list[float]
) -> None:
    to_s, whole = steps[-1], Shown(session.path).at(*straight(30.0))
    leaps = [(s, True) for s in steps]
    shown = Shown(session.path).at(*straight(3.0), *leaps, (to_s + 1.0, False))
    leapt, after = shown.frames[-2:]
    assert leapt.is_snapshot
    assert leapt.news["generation"] == 1  # it is the same scene, and nobody's zoom is lost
    here, later = round(2 * to_s), slice(round(2 * to_s), round(2 * to_s) + 2)
    recording = shown.recording
    glows_ms = recording.start_ns / 1e6 + 1e3 * (to_s - recording.scene.page.afterglow_s)
    seen, wanted = (
        {name: column[columns["t_utc_ms"] >= glows_ms] for name, column in columns.items()}
        for columns in (
            plots(shown, DELIVERED, slice(-2, -1)),
            plots(whole, DELIVERED, slice(here)),
        )
    )
    assert_same(seen, wanted)
    seen, wanted = plots(shown, DELIVERED, slice(-1, None)), plots(whole, DELIVERED, later)
    assert_same(seen, wanted)
    lost = plots(whole, LOST, later)
    assert after.news["totals"]["plots"] == len(wanted["drone"]) + len(lost["drone"]) > 0


def test_what_leads_somewhere_makes_no_difference_to_what_is_counted_from_there(
    session: Played,
) -> None:
    once = Shown(session.path).at((10.0, True), (12.0, False), (14.0, False))
    often = Shown(session.path).at(*straight(2.0), (25.0, True), (10.0, True), (14.0, False))
    for key in ("totals", "settings", "details"):
        assert once.news[key] == often.news[key]
    straight_on = (Shown(session.path).at(*straight(second)) for second in (10.0, 14.0))
    before, after, leapt = (
        sum(shown.news["details"]["near"]["detections"]["looks"]) for shown in (*straight_on, once)
    )
    assert leapt == after - before > 0


@pytest.mark.parametrize(("second", "latency_ms"), [(5.0, 300), (16.5, 700)])
def test_links_are_in_force_as_the_ledger_says_wherever_it_is(
    session: Played, second: float, latency_ms: int
) -> None:
    for steps in (straight(second), [(second, True)], [(second, True), (second + 3.0, False)]):
        settings = Shown(session.path).at(*steps).news["settings"]
        assert settings["far"]["link"]["latency_ms"] == latency_ms
        assert settings["near"].get("link") is None


def test_drones_are_where_they_were(session: Played) -> None:
    shown = Shown(session.path).at(*straight(20.0))
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


def test_plots_are_read_from_asterix_where_there_is_nothing_better(tmp_path: Path) -> None:
    session = played(tmp_path, radar(more='report = ["asterix-048"]'))
    shown = Shown(session.path).at(*straight(WHOLE_S))
    found, expected = plots(shown, DELIVERED), plots(session, DELIVERED)
    assert len(found["drone"]) > 30
    assert sorted(found["drone"]) == sorted(expected["drone"])
    off_m = np.sort(found["range_m"]) - np.sort(expected["range_m"])
    assert np.abs(off_m).max() <= 1852 / 256  # of which 048 tells whole ones
    assert not shown.recording.notes


def test_without_a_ledger_plots_are_shown_as_they_left_and_nobody_s(tmp_path: Path) -> None:
    session, path = played(tmp_path, radar(more='report = ["plots"]') + LINK), tmp_path / "x.mcap"
    done = plotfeed(
        "convert", session.path, path, "--topic", "plotfeed/+/plots", "--stage", "after"
    )
    assert done.returncode == 0, done.stderr
    shown = Shown(path).at(*straight(WHOLE_S))
    found, expected = plots(shown, DELIVERED), plots(session, DELIVERED)
    for name, _ in LAYOUTS[SectionKind.PLOTS]:
        np.testing.assert_allclose(found[name], expected[name], 1e-5, 1e-3, err_msg=name)
    assert set(found["drone"]) == {str(UNKNOWN_DRONE)}
    assert any("no ledger" in note for note in shown.recording.notes)


@cache
def messages(path: Path) -> list[Recorded]:
    with McapReader(path) as log:
        return list(log.messages())


def written(path: Path, recorded: Iterable[Recorded], scene: bytes | None) -> Path:
    attachments = []
    if scene is not None:
        attachments = [Attachment(name=SCENE_NAME, media_type="application/toml", data=scene)]
    path.write_bytes(mcap_of(recorded, attachments=attachments))
    return path


def test_a_sensor_whose_plots_cannot_be_read_is_named(session: Played, tmp_path: Path) -> None:
    kept = [m for m in messages(session.path) if not m.topic.startswith("plotfeed/far/")]
    path = written(tmp_path / "half.mcap", kept, scene_of(session.path))
    shown = Shown(path).at(*straight(5.0))
    assert set(plots(shown, DELIVERED)["sensor"]) == {0}
    assert any("far" in note for note in shown.recording.notes)


def scene_of(path: Path) -> bytes:
    return (path.parent / "scene.toml").read_bytes()


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


def test_damage_is_refused_or_told_and_never_worse(session: Played, tmp_path: Path) -> None:
    data, path = session.path.read_bytes(), tmp_path / "damaged.mcap"
    shown = 0
    for at in range(0, len(data), len(data) // 7):
        for damaged in (data[:at], data[:at] + bytes(64) + data[at + 64 :]):
            path.write_bytes(damaged)
            try:
                Shown(path).at((20.0, True), (21.0, False))
                shown += 1
            except PlotfeedError as error:
                assert "\n" not in str(error)
    assert shown > 3


def test_entries_that_no_session_wrote_are_passed_over(session: Played, tmp_path: Path) -> None:
    nan, far = float("nan"), 1 << 62
    good = messages(session.path)
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
    path = written(tmp_path / "hostile.mcap", [*hostile, *good], scene_of(session.path))
    shown = Shown(path).at(*straight(WHOLE_S))
    assert_same(plots(shown, DELIVERED), plots(session, DELIVERED))
