"""What a command needs that only an extra brings."""

from __future__ import annotations

from plotfeed.proto.errors import PlotfeedError


def need_matplotlib() -> None:
    """Raise `PlotfeedError` if it is not installed: before anything is worked out in vain."""
    try:
        import matplotlib.figure  # noqa: F401 - an extra
    except ImportError:
        raise PlotfeedError("charts need matplotlib: pip install 'plotfeed[charts]'") from None
