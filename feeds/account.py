"""An entry of the ledger under way: complete when all of its messages are settled."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from plotfeed.proto import plotfeed_pb2 as pb


class Account:
    """Collects what became of the messages that tell of one thing, such as a sector."""

    __slots__ = ("_closed", "_on_complete", "_sent", "_unsettled")

    def __init__(self, on_complete: Callable[[Sequence[pb.Sent]], None]) -> None:
        self._sent: list[pb.Sent] = []
        self._unsettled = 0
        self._closed = False
        self._on_complete = on_complete

    def expect(self) -> None:
        """Another message, or another copy of one, is on its way."""
        self._unsettled += 1

    def settle(self, sent: pb.Sent) -> None:
        """That is what became of one."""
        self._sent.append(sent)
        self._unsettled -= 1
        self._complete()

    def close(self) -> None:
        """No more will come."""
        self._closed = True
        self._complete()

    def _complete(self) -> None:
        if self._closed and not self._unsettled:
            self._on_complete(sorted(self._sent, key=lambda sent: (sent.number, sent.copy)))
