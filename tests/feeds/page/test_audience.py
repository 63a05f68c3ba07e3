"""What presenter and audience may do, tried by requests made by hand."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
from support.made_up_session import MadeUpSession
from support.page_server import (
    Served,
    on_stage,
    small_page,  # noqa: F401 - a fixture
    small_stage,  # noqa: F401 - a fixture
)
from support.page_updates import Frame, read_frame
from support.waiting import PATIENCE_S
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection

from plotfeed.feeds.engine.change_control import told
from plotfeed.feeds.page.page_access import (
    KEPT_ACTIONS,
    MAX_NAME,
    MAX_WORDS,
    Audience,
    PageAddress,
    Role,
    Tokens,
    name_in,
    words_of,
)
from plotfeed.feeds.page.updates import SectionKind
from plotfeed.proto.errors import PlotfeedError

TRUE_KINDS = {
    SectionKind.PLOT_TRUTHS,
    SectionKind.LOST_PLOTS,
    SectionKind.DRONES,
    SectionKind.TRUE_NEWS,
}
COMMANDS: tuple[dict[str, Any], ...] = (
    {"sensor": "radar", "set": {"pfa": 1e-4}},
    {"clock": {"paused": True}},
    {"session": {"restart": True}},
    {"record": {"start": True}},
    {"replay": {"load": "morning.mcap"}},
    {"story": "jamming"},
    {"undo": True},
)
AUDIENCE = "/audience/feed"


def frames(feed: ClientConnection) -> Iterator[Frame]:
    while True:
        data = feed.recv(PATIENCE_S)
        if isinstance(data, bytes):
            yield read_frame(data)


def said(feed: ClientConnection, message: dict[str, Any]) -> dict[str, Any]:
    feed.send(json.dumps(message))
    while isinstance(data := feed.recv(PATIENCE_S), bytes) or "build" in data:
        pass
    found: dict[str, Any] = json.loads(data)
    return found


def asked(feed: ClientConnection, **command: Any) -> dict[str, Any]:
    return said(feed, {"number": 1, "command": command})


def knows_the_truth(frame: Frame) -> bool:
    news = frame.news
    return (
        any(section.kind in TRUE_KINDS for section in frame.sections)
        or "drones" in news.get("totals", {})
        or any(of["detections"] for of in news.get("details", {}).values())
        or bool(news.get("refusal"))
        or bool(news.get("scene", {}).get("about", {}).get("look_for"))
    )


def test_the_audience_never_gets_the_truth_that_it_was_not_given(
    page: Served, stage: MadeUpSession
) -> None:
    page.call(lambda: page.server._view.tell(refusal="plotfeed/telemetry/secret: no telemetry"))
    with page.feed(path=AUDIENCE) as feed, page.feed() as presenter:
        refused = said(feed, {"look": {"truth": True, "watch": ["radar"]}})
        assert refused["ok"] is False
        assert "truth" in refused["error"]
        said(presenter, {"look": {"truth": True, "watch": ["radar"]}})
        assert any(frame.of(SectionKind.DRONES) for frame in frames(presenter))
        seen = []
        for frame in frames(feed):
            seen.append(frame)
            if len(seen) > 10 and any("details" in f.news for f in seen):
                break
        assert not [frame.number for frame in seen if knows_the_truth(frame)]
        assert any(frame.of(SectionKind.PLOTS) for frame in seen)


def test_the_presenter_gives_the_truth_and_takes_it_back(page: Served) -> None:
    with page.feed(path=AUDIENCE) as feed, page.feed() as presenter:
        given = asked(presenter, audience={"truth": True})
        assert given["in_force"] == {
            "truth": True,
            "controls": False,
            "url": page.server.audience_url,
        }
        assert any(frame.news.get("audience", {}).get("truth") for frame in frames(feed))
        assert said(feed, {"look": {"truth": True, "watch": []}}) == {"looking": True}
        assert any(frame.of(SectionKind.DRONES) for frame in frames(feed))
        asked(presenter, audience={"truth": False})
        assert any(
            frame.news.get("audience") == {"truth": False, "controls": False}
            for frame in frames(feed)
        )
        later = [frame for frame, _ in zip(frames(feed), range(8), strict=False)]
        assert not [frame.number for frame in later if knows_the_truth(frame)]


def test_the_audience_has_no_controls_unless_they_are_given(
    page: Served, stage: MadeUpSession
) -> None:
    with page.feed(path=AUDIENCE) as feed, page.feed() as presenter:
        for command in COMMANDS:
            refused = asked(feed, **command)
            assert refused == {
                "number": 1,
                "ok": False,
                "error": "the audience has no controls unless the presenter gives them",
            }
            assert not stage.commands
            assert asked(presenter, audience={"controls": True})["ok"]
            assert asked(feed, **command)["ok"]
            assert stage.commands == [command]
            asked(presenter, audience={"controls": False})
            assert not asked(feed, **command)["ok"]
            assert len(stage.commands) == 1
            stage.commands.clear()


def test_only_the_presenter_gives(page: Served) -> None:
    with page.feed(path=AUDIENCE) as feed, page.feed() as presenter:
        for given in (False, True):
            asked(presenter, audience={"controls": given})
            assert "only the presenter" in asked(feed, audience={"truth": True})["error"]
            assert said(feed, {"look": {"truth": True, "watch": []}})["ok"] is False


def test_what_is_no_gift_is_refused_in_a_line(page: Served) -> None:
    with page.feed() as presenter:
        for wrong in (None, 5, {}, {"truth": 1}, {"all": True}, {"truth": None}):
            assert asked(presenter, audience=wrong)["error"].startswith("audience: expected")


def test_everybody_sees_who_did_what_but_not_what_was_refused(page: Served) -> None:
    with page.feed() as presenter, page.feed(path=AUDIENCE) as feed:
        said(presenter, {"look": {"watch": [], "name": "Ana\n\x1b[31m"}})
        asked(presenter, sensor="radar", set={"link": {"latency_ms": 250}})
        asked(presenter, sensor="nobody", set={})
        asked(feed, clock={"paused": True})
        asked(presenter, audience={"controls": True})
        asked(feed, clock={"paused": True})
        actions = next(a for f in frames(feed) if len(a := f.news.get("actions", [])) >= 3)
        told = [(action["who"], action["what"]) for action in actions]
        assert told == [
            ("Ana [31m (presenter 1)", "radar: link latency_ms 250"),
            ("Ana [31m (presenter 1)", "audience: controls"),
            ("audience 1", "clock: paused"),
        ]


def test_each_address_has_its_own_token(stage: MadeUpSession) -> None:
    wide, tokens = PageAddress("0.0.0.0", 0), Tokens("p" * 16, "a" * 16)  # noqa: S104
    with on_stage(stage, address=wide, tokens=tokens) as page:
        assert page.server.audience_url.endswith("/audience/?token=aaaaaaaaaaaaaaaa")
        assert set(page.server.urls) == {"page", "audience"}
        for asked_for in ("/?token=", "/audience/?token=", "/audience?token="):
            status, headers, _ = page.get(asked_for + "a" * 16)
            assert (status, headers["location"]) == (303, "/audience/")
        cookie = headers["set-cookie"].partition(";")[0]
        assert page.get("/audience/", Cookie=cookie)[0] == 200
        assert page.get("/page.js", Cookie=cookie)[0] == 200
        assert page.get("/", Cookie=cookie)[0] == 403
        with pytest.raises(InvalidStatus):
            page.feed(additional_headers={"Cookie": cookie})
        with page.feed(path=AUDIENCE, additional_headers={"Cookie": cookie}) as feed:
            hello = json.loads(feed.recv(PATIENCE_S))
            assert hello.keys() == {"build"}
            assert "only the presenter" in asked(feed, audience={"truth": True})["error"]
        _, headers, _ = page.get("/?token=" + "p" * 16)
        presenter = headers["set-cookie"].partition(";")[0]
        for path in ("/", "/audience/"):
            assert page.get(path, Cookie=presenter)[0] == 200


def test_the_log_is_short_and_names_and_deeds_are_plain_words() -> None:
    audience = Audience()
    for number in range(KEPT_ACTIONS + 5):
        audience.log(number * 1_000_000, "presenter 1", {"clock": {"speed": number}})
    assert len(audience.actions) == KEPT_ACTIONS
    assert audience.actions[-1] == {
        "t_utc_ms": KEPT_ACTIONS + 4,
        "who": "presenter 1",
        "what": f"clock: speed {KEPT_ACTIONS + 4}",
    }
    assert [audience.called(Role.AUDIENCE) for _ in range(2)] == ["audience 1", "audience 2"]
    assert len(name_in("x" * 100)) == MAX_NAME
    with pytest.raises(PlotfeedError, match="name in words"):
        name_in(5)
    assert words_of({"sensor": "radar", "reset": True}) == "radar: reset"
    loss = {"link": {"loss": {"kind": "random", "probability": 0.02}, "latency_ms": 5}}
    assert words_of({"sensor": "radar", "set": loss}) == (
        "radar: link loss kind random, link loss probability 0.02, link latency_ms 5"
    )
    ten_times = {"sensor": "tower", "set": {"pfa": 1.9999999999999998e-5}}
    assert words_of(ten_times) == "tower: pfa 2e-05"
    assert told({"pfa": 1.9999999999999998e-5, "link": {"latency_ms": 250}}) == (
        "pfa 2e-05, link.latency_ms 250"
    )
    assert words_of({"session": {"scene": "coast"}}) == "session: scene coast"
    assert words_of({"story": "jamming", "reset": True}) == "story jamming, reset"
    assert words_of({"undo": True}) == "undo"
    assert len(words_of({"sensor": "x" * 1000, "set": {}})) <= MAX_WORDS
