"""The live page beside a session in a terminal: where it was asked for, or where a demo has it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec

import click

from plotfeed.feeds.clock import Clock
from plotfeed.feeds.observers import Extras
from plotfeed.feeds.scene import Scene
from plotfeed.feeds.totals import Totals
from plotfeed.proto.errors import PlotfeedError

LIBRARIES = ("starlette", "uvicorn", "websockets")
"""Of the extra `page`; the page loads them once the session is under way."""


def what_is_missing() -> str:
    """A word to whoever wants the page where its libraries are not installed; else empty."""
    if all(find_spec(name) for name in LIBRARIES):
        return ""
    return "needs more: pip install 'plotfeed[page]'"


async def with_page(
    stop: asyncio.Event,
    on_ready: Callable[[dict[str, str], Totals], None],
    *,
    page: str | None,
    another_clock: Callable[[Scene], Clock],
    scene: Scene,
    clock: Clock,
    broker: str | None,
    duration_s: float | None,
    extras: Extras,
) -> Totals:
    """Sessions as the page's viewers want them; raises `PlotfeedError`.

    `page` is its address. None is for the usual one, or any that is free where that is taken.
    """
    from plotfeed.feeds.page.access import DEFAULT_PORT, PageAddress  # noqa: PLC0415 - if at all
    from plotfeed.feeds.page.listening import PageError  # noqa: PLC0415
    from plotfeed.feeds.page.show import run_with_page  # noqa: PLC0415

    run = partial(
        run_with_page,
        scene=scene,
        clock=clock,
        another_clock=another_clock,
        broker=broker,
        duration_s=duration_s,
        stop=stop,
        extras=extras,
        on_ready=on_ready,
    )
    if page is not None:
        return await run(PageAddress.parse(page))
    try:
        return await run(PageAddress())
    except PageError:  # before anything has begun
        click.echo(f"port {DEFAULT_PORT} is taken: the page has another")
        return await run(PageAddress(port=0))


def asked_page(page: str | None, *, or_usual: bool) -> tuple[bool, str]:
    """Whether to serve it, and what to say if not; raises `PlotfeedError` where it must be.

    `or_usual` says that it is welcome even where nobody asked for it.
    """
    if page is None and not or_usual:
        return False, ""
    missing = what_is_missing()
    if missing and page is not None:
        raise PlotfeedError(f"the page {missing}")
    return not missing, missing
