from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from typing import Any

import pytest
from support.brokers import free_port
from support.made_up_session import MadeUpSession
from support.page_server import (
    Served,
    on_stage,
    served,
    small_page,  # noqa: F401 - a fixture
    small_stage,  # noqa: F401 - a fixture
)
from support.page_updates import Frame, read_frame
from support.waiting import PATIENCE_S, wait_until
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection

from plotfeed import testing
from plotfeed.feeds.page import application
from plotfeed.feeds.page.page_access import PageAddress, PageError, Tokens
from plotfeed.feeds.page.updates import MAX_COMMAND_OCTETS, NoControls, SectionKind
from plotfeed.feeds.page.view import View


def next_frame(feed: ClientConnection) -> Frame:
    while not isinstance(data := feed.recv(PATIENCE_S), bytes):
        pass
    return read_frame(data)


def frames(feed: ClientConnection) -> Iterator[Frame]:
    while True:
        yield next_frame(feed)


def answer(feed: ClientConnection, message: str) -> dict[str, Any]:
    feed.send(message)
    while isinstance(data := feed.recv(PATIENCE_S), bytes) or "build" in data:
        pass
    found: dict[str, Any] = json.loads(data)
    return found


def status_of(page: Served, **more: Any) -> int:
    with pytest.raises(InvalidStatus) as refused:
        page.feed(**more)
    return refused.value.response.status_code


def test_every_file_is_served_by_its_kind_and_nothing_else_is(page: Served) -> None:
    kinds = {"/": "text/html", "/page.css": "text/css", "/page.js": "text/javascript"}
    for path, kind in (kinds | {"/icon.svg": "image/svg+xml"}).items():
        status, headers, body = page.get(path)
        assert (status, headers["content-type"].partition(";")[0]) == (200, kind)
        assert body
    for path in ("/none", "/basemap", "/../server.py", "/%2e%2e/server.py", "/static/page.js"):
        assert page.get(path)[0] == 404


def test_the_policy_allows_the_page_itself_and_nobody_else(page: Served) -> None:
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


def test_no_foreign_name_reaches_the_page(page: Served) -> None:
    for host in (f"evil.example:{page.port}", "127.0.0.1.evil.example", ""):
        status, headers, body = page.get("/", Host=host)
        assert status == 421
        assert b"<html" not in body
        assert "content-security-policy" in headers
    assert page.get("/", Host="localhost")[0] == 200
    assert status_of(page, additional_headers={"Host": "evil.example"}) in (403, 400)


def test_no_script_of_another_site_reaches_the_feed(page: Served) -> None:
    for origin in ("http://evil.example", f"http://127.0.0.1:{page.port + 1}", "null"):
        assert status_of(page, origin=origin) == 403


def test_bound_wider_everything_needs_the_token(stage: MadeUpSession) -> None:
    wide = PageAddress("0.0.0.0", 0)  # noqa: S104 - with a token
    with on_stage(stage, address=wide, tokens=Tokens("secret-token")) as page:
        assert page.url.endswith("/?token=secret-token")
        for path in ("/", "/page.js", "/basemap", "/?token=wrong"):
            status, _, body = page.get(path)
            assert status == 403
            assert b"token" in body
        assert status_of(page) == 403
        status, headers, _ = page.get("/?token=secret-token")
        assert (status, headers["location"]) == (303, "/")
        cookie, *rules = headers["set-cookie"].split("; ")
        assert {"HttpOnly", "SameSite=lax"} <= set(rules)
        assert page.get("/", Cookie=cookie)[0] == 200
        assert page.get("/", Cookie=cookie, Host="evil.example")[0] == 421
        with page.feed(additional_headers={"Cookie": cookie}) as feed:
            assert next_frame(feed).is_snapshot


def test_a_viewer_gets_a_snapshot_and_then_ten_updates_a_second(page: Served) -> None:
    with page.feed() as feed:
        build = json.loads(feed.recv(PATIENCE_S))
        assert build["build"]
        first = next_frame(feed)
        assert first.is_snapshot
        assert first.news["scene"]["name"] == "road"
        numbers = [next_frame(feed).number for _ in range(5)]
        assert numbers == list(range(numbers[0], numbers[0] + 5))


def test_the_truth_is_sent_only_to_who_asks_for_it(page: Served) -> None:
    with page.feed() as plain, page.feed() as curious:
        assert answer(curious, '{"look": {"truth": true, "watch": ["radar"]}}') == {"looking": True}
        assert any(frame.of(SectionKind.DRONES) for frame in frames(curious))
        for _ in range(5):
            kinds = {section.kind for section in next_frame(plain).sections}
            assert not kinds & {
                SectionKind.DRONES,
                SectionKind.PLOT_TRUTHS,
                SectionKind.LOST_PLOTS,
                SectionKind.TRUE_NEWS,
            }
        answer(curious, '{"look": {"truth": false}}')
        assert any(frame.is_snapshot for frame in frames(curious))
        assert not any(next_frame(curious).of(SectionKind.DRONES) for _ in range(5))


def test_details_are_told_of_what_anybody_watches(page: Served) -> None:
    with page.feed() as one, page.feed() as other:
        answer(one, '{"look": {"watch": ["radar"]}}')
        answer(other, '{"look": {"watch": ["gate", "nobody"]}}')
        assert any(f.news.get("details", {}).keys() == {"radar", "gate"} for f in frames(one))
        other.close()
        assert any(f.news.get("details", {}).keys() == {"radar"} for f in frames(one))


def test_commands_are_carried_out_answered_and_seen_by_all(
    page: Served, stage: MadeUpSession
) -> None:
    command = {"sensor": "radar", "set": {"pfa": 1e-4}}
    with page.feed() as one, page.feed() as other:
        next_frame(other)
        said = answer(one, json.dumps({"number": 5, "command": command}))
        assert (said["number"], said["ok"], said["in_force"]["pfa"]) == (5, True, 1e-4)
        told = (frame.news.get("settings", {}).get("radar", {}) for frame in frames(other))
        assert any(settings.get("pfa") == 1e-4 for settings in told)
    assert stage.commands == [command]


NO_WISHES: tuple[str | bytes, ...] = (
    "",
    "nonsense",
    "5",
    "null",
    "[]",
    '{"number": 1}',
    '{"command": {"sensor": "radar"}}',
    '{"number": 1, "command": {}}',
    '{"number": 1, "command": {"sensor": "a", "clock": {}}}',
    '{"look": 5}',
    '{"look": {"watch": "radar"}}',
    '{"look": {"watch": [5]}}',
    "[" * 50_000,
    b"\x00\x01",
)


def test_what_is_no_wish_is_refused_in_a_line(page: Served, stage: MadeUpSession) -> None:
    with page.feed() as feed:
        for message in NO_WISHES:
            said = answer(feed, message)
            assert said["ok"] is False, message
            assert said["error"]
            assert "\n" not in said["error"]
            next_frame(feed)
    assert not stage.commands


def test_what_the_session_refuses_is_told_to_who_asked(page: Served) -> None:
    with page.feed() as feed:
        wish = {"number": 9, "command": {"sensor": "nobody", "set": {}}}
        said = answer(feed, json.dumps(wish))
        assert (said["number"], said["ok"]) == (9, False)
        assert said["error"].startswith("sensor: there is no 'nobody'; expected one of radar, ")


def test_a_page_without_controls_says_so(stage: MadeUpSession) -> None:
    assert stage.view is not None
    with served(stage.view, NoControls(), lambda: stage.now_ns) as page, page.feed() as feed:
        wish = {"number": 1, "command": {"session": {"restart": True}}}
        assert "no commands" in answer(feed, json.dumps(wish))["error"]


def test_who_says_too_much_is_cut_off_and_others_are_not(page: Served) -> None:
    with page.feed() as other, page.feed() as feed:
        feed.send("x" * (MAX_COMMAND_OCTETS + 1))
        with pytest.raises(ConnectionClosed):
            list(frames(feed))
        assert next_frame(other)


def test_a_viewer_that_stalls_is_dropped_and_holds_up_nobody(
    page: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(application, "STALLED_S", 2.0)
    stalled = socket.socket()
    stalled.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    stalled.settimeout(PATIENCE_S)
    stalled.connect(("127.0.0.1", page.port))
    host = f"127.0.0.1:{page.port}"
    stalled.sendall(
        f"GET /feed HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
    )
    with page.feed() as feed:
        wait_until(lambda: len(page.server.viewers) == 2)
        crowd(page)
        while len(page.server.viewers) > 1:
            assert next_frame(feed)
        assert next_frame(feed)
    stalled.close()


def crowd(page: Served) -> None:
    """Make every viewer's next frames long."""
    text = "x" * (1 << 22)

    def tell() -> None:
        for viewer in page.server.viewers:
            viewer.start_again()
        page.server._view.session({"recordings": [text]})

    page.call(tell)


def test_viewers_are_as_many_as_there_is_room_for(
    page: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(application, "MAX_VIEWERS", 2)
    audience = {"path": "/audience/feed"}
    with page.feed(**audience) as one, page.feed(**audience) as other:
        assert next_frame(one)
        assert next_frame(other)
        assert status_of(page, **audience) == 403
        with page.feed() as presenter:  # whose places are others
            assert next_frame(presenter)
    wait_until(lambda: not page.server.viewers)
    with page.feed() as feed:
        assert next_frame(feed).is_snapshot


def test_a_port_in_use_is_one_clear_line() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with (
            pytest.raises(PageError, match=f"--page 127.0.0.1:{port}: Address already in use"),
            served(View(), NoControls(), lambda: 0, address=PageAddress("127.0.0.1", port)),
        ):
            pass


def test_a_host_that_is_not_ours_is_one_clear_line() -> None:
    with (
        pytest.raises(PageError, match=r"--page 192\.0\.2\.1:\d+: "),
        served(View(), NoControls(), lambda: 0, address=PageAddress("192.0.2.1", free_port())),
    ):
        pass


def test_the_end_of_a_session_ends_the_page_at_once_with_viewers_and_all(
    stage: MadeUpSession,
) -> None:
    looking, closed = threading.Event(), threading.Event()

    def follow(page: Served) -> None:
        with page.feed() as feed:
            next_frame(feed)
            looking.set()
            with pytest.raises(ConnectionClosed):
                list(frames(feed))
        closed.set()

    with on_stage(stage) as page:
        threading.Thread(target=follow, args=(page,), daemon=True).start()
        assert looking.wait(PATIENCE_S)
        port = page.port
    assert closed.wait(PATIENCE_S)
    with socket.socket() as again:
        again.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        again.bind(("127.0.0.1", port))


def test_another_scene_is_a_snapshot_for_everybody(page: Served, stage: MadeUpSession) -> None:
    with page.feed() as one, page.feed() as other:
        assert next_frame(one).is_snapshot
        assert next_frame(other).is_snapshot
        scene = testing.scene([testing.radar(id="new")], seed=1)
        page.call(lambda: stage.view and stage.view.scene(scene))
        for feed in (one, other):
            frame = next(f for f in frames(feed) if sensors_of(f) == ["new"])
            assert frame.is_snapshot


def sensors_of(frame: Frame) -> list[str]:
    """Of the scene that it tells of, if it does."""
    return [sensor["id"] for sensor in frame.news.get("scene", {}).get("sensors", [])]
