from __future__ import annotations

import asyncio
import sys
import urllib.request
from dataclasses import fields
from http.client import HTTPConnection
from pathlib import Path
from urllib.parse import parse_qsl, urlsplit

import pytest
from prometheus_client import Metric
from prometheus_client.parser import text_string_to_metric_families
from support.brokers import deaf_server, free_port, is_listening, sockets
from support.command import plotfeed_here
from support.scene_files import radar, scene_file, scene_text
from support.sessions import at_work
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.link.counters import SessionCounters, lateness_us
from plotfeed.feeds.metrics import COUNTERS, TOKEN_VARIABLE, MetricsAddress, MetricsError, served
from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.timing.clock import WallClock

LINK = """
[sensor.link]
latency_ms = 400.0
duplicate = 0.2
loss = { kind = "random", probability = 0.2 }
"""
SENSORS = radar("far", period_s=2.0, sectors=32) + LINK + radar("near", period_s=2.0, sectors=32)
Read = dict[tuple[str, str], float]


def scrape(port: int) -> dict[str, Metric]:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics") as answer:
        text = answer.read().decode()
    return {family.name: family for family in text_string_to_metric_families(text)}


def values(families: dict[str, Metric]) -> Read:
    """By name and by the value of the only label, if there is one."""
    return {
        (one.name, next(iter(one.labels.values()), "")): one.value
        for family in families.values()
        for one in family.samples
    }


@pytest.mark.asyncio
async def test_metrics_are_what_the_session_counts(tmp_path: Path) -> None:
    """While its clock stands, so that nothing changes; they are served on loopback alone."""
    text = scene_text(start_utc="2026-01-01T12:00:00Z", sensors=SENSORS, port=1883)
    scene, port = load(scene_file(tmp_path, text)), free_port()
    clock = WallClock(scene.scene.start_utc_ns, speed=10.0)
    with served(MetricsAddress(port=port)) as collector:
        async with at_work(scene, None, collector, clock=clock) as session:
            totals, messages = session.totals, -1
            await until(lambda: totals.lost > 5 and totals.duplicated > 5)
            session.session.intake.receive([("plotfeed/telemetry/x", b"?", None)], clock.now_ns())
            clock.pause()
            while totals.messages != messages:  # until what was being done is done
                messages, families = totals.messages, await asyncio.to_thread(scrape, port)
            read, sensors = values(families), session.session.sensors.items()
            for name in COUNTERS:
                assert families[f"plotfeed_{name}"].type == "counter"
                assert read[f"plotfeed_{name}_total", ""] == getattr(totals, name), name
            assert read["plotfeed_drones", ""] == totals.drones == 1
            assert read["plotfeed_refused_total", ""] == 1
            assert read["plotfeed_inbox", ""] == 0
            late_us = lateness_us(totals.lateness_ns, 50, 99, 99.9)
            for quantile, late in zip(("0.5", "0.99", "0.999"), late_us, strict=True):
                assert read["plotfeed_lateness_seconds", quantile] == pytest.approx(late / 1e6)
            for name in ("lost", "duplicated", "plots", "undelivered"):
                told = [getattr(task.status, name) for _, task in sensors]
                assert sum(told) == getattr(totals, name), name
            for sensor, task in sensors:
                for name in ("scan", "plots", "lost", "on_the_way", "waiting", "enabled"):
                    told_of = getattr(task.status, name)
                    assert read[f"plotfeed_sensor_{name}", sensor] == told_of, name
            assert read["plotfeed_sensor_on_the_way", "far"] > 0
            assert read["plotfeed_sensor_on_the_way", "near"] == 0
            assert {each.address for each in sockets() if each.port == port} == {"0100007F"}
    assert not is_listening(port)


def test_every_count_in_the_totals_is_a_metric() -> None:
    """But for the last scan, which each sensor has of its own, and what only ends know."""
    counts = {f.name for f in fields(SessionCounters) if f.type == "int"}
    assert counts - {"drones", "scan", "ended", "other_sessions"} == set(COUNTERS)


def test_a_place_that_is_taken_or_none_is_one_line(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, scene_text(sensors=radar(), port=1883))
    with deaf_server() as port:
        taken = f"127.0.0.1:{port}"
        for text, code, says in (
            (taken, 1, f" {taken}: Address already in use"),
            ("::1:9464", 2, ": expected HOST:PORT, such as 127.0.0.1:9464, not '::1:9464'"),
            ("70000", 2, ": expected HOST:PORT, such as 127.0.0.1:9464, not '70000'"),
        ):
            done = plotfeed_here("run", scene, "--broker", "none", "--metrics", text)
            assert (done.returncode, done.stdout) == (code, "")
            assert done.stderr == f"plotfeed: --metrics{says}\n"


def test_without_the_library_that_serves_them_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "prometheus_client", None)
    with pytest.raises(MetricsError) as caught, served(MetricsAddress()):
        pass
    expected = "metrics need prometheus-client: pip install 'plotfeed[metrics]'"
    assert (str(caught.value), caught.value.exit_code) == (expected, 1)


def test_metrics_are_for_who_asks_for_this_machine() -> None:
    """A web site whose name stands for loopback (DNS rebinding) has its browser name that site."""
    port = free_port()
    with served(MetricsAddress(port=port)):
        for host in ("127.0.0.1", f"localhost:{port}", f"[::1]:{port}"):
            assert answer_to(port, host) == 200
        for host in ("evil.example", f"evil.example:{port}", "127.0.0.1.evil.example", ""):
            assert answer_to(port, host) == 403


@pytest.mark.parametrize("host", ["0.0.0.0", "::"])  # noqa: S104
@pytest.mark.parametrize("fixed", ["", "a-token-of-16-letters"])
def test_metrics_beyond_this_machine_need_the_token_that_is_told(
    host: str, fixed: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    if fixed:
        monkeypatch.setenv(TOKEN_VARIABLE, fixed)
    with served(MetricsAddress(host, 0)):
        (line,) = caplog.messages
        url = urlsplit(line.rpartition(" ")[2])
        assert line.startswith("metrics are at http://")
        ((_, token),) = parse_qsl(url.query)
        port, path = url.port or 0, url.path
        assert path == "/metrics"
        assert token == fixed or (not fixed and len(token) >= 16)
        assert answer_to(port, "127.0.0.1", f"{path}?token={token}") == 200
        assert answer_to(port, "127.0.0.1", path, Authorization=f"Bearer {token}") == 200
        assert answer_to(port, "192.0.2.1", f"{path}?token={token}") == 200
        for wrong in ("", "x", f"{token}x", "%C3%A9"):
            assert answer_to(port, "127.0.0.1", f"{path}?token={wrong}") == 401
        assert answer_to(port, "127.0.0.1", path, Authorization=f"Bearer x{token}") == 401
        assert answer_to(port, "evil.example", f"{path}?token={token}") == 403


def answer_to(port: int, host: str, path: str = "/metrics", **headers: str) -> int:
    asking = HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    asking.request("GET", path, headers={"Host": host, **headers})
    try:
        return asking.getresponse().status
    finally:
        asking.close()
