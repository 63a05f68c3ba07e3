"""Answers of a service that is asked again and again over HTTP."""

from __future__ import annotations

import asyncio
import logging
import os
from urllib.parse import quote

from plotfeed.feeds.scene.telemetry_keys import SourceAddress
from plotfeed.feeds.transport.http_client import HttpClient, HttpError
from plotfeed.feeds.transport.mqtt.address import BrokerAccess
from plotfeed.feeds.transport.octet_sources import OctetsTaker, SourceError
from plotfeed.proto.errors import PlotfeedError

log = logging.getLogger(__name__)

TOKEN_VARIABLE = "PLOTFEED_REMOTE_ID_TOKEN"  # noqa: S105 - where it is, not what it is
TIMEOUT_S = 10.0
MAX_ANSWER_OCTETS = 8 << 20
SLOWEST_S = 30.0  # Between two questions to a service that fails
WHY = {
    401: f"it wants a token: {TOKEN_VARIABLE}",
    403: f"it does not let that token in: {TOKEN_VARIABLE}",
    413: "the view is too large for it: 7 km across at most",
}


class PolledOctets:
    """GET {base}/uss/flights?view=..., each answer whole to the taker."""

    bound_port = 0
    correspondents: tuple[str, ...] = ()

    def __init__(
        self, address: SourceAddress, taker: OctetsTaker, view: str, every_s: float
    ) -> None:
        self._address, self._taker, self._every_s = address, taker, every_s
        self._url = f"{address.path.rstrip('/')}/uss/flights?view={quote(view, safe=',')}"
        self._is_told = False

    async def open(self) -> None:
        """See whether the token can be sent; raises `SourceError`."""
        token = os.environ.get(TOKEN_VARIABLE, "")
        if not (token.isascii() and token.isprintable()):
            raise SourceError(f"{TOKEN_VARIABLE}: expected printable ASCII")

    async def run(self) -> None:
        """Ask for ever: at the usual interval, more slowly while there is no answer."""
        wait_s = self._every_s
        while True:
            try:
                answer = await self._get()
            except PlotfeedError as error:
                if not self._is_told:
                    log.warning("%s: %s; asked again", self._address, error)
                    self._is_told = True
                wait_s = min(2 * wait_s, max(SLOWEST_S, self._every_s))
            else:
                if self._is_told:
                    log.warning("%s: it answers again", self._address)
                    self._is_told = False
                wait_s = self._every_s
                self._taker.octets(str(self._address), answer)
            await asyncio.sleep(wait_s)

    def close(self) -> None:
        """Nothing is open between questions."""

    def send(self, peer: str, data: bytes) -> None:
        """Nobody is told anything."""

    async def _get(self) -> bytes:
        fields = ["Accept: application/json", "Connection: close"]
        if token := os.environ.get(TOKEN_VARIABLE):
            fields.append(f"Authorization: Bearer {token}")
        tls = BrokerAccess().tls_context() if self._url.startswith("https") else None
        server = HttpClient(self._url, tls, fields)
        try:
            status, answer = await server.ask(
                "GET", (), b"", timeout_s=TIMEOUT_S, most=MAX_ANSWER_OCTETS
            )
        finally:
            server.hang_up()
        if status != 200:
            raise HttpError(f"status {status}" + (f", {WHY[status]}" if status in WHY else ""))
        if answer is None:
            raise HttpError(f"an answer of more than {MAX_ANSWER_OCTETS} octets")
        return answer
