"""A service provider of Remote ID is asked again and again, and nobody else is."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest
from support.waiting import PATIENCE_S, until

from plotfeed.feeds.scene.telemetry_keys import TelemetrySource
from plotfeed.feeds.telemetry.position_report import PositionReport, Refused
from plotfeed.feeds.transport import http
from plotfeed.feeds.transport.http import HttpClient
from plotfeed.feeds.transport.live_source import LiveSource
from plotfeed.models.state import AltitudeReference

NOW = 1_767_225_600_000_000_000
VIEW = [40.43, -3.76, 40.47, -3.70]


def flight(number: int, **position: object) -> dict[str, Any]:
    """As F3411-22a has it."""
    place = {"lat": 40.45, "lng": -3.73, "alt": 760.5, "accuracy_h": "HA3m", "accuracy_v": "VA10m"}
    return {
        "id": f"flight-{number}",
        "aircraft_type": "Helicopter",
        "current_state": {
            "timestamp": {"value": "2026-01-01T00:00:00.5Z", "format": "RFC3339"},
            "position": {**place, **position},
            "track": 90.0,
            "speed": 10.0,
            "vertical_speed": 63.0,
            "speed_accuracy": "SA1mps",
        },
    }


class Provider(ThreadingHTTPServer):
    """Answers what it is told to, and remembers who asked for what."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.asked: list[tuple[str, str | None]] = []
        self.status, self.answer, self.to = 200, b'{"flights": []}', ""


class Handler(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        provider = self.server
        assert isinstance(provider, Provider)
        provider.asked.append((self.path, self.headers.get("Authorization")))
        self.send_response(provider.status)
        if provider.to:
            self.send_header("Location", provider.to)
        self.send_header("Content-Length", str(len(provider.answer)))
        self.end_headers()
        self.wfile.write(provider.answer)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def provider() -> Iterator[Provider]:
    server = Provider()
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


async def listen(provider: Provider, enough: Any) -> list[tuple[str, PositionReport | Refused]]:
    heard: list[tuple[str, PositionReport | Refused]] = []
    url = f"remote-id:http://127.0.0.1:{provider.server_port}/rid"
    settings = TelemetrySource.model_validate({"url": url, "view": VIEW, "poll_s": 0.2})
    both = {"take": lambda *r: heard.append(r), "refuse": lambda *r: heard.append(r)}
    source = LiveSource(settings, now_utc_ns=lambda: NOW, **both)
    await source.open()
    running = asyncio.create_task(source.run())
    await until(lambda: enough(heard))
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    source.close()
    return heard


@pytest.mark.asyncio
async def test_flights_are_taken_once_with_their_accuracies(
    provider: Provider, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PLOTFEED_REMOTE_ID_TOKEN", "abc")
    flights = [flight(1), flight(2, lat="north"), flight(3, alt=-1000)]
    provider.answer = json.dumps({"flights": flights}).encode()
    heard = await listen(provider, lambda _: len(provider.asked) >= 3)
    assert provider.asked[0] == (
        "/rid/uss/flights?view=40.430000,-3.760000,40.470000,-3.700000",
        "Bearer abc",
    )
    reports = [said for _, said in heard if isinstance(said, PositionReport)]
    (found,) = reports  # though it was told thrice
    assert (found.t_utc_ns, found.altitude_m) == (NOW + 500_000_000, 760.5)
    assert found.altitude_reference is AltitudeReference.ELLIPSOID
    assert found.horizontal_accuracy_m == pytest.approx(3 / 2.4477, rel=1e-4)
    assert found.vertical_accuracy_m == pytest.approx(10 / 1.95996, rel=1e-4)
    assert found.velocity_enu_m_s == pytest.approx((10, 0, float("nan")), nan_ok=True, abs=1e-9)
    refused = {drone: said.detail for drone, said in heard if isinstance(said, Refused)}
    assert refused == {
        "flight-2": "lat is 'north'; expected a number",
        "flight-3": "position.alt is missing or unknown",
    }


@pytest.mark.asyncio
async def test_a_token_goes_to_nobody_else(
    provider: Provider, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("PLOTFEED_REMOTE_ID_TOKEN", "abc")
    other = Provider()
    monkeypatch.setenv("http_proxy", f"http://127.0.0.1:{other.server_port}")
    provider.status, provider.to = 302, f"http://127.0.0.1:{other.server_port}/"
    await listen(provider, lambda _: caplog.text)
    other.server_close()
    assert other.asked == []
    assert "status 302" in caplog.text
    assert "abc" not in caplog.text


@pytest.mark.asyncio
async def test_a_service_that_fails_is_asked_again(
    provider: Provider, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(http, "SLOWEST_S", 0.2)
    provider.status = 401

    def mended(heard: list[object]) -> bool:
        if caplog.text and provider.status == 401:
            provider.status, provider.answer = 200, json.dumps({"flights": [flight(1)]}).encode()
        return bool(heard)

    await listen(provider, mended)
    assert "status 401, it wants a token: PLOTFEED_REMOTE_ID_TOKEN" in caplog.text
    assert "it answers again" in caplog.text


async def _silent(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    await reader.read()
    writer.close()
    await writer.wait_closed()


@pytest.mark.asyncio
async def test_a_service_that_is_silent_holds_up_no_end() -> None:
    """No thread waits for it: who is cancelled has ended when its connection has."""
    before, tasks = threading.active_count(), asyncio.all_tasks()
    server = await asyncio.start_server(_silent, "127.0.0.1", 0)
    url = f"remote-id:http://127.0.0.1:{server.sockets[0].getsockname()[1]}/rid"
    settings = TelemetrySource.model_validate({"url": url, "view": VIEW, "poll_s": 0.2})
    source = LiveSource(settings, now_utc_ns=lambda: NOW, take=lambda *_: None, refuse=print)
    await source.open()
    running = asyncio.create_task(source.run())
    await until(lambda: len(asyncio.all_tasks()) > len(tasks) + 1)  # it is asked
    assert threading.active_count() == before
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    source.close()
    server.close()
    await until(lambda: asyncio.all_tasks() == tasks)  # who was asked sees the end


CHUNKS = b'5;x=y\r\n{"fli\r\nA\r\nghts": []}\r\n0\r\na: b\r\n\r\n'


@pytest.mark.parametrize(
    "answer",
    [
        b"Transfer-Encoding: chunked\r\nConnection: close\r\n\r\n" + CHUNKS,
        b'Connection: close\r\n\r\n{"flights": []}',
    ],
)
@pytest.mark.asyncio
async def test_an_answer_of_no_told_length_is_read(answer: bytes) -> None:
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.write(b"HTTP/1.1 200 OK\r\n" + answer)
        writer.close()
        await writer.wait_closed()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    client = HttpClient(f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}/", None)
    tasks = asyncio.all_tasks()
    for most, body in ((100, b'{"flights": []}'), (10, None)):
        assert await client.ask("GET", (), b"", timeout_s=PATIENCE_S, most=most) == (200, body)
    client.hang_up()
    server.close()
    await until(lambda: asyncio.all_tasks() == tasks)
