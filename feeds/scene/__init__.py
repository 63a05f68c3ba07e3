"""Every key that a scene may have, validated, and nothing else: no clock, no socket.

A scene is read from TOML into one frozen `Scene`; sensors, presets and examples have rooms within.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from plotfeed.feeds.scene.scene import Scene, load

__all__ = ["Scene", "load"]


def __getattr__(name: str) -> Any:
    """Whoever needs some keys alone does not wait for all sensors."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from plotfeed.feeds.scene import scene

    return getattr(scene, name)
