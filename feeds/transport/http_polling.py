"""Answers of a service that is asked again and again over HTTP, by a thread of its own."""

from __future__ import annotations

import asyncio
import http.client
import logging
import os
import urllib.error
import urllib.request
from typing import Any
from urllib.parse import quote

from plotfeed.feeds.scene.source_keys import SourceAddress
from plotfeed.feeds.transport.octet_sources import OctetsTaker, SourceError

log = logging.getLogger(__name__)

TOKEN_VARIABLE = "PLOTFEED_REMOTE_ID_TOKEN"  # noqa: S105 - where it is, not what it is
TIMEOUT_S = 10.0
MAX_ANSWER_OCTETS = 8 << 20
SLOWEST_S = 30.0
"""Between two questions to a service that fails."""
WHY = {
    401: f"it wants a token: {TOKEN_VARIABLE}",
    403: f"it does not let that token in: {TOKEN_VARIABLE}",
    413: "the view is too large for it: 7 km across at most",
}


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """A token goes to nobody but who was named."""

    def redirect_request(self, *_: Any) -> None:
        return None


class PolledOctets:
    """GET {base}/uss/flights?view=..., each answer whole to the taker."""

    bound_port = 0
    correspondents: tuple[str, ...] = ()

    def __init__(
        self, address: SourceAddress, taker: OctetsTaker, view: str, every_s: float
    ) -> None:
        self._address, self._taker, self._every_s = address, taker, every_s
        self._url = f"{address.path.rstrip('/')}/uss/flights?view={quote(view, safe=',')}"
        # Neither redirects nor proxies of the environment: only who was named is asked.
        self._opener = urllib.request.build_opener(_NoRedirect(), urllib.request.ProxyHandler({}))
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
                answer = await asyncio.to_thread(self._get)
            except (OSError, http.client.HTTPException, ValueError) as error:
                if not self._is_told:
                    log.warning("%s: %s; asked again", self._address, _why(error))
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

    def _get(self) -> bytes:
        request = urllib.request.Request(self._url, headers={"Accept": "application/json"})  # noqa: S310
        if token := os.environ.get(TOKEN_VARIABLE):
            request.add_unredirected_header("Authorization", f"Bearer {token}")
        with self._opener.open(request, timeout=TIMEOUT_S) as answer:
            data: bytes = answer.read(MAX_ANSWER_OCTETS + 1)
        if len(data) > MAX_ANSWER_OCTETS:
            raise ValueError(f"an answer of more than {MAX_ANSWER_OCTETS} octets")
        return data


def _why(error: Exception) -> str:
    if isinstance(error, urllib.error.HTTPError):
        return f"status {error.code}" + (f", {WHY[error.code]}" if error.code in WHY else "")
    reason = getattr(error, "reason", error)
    return str(getattr(reason, "strerror", None) or reason)[:200]
