"""Who is let in to the page's web application, and what every answer of it forbids a browser."""

from __future__ import annotations

from typing import TYPE_CHECKING
from urllib.parse import parse_qs

from starlette.datastructures import MutableHeaders
from starlette.responses import PlainTextResponse, RedirectResponse, Response

from plotfeed.feeds.page.audience import Role
from plotfeed.feeds.page.page_access import AUDIENCE_PATH, PageAccess

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'{socket}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
SAFE_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-cache",
}
COOKIE_S = 30 * 86_400


class PageGuard:
    """ASGI middleware that lets requests pass, or answers them."""

    def __init__(self, app: ASGIApp, access: PageAccess) -> None:
        self._app = app
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request pass, or answer it."""
        headers = {
            name.decode("latin-1").lower(): value.decode("latin-1")
            for name, value in scope["headers"]
        }
        answer = self._answer(scope, headers)
        if answer is None:
            await self._app(scope, receive, _with_headers(send, headers.get("host", "")))
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 4403})
        else:
            await answer(scope, receive, _with_headers(send, ""))

    def _answer(self, scope: Scope, headers: dict[str, str]) -> Response | None:
        access = self._access
        if not access.host_is_ours(headers):
            return PlainTextResponse("This page is not here under that name.\n", 421)
        if scope["type"] == "websocket" and not access.origin_is_ours(headers):
            return PlainTextResponse("Only the page itself may ask this.\n", 403)
        path = scope["path"]
        tokens = parse_qs(scope["query_string"].decode("latin-1")).get("token", [])
        role = access.role_with(tokens[0]) if tokens and scope["type"] == "http" else None
        if role is not None:
            return self._let_in(tokens[0], role, path)
        if not access.may_ask(headers, path):
            return PlainTextResponse(
                "This page needs the address that plotfeed printed, with its token.\n", 403
            )
        return None

    def _let_in(self, token: str, role: Role, path: str) -> Response:
        """Keep the token in a cookie, and out of the address."""
        is_audience = role is Role.AUDIENCE or path.startswith(AUDIENCE_PATH)
        answer = RedirectResponse(f"{AUDIENCE_PATH}/" if is_audience else "/", 303)
        answer.set_cookie(
            self._access.cookie(role), token, max_age=COOKIE_S, httponly=True, samesite="lax"
        )
        return answer


def _with_headers(send: Send, host: str) -> Send:
    # 'self' holds for WebSockets too, but not in every browser that is still about.
    socket = f" ws://{host}" if host and all(c.isalnum() or c in ".-:[]" for c in host) else ""

    async def send_on(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            headers.update(SAFE_HEADERS)
            headers["Content-Security-Policy"] = POLICY.format(socket=socket)
        await send(message)

    return send_on
