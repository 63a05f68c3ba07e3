"""The root of every error that plotfeed raises on purpose, and the codecs' own."""

from __future__ import annotations


class PlotfeedError(Exception):
    """Something that a user can mend: its text is one line that names what was wrong."""

    # Exit code of the command: 2 for wrong use or bad input, 1 for what failed all the same.
    exit_code = 2


class DecodeError(PlotfeedError):
    """Bytes that are not what they should be. `at_octet` counts from 0; None if it is the whole."""

    def __init__(self, message: str, *, at_octet: int | None = None) -> None:
        super().__init__(message if at_octet is None else f"octet {at_octet}: {message}")
        self.at_octet = at_octet


class EncodeError(PlotfeedError):
    """A value that the format cannot carry. `field` names it."""

    def __init__(self, message: str, *, field: str) -> None:
        super().__init__(f"{field}: {message}")
        self.field = field
