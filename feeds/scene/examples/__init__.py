"""The scenes that come with plotfeed, and what each of them is about."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from types import MappingProxyType

from plotfeed.feeds.scene.scene_head import head_of

FIRST = "field-day"
"""Listed before the others: the one of the demo."""


@cache
def summaries() -> MappingProxyType[str, str]:
    """What each scene is about, in a sentence, by its name: the first one that its file says."""
    found = {
        file.name.removesuffix(".toml"): head_of(file.read_text(encoding="utf-8")).summary
        for file in files(__name__).iterdir()
        if file.name.endswith(".toml")
    }
    names = sorted(found, key=lambda name: (name != FIRST, name))
    return MappingProxyType({name: found[name] for name in names})
