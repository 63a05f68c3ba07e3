"""Help for tests of your own tracker: scenes in a few words, their feeds, a broker, a receiver."""

from plotfeed.feeds.testing.built_scene import (
    SITE,
    flown,
    held,
    radar,
    rotating,
    scene,
    staring,
    waypoint,
)
from plotfeed.feeds.testing.flown_feed import START_NS, Feed, FeedTable, fly
from plotfeed.feeds.testing.mqtt_receiver import MqttMessage, MqttReceiver
from plotfeed.feeds.testing.own_broker import broker

__all__ = [
    "SITE",
    "START_NS",
    "Feed",
    "FeedTable",
    "MqttMessage",
    "MqttReceiver",
    "broker",
    "flown",
    "fly",
    "held",
    "radar",
    "rotating",
    "scene",
    "staring",
    "waypoint",
]
