"""The live page of a demo, which nobody had to ask for."""

from __future__ import annotations

import json
import sys
import time
from urllib.request import urlopen

import pytest
from support.brokers import free_port, port_is_taken
from support.command import plotfeed, plotfeed_here, running
from support.page_updates import read_frame
from support.waiting import PATIENCE_S
from websockets import Origin
from websockets.sync.client import connect

pytest.importorskip("uvicorn")

USUAL_PORT = 8590
QUICK = ("--speed", "20", "--duration", "5", "--broker", "none")


def title_at(port: int) -> bool:
    with urlopen(f"http://127.0.0.1:{port}/", timeout=PATIENCE_S) as answer:
        return b"<title>plotfeed</title>" in answer.read()


def test_a_demo_has_its_page_and_shows_the_world_s_time_until_somebody_holds_it() -> None:
    with running("demo") as demo:
        port = demo.port("page")
        assert title_at(port)
        way = f"look at it: in a browser http://127.0.0.1:{port}/, or plotfeed show mqtt://"
        assert demo.introduction[-1].startswith(way)
        moved = any(line.startswith(f"port {USUAL_PORT} is taken") for line in demo.introduction)
        assert moved == (port != USUAL_PORT)
        host = f"127.0.0.1:{port}"
        with connect(f"ws://{host}/feed", origin=Origin(f"http://{host}"), max_size=None) as feed:
            frames = (octets for octets in feed if isinstance(octets, bytes))
            assert abs(read_frame(next(frames)).now_ms - time.time() * 1000) < 60_000
            feed.send(json.dumps({"number": 1, "command": {"clock": {"paused": True}}}))
            answers = (json.loads(text) for text in feed if isinstance(text, str))
            assert next(answer for answer in answers if answer.get("number") == 1)["ok"]


def test_where_the_usual_port_is_taken_it_has_another_unless_one_was_asked_for() -> None:
    with port_is_taken(USUAL_PORT):
        with running("demo", "--broker", "none") as demo:
            assert demo.introduction[0] == f"port {USUAL_PORT} is taken: the page has another"
            assert demo.port("page") != USUAL_PORT
            assert title_at(demo.port("page"))
        done = plotfeed("demo", "--page", USUAL_PORT)
        assert (done.returncode, done.stdout) == (1, "")
        assert done.stderr.startswith(f"plotfeed: --page 127.0.0.1:{USUAL_PORT}: ")
        assert len(done.stderr.splitlines()) == 1
        # Totals as JSON are all that is said.
        assert json.loads(plotfeed("demo", *QUICK, "--json").stdout)["messages"] > 0
    port = free_port()
    with running("demo", "--broker", "none", "--page", port) as demo:
        assert demo.port("page") == port
    for options in (("--page", "none"), ("--speed", "max")):
        done = plotfeed("demo", *QUICK, *options)
        assert (done.returncode, done.stderr) == (0, "")
        assert "page" not in done.stdout


def test_without_the_extra_a_demo_says_how_to_get_it_and_runs_on_unless_a_page_was_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    hint = "uvicorn missing here: pip install 'plotfeed[page]'"
    done = plotfeed_here("demo", *QUICK)
    assert (done.returncode, done.stderr) == (0, "")
    hints = [line for line in done.stdout.splitlines() if "page" in line]
    assert hints == [f"  page        none, {hint}"]
    assert done.stdout.splitlines()[-1].startswith("drones 21 ")
    done = plotfeed_here("demo", *QUICK, "--page", "0")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"plotfeed: the page cannot be served, {hint}\n"
