"""Who looks at the page: what presenter and audience may see and do, and who did what."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Mapping
from enum import StrEnum
from typing import Any, NamedTuple

from plotfeed.feeds.console.printed import in_short
from plotfeed.proto.errors import PlotfeedError

KEPT_ACTIONS = 40
MAX_NAME, MAX_WORDS = 40, 160  # Characters of a viewer's name, and of what he did
# Counts that say what only the truth knows.
TRUE_TOTALS = frozenset({"drones", "forgotten", "looks", "false_alarms", "telemetry", "refused"})
GIFTS = ("truth", "controls")


class Role(StrEnum):
    """The address by which a viewer came: presenter or audience."""

    PRESENTER = "presenter"
    AUDIENCE = "audience"


class NotAllowed(PlotfeedError):  # noqa: N818 - what is so, not what broke
    """A viewer asked for what his role does not allow."""


class Action(NamedTuple):
    """What somebody did on the page."""

    t_utc_ms: int
    who: str
    what: str


class Audience:
    """What the presenter has given the audience, and a log of what was done."""

    def __init__(self) -> None:
        self.truth = False
        self.controls = False
        self._numbers = dict.fromkeys(Role, 0)
        self._actions: deque[Action] = deque(maxlen=KEPT_ACTIONS)

    @property
    def news(self) -> dict[str, bool]:
        """What is given, as every page is told."""
        return {gift: getattr(self, gift) for gift in GIFTS}

    @property
    def actions(self) -> list[dict[str, Any]]:
        """The log, the oldest action first."""
        return [action._asdict() for action in self._actions]

    def called(self, role: Role) -> str:
        """What the next viewer of that role is called."""
        self._numbers[role] += 1
        return f"{role} {self._numbers[role]}"

    def log(self, t_utc_ns: int, who: str, command: Mapping[str, Any]) -> None:
        """Somebody did that."""
        self._actions.append(Action(t_utc_ns // 1_000_000, who, words_of(command)))

    def check_look(self, role: Role, *, truth: bool) -> None:
        """Raise `NotAllowed` if who has that role may not see the truth that he asks for."""
        if truth and role is Role.AUDIENCE and not self.truth:
            raise NotAllowed("the audience sees no truth unless the presenter gives it")

    def check_command(self, role: Role, command: Mapping[str, Any]) -> None:
        """Raise `NotAllowed` if who has that role may not ask for that."""
        if role is Role.PRESENTER:
            return
        if "audience" in command:
            raise NotAllowed("only the presenter says what the audience may do")
        if not self.controls:
            raise NotAllowed("the audience has no controls unless the presenter gives them")

    def give(self, asked: object) -> None:
        """Give or take what a presenter's command says; raises `PlotfeedError`."""
        if not isinstance(asked, dict) or not asked or asked.keys() - set(GIFTS):
            raise PlotfeedError(f"audience: expected {' or '.join(GIFTS)}")
        if not all(isinstance(given, bool) for given in asked.values()):
            raise PlotfeedError("audience: expected true or false")
        for gift, given in asked.items():
            setattr(self, gift, given)


def name_in(text: object) -> str:
    """A viewer's name of himself, as it may be shown; raises `PlotfeedError`."""
    if not isinstance(text, str):
        raise PlotfeedError("look: expected a name in words")
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())[:MAX_NAME]


def words_of(command: Mapping[str, Any]) -> str:
    """A command in a few words."""
    asked = dict(command)
    if "sensor" in asked:
        told = f"{asked.pop('sensor')}: {', '.join(_leaves(asked))}"
    else:
        told = ", ".join(
            f"{subject}: {', '.join(_leaves(tree))}"
            if isinstance(tree, dict)
            else ", ".join(_leaves({subject: tree}))
            for subject, tree in asked.items()
        )
    return told[:MAX_WORDS]


def _leaves(tree: object, path: str = "") -> list[str]:
    """Every value of a tree, after the keys that lead there."""
    if isinstance(tree, dict) and tree:
        keys = (
            (f"{path} {key}" if path and path != "set" else str(key), tree[key]) for key in tree
        )
        return [leaf for path, below in keys for leaf in _leaves(below, path)]
    said = tree if isinstance(tree, str) else json.dumps(in_short(tree))
    return [path if tree is True else f"{path} {said}".strip()]


def without_truth(told: Mapping[str, Any]) -> dict[str, Any]:
    """News as the audience has them, as long as it is not given the truth."""
    shown = dict(told)
    if "totals" in told:
        shown["totals"] = {k: v for k, v in told["totals"].items() if k not in TRUE_TOTALS}
    if "details" in told:
        shown["details"] = {
            sensor: {**of, "detections": None} for sensor, of in told["details"].items()
        }
    if "scene" in told:
        shown["scene"] = {**told["scene"], "about": {**told["scene"]["about"], "look_for": []}}
    if "refusal" in told:
        shown["refusal"] = None
    return shown


# Keys of news that the audience has otherwise.
CONCEALS = frozenset({"totals", "details", "scene", "refusal"})
