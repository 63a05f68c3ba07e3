"""Everything that waits, listens or sends, and the face that it shows to Python.

`load` a scene, `run` it as a session that an `Observer` follows, or `simulate` it: what its sensors
report, as NumPy columns. All errors are `PlotfeedError`. Each name is loaded when it is asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from plotfeed.feeds.scene.scene import Scene, load
    from plotfeed.feeds.sensing.simulation import simulate
    from plotfeed.feeds.session.observer import Observer
    from plotfeed.feeds.session.session import run
    from plotfeed.proto.errors import PlotfeedError

__all__ = ["Observer", "PlotfeedError", "Scene", "load", "run", "simulate"]

_HOMES = {
    "Observer": "plotfeed.feeds.session.observer",
    "PlotfeedError": "plotfeed.proto.errors",
    "Scene": "plotfeed.feeds.scene.scene",
    "load": "plotfeed.feeds.scene.scene",
    "run": "plotfeed.feeds.session.session",
    "simulate": "plotfeed.feeds.sensing.simulation",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
