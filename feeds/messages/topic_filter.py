"""Topic filters of MQTT, with + for a level and # for the rest."""

from __future__ import annotations

from plotfeed.proto.errors import PlotfeedError


def checked(topic_filter: str) -> str:
    """The text, if it is a topic filter; raises `PlotfeedError` if it is none."""
    levels = topic_filter.split("/")
    for place, level in enumerate(levels):
        alone = len(level) == 1 and (level == "+" or place == len(levels) - 1)
        if ("+" in level or "#" in level) and not alone:
            raise PlotfeedError(f"{topic_filter!r}: + is a whole level, # is the last one")
    return topic_filter


def matches(topic_filter: str, topic: str) -> bool:
    """Whether a topic is one of those that the filter is for."""
    wanted, levels = topic_filter.split("/"), topic.split("/")
    for place, level in enumerate(wanted):
        if level == "#":
            return True
        if place >= len(levels) or level not in ("+", levels[place]):
            return False
    return len(wanted) == len(levels)
