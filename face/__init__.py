"""plotfeed from Python: what counter-UAS sensors would have reported, from drone telemetry.

`load` reads a scene. `simulate` gives what its sensors report as NumPy columns, an `Engine` gives
it message by message at whatever time you give it, and `run` sends it in real time, followed by an
`Observer`. All errors are `PlotfeedError`. Each name is loaded when it is first asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from plotfeed.feeds.engine.engine import Engine
    from plotfeed.feeds.engine.simulation import simulate
    from plotfeed.feeds.scene.scene import Scene, load
    from plotfeed.feeds.session.observer import Observer
    from plotfeed.feeds.session.session import run
    from plotfeed.proto.errors import PlotfeedError

__all__ = ["Engine", "Observer", "PlotfeedError", "Scene", "load", "run", "simulate"]
__version__: str

_HOMES = {
    "Engine": "plotfeed.feeds.engine.engine",
    "Observer": "plotfeed.feeds.session.observer",
    "PlotfeedError": "plotfeed.proto.errors",
    "Scene": "plotfeed.feeds.scene.scene",
    "load": "plotfeed.feeds.scene.scene",
    "run": "plotfeed.feeds.session.session",
    "simulate": "plotfeed.feeds.engine.simulation",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version("plotfeed")
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
