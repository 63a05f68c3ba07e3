"""ASTERIX data blocks to a raw file, as they leave a session."""

from __future__ import annotations

import contextlib
from pathlib import Path
from types import TracebackType
from typing import Self

from plotfeed.feeds.messages.message import Message
from plotfeed.feeds.session.observer import Observer


class RawFile(Observer):
    """Writes the ASTERIX among the messages. A full disk ends the file, not the session."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.failure = ""
        """Why the file is not whole; empty while it is."""
        self._file = path.open("wb")

    def after_link(self, message: Message, _sent_utc_ns: int) -> None:
        """Take what is ASTERIX."""
        if self.failure or not message.content_type.startswith("application/x-asterix"):
            return
        try:
            self._file.write(message.payload)
        except OSError as error:
            self._failed(error)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self._file.close()
        except OSError as closing:
            self._failed(closing)

    def _failed(self, error: OSError) -> None:
        if not self.failure:
            self.failure = f"{self.path}: {error.strerror}; what came after is not in the file"
        with contextlib.suppress(OSError):
            self._file.close()
