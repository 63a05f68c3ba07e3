"""Profiles: limits on a tracker's figures, and what of a score keeps them."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, ValidationError, model_validator

from plotfeed.feeds.scene.fields import SceneTable
from plotfeed.feeds.scene.problems import in_a_line, problems_of
from plotfeed.feeds.score.score_figures import FIGURE_NAMES, Score
from plotfeed.feeds.score.score_settings import ScoreSettings
from plotfeed.models.state import Floats
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import NS

SUFFIX = ".toml"
MAX_OCTETS = 1 << 20
Seconds = Annotated[float, Field(gt=0, le=86_400)]
Metres = Annotated[float, Field(gt=0, le=1e7)]


class ScoreLimit(SceneTable):
    """One figure, and what it must not pass."""

    figure: str
    """Which, as `plotfeed score --json` names it, or update_share, long_gap_share, far_share."""
    at_most: float | None = None
    at_least: float | None = None
    period_s: Seconds | None = None
    """Of update_share: the share of such periods in which a drone in cover was reported."""
    longer_than_s: Seconds | None = None
    """Of long_gap_share: the share of drones' time in cover that lies in longer gaps."""
    beyond_m: Metres | None = None
    """Of far_share: the share of reports that are further from any drone."""
    name: Annotated[str, Field(max_length=200)] = ""
    """What the limit is called; without it, by its figure."""

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if (self.at_most is None) == (self.at_least is None):
            raise ValueError("expected at_most or at_least")
        needed = PARAMETERS.get(self.figure)
        if needed is None and self.figure not in FIGURE_NAMES:
            raise ValueError(
                f"figure: expected one of {', '.join(PARAMETERS)}, or of the figures of a score"
            )
        for parameter in PARAMETERS.values():
            is_there = getattr(self, parameter) is not None
            if is_there != (parameter == needed):
                verb = "is not of" if is_there else "is needed by"
                raise ValueError(f"{parameter}: {verb} {self.figure}")
        return self

    @property
    def title(self) -> str:
        """The name, or the figure and its bound."""
        return self.name or f"{self.figure} {self.asked}"

    @property
    def asked(self) -> str:
        """What is asked, in words."""
        if self.at_most is not None:
            return f"at most {self.at_most:g}"
        return f"at least {self.at_least:g}"


class ProfileHead(SceneTable):
    """What a profile is."""

    title: Annotated[str, Field(max_length=200)]
    note: Annotated[str, Field(max_length=2000)] = ""


class ScoreProfile(SceneTable):
    """A file of limits."""

    profile: ProfileHead
    settings: dict[str, Any] = Field(default_factory=dict)
    limit: Annotated[list[ScoreLimit], Field(min_length=1, max_length=1000)]

    def score_settings(self) -> ScoreSettings:
        """How tracks are scored for it; raises `PlotfeedError`."""
        return ScoreSettings.of(self.settings)


PARAMETERS = {
    "update_share": "period_s",
    "long_gap_share": "longer_than_s",
    "far_share": "beyond_m",
}
"""Figures that need one more number."""


def shipped_profiles() -> list[str]:
    """The names of the profiles that come with plotfeed."""
    folder = files(__package__) / "profiles"
    names = (entry.name for entry in folder.iterdir())
    return sorted(name.removesuffix(SUFFIX) for name in names if name.endswith(SUFFIX))


def load_profile(name: str) -> ScoreProfile:
    """The profile in a file, or one that comes with plotfeed; raises `PlotfeedError`, `OSError`."""
    path = Path(name)
    if path.suffix == SUFFIX or path.is_file():
        if path.stat().st_size > MAX_OCTETS:
            raise PlotfeedError(f"{name}: expected a profile, of at most {MAX_OCTETS} octets")
        data = path.read_bytes()
    elif name in shipped_profiles():
        data = (files(__package__) / "profiles" / f"{name}{SUFFIX}").read_bytes()
    else:
        raise PlotfeedError(
            f"{name}: expected a file that ends in {SUFFIX}, or one of "
            f"{', '.join(shipped_profiles())}"
        )
    try:
        tree = tomllib.loads(data.decode("utf-8-sig"))
        found = ScoreProfile.model_validate(tree)
        found.score_settings()
    except ValidationError as error:
        raise PlotfeedError(f"{name}: {in_a_line(problems_of(error, tree))}") from None
    except (ValueError, RecursionError) as error:
        raise PlotfeedError(f"{name}: no TOML: {error}") from None
    except PlotfeedError as error:
        raise PlotfeedError(f"{name}: settings.{error}") from None
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitVerdict:
    """A limit, and whether a score keeps it."""

    name: str
    figure: str
    asked: str
    value: float
    status: Literal["passed", "failed", "not testable"]
    of: int
    """How many reports, periods or drones the figure is of; 0 where that says nothing."""

    @property
    def told(self) -> str:
        """The figure beside what is asked."""
        value = f"{self.value:.6g}" if math.isfinite(self.value) else "not known"
        many = f" (of {self.of})" if self.of else ""
        return f"{self.figure} {value}{many}, asked {self.asked}"


def verdicts_of(score: Score, profile: ScoreProfile) -> list[LimitVerdict]:
    """Every limit of a profile, in its order."""
    return [_verdict(score, limit) for limit in profile.limit]


def _verdict(score: Score, limit: ScoreLimit) -> LimitVerdict:
    worked_out = _WORKED_OUT.get(limit.figure)
    if worked_out is None:
        value, of = score.figures()[limit.figure], 0
    else:
        value, of = worked_out(score, getattr(limit, PARAMETERS[limit.figure]))
    status: Literal["passed", "failed", "not testable"] = "not testable"
    if not math.isnan(value):
        most = math.inf if limit.at_most is None else limit.at_most
        least = -math.inf if limit.at_least is None else limit.at_least
        status = "passed" if least <= value <= most else "failed"
    return LimitVerdict(
        name=limit.title,
        figure=limit.figure,
        asked=limit.asked,
        value=value,
        status=status,
        of=of,
    )


def update_share(score: Score, period_s: float) -> tuple[float, int]:
    """The share of whole periods in cover in which a drone was reported, and how many they are."""
    period_ns, reported, periods = round(period_s * NS), 0, 0
    for drone, stays in enumerate(score.over_time.stays_utc_ns):
        cells = score.errors.t_utc_ns[score.errors.drone == drone] // period_ns
        for begin_ns, end_ns in stays:
            first, end = -(-begin_ns // period_ns), end_ns // period_ns
            if end > first:
                periods += end - first
                reported += len(np.unique(cells[(cells >= first) & (cells < end)]))
    return (reported / periods if periods else math.nan), periods


def long_gap_share(score: Score, longer_than_s: float) -> tuple[float, int]:
    """The share of the time of drones in cover that lies in gaps longer than that.

    A gap is from one report of the drone to the next, from when it comes to its first, and from
    its last to when it goes. Beside it stands how many gaps there are.
    """
    longest_ns, long_ns, whole_ns, gaps = round(longer_than_s * NS), 0, 0, 0
    for drone, stays in enumerate(score.over_time.stays_utc_ns):
        times = np.sort(score.errors.t_utc_ns[score.errors.drone == drone])
        for begin_ns, end_ns in stays:
            inside = times[(times >= begin_ns) & (times <= end_ns)]
            between = np.diff(np.concatenate([[begin_ns], inside, [end_ns]]))
            gaps += len(between)
            long_ns += int(between[between > longest_ns].sum())
            whole_ns += end_ns - begin_ns
    return (long_ns / whole_ns if whole_ns else math.nan), gaps


def far_share(score: Score, beyond_m: float) -> tuple[float, int]:
    """The share of reports that are further over the ground from any drone, and of how many."""
    known: Floats = score.nearest_m[np.isfinite(score.nearest_m)]
    far = int(np.count_nonzero(known > beyond_m))
    return (far / len(known) if len(known) else math.nan), len(known)


_WORKED_OUT: dict[str, Callable[[Score, float], tuple[float, int]]] = {
    "update_share": update_share,
    "long_gap_share": long_gap_share,
    "far_share": far_share,
}


def is_kept(verdicts: Sequence[LimitVerdict], failure: str) -> bool:
    """Whether no limit is broken, and the tracker did not fail."""
    return not failure and all(each.status != "failed" for each in verdicts)
