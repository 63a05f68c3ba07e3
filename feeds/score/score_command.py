"""`plotfeed score`: flights of a recording beside a tracker's tracks; text, JSON, HTML, XML."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from io import BufferedWriter
from pathlib import Path

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.console.printed import say
from plotfeed.feeds.console.process import new_file, refuse_if_there
from plotfeed.feeds.score.feed_checks import as_json, as_text, check_feed
from plotfeed.feeds.score.flights_told import read_truths, scene_of
from plotfeed.feeds.score.junit_xml import junit_of
from plotfeed.feeds.score.score_figures import Score
from plotfeed.feeds.score.score_page import html_of
from plotfeed.feeds.score.score_profiles import (
    LimitVerdict,
    ScoreProfile,
    is_kept,
    load_profile,
    verdicts_of,
)
from plotfeed.feeds.score.score_settings import ScoreSettings
from plotfeed.feeds.score.score_text import as_values, lines
from plotfeed.feeds.score.scoring import score_run
from plotfeed.feeds.score.track_files import read_tracks
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.utc import DAY_NS

KEPT, BROKEN = 0, 1
"""Exit codes."""
NO_PROFILE = "no profile"


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreOptions:
    """What `plotfeed score` is asked, in the words of its options."""

    tracks: Path | None = None
    """The file of tracks; without it they are in the recording."""
    topics: Sequence[str] = ()
    out: Path | None = None
    junit: Path | None = None
    profile: str | None = None
    cutoff_m: float | None = None
    stale_s: float | None = None
    protect: str | None = None
    """LATITUDE,LONGITUDE."""
    feed: bool = False
    """Whether the feed is checked, and no tracker."""
    as_json: bool = False
    force: bool = False


def score_recording(recording: Path, options: ScoreOptions) -> int:
    """Score a tracker and print what it came to; the exit code.

    That is 1 where the tracker failed or a limit of the profile is broken, or the feed is not as
    claimed. Raises `PlotfeedError` and `OSError`.
    """
    if options.feed:
        return _check_feed(recording, options)
    for path in (options.out, options.junit):
        if path is not None:
            refuse_if_there(path, force=options.force)  # before anything is read in vain
    if options.out is not None:
        need_extra("matplotlib.figure", "a chart", "charts")
    profile = None if options.profile is None else load_profile(options.profile)
    settings = settings_of(profile, options)
    scene = scene_of(recording)
    truths = read_truths(recording, scene)
    file = recording if options.tracks is None else options.tracks
    first_ns = min((int(p.t_utc_ns[0]) for p in truths.paths if len(p.t_utc_ns)), default=0)
    tracks = read_tracks(file, scene, options.topics, date_utc_ns=first_ns // DAY_NS * DAY_NS)
    score = score_run(truths, tracks, settings)
    verdicts = [] if profile is None else verdicts_of(score, profile)
    publish(score, profile, verdicts, options)
    return KEPT if is_kept(verdicts, score.failure) else BROKEN


def _check_feed(recording: Path, options: ScoreOptions) -> int:
    """Check the feed and print what it came to."""
    for name in ("tracks", "topics", "out", "junit", "profile", "cutoff_m", "stale_s", "protect"):
        if getattr(options, name):
            option = {"topics": "topic"}.get(name, name.replace("_", "-"))
            raise PlotfeedError(f"--feed checks sensors, and --{option} is about a tracker")
    verdict = check_feed(recording)
    if options.as_json:
        say(json.dumps(as_json(verdict)))
    else:
        for line in as_text(verdict):
            say(line)
    return BROKEN if verdict.wrong else KEPT


def settings_of(profile: ScoreProfile | None, options: ScoreOptions) -> ScoreSettings:
    """How tracks are scored: as the profile says, and as options say that stand before it."""
    found = ScoreSettings() if profile is None else profile.score_settings()
    if options.cutoff_m is not None:
        found = replace(found, cutoff_m=options.cutoff_m)
    if options.stale_s is not None:
        found = replace(found, stale_s=options.stale_s)
    if options.protect is not None:
        parts = options.protect.split(",")
        try:
            latitude_deg, longitude_deg = map(float, parts)
        except ValueError:
            raise PlotfeedError(
                f"--protect: expected LATITUDE,LONGITUDE in degrees, not {options.protect!r}"
            ) from None
        found = replace(found, protected_deg=(latitude_deg, longitude_deg))
    return found


def publish(
    score: Score,
    profile: ScoreProfile | None,
    verdicts: Sequence[LimitVerdict],
    options: ScoreOptions,
) -> None:
    """Print a score, and write the files that are asked for."""
    title = "" if profile is None else profile.profile.title
    note = "" if profile is None else profile.profile.note
    if options.out is not None:
        _write(options.out, html_of(score, title, note, verdicts).encode(), force=options.force)
    if options.junit is not None:
        text = junit_of(score, title or NO_PROFILE, verdicts)
        _write(options.junit, text, force=options.force)
    if options.as_json:
        say(json.dumps(as_values(score, title, verdicts)))
    else:
        for line in lines(score, title, verdicts):
            say(line)


def _write(path: Path, octets: bytes, *, force: bool) -> None:
    with BufferedWriter(new_file(path, force=force)) as file:
        file.write(octets)
