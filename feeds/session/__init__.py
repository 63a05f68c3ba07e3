"""A scene at work in real or simulated time: the loop, its sensors, what comes in and goes out.

Whoever wants to follow a session is an `Observer`; none of them is known here by name.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from plotfeed.feeds.session.session import run

__all__ = ["run"]


def __getattr__(name: str) -> Any:
    """Whoever only observes a session does not wait for what runs it."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from plotfeed.feeds.session import session

    return getattr(session, name)
