"""What the page's server gives and takes, tried by requests made by hand."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import Any

import pytest
from support import made_up_session
from support.brokers import free_port
from support.made_up_session import MadeUpSession
from support.page_server import Served, on_stage, served
from support.page_updates import TRUE_KINDS, Frame, read_frame
from support.waiting import PATIENCE_S, wait_until
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection

from plotfeed import testing
from plotfeed.feeds.page import application
from plotfeed.feeds.page.page_access import PageAddress, PageError, Tokens
from plotfeed.feeds.page.updates import MAX_COMMAND_OCTETS, NoControls, SectionKind
from plotfeed.feeds.page.view import View

AUDIENCE = "/audience/feed"
WIDE = PageAddress("0.0.0.0", 0)  # noqa: S104 - with tokens


@pytest.fixture
def stage() -> MadeUpSession:
    """On which nothing has happened yet."""
    return MadeUpSession(View(), made_up_session.scene(8))


@pytest.fixture
def page(stage: MadeUpSession) -> Iterator[Served]:
    """That stage, served to nobody's browser."""
    with on_stage(stage) as page:
        yield page


def frames(feed: ClientConnection) -> Iterator[Frame]:
    while True:
        if isinstance(data := feed.recv(PATIENCE_S), bytes):
            yield read_frame(data)


def next_frame(feed: ClientConnection) -> Frame:
    return next(frames(feed))


def answer(feed: ClientConnection, message: object) -> dict[str, Any]:
    """To octets or text as they are, or to anything else as JSON."""
    feed.send(message if isinstance(message, str | bytes) else json.dumps(message))
    while isinstance(data := feed.recv(PATIENCE_S), bytes) or "build" in data:
        pass
    found: dict[str, Any] = json.loads(data)
    return found


def look(feed: ClientConnection, *, truth: bool = False, **more: Any) -> dict[str, Any]:
    return answer(feed, {"look": {"truth": truth, "watch": [], **more}})


def asked(feed: ClientConnection, **command: Any) -> dict[str, Any]:
    return answer(feed, {"number": 1, "command": command})


def status_of(page: Served, **more: Any) -> int:
    with pytest.raises(InvalidStatus) as refused:
        page.feed(**more)
    return refused.value.response.status_code


def test_every_file_is_served_by_its_kind_and_policy_and_nothing_else_is(page: Served) -> None:
    kinds = {"/": "text/html", "/page.css": "text/css", "/page.js": "text/javascript"}
    for path, kind in (kinds | {"/icon.svg": "image/svg+xml"}).items():
        status, headers, body = page.get(path)
        assert (status, headers["content-type"].partition(";")[0]) == (200, kind)
        assert body
    for path in ("/none", "/basemap", "/../server.py", "/%2e%2e/server.py", "/static/page.js"):
        assert page.get(path)[0] == 404
    for path in ("/", "/page.js", "/none"):
        _, headers, _ = page.get(path)
        rules = dict(r.strip().split(" ", 1) for r in headers["content-security-policy"].split(";"))
        ours = {"'self'", "'none'", f"ws://127.0.0.1:{page.port}"}
        assert rules.pop("default-src") == "'none'"
        assert {source for sources in rules.values() for source in sources.split()} <= ours
        assert rules["frame-ancestors"] == rules["base-uri"] == rules["form-action"] == "'none'"
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert "server" not in headers


def test_no_foreign_name_and_no_script_of_another_site_reaches_the_page(page: Served) -> None:
    for host in (f"evil.example:{page.port}", "127.0.0.1.evil.example", ""):
        status, headers, body = page.get("/", Host=host)
        assert status == 421
        assert b"<html" not in body
        assert "content-security-policy" in headers
    assert page.get("/", Host="localhost")[0] == 200
    assert status_of(page, additional_headers={"Host": "evil.example"}) in (403, 400)
    for origin in ("http://evil.example", f"http://127.0.0.1:{page.port + 1}", "null"):
        assert status_of(page, origin=origin) == 403


def test_bound_wider_each_address_needs_its_own_token(stage: MadeUpSession) -> None:
    presenter, audience = "p" * 16, "a" * 16
    with on_stage(stage, address=WIDE, tokens=Tokens(presenter, audience)) as page:
        assert page.url.endswith(f"/?token={presenter}")
        assert page.server.audience_url.endswith(f"/audience/?token={audience}")
        assert set(page.server.urls) == {"page", "audience"}
        for path in ("/", "/page.js", "/basemap", "/?token=wrong"):
            status, _, body = page.get(path)
            assert status == 403
            assert b"token" in body
        assert status_of(page) == 403

        def kept(path: str, leads_to: str) -> dict[str, str]:
            """The cookie by which an address with its token leads to that page, as a header."""
            status, headers, _ = page.get(path)
            assert (status, headers["location"]) == (303, leads_to)
            cookie, *rules = headers["set-cookie"].split("; ")
            assert {"HttpOnly", "SameSite=lax"} <= set(rules)
            return {"Cookie": cookie}

        cookie = kept(f"/?token={presenter}", "/")
        assert [page.get(path, **cookie)[0] for path in ("/", "/audience/")] == [200, 200]
        assert page.get("/", Host="evil.example", **cookie)[0] == 421
        with page.feed(additional_headers=cookie) as feed:
            assert next_frame(feed).is_snapshot
        for path in ("/?token=", "/audience/?token=", "/audience?token="):
            cookie = kept(path + audience, "/audience/")
        found = [page.get(path, **cookie)[0] for path in ("/audience/", "/page.js", "/")]
        assert found == [200, 200, 403]
        assert status_of(page, additional_headers=cookie) == 403
        with page.feed(path=AUDIENCE, additional_headers=cookie) as feed:
            assert json.loads(feed.recv(PATIENCE_S)).keys() == {"build"}
            assert "only the presenter" in asked(feed, audience={"truth": True})["error"]


def test_a_viewer_gets_a_snapshot_and_then_updates_with_details_of_what_anybody_watches(
    page: Served,
) -> None:
    with page.feed() as one, page.feed() as other:
        assert json.loads(one.recv(PATIENCE_S))["build"]
        first = next_frame(one)
        assert first.is_snapshot
        assert first.news["scene"]["name"] == "road"
        numbers = [next_frame(one).number for _ in range(5)]
        assert numbers == list(range(numbers[0], numbers[0] + 5))
        look(one, watch=["radar"])
        look(other, watch=["gate", "nobody"])
        assert any(f.news.get("details", {}).keys() == {"radar", "gate"} for f in frames(one))
        other.close()
        assert any(f.news.get("details", {}).keys() == {"radar"} for f in frames(one))
        scene = testing.scene([testing.radar(id="new")], seed=1)
        page.view.scene(scene)
        frame = next(f for f in frames(one) if "scene" in f.news)
        assert frame.is_snapshot
        assert [sensor["id"] for sensor in frame.news["scene"]["sensors"]] == ["new"]


def knows_the_truth(frame: Frame) -> bool:
    news = frame.news
    return (
        any(section.kind in TRUE_KINDS for section in frame.sections)
        or "drones" in news.get("totals", {})
        or any(of["detections"] for of in news.get("details", {}).values())
        or bool(news.get("refusal"))
        or bool(news.get("scene", {}).get("about", {}).get("look_for"))
    )


def test_the_truth_is_sent_to_the_presenter_who_asks_and_to_an_audience_that_is_given_it(
    page: Served,
) -> None:
    page.view.tell(refusal="plotfeed/telemetry/secret: no telemetry")
    with page.feed(path=AUDIENCE) as feed, page.feed() as presenter, page.feed() as plain:
        refused = look(feed, truth=True, watch=["radar"])
        assert refused["ok"] is False
        assert "truth" in refused["error"]
        assert answer(feed, {"look": {"watch": []}}) == {"looking": True}
        assert look(presenter, truth=True, watch=["radar"]) == {"looking": True}
        assert any(frame.of(SectionKind.DRONES) for frame in frames(presenter))
        seen = []
        for frame in frames(feed):
            seen.append(frame)
            if len(seen) > 10 and any("details" in f.news for f in seen):
                break
        assert not [frame.number for frame in seen if knows_the_truth(frame)]
        assert any(frame.of(SectionKind.PLOTS) for frame in seen)
        for frame, _ in zip(frames(plain), range(5), strict=False):
            assert not TRUE_KINDS & {section.kind for section in frame.sections}
        given = asked(presenter, audience={"truth": True})["in_force"]
        assert given == {"truth": True, "controls": False, "url": page.server.audience_url}
        assert any(frame.news.get("audience", {}).get("truth") for frame in frames(feed))
        assert look(feed, truth=True) == {"looking": True}
        assert any(frame.of(SectionKind.DRONES) for frame in frames(feed))
        asked(presenter, audience={"truth": False})
        taken = {"truth": False, "controls": False}
        assert any(frame.news.get("audience") == taken for frame in frames(feed))
        later = [frame for frame, _ in zip(frames(feed), range(8), strict=False)]
        assert not [frame.number for frame in later if knows_the_truth(frame)]
        look(presenter)
        assert any(frame.is_snapshot for frame in frames(presenter))
        assert not any(next_frame(presenter).of(SectionKind.DRONES) for _ in range(5))


COMMANDS: tuple[dict[str, Any], ...] = (
    {"sensor": "radar", "set": {"pfa": 1e-4}},
    {"clock": {"paused": True}},
    {"session": {"restart": True}},
    {"record": {"start": True}},
    {"replay": {"load": "morning.mcap"}},
    {"story": "jamming"},
    {"undo": True},
)


def test_the_audience_has_no_controls_unless_the_presenter_gives_them(
    page: Served, stage: MadeUpSession
) -> None:
    no_controls = "the audience has no controls unless the presenter gives them"
    with page.feed(path=AUDIENCE) as feed, page.feed() as presenter:
        for command in COMMANDS:
            assert asked(feed, **command) == {"number": 1, "ok": False, "error": no_controls}
        assert not stage.commands
        assert asked(presenter, audience={"controls": True})["ok"]
        for command in COMMANDS:
            assert asked(feed, **command)["ok"]
        assert stage.commands == [*COMMANDS]
        for given in (True, False):
            asked(presenter, audience={"controls": given})
            assert "only the presenter" in asked(feed, audience={"truth": True})["error"]
            assert look(feed, truth=True)["ok"] is False
        assert not any(asked(feed, **command)["ok"] for command in COMMANDS)
        assert len(stage.commands) == len(COMMANDS)
        for wrong in (None, 5, {}, {"truth": 1}, {"all": True}, {"truth": None}):
            assert asked(presenter, audience=wrong)["error"].startswith("audience: expected")


def test_commands_are_carried_out_answered_and_seen_by_all_with_who_gave_them(
    page: Served, stage: MadeUpSession
) -> None:
    with page.feed() as presenter, page.feed(path=AUDIENCE) as feed:
        look(presenter, name="Ana\n\x1b[31m")
        command = {"sensor": "radar", "set": {"pfa": 1e-4}}
        said = answer(presenter, {"number": 5, "command": command})
        assert (said["number"], said["ok"], said["in_force"]["pfa"]) == (5, True, 1e-4)
        told = (frame.news.get("settings", {}).get("radar", {}) for frame in frames(feed))
        assert any(settings.get("pfa") == 1e-4 for settings in told)
        assert stage.commands == [command]
        said = answer(presenter, {"number": 9, "command": {"sensor": "nobody", "set": {}}})
        assert (said["number"], said["ok"]) == (9, False)
        assert said["error"].startswith("sensor: there is no 'nobody'; expected one of radar, ")
        asked(feed, clock={"paused": True})  # refused, and not told of
        asked(presenter, audience={"controls": True})
        asked(feed, clock={"paused": True})
        actions = next(a for f in frames(feed) if len(a := f.news.get("actions", [])) >= 3)
        assert [(action["who"], action["what"]) for action in actions] == [
            ("Ana [31m (presenter 1)", "radar: pfa 0.0001"),
            ("Ana [31m (presenter 1)", "audience: controls"),
            ("audience 1", "clock: paused"),
        ]


NO_WISHES: tuple[str | bytes, ...] = (
    *("", "nonsense", "5", "null", "[]", "[" * 50_000, b"\x00\x01"),
    *('{"number": 1}', '{"command": {"sensor": "radar"}}', '{"number": 1, "command": {}}'),
    '{"number": 1, "command": {"sensor": "a", "clock": {}}}',
    *('{"look": 5}', '{"look": {"watch": "radar"}}', '{"look": {"watch": [5]}}'),
    '{"look": {"watch": [], "name": 5}}',
)


def test_what_is_no_wish_is_refused_in_a_line_and_who_says_too_much_is_cut_off(
    page: Served, stage: MadeUpSession
) -> None:
    with page.feed() as other, page.feed() as feed:
        for message in NO_WISHES:
            said = answer(feed, message)
            assert said["ok"] is False, message
            assert said["error"]
            assert "\n" not in said["error"]
            next_frame(feed)
        assert not stage.commands
        feed.send("x" * (MAX_COMMAND_OCTETS + 1))
        with pytest.raises(ConnectionClosed):
            list(frames(feed))
        assert next_frame(other)


def test_a_viewer_that_stalls_is_dropped_and_holds_up_nobody(
    page: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(application, "STALLED_S", 2.0)
    narrow = socket.socket()
    narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    narrow.connect(("127.0.0.1", page.port))

    def crowd() -> None:
        """Make every viewer's next frames long."""
        for viewer in page.server.viewers:
            viewer.start_again()
        page.server._view.session({"recordings": ["x" * (1 << 22)]})

    with page.feed(sock=narrow, max_queue=1, close_timeout=0), page.feed() as feed:
        wait_until(lambda: len(page.server.viewers) == 2)
        page.call(crowd)
        wait_until(lambda: next_frame(feed) and len(page.server.viewers) == 1)
        assert next_frame(feed)


def test_viewers_are_as_many_as_there_is_room_for(
    page: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(application, "MAX_VIEWERS", 2)
    with page.feed(path=AUDIENCE) as one, page.feed(path=AUDIENCE) as other:
        assert next_frame(one)
        assert next_frame(other)
        assert status_of(page, path=AUDIENCE) == 403
        with page.feed() as presenter:  # whose places are others
            assert next_frame(presenter)
    wait_until(lambda: not page.server.viewers)
    with page.feed() as feed:
        assert next_frame(feed).is_snapshot


def test_a_port_in_use_and_a_host_that_is_not_ours_are_one_clear_line_each() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken = other.getsockname()[1]
        for address, why in (
            (PageAddress("127.0.0.1", taken), f"127.0.0.1:{taken}: Address already in use"),
            (PageAddress("192.0.2.1", free_port()), r"192\.0\.2\.1:\d+: "),
        ):
            page = served(View(), NoControls(), lambda: 0, address=address)
            with pytest.raises(PageError, match=f"--page {why}"), page:
                pass


def test_the_end_of_a_session_ends_the_page_at_once_with_viewers_and_all(
    stage: MadeUpSession,
) -> None:
    def follow(feed: ClientConnection) -> None:
        with pytest.raises(ConnectionClosed, match="service restart"):  # said, not cut off
            list(frames(feed))

    with ThreadPoolExecutor(1) as watching, ExitStack() as outlasts:
        with on_stage(stage) as page:
            feed = outlasts.enter_context(page.feed())
            next_frame(feed)
            follows = watching.submit(follow, feed)
        follows.result()
    with socket.socket() as again:
        again.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        again.bind(("127.0.0.1", page.port))
