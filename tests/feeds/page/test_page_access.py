from __future__ import annotations

import socket

import pytest

from plotfeed.feeds.engine.change_control import told
from plotfeed.feeds.page.page_access import (
    AUDIENCE_VARIABLE,
    DEFAULT_PORT,
    KEPT_ACTIONS,
    MAX_NAME,
    MAX_WORDS,
    TOKEN_VARIABLE,
    Audience,
    PageAccess,
    PageAddress,
    Role,
    Tokens,
    fixed_tokens,
    name_in,
    words_of,
)
from plotfeed.proto.errors import PlotfeedError

LOCAL = PageAddress("127.0.0.1", 8000)
WIDE = PageAddress("0.0.0.0", 8000)  # noqa: S104 - nothing listens


@pytest.mark.parametrize(
    ("text", "host", "port", "is_loopback"),
    [
        ("127.0.0.1:8000", "127.0.0.1", 8000, True),
        ("localhost:1", "localhost", 1, True),
        ("127.8.9.1:1", "127.8.9.1", 1, True),
        ("[::1]:65535", "::1", 65535, True),
        (":8000", "127.0.0.1", 8000, True),
        ("8000", "127.0.0.1", 8000, True),
        ("0", "127.0.0.1", 0, True),
        ("0.0.0.0:8000", "0.0.0.0", 8000, False),  # noqa: S104 - only read
        ("[::]:80", "::", 80, False),
        ("192.168.1.7:8000", "192.168.1.7", 8000, False),
        ("ops.example:8000", "ops.example", 8000, False),
    ],
)
def test_an_address_is_host_and_port(text: str, host: str, port: int, is_loopback: bool) -> None:
    address = PageAddress.parse(text)
    assert (address.host, address.port, address.is_loopback) == (host, port, is_loopback)


@pytest.mark.parametrize("text", ["", "localhost", "::1", "1:2:3", "h:70000", "h:-1", "h:٣", "h:"])
def test_what_is_no_address_is_a_line(text: str) -> None:
    with pytest.raises(PlotfeedError, match=f"such as 127.0.0.1:{DEFAULT_PORT}") as error:
        PageAddress.parse(text)
    assert "\n" not in str(error.value)


def test_on_loopback_only_names_of_loopback_are_ours() -> None:
    access = PageAccess(LOCAL)
    for ours in ("localhost:8000", "127.0.0.1:8000", "[::1]:8000", "LOCALHOST", "127.0.0.1"):
        assert access.host_is_ours({"host": ours})
    for foreign in ("evil.example:8000", "127.0.0.1.evil.example", "192.168.0.1:8000", "", "[::2]"):
        assert not access.host_is_ours({"host": foreign})
    assert not access.host_is_ours({})


def test_bound_wider_addresses_and_this_machine_are_ours_but_not_any_name() -> None:
    access = PageAccess(WIDE)
    ours = ("192.168.0.1:8000", "[fe80::1]:8000", "localhost:8000", f"{socket.gethostname()}:8000")
    assert all(access.host_is_ours({"host": host}) for host in ours)
    assert not access.host_is_ours({"host": "evil.example:8000"})


def test_tokens_are_drawn_where_others_can_get_and_nowhere_else() -> None:
    assert PageAccess(LOCAL).tokens == (None, None)
    assert PageAccess(LOCAL).may_ask({}, "/feed")
    drawn = [token for _ in range(2) for token in PageAccess(WIDE).tokens]
    assert all(token and len(token) >= 24 for token in drawn)
    assert len(set(drawn)) == 4


def test_a_token_that_is_fixed_is_needed_on_loopback_too() -> None:
    access = PageAccess(LOCAL, Tokens("right"))
    assert access.tokens.presenter == "right"
    assert access.tokens.audience not in (None, "right")
    assert not access.may_ask({}, "/")


def test_only_the_token_lets_in() -> None:
    access = PageAccess(WIDE, Tokens("right", "theirs"))
    name, theirs = (access.cookie(role) for role in Role)
    assert access.may_ask({"cookie": f"a=b; {name}=right"}, "/feed")
    cookies = ("", f"{name}=wrong", f"{name}=", "other=right", "=;;\x00", "é", f"{name}=theirs")
    for cookie in (*cookies, f"{theirs}=right"):
        for path in ("/", "/feed", "/page.js", "/audience/", "/audience/feed"):
            assert not access.may_ask({"cookie": cookie}, path), (cookie, path)
    assert not access.may_ask({}, "/")
    assert access.role_with("rigHt") is access.role_with("ä") is access.role_with("") is None


def test_the_audience_may_ask_for_its_own_page_and_the_presenter_for_both() -> None:
    access = PageAccess(WIDE, Tokens("right", "theirs"))
    presenter, audience = (
        {"cookie": f"{access.cookie(r)}={t}"} for r, t in zip(Role, access.tokens, strict=True)
    )
    for path in ("/audience/", "/audience/feed", "/page.js", "/basemap"):
        assert access.may_ask(presenter, path)
        assert access.may_ask(audience, path)
    for path in ("/", "/feed"):
        assert access.may_ask(presenter, path)
        assert not access.may_ask(audience, path)


def test_only_the_page_itself_is_of_our_origin() -> None:
    access = PageAccess(LOCAL)
    host = {"host": "localhost:8000"}
    assert access.origin_is_ours(host | {"origin": "http://localhost:8000"})
    assert access.origin_is_ours(host | {"origin": "https://localhost:8000"})
    for origin in ("http://localhost:8001", "http://evil.example", "null", "", "http://localhost"):
        assert not access.origin_is_ours(host | {"origin": origin})
    assert not access.origin_is_ours(host)
    assert not access.origin_is_ours({"origin": "http://localhost:8000"})


@pytest.mark.parametrize("variable", [TOKEN_VARIABLE, AUDIENCE_VARIABLE])
def test_a_token_of_the_environment_is_taken_and_a_poor_one_refused_without_showing_it(
    variable: str,
) -> None:
    assert fixed_tokens({}) == (None, None)
    assert "field-day_2026-11" in fixed_tokens({variable: "field-day_2026-11"})
    for poor in ("", "short", "sixteen&letters!", "x" * 129):
        with pytest.raises(PlotfeedError, match=f"{variable}: expected 16 to 128") as error:
            fixed_tokens({variable: poor})
        assert not poor or poor not in str(error.value)


def test_presenter_and_audience_do_not_have_the_same_token() -> None:
    same = dict.fromkeys((TOKEN_VARIABLE, AUDIENCE_VARIABLE), "field-day_2026-11")
    with pytest.raises(PlotfeedError, match=f"{AUDIENCE_VARIABLE}: expected another token"):
        fixed_tokens(same)


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
    loss = {"link": {"loss": {"kind": "random", "probability": 0.02}, "latency_ms": 5}}
    ten_times = {"pfa": 1.9999999999999998e-5}
    for command, words in (
        ({"sensor": "radar", "reset": True}, "radar: reset"),
        (
            {"sensor": "radar", "set": loss},
            "radar: link loss kind random, link loss probability 0.02, link latency_ms 5",
        ),
        ({"sensor": "tower", "set": ten_times}, "tower: pfa 2e-05"),
        ({"session": {"scene": "coast"}}, "session: scene coast"),
        ({"story": "jamming", "reset": True}, "story jamming, reset"),
        ({"undo": True}, "undo"),
    ):
        assert words_of(command) == words
    assert told(ten_times | {"link": {"latency_ms": 250}}) == "pfa 2e-05, link.latency_ms 250"
    assert len(words_of({"sensor": "x" * 1000, "set": {}})) <= MAX_WORDS
