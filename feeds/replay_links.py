"""The links that a replay is told of on the command line: a TOML file, or a few figures."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from plotfeed.feeds.impairment.settings import Link
from plotfeed.feeds.replay_settings import LinkRule, ReplayError
from plotfeed.feeds.scene_problems import problems_of

MAX_OCTETS = 1 << 20


def link_rule(text: str) -> LinkRule:
    """From FILE, for all topics, or TOPIC=FILE; raises `ReplayError`.

    The file holds the keys of a scene's [sensor.link].
    """
    topic, equals, name = text.rpartition("=")
    if equals and not topic:
        raise ReplayError(f"link: expected FILE or TOPIC=FILE, not {text!r}")
    return LinkRule(topic, link_in(Path(name)))


def link_in(path: Path) -> Link:
    """The link in a file; raises `ReplayError`."""
    try:
        with path.open("rb") as file:
            tree = tomllib.loads(file.read(MAX_OCTETS).decode())
    except OSError as error:
        raise ReplayError(f"{path}: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise ReplayError(f"{path}: not TOML: {error}") from None
    return _checked(tree, f"{path}: ")


def simple_link(
    latency_ms: float | None, jitter_ms: float | None, loss: float | None
) -> LinkRule | None:
    """Of all topics, with those figures; None if there are none. Raises `ReplayError`."""
    tree: dict[str, Any] = {"latency_ms": latency_ms, "jitter_ms": jitter_ms}
    if loss is not None:
        tree["loss"] = {"kind": "random", "probability": loss}
    tree = {key: value for key, value in tree.items() if value is not None}
    return LinkRule("", _checked(tree, "link: ")) if tree else None


def _checked(tree: dict[str, Any], where: str) -> Link:
    try:
        return Link.model_validate(tree)
    except ValidationError as error:
        problems = problems_of(error, tree)
        lines = [f"{where}{key}: {text}" if key else f"{where}{text}" for key, text in problems]
        raise ReplayError("\n".join(lines)) from None
