from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from support import made_up_session
from support.made_up_session import MadeUpSession
from support.page_updates import Frame, read_frame

from plotfeed import testing
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.page.shown import MAX_KEPT
from plotfeed.feeds.page.updates import PlotFlag, SectionKind, Update
from plotfeed.feeds.page.view import View
from plotfeed.feeds.scene.fields import frame_at
from plotfeed.models.beam import Sector
from plotfeed.models.frames import aer_to_enu
from plotfeed.models.state import Looks, Plots, TruthState
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.utc import NS

TRUE_KINDS = {
    SectionKind.PLOT_TRUTHS,
    SectionKind.LOST_PLOTS,
    SectionKind.DRONES,
    SectionKind.TRUE_NEWS,
}
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


def report(found: Plots, sensor: str = "radar", looks: Looks | None = None) -> Batch:
    return Batch.of_one(SECTOR, found, looks or Looks.none(), sensors=[sensor])


def sent(topic: str = "plotfeed/radar/plots", **changes: Any) -> pb.Sent:
    given: dict[str, Any] = {
        "topic": topic,
        "due_utc_ns": SECTOR.end_ns,
        "link_due_utc_ns": SECTOR.end_ns,
        "sent_utc_ns": SECTOR.end_ns + 250_000_000,
        "delivered": True,
    }
    return pb.Sent(**(given | changes))


def lost(**changes: Any) -> pb.Sent:
    return sent(delivered=False, sent_utc_ns=0, fate=pb.LOST, **changes)


def view_of_radar(**changes: Any) -> View:
    view = View()
    view.scene(testing.scene([testing.radar(**changes)], seed=1))
    view.update(testing.START_NS, 0.0)
    return view


def details(view: View, sensor: str) -> Any:
    view.watch([])
    view.watch([sensor])
    return read_frame(view.update(testing.START_NS, 0.0).public).news["details"][sensor]


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
    found = plots(50, range_m=np.linspace(100, 19_000, 50), elevation_deg=np.linspace(-5, 70, 50))
    view.settled(report(found, "far"), [sent("plotfeed/far/plots")])
    frame = read_frame(view.update(testing.START_NS, 0.0).public)
    measured = aer_to_enu(found.azimuth_deg, found.elevation_deg, found.range_m)
    there = frame_at(scene.scene.site, scene.sensor[1].position_enu_m)
    expected = testing.SITE.from_ecef(there.to_ecef(measured))
    for name, column in (("east_m", 0), ("north_m", 1)):
        np.testing.assert_allclose(
            frame.column(SectionKind.PLOTS, name), expected[:, column], atol=5e-3
        )
    np.testing.assert_array_equal(frame.column(SectionKind.PLOTS, "sensor"), 1)
    np.testing.assert_allclose(frame.column(SectionKind.PLOTS, "snr_db"), 20.0)
    np.testing.assert_allclose(frame.column(SectionKind.PLOTS, "latency_ms"), 1250.0)


def test_a_plot_without_range_is_a_bearing_and_one_without_azimuth_is_nowhere() -> None:
    view = view_of_radar()
    nothing = np.full(1, np.nan)
    view.settled(report(plots(1, range_m=nothing, elevation_deg=nothing)), [sent()])
    view.settled(report(plots(1, range_m=nothing, azimuth_deg=nothing)), [sent()])
    frame = read_frame(view.update(testing.START_NS, 0.0).public)
    assert frame.column(SectionKind.PLOTS, "flags").tolist() == [PlotFlag.BEARING, PlotFlag.NOWHERE]
    east_m, north_m = (frame.column(SectionKind.PLOTS, name) for name in ("east_m", "north_m"))
    assert np.hypot(east_m[0], north_m[0]) == pytest.approx(20_000.0)  # the edge of cover
    assert np.degrees(np.arctan2(east_m[0], north_m[0])) == pytest.approx(10.0)
    assert np.isnan([east_m[1], north_m[1]]).all()


def test_plots_are_delivered_by_the_first_message_that_brings_them() -> None:
    view = view_of_radar()
    late = sent("plotfeed/radar/asterix/048", sent_utc_ns=SECTOR.end_ns + NS)
    north_message = sent("plotfeed/radar/asterix/034", sent_utc_ns=SECTOR.end_ns)
    view.settled(report(plots(3)), [late, north_message, sent()])
    frame = read_frame(view.update(testing.START_NS, 0.0).public)
    np.testing.assert_allclose(frame.column(SectionKind.PLOTS, "latency_ms"), 1250.0)


def test_what_no_message_brought_is_seen_with_the_truth_alone() -> None:
    view = view_of_radar()
    view.settled(report(plots(3)), [lost(), sent("plotfeed/radar/asterix/034")])
    public, everything = frames(view.update(testing.START_NS, 0.0))
    assert not public.of(SectionKind.PLOTS)
    assert np.isnan(everything.column(SectionKind.LOST_PLOTS, "latency_ms")).all()
    assert len(everything.column(SectionKind.LOST_PLOTS, "east_m")) == 3


def test_merged_drones_are_counted_for_who_sees_the_truth() -> None:
    view = view_of_radar()
    others = np.empty(3, np.object_)
    others[:] = [(), (1,), (1, 2)]
    merged = plots(3, drone=np.zeros(3, np.int64), merged_drones=others)
    view.settled(report(merged), [sent()])
    _, everything = frames(view.update(testing.START_NS, 0.0))
    assert everything.column(SectionKind.PLOT_TRUTHS, "merged").tolist() == [0, 1, 2]


def test_a_snapshot_has_what_updates_had_and_forgets_what_has_faded() -> None:
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


def test_a_snapshot_is_bounded_whatever_is_reported() -> None:
    view = view_of_radar()
    for _ in range(60):
        view.settled(report(plots(1000)), [sent()])
        view.update(testing.START_NS, 0.0)
    kept = len(
        read_frame(view.snapshot(testing.START_NS).public).column(SectionKind.PLOTS, "sensor")
    )
    assert MAX_KEPT - 1000 <= kept <= MAX_KEPT


def test_another_scene_begins_with_a_snapshot_of_nothing() -> None:
    view = view_of_radar()
    view.settled(report(plots(4)), [sent()])
    view.update(testing.START_NS, 0.0)
    view.scene(testing.scene([testing.radar(id="other")], seed=1))
    update = view.update(testing.START_NS, 0.0)
    frame = read_frame(update.public)
    assert update.is_snapshot
    assert frame.is_snapshot
    assert not frame.of(SectionKind.PLOTS)
    assert [s["id"] for s in frame.news["scene"]["sensors"]] == ["other"]
    assert not view.update(testing.START_NS, 0.0).is_snapshot
    view.settled(report(plots(4), "radar"), [sent()])  # of the scene before: nobody's
    assert not read_frame(view.update(testing.START_NS, 0.0).public).of(SectionKind.PLOTS)


def test_news_are_told_once_and_again_in_every_snapshot() -> None:
    view = view_of_radar()
    view.tell(refusal="it was no telemetry")
    view.session({"clock": {"paused": True}})
    view.session({"clock": {"paused": True}, "record": {"on": False}})
    told = read_frame(view.update(testing.START_NS, 0.0).public).news
    assert told["refusal"] == "it was no telemetry"
    assert told["session"] == {"clock": {"paused": True}, "record": {"on": False}}
    view.session({"clock": {"paused": True}})
    assert read_frame(view.update(testing.START_NS, 0.0).public).news == {}
    again = read_frame(view.snapshot(testing.START_NS).public).news
    assert {"layouts", "scene", "settings", "session", "refusal"} <= again.keys()


def test_detections_are_counted_by_range_beside_what_was_predicted() -> None:
    view = view_of_radar(range_max_m=2500.0)
    range_m = np.repeat([50.0, 150.0, 2499.0], 4)
    looks = Looks(
        drone=np.zeros(12, np.int64),
        channel=np.zeros(12, np.int64),
        t_utc_ns=np.full(12, testing.START_NS),
        range_m=range_m,
        azimuth_deg=np.zeros(12),
        elevation_deg=np.zeros(12),
        snr=np.ones(12),
        pd=np.full(12, 0.75),
        detected=np.arange(12) % 4 != 0,
    )
    view.report(report(plots(0), looks=looks))
    found = details(view, "radar")["detections"]
    assert found["width_m"] == 100.0
    assert [i for i, n in enumerate(found["looks"]) if n] == [0, 1, 24]
    assert found["detected"][24] == found["expected"][24] == 3
    assert found["variance"][0] == 0.75
    view.settings("radar", {}, new_model=False)
    assert sum(details(view, "radar")["detections"]["looks"]) == 12
    view.settings("radar", {"pfa": 1e-5})
    assert sum(details(view, "radar")["detections"]["looks"]) == 0


def test_links_are_judged_since_their_settings_changed() -> None:
    view = view_of_radar()
    view.settings("radar", {"link": {"latency_ms": 250.0}}, asked_latency_ms=[240.0, 250.0, 260.0])
    view.settled(report(plots(1)), [sent(number=i) for i in range(5)])
    view.settled(report(plots(1)), [lost(number=n) for n in (7, 6, 9)])
    view.settled(report(plots(1)), [sent(number=0, copy=1)])
    later_ns = SECTOR.end_ns + 250_000_000
    view.update(later_ns - 1, 0.0)
    assert details(view, "radar")["link"]["messages"] == 5  # what is lost has not been missed yet
    view.update(later_ns, 0.0)
    link = details(view, "radar")["link"]
    assert (link["messages"], link["lost"], link["duplicates"]) == (8, 3, 1)
    assert link["mean_burst"] == 1.5
    assert link["mean_ms"] == pytest.approx(250.0)
    assert link["asked_mean_ms"] == pytest.approx(250.0)
    assert sum(link["delivered"]) == pytest.approx(1.0)
    view.settings("radar", {}, asked_latency_ms=[0.0])
    assert details(view, "radar")["link"]["messages"] == 0


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


def test_a_drone_that_went_is_shown_where_it_was_for_a_while() -> None:
    view = view_of_radar()
    here = testing.SITE.to_ecef(np.array([[100.0, 200.0, 50.0], [0.0, 1000.0, 60.0]]))
    both = TruthState(
        drone=np.arange(2),
        t_utc_ns=np.full(2, testing.START_NS),
        position_ecef_m=here,
        velocity_ecef_m_s=np.zeros((2, 3)),
    )
    view.truth(testing.START_NS, both, ["a", "b"])
    later_ns = testing.START_NS + 12 * NS
    view.truth(later_ns, both.rows(np.array([1])), ["a", "b"])
    _, frame = frames(view.update(later_ns, 0.0))
    assert frame.column(SectionKind.DRONES, "gone_ms").tolist() == [12_000.0, 0.0]
    np.testing.assert_allclose(frame.column(SectionKind.DRONES, "east_m"), [100.0, 0.0], atol=1e-4)
    view.truth(later_ns + 30 * NS, both.rows(np.array([1])), ["a", "b"])
    _, frame = frames(view.update(later_ns + 30 * NS, 0.0))
    assert frame.column(SectionKind.DRONES, "drone").tolist() == [1]


def true_news(update: Update) -> list[Any]:
    sections = frames(update)[1].sections
    return [each.news for each in sections if each.kind == SectionKind.TRUE_NEWS]


def test_the_class_of_what_is_no_drone_is_told_beside_the_names() -> None:
    view = view_of_radar()
    state = TruthState(
        drone=np.arange(2),
        t_utc_ns=np.full(2, testing.START_NS),
        position_ecef_m=testing.SITE.to_ecef(np.array([[100.0, 200.0, 50.0], [0.0, 1000.0, 60.0]])),
        velocity_ecef_m_s=np.zeros((2, 3)),
    )
    classes = np.array(["drone", "aircraft", 0, 0], np.object_)  # with room for more
    names = ["a", "b"]
    view.truth(testing.START_NS, state, names, classes)
    said = {"drones": ["a", "b"], "classes": {"1": "aircraft"}, "unseen": {}}
    assert said in true_news(view.update(testing.START_NS, 0.0))
    view.truth(testing.START_NS, state, names, classes)
    assert said not in true_news(view.update(testing.START_NS, 0.0))
    view.truth(testing.START_NS, state, names, np.array(["drone", "drone"], np.object_))
    assert {**said, "classes": {}} in true_news(view.update(testing.START_NS, 0.0))
    view.unseen({"b": "far away"})
    told = view.update(testing.START_NS, 0.0)
    assert {**said, "classes": {}, "unseen": {"b": "far away"}} in true_news(told)
    assert b"far away" not in told.public


def test_what_the_session_says_of_unknown_sensors_is_nothing() -> None:
    view = view_of_radar()
    view.report(report(plots(2), "nobody"))
    view.settled(report(plots(2), "nobody"), [sent()])
    view.settings("nobody", {})
    view.watch(["nobody"])
    assert read_frame(view.update(testing.START_NS, 0.0).public).news.get("details", {}) == {}


def test_nothing_is_told_that_is_no_json() -> None:
    view = view_of_radar()
    view.settings("radar", {"pfa": float("nan"), "link": {"latency_ms": float("inf")}})
    view.session({"replay": {"position_s": float("nan")}})
    text = view.update(testing.START_NS, 0.0).public.decode("latin-1")
    assert "NaN" not in text
    assert "Infinity" not in text


def test_the_site_may_be_anywhere() -> None:
    for latitude_deg, longitude_deg in ((90.0, 0.0), (-90.0, 10.0), (0.0, 180.0), (0.0, -180.0)):
        tree = {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg, "height_m": 0.0}
        general = {"name": "edge", "seed": 1, "site": tree}
        view = View()
        view.scene(testing.scene([testing.radar()], seed=1, scene=general))
        view.settled(report(plots(4)), [sent()])
        frame = read_frame(view.update(testing.START_NS, 0.0).public)
        assert np.isfinite(frame.column(SectionKind.PLOTS, "east_m")).all()


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
            view.settings("radar", {}, asked_latency_ms=[2000.0], since_utc_ns=dues_ns[20])
        view.settled(report(plots(1)), told.get(i, []))
        news = read_frame(view.update(SECTOR.end_ns + i * tenth_ns, (i + 1) / 10).public).news
        counts = [(s["lost"], s["messages"]) for s in news.get("seconds", [])]
        shares += [lost_ / (lost_ + came) for lost_, came in counts if lost_ + came]
    assert len(shares) >= 5
    assert max(shares) <= 0.4


def test_the_score_is_told_to_who_sees_the_truth_alone(stage: MadeUpSession) -> None:
    view = stage.view
    view.update(stage.now_ns, 0.0)
    assert b'"score"' not in view.update(stage.now_ns, 0.1).truth
    view.score({"time_utc": "2026-01-01T12:00:01Z", "window": {"gospa_m": 12.5}})
    for update in (view.update(stage.now_ns, 0.2), view.snapshot(stage.now_ns)):
        assert b'"gospa_m":12.5' in update.truth
        assert b"gospa_m" not in update.public + (update.audience or b"")
    assert b'"score"' not in view.update(stage.now_ns, 0.3).truth  # said once
