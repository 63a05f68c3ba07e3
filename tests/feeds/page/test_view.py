from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support import made_up_session
from support.asterix_input import tracks
from support.made_up_session import MadeUpSession
from support.page_updates import TRUE_KINDS, Frame, read_frame

from plotfeed import testing
from plotfeed.feeds.formats.told_tracks import ToldTrack
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.page.shown import MAX_KEPT, MAX_TRACKS, ShownTracks, tracks_to_show
from plotfeed.feeds.page.strips import RANGE_BINS
from plotfeed.feeds.page.updates import PlotFlag, SectionKind, TrackFlag, Update
from plotfeed.feeds.page.view import View
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.models.beam import Sector
from plotfeed.models.frames import aer_to_enu
from plotfeed.models.state import Looks, Plots, TruthState
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.asterix.cat062 import TrackEncoder062
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.utc import NS

SECTOR = Sector(5, 0, testing.START_NS, testing.START_NS + NS, 0.0, 360.0)


def frames(update: Update) -> tuple[Frame, Frame]:
    """What everybody sees, and what who sees the truth does."""
    return read_frame(update.public), read_frame(update.public + update.truth)


def plots(n: int, **columns: Any) -> Plots:
    given = {
        "t_utc_ns": np.full(n, testing.START_NS),
        "range_m": np.full(n, 2000.0),
        "azimuth_deg": np.linspace(10.0, 80.0, n),
        "elevation_deg": np.full(n, 3.0),
        "snr": np.full(n, 100.0),
    }
    return Plots.of(**(given | columns))


def looks(range_m: Any, pd: Any, detected: Any) -> Looks:
    """At one drone, by one signal."""
    zeros = dict.fromkeys(("drone", "channel", "t_utc_ns"), np.zeros(len(pd), np.int64))
    ones = dict.fromkeys(("azimuth_deg", "elevation_deg", "snr"), np.ones(len(pd)))
    of_these = {"pd": np.array(pd), "detected": np.array(detected)}
    return Looks.none().but(**zeros, **ones, range_m=np.full(len(pd), range_m), **of_these)


def report(found: Plots, sensor: str = "radar", seen: Looks | None = None) -> Batch:
    return Batch.of_one(SECTOR, found, seen or Looks.none(), sensors=[sensor])


def sent(topic: str = "plotfeed/radar/plots", **changes: Any) -> pb.Sent:
    due = dict.fromkeys(("due_utc_ns", "link_due_utc_ns"), SECTOR.end_ns)
    left = {"sent_utc_ns": SECTOR.end_ns + 250_000_000, "delivered": True}
    return pb.Sent(topic=topic, **(due | left | changes))


def lost(**changes: Any) -> pb.Sent:
    return sent(delivered=False, sent_utc_ns=0, fate=pb.LOST, **changes)


def view_of_radar(**changes: Any) -> View:
    """That radar as it begins, of which an update has told."""
    view, scene = View(), testing.scene([testing.radar(**changes)], seed=1)
    view.scene(scene)
    view.settings(scene.sensor[0], 0)
    view.update(testing.START_NS, 0.0)
    return view


def a_radar(**changes: Any) -> Sensor:
    """The radar of such a view as its keys are now."""
    return testing.scene([testing.radar(**changes)], seed=1).sensor[0]


def updated(view: View, now_ns: int = testing.START_NS) -> Frame:
    """What who sees the truth is told next."""
    return frames(view.update(now_ns, 0.0))[1]


def details(view: View) -> Any:
    view.watch([])
    view.watch(["radar"])
    return updated(view).news["details"]["radar"]


def test_everybody_sees_plots_and_only_who_asks_sees_whose_they_are() -> None:
    stage = MadeUpSession(View(), made_up_session.scene())
    assert stage.view is not None
    for _ in range(40):
        stage.advance(stage.now_ns + NS // 10)
        public, everything = frames(stage.view.update(stage.now_ns, stage.now_ns / NS))
        assert not TRUE_KINDS & {section.kind for section in public.sections}
        assert "drone-0" not in json.dumps(public.news)
        told = everything.of(SectionKind.PLOT_TRUTHS)
        assert [(s.first, s.rows) for s in told] == [
            (s.first, s.rows) for s in public.of(SectionKind.PLOTS)
        ]
    public, everything = frames(stage.view.snapshot(stage.now_ns))
    assert not TRUE_KINDS & {section.kind for section in public.sections}
    assert everything.column(SectionKind.DRONES, "drone").tolist() == list(range(40))
    (names,) = everything.of(SectionKind.TRUE_NEWS)
    assert names.news["drones"] == [f"drone-{i:03}" for i in range(40)]


def test_plots_lie_where_the_sensor_measured_them_on_the_curved_earth() -> None:
    far = testing.radar(id="far", position_enu_m=[12_000.0, -7000.0, 80.0])
    scene = testing.scene([testing.radar(), far], seed=1)
    view = View()
    view.scene(scene)
    place = {"azimuth_deg": np.linspace(10.0, 80.0, 50), "elevation_deg": np.linspace(-5, 70, 50)}
    place["range_m"] = np.linspace(100, 19_000, 50)
    true = {f"true_{name}": column + 0.5 for name, column in place.items()}
    view.settled(report(plots(50, **place, **true), "far"), [sent("plotfeed/far/plots")])
    frame = updated(view)
    there = frame_at(scene.scene.site, scene.sensor[1].position_enu_m)
    for kind, mark, off in ((SectionKind.PLOTS, "", 0.0), (SectionKind.PLOT_TRUTHS, "true_", 0.5)):
        local_m = aer_to_enu(*(place[name] + off for name in place))
        expected = testing.SITE.from_ecef(there.to_ecef(local_m))
        for name, values in (("east_m", expected[:, 0]), ("north_m", expected[:, 1])):
            np.testing.assert_allclose(frame.column(kind, mark + name), values, atol=5e-3)
    for name, value in {"sensor": 1, "snr_db": 20.0, "latency_ms": 1250.0}.items():
        np.testing.assert_allclose(frame.column(SectionKind.PLOTS, name), value, atol=5e-3)


@pytest.mark.parametrize(
    ("latitude_deg", "longitude_deg"), [(90.0, 0.0), (-90.0, 10.0), (0.0, 180.0), (0.0, -180.0)]
)
def test_the_site_may_be_anywhere(latitude_deg: float, longitude_deg: float) -> None:
    tree = {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg, "height_m": 0.0}
    view, general = View(), {"name": "edge", "seed": 1, "site": tree}
    view.scene(testing.scene([testing.radar()], seed=1, scene=general))
    view.settled(report(plots(4)), [sent()])
    assert np.isfinite(updated(view).column(SectionKind.PLOTS, "east_m")).all()


def test_a_plot_without_range_is_a_bearing_and_one_without_azimuth_is_nowhere() -> None:
    view = view_of_radar()
    nothing = np.full(1, np.nan)
    for lacking in ("elevation_deg", "azimuth_deg"):
        found = plots(1, **{"range_m": nothing, lacking: nothing})
        view.settled(report(found), [sent()])
    frame = updated(view)
    assert frame.column(SectionKind.PLOTS, "flags").tolist() == [PlotFlag.BEARING, PlotFlag.NOWHERE]
    east_m, north_m = (frame.column(SectionKind.PLOTS, name) for name in ("east_m", "north_m"))
    assert np.hypot(east_m[0], north_m[0]) == pytest.approx(20_000.0)  # the edge of cover
    assert np.degrees(np.arctan2(east_m[0], north_m[0])) == pytest.approx(10.0)
    assert np.isnan([east_m[1], north_m[1]]).all()


def test_plots_are_delivered_by_the_first_message_that_brings_them_or_seen_with_the_truth() -> None:
    view = view_of_radar()
    late = sent("plotfeed/radar/asterix/048", sent_utc_ns=SECTOR.end_ns + NS)
    north_message = sent("plotfeed/radar/asterix/034", sent_utc_ns=SECTOR.end_ns)
    view.settled(report(plots(3)), [late, north_message, sent()])
    latency_ms = updated(view).column(SectionKind.PLOTS, "latency_ms")
    np.testing.assert_allclose(latency_ms, 1250.0)
    view.settled(report(plots(3)), [lost(), sent("plotfeed/radar/asterix/034")])
    public, everything = frames(view.update(testing.START_NS, 0.0))
    assert not public.of(SectionKind.PLOTS)
    latency_ms = everything.column(SectionKind.LOST_PLOTS, "latency_ms")
    assert np.isnan(latency_ms).tolist() == [True] * 3
    others = np.empty(3, np.object_)
    others[:] = [(), (1,), (1, 2)]
    merged = plots(3, drone=np.zeros(3, np.int64), merged_drones=others)
    view.settled(report(merged), [sent()])
    assert updated(view).column(SectionKind.PLOT_TRUTHS, "merged").tolist() == [0, 1, 2]


def test_a_snapshot_has_what_updates_had_is_bounded_and_forgets_what_has_faded() -> None:
    view = view_of_radar()
    numbers = []
    for second in range(100):
        view.settled(report(plots(4)), [sent()])
        now_ns = testing.START_NS + second * NS
        frame = read_frame(view.update(now_ns, float(second)).public)
        numbers.append(frame.of(SectionKind.PLOTS)[0].first)
    assert numbers == list(range(0, 400, 4))
    public, everything = frames(view.snapshot(now_ns))
    assert public.is_snapshot
    assert [s.first for s in public.of(SectionKind.PLOTS)] == numbers[-61:]
    assert [s.first for s in everything.of(SectionKind.PLOT_TRUTHS)] == numbers[-61:]
    assert len(public.news["seconds"]) == 99
    for _ in range(60):
        view.settled(report(plots(1000)), [sent()])
        view.update(now_ns, 100.0)
    shown = read_frame(view.snapshot(now_ns).public)
    assert MAX_KEPT - 1000 <= len(shown.column(SectionKind.PLOTS, "sensor")) <= MAX_KEPT


def test_another_scene_begins_with_a_snapshot_of_nothing() -> None:
    view = view_of_radar()
    view.settled(report(plots(4)), [sent()])
    view.update(testing.START_NS, 0.0)
    view.scene(testing.scene([testing.radar(id="other")], seed=1))
    update = view.update(testing.START_NS, 0.0)
    frame = read_frame(update.public)
    assert update.is_snapshot is frame.is_snapshot is True
    assert not frame.of(SectionKind.PLOTS)
    assert [s["id"] for s in frame.news["scene"]["sensors"]] == ["other"]
    assert not view.update(testing.START_NS, 0.0).is_snapshot
    # What is told of the scene before, or of a sensor that nobody knows, is nothing.
    view.settled(report(plots(4)), [sent()])
    view.settings(a_radar(), 0)
    view.watch(["radar"])
    frame = updated(view)
    assert not frame.of(SectionKind.PLOTS)
    assert frame.news.get("details", {}) == {}


def test_news_are_told_once_and_again_in_every_snapshot_and_are_json() -> None:
    view = view_of_radar()
    view.tell(refusal="it was no telemetry")
    view.session({"clock": {"paused": True}})
    view.session({"clock": {"paused": True}, "record": {"on": False}})
    told = updated(view).news
    assert told["refusal"] == "it was no telemetry"
    assert told["session"] == {"clock": {"paused": True}, "record": {"on": False}}
    view.session({"clock": {"paused": True}})
    assert updated(view).news == {}
    again = read_frame(view.snapshot(testing.START_NS).public).news
    assert {"layouts", "scene", "settings", "session", "refusal"} <= again.keys()
    view.tell(settings={"radar": {"pfa": float("nan"), "latency_ms": float("inf")}})
    view.session({"replay": {"position_s": float("nan")}})
    text = view.update(testing.START_NS, 0.0).public.decode("latin-1")
    assert "NaN" not in text
    assert "Infinity" not in text


def test_detections_are_counted_by_range_beside_what_their_odds_predict_and_once_if_merged() -> (
    None
):
    view = view_of_radar(range_max_m=2500.0)
    ranges_m, pd = (
        np.repeat([50.0, 150.0, 2499.0], 4),
        [0.9, 0.5, 0.9, 0.5, *[0.75] * 4, *[0.25] * 4],
    )
    view.settled(report(plots(0), seen=looks(ranges_m, pd, np.arange(12) % 4 != 0)), [])
    found = details(view)["detections"]
    assert found["width_m"] == 100.0
    columns = [found[name] for name in ("looks", "detected", "expected", "variance")]
    assert {len(column) for column in columns} == {RANGE_BINS}
    assert sum(found["looks"]) == 12
    for i, told in ((0, (4, 3, 2.8, 0.68)), (1, (4, 3, 3.0, 0.75)), (24, (4, 3, 1.0, 0.75))):
        assert tuple(column[i] for column in columns) == pytest.approx(told)
    for keys, kept in (({"link": {"latency_ms": 5.0}}, 12), ({"pfa": 1e-5}, 0)):
        view.settings(a_radar(range_max_m=2500.0, **keys), 0)
        assert sum(details(view)["detections"]["looks"]) == kept
    for merging, counted in (({"merging": {}}, 1), ({}, 2)):
        view = view_of_radar(**merging)
        view.settled(report(plots(0), seen=looks(500.0, [0.5, 0.5], [True, True])), [])
        assert sum(details(view)["detections"]["looks"]) == counted


def test_links_are_judged_since_their_settings_changed() -> None:
    view = view_of_radar()
    view.settings(a_radar(link={"latency_ms": 250.0}), 0)
    view.settled(report(plots(1)), [sent(number=i) for i in range(5)])
    view.settled(report(plots(1)), [lost(number=n) for n in (7, 6, 9)])
    view.settled(report(plots(1)), [sent(number=0, copy=1)])
    later_ns = SECTOR.end_ns + 250_000_000
    view.update(later_ns - 1, 0.0)
    assert details(view)["link"]["messages"] == 5  # what is lost has not been missed yet
    view.update(later_ns, 0.0)
    link = details(view)["link"]
    assert (link["messages"], link["lost"], link["duplicates"]) == (8, 3, 1)
    assert link["mean_burst"] == 1.5
    assert link["mean_ms"] == link["asked_mean_ms"] == pytest.approx(250.0)
    assert sum(link["delivered"]) == pytest.approx(1.0)
    view.settings(a_radar(), SECTOR.end_ns + 1)  # after these were handed over
    view.settled(report(plots(1)), [sent(number=9), lost(number=10), sent(number=9, copy=1)])
    view.update(later_ns, 0.0)
    link = details(view)["link"]
    assert (link["messages"], link["lost"], link["duplicates"]) == (0, 0, 0)
    view.settled(
        report(plots(1)),
        [sent(number=11, link_due_utc_ns=SECTOR.end_ns + 1, due_utc_ns=SECTOR.end_ns + 1)],
    )
    assert details(view)["link"]["messages"] == 1


def test_rates_are_of_whole_seconds_and_lateness_is_that_of_the_engine() -> None:
    view = view_of_radar()
    view.settled(report(plots(3)), [sent(link_due_utc_ns=SECTOR.end_ns + 249_900_000), lost()])
    assert "seconds" not in read_frame(view.update(SECTOR.end_ns, 0.5).public).news
    (second,) = read_frame(view.update(SECTOR.end_ns, 1.0).public).news["seconds"]
    assert second == {
        "t_utc_ms": SECTOR.end_ns / 1e6,
        "plots": [3],
        "messages": 1,
        "lost": 1,
        "late_p50_us": 100.0,
        "late_p99_us": 100.0,
    }
    assert "seconds" not in read_frame(view.update(SECTOR.end_ns, 1.9).public).news
    (quiet,) = read_frame(view.update(SECTOR.end_ns, 2.0).public).news["seconds"]
    assert (quiet["late_p50_us"], quiet["late_p99_us"]) == (None, None)  # nothing left


def test_after_a_change_of_latency_losses_count_beside_the_deliveries_of_their_time() -> None:
    """One message in four is lost, a tenth of a second apart; from the 20th on they take 2 s."""
    view, shares, tenth_ns = view_of_radar(), [], NS // 10
    dues_ns = [SECTOR.end_ns + i * tenth_ns for i in range(60)]
    told: dict[int, list[pb.Sent]] = {}
    for i, due_ns in enumerate(dues_ns):
        number, later = {"number": i, "due_utc_ns": due_ns}, 0 if i < 20 else 20
        if i % 4 == 0:
            told.setdefault(i, []).append(lost(**number))  # known at once
        else:
            told.setdefault(i + later, []).append(
                sent(**number, sent_utc_ns=due_ns + later * tenth_ns)
            )
    for i in range(80):
        if i == 20:
            view.settings(a_radar(link={"latency_ms": 2000.0}), dues_ns[20])
        view.settled(report(plots(1)), told.get(i, []))
        news = read_frame(view.update(SECTOR.end_ns + i * tenth_ns, (i + 1) / 10).public).news
        counts = [(s["lost"], s["messages"]) for s in news.get("seconds", [])]
        shares += [lost_ / (lost_ + came) for lost_, came in counts if lost_ + came]
    assert len(shares) >= 5
    assert max(shares) <= 0.4


TWO_DRONES = TruthState(
    drone=np.arange(2),
    t_utc_ns=np.full(2, testing.START_NS),
    position_ecef_m=testing.SITE.to_ecef(np.array([[100.0, 200.0, 50.0], [0.0, 1000.0, 60.0]])),
    velocity_ecef_m_s=np.zeros((2, 3)),
)


def test_a_drone_that_went_is_shown_where_it_was_for_a_while() -> None:
    view = view_of_radar()
    view.truth(testing.START_NS, TWO_DRONES, ["a", "b"])
    for after_s, drones, gone_ms in ((12, [0, 1], [12_000.0, 0.0]), (42, [1], [0.0])):
        now_ns = testing.START_NS + after_s * NS
        view.truth(now_ns, TWO_DRONES.rows(np.array([1])), ["a", "b"])
        frame = updated(view, now_ns)
        assert frame.column(SectionKind.DRONES, "drone").tolist() == drones
        assert frame.column(SectionKind.DRONES, "gone_ms").tolist() == gone_ms
        east_m = frame.column(SectionKind.DRONES, "east_m")
        np.testing.assert_allclose(east_m, [100.0, 0.0][-len(drones) :], atol=1e-4)


def true_news(update: Update) -> list[Any]:
    return [each.news for each in frames(update)[1].of(SectionKind.TRUE_NEWS)]


def test_the_class_of_what_is_no_drone_is_told_beside_the_names() -> None:
    view = view_of_radar()
    classes = np.array(["drone", "aircraft", 0, 0], np.object_)  # with room for more
    names = ["a", "b"]
    said = {"drones": ["a", "b"], "classes": {"1": "aircraft"}, "unseen": {}}
    for expected in ([said], []):
        view.truth(testing.START_NS, TWO_DRONES, names, classes)
        assert true_news(view.update(testing.START_NS, 0.0)) == expected
    view.truth(testing.START_NS, TWO_DRONES, names, np.array(["drone", "drone"], np.object_))
    assert true_news(view.update(testing.START_NS, 0.0)) == [{**said, "classes": {}}]
    view.unseen({"b": "far away"})
    told = view.update(testing.START_NS, 0.0)
    assert true_news(told) == [{**said, "classes": {}, "unseen": {"b": "far away"}}]
    assert b"far away" not in told.public


def test_the_score_is_told_to_who_sees_the_truth_alone() -> None:
    view = view_of_radar()
    view.score({"time_utc": "2026-01-01T12:00:01Z", "window": {"gospa_m": 12.5}})
    for update in (view.update(testing.START_NS, 0.2), view.snapshot(testing.START_NS)):
        assert b'"gospa_m":12.5' in update.truth
        assert b"gospa_m" not in update.public + (update.audience or b"")
    assert b'"score"' not in view.update(testing.START_NS, 0.3).truth  # said once


# Tracks of the tracker under test.

HERE = {"track": 7, "latitude_deg": 40.46, "longitude_deg": -3.72}


def told_in(payload: bytes) -> Any:
    return tracks_to_show(payload, None, testing.START_NS, testing.SITE)


def decoded(message: Any) -> list[ToldTrack]:
    found: list[ToldTrack] = told_in(json.dumps(message).encode())
    return found


def of_062(source: int = 1, **columns: Any) -> bytes:
    (block,) = TrackEncoder062(source, 2).blocks(tracks(**columns))
    return block


def shown(*payloads: bytes) -> Frame:
    """What the page is told of messages."""
    view = view_of_radar()
    for payload in payloads:
        view.tracks(told_in(payload))
    return updated(view)


def column(frame: Frame, name: str) -> list[Any]:
    return list(frame.column(SectionKind.TRACKS, name).tolist())


def test_tracks_of_category_062_are_where_and_when_they_say() -> None:
    block = of_062(
        track=np.array([3, 4]),
        t_utc_ns=np.array([testing.START_NS - 10**9, testing.START_NS]),
        latitude_deg=40.5,
        longitude_deg=-3.7,
        velocity_east_m_s=np.array([10.0, -20.0]),
        velocity_north_m_s=5.0,
        tentative=np.array([True, False]),
        coasted=np.array([False, True]),
        last=np.array([False, True]),
    )
    frame = shown(block)
    assert column(frame, "track") == [3, 4]
    assert column(frame, "t_utc_ms") == pytest.approx(
        [testing.START_NS / 1e6 - 1e3, testing.START_NS / 1e6], abs=10
    )
    assert column(frame, "velocity_east_m_s") == [10.0, -20.0]
    assert column(frame, "flags") == [TrackFlag.TENTATIVE, TrackFlag.COASTED | TrackFlag.ENDED]


def test_tracks_without_time_or_height_are_of_now_and_at_the_site() -> None:
    (here,) = decoded(HERE)
    assert (here.t_utc_ns, here.height_m) == (testing.START_NS, testing.SITE.height_m)
    told = HERE | {"time_utc": "2023-11-14T22:13:19.5Z", "height_m": 700}
    here, later = decoded([HERE, told])
    assert (later.t_utc_ns, later.height_m) == (testing.START_NS - 500_000_000, 700.0)
    assert decoded([]) == []


def test_a_track_has_a_number_whatever_its_name_and_source() -> None:
    frame = shown(of_062(1, track=5), of_062(3, track=5), of_062(1, track=5))
    first, second, third = column(frame, "track")
    assert first == third == 5
    assert frame.news["track_names"] == {str(second): "3.2.5"}
    for name in ("7", -1, 1 << 32, 10**400, "7" * 400, "\0\n", "T\u202e7"):
        frame = shown(json.dumps(HERE | {"track": name}).encode())
        assert len(column(frame, "track")) == 1, name
        assert all(len(name) <= 64 for name in frame.news.get("track_names", {}).values())


def test_what_is_no_place_is_refused_by_its_key() -> None:
    """And what is no track at all, of which tests/feeds/lab has more."""
    for key, wrong in (
        ("track", None),
        ("latitude_deg", 91),
        ("latitude_deg", -91),
        ("longitude_deg", None),
        ("velocity_east_m_s", float("inf")),
        ("velocity_north_m_s", 1e5),
        ("height_m", float("inf")),
        ("time_utc", "yesterday"),
    ):
        with pytest.raises(DecodeError, match=key):
            decoded({**HERE, key: wrong})


def test_tracks_are_placed_along_the_horizontal_of_the_site() -> None:
    enu_m = np.array([[3000.0, -4000.0, 120.0]])
    place = zip(
        ("latitude_deg", "longitude_deg", "height_m"), testing.SITE.to_geodetic(enu_m), strict=True
    )
    frame = shown(json.dumps({"track": 1, **{name: value[0] for name, value in place}}).encode())
    found_m = [*column(frame, "east_m"), *column(frame, "north_m")]
    np.testing.assert_allclose(found_m, enu_m[0, :2], atol=1e-3)


def test_a_track_is_shown_until_it_ends_or_is_silent_for_long() -> None:
    view = view_of_radar()
    view.tracks(decoded([HERE, {**HERE, "track": 8}]))
    assert column(updated(view), "track") == [7, 8]
    view.tracks(decoded({**HERE, "ended": True}))
    assert column(updated(view), "flags") == [TrackFlag.ENDED]
    assert column(read_frame(view.snapshot(testing.START_NS).public), "track") == [8]
    later_ns = testing.START_NS + 61 * NS
    view.update(later_ns, 0.0)
    assert not read_frame(view.snapshot(later_ns).public).of(SectionKind.TRACKS)


def test_no_flood_of_tracks_takes_more_than_its_room() -> None:
    kept = ShownTracks(testing.SITE)
    (here,) = decoded(HERE)
    for start in range(0, 5 * MAX_TRACKS, 5000):
        kept.take([replace(here, name=f"{n:064}") for n in range(start, start + 5000)])
        if start % 10_000 == 0:
            kept.news(testing.START_NS)
    assert len(kept.snapshot()) < 50 * MAX_TRACKS
    assert len(kept.names()) <= MAX_TRACKS
    kept.news(testing.START_NS + 61 * NS)
    assert not kept.names()
    assert not kept.snapshot()
