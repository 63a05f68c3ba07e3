"""The native log as one format among those of other tools."""

from __future__ import annotations

from collections.abc import Iterator
from typing import BinaryIO

from plotfeed.proto.errors import EncodeError
from plotfeed.replay.mcap.log_reader import LogReader
from plotfeed.replay.mcap.log_writer import LogWriter
from plotfeed.replay.mcap.records import Attachment
from plotfeed.replay.recorded import Damage, Recorded


class McapReader:
    """All messages by log time. Raises `DecodeError` if the file is no MCAP."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.log = LogReader(file)
        self.skipped = 0

    @property
    def damage(self) -> list[Damage]:
        """Found so far."""
        return self.log.damage

    @property
    def at(self) -> int:
        """Where the file is read now."""
        return self._file.tell()

    def messages(self) -> Iterator[Recorded]:
        """Those of all channels."""
        return self.log.messages()

    def attachments(self) -> Iterator[Attachment]:
        """The last of each name that is whole."""
        for name in dict.fromkeys(entry.name for entry in self.log.summary().attachments):
            attachment = self.log.attachment(name)
            if attachment is not None:
                yield attachment


class McapWriter:
    """Everything that a message has."""

    def __init__(self, file: BinaryIO) -> None:
        self._log = LogWriter(file)

    def write(self, message: Recorded) -> str | None:
        """Write a message; why it cannot be held, or None."""
        try:
            self._log.write(message)
        except EncodeError as error:
            return str(error)
        return None

    def attach(self, attachment: Attachment) -> None:
        """Put another file into the file."""
        self._log.attach(attachment)

    def notes(self) -> list[str]:
        """Nothing is lost."""
        return []

    def close(self) -> None:
        """Write the index."""
        self._log.close()
