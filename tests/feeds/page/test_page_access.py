from __future__ import annotations

import socket
from typing import Any

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


OUR_NAMES = ("localhost:8000", "127.0.0.1:8000", "[::1]:8000", "LOCALHOST", "127.0.0.1")
NUMBERS = ("192.168.0.1:8000", "[fe80::1]:8000")
FOREIGN_NAMES = ("evil.example:8000", "127.0.0.1.evil.example", "")


@pytest.mark.parametrize(
    ("address", "ours", "foreign"),
    [
        (LOCAL, OUR_NAMES, (*FOREIGN_NAMES, *NUMBERS, "[::2]")),
        (WIDE, (*OUR_NAMES, *NUMBERS, f"{socket.gethostname()}:8000"), FOREIGN_NAMES),
    ],
)
def test_requests_are_for_a_name_of_this_machine_and_from_the_page_itself(
    address: PageAddress, ours: tuple[str, ...], foreign: tuple[str, ...]
) -> None:
    access = PageAccess(address)
    assert all(access.host_is_ours({"host": host}) for host in ours)
    assert not any(access.host_is_ours({"host": host}) for host in foreign)
    assert not access.host_is_ours({})
    host = {"host": "localhost:8000"}
    for scheme in ("http", "https"):
        assert access.origin_is_ours(host | {"origin": f"{scheme}://localhost:8000"})
    for origin in ("http://localhost:8001", "http://evil.example", "null", "", "http://localhost"):
        assert not access.origin_is_ours(host | {"origin": origin})
    assert not access.origin_is_ours(host)
    assert not access.origin_is_ours({"origin": "http://localhost:8000"})


def test_tokens_are_drawn_where_others_can_get_and_beside_a_fixed_one() -> None:
    assert PageAccess(LOCAL).tokens == (None, None)
    assert PageAccess(LOCAL).may_ask({}, "/feed")
    drawn = [token for _ in range(2) for token in PageAccess(WIDE).tokens]
    assert all(token and len(token) >= 24 for token in drawn)
    assert len(set(drawn)) == 4
    access = PageAccess(LOCAL, Tokens("right"))
    assert access.tokens.presenter == "right"
    assert access.tokens.audience not in (None, "right")
    assert not access.may_ask({}, "/")


PRESENTERS, BOTH = ("/", "/feed"), ("/audience/", "/audience/feed", "/page.js", "/basemap")


def test_only_the_token_lets_in_the_presenter_s_to_all_the_audience_s_to_its_own_page() -> None:
    access = PageAccess(WIDE, Tokens("right", "theirs"))
    presenter, audience = (access.cookie(role) for role in Role)
    cookies = ("", f"{presenter}=wrong", f"{presenter}=", "other=right", "=;;\x00", "é")
    for cookie, opens in (
        (f"a=b; {presenter}=right", {*PRESENTERS, *BOTH}),
        (f"{audience}=theirs", {*BOTH}),
        *((cookie, set()) for cookie in cookies),
        *((cookie, set()) for cookie in (f"{presenter}=theirs", f"{audience}=right")),
    ):
        asked = (*PRESENTERS, *BOTH)
        assert {path for path in asked if access.may_ask({"cookie": cookie}, path)} == opens, cookie
    assert not access.may_ask({}, "/")
    assert access.role_with("rigHt") is access.role_with("ä") is access.role_with("") is None


@pytest.mark.parametrize("variable", [TOKEN_VARIABLE, AUDIENCE_VARIABLE])
def test_a_token_of_the_environment_is_taken_and_a_poor_one_refused_without_showing_it(
    variable: str,
) -> None:
    good = "field-day_2026-11"
    assert fixed_tokens({}) == (None, None)
    assert good in fixed_tokens({variable: good})
    for poor in ("", "short", "sixteen&letters!", "x" * 129):
        with pytest.raises(PlotfeedError, match=f"{variable}: expected 16 to 128") as error:
            fixed_tokens({variable: poor})
        assert not poor or poor not in str(error.value)
    with pytest.raises(PlotfeedError, match=f"{AUDIENCE_VARIABLE}: expected another token"):
        fixed_tokens({TOKEN_VARIABLE: good, AUDIENCE_VARIABLE: good})


LOSS = {"link": {"loss": {"kind": "random", "probability": 0.02}, "latency_ms": 5}}
TEN_TIMES = {"pfa": 1.9999999999999998e-5}


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ({"sensor": "radar", "reset": True}, "radar: reset"),
        (
            {"sensor": "radar", "set": LOSS},
            "radar: link loss kind random, link loss probability 0.02, link latency_ms 5",
        ),
        ({"sensor": "tower", "set": TEN_TIMES}, "tower: pfa 2e-05"),
        ({"session": {"scene": "coast"}}, "session: scene coast"),
        ({"story": "jamming", "reset": True}, "story jamming, reset"),
        ({"undo": True}, "undo"),
        ({"sensor": "x" * 1000, "set": {}}, "x" * MAX_WORDS),
    ],
)
def test_deeds_are_told_in_plain_words(command: dict[str, Any], words: str) -> None:
    assert words_of(command) == words


def test_the_log_is_short_and_names_are_plain_words() -> None:
    audience = Audience()
    for number in range(KEPT_ACTIONS + 5):
        audience.log(number * 1_000_000, "presenter 1", {"clock": {"speed": number}})
    assert len(audience.actions) == KEPT_ACTIONS
    last = KEPT_ACTIONS + 4
    expected = {"t_utc_ms": last, "who": "presenter 1", "what": f"clock: speed {last}"}
    assert audience.actions[-1] == expected
    assert [audience.called(Role.AUDIENCE) for _ in range(2)] == ["audience 1", "audience 2"]
    assert len(name_in("x" * 100)) == MAX_NAME
    with pytest.raises(PlotfeedError, match="name in words"):
        name_in(5)
    assert told(TEN_TIMES | {"link": {"latency_ms": 250}}) == "pfa 2e-05, link.latency_ms 250"
