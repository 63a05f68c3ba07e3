"""Posts messages to a server by HTTP/1.1, one after the other on a connection that is kept."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import urlsplit
from uuid import uuid4

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.scene.output_keys import TOKEN_VARIABLE, HttpDestination
from plotfeed.feeds.transport.http_client import HttpClient, HttpError
from plotfeed.feeds.transport.mqtt.address import AccessError, BrokerAccess
from plotfeed.feeds.transport.queued_transport import QueuedTransport, SendError

# Of an answer, which is read so that the connection can be kept; more, and it is not.
MAX_BODY_OCTETS = 1 << 20
TRY_AGAIN = frozenset({408, 425, 429})  # Answers that ask for patience, as those from 500 on do
MEANINGS = {401: "is the token right?", 403: "may this token do that?", 422: "it wants other keys"}


class HttpTransport(QueuedTransport):
    """One address, and the connection to its server."""

    def __init__(
        self,
        settings: HttpDestination,
        key: str = "http",
        environment: Mapping[str, str] = os.environ,
    ) -> None:
        """`key` is the destination's place in the scene; raises `AccessError`."""
        url = settings.url.replace("{session}", str(uuid4()))
        parts = urlsplit(url)
        super().__init__(
            settings, f"{key} {parts.scheme}://{parts.netloc}{parts.path}", retries=settings.retries
        )
        self._timeout_s = settings.timeout_s
        tls = None
        if parts.scheme == "https":
            ca_file = None if settings.ca_file is None else Path(settings.ca_file)
            tls = BrokerAccess(ca_file=ca_file).tls_context()
        fields = []
        if settings.token is not None:
            token = token_of(settings.token, f"{key}.token", environment)
            fields.append(f"Authorization: Bearer {token}")
        self._server = HttpClient(url, tls, fields)

    async def send(self, message: Message) -> None:
        """Post a message and read the answer; raises `SendError` unless it is one of 200 to 299."""
        kind = message.content_type.partition(";")[0]
        fields = [f"Content-Type: {kind}", f"Content-Length: {len(message.payload)}"]
        try:
            status, _ = await self._server.ask(
                "POST", fields, message.payload, timeout_s=self._timeout_s, most=MAX_BODY_OCTETS
            )
        except HttpError as error:
            raise SendError(str(error)) from None
        if 200 <= status < 300:
            return
        if 300 <= status < 400:
            why = f"it answers {status} and wants another address, such as one without a slash"
            raise SendError(why, is_final=True)
        what = f"it answers {status}" + (f": {MEANINGS[status]}" if status in MEANINGS else "")
        raise SendError(what, is_final=status < 500 and status not in TRY_AGAIN)

    def hang_up(self) -> None:
        """Close the connection, if there is one."""
        self._server.hang_up()


def token_of(name: str, key: str, environment: Mapping[str, str]) -> str:
    """The token of that name in the environment; raises `AccessError`, which does not show it."""
    variable = f"{TOKEN_VARIABLE}{name}"
    token = environment.get(variable)
    if not token:
        raise AccessError(f"{key}: the environment has no {variable}")
    if not (token.isascii() and token.isprintable()) or " " in token:
        raise AccessError(f"{variable}: expected a token of printable ASCII without spaces")
    return token
