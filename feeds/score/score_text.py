"""A score as lines of text, and as values for JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from plotfeed.feeds.console.printed import Row, finite, printable
from plotfeed.feeds.report.text_tables import number, percent, table
from plotfeed.feeds.score.score_figures import Score, SetFigures
from plotfeed.feeds.score.score_profiles import LimitVerdict
from plotfeed.proto.utc import NS, iso_utc

SETS: Mapping[str, tuple[str, str]] = {
    "gospa_m": ("GOSPA, m", ".2f"),
    "gospa_localisation_m": ("  by localisation, m", ".2f"),
    "gospa_missed_m": ("  by drones without a track, m", ".2f"),
    "gospa_false_m": ("  by tracks of no drone, m", ".2f"),
    "ospa_m": ("OSPA, m", ".2f"),
    "ospa2_m": ("OSPA(2), m", ".2f"),
    "t_gospa_m": ("T-GOSPA, m", ".2f"),
    "t_gospa_switching_m": ("  by switches, m", ".2f"),
    "completeness": ("completeness, %", "%"),
    "ambiguity": ("ambiguity, tracks a drone", ".3f"),
    "spuriousness": ("spuriousness, %", "%"),
    "position_accuracy_m": ("mean error of position, m", ".2f"),
    "velocity_accuracy_m_s": ("mean error of velocity, m/s", ".2f"),
    "longest_segment": ("longest segment, %", "%"),
    "number_changes_per_h": ("changes of number, 1/h", ".2f"),
    "breaks": ("breaks", ".0f"),
    "swaps": ("swaps", ".0f"),
}
"""Names and forms of figures of sets; % for shares."""
REPORTS: Mapping[str, tuple[str, str]] = {
    "position_rms_m": ("position, rms, m", ".2f"),
    "position_p50_m": ("position, 50 %, m", ".2f"),
    "position_p95_m": ("position, 95 %, m", ".2f"),
    "bias_east_m": ("mean error east, m", "+.2f"),
    "bias_north_m": ("mean error north, m", "+.2f"),
    "bias_up_m": ("mean error up, m", "+.2f"),
    "along_rms_m": ("along the way, rms, m", ".2f"),
    "across_rms_m": ("across the way, rms, m", ".2f"),
    "velocity_rms_m_s": ("velocity, rms, m/s", ".2f"),
    "nees": ("NEES over its freedom (1)", ".3f"),
    "nees_low": ("  of an honest tracker from", ".3f"),
    "nees_high": ("  to, in 95 of 100 runs", ".3f"),
    "lag_s": ("lag along the way, s", "+.3f"),
    "lag_se_s": ("  standard error, s", ".3f"),
    "latency_p50_s": ("latency, 50 %, s", ".3f"),
    "latency_p95_s": ("latency, 95 %, s", ".3f"),
    "latency_max_s": ("latency, most, s", ".3f"),
    "update_p50_s": ("between reports, 50 %, s", ".3f"),
    "update_p95_s": ("between reports, 95 %, s", ".3f"),
}
"""Likewise of reports."""
DRONES_TOLD = 50
"""In text; JSON has all."""


def lines(score: Score, profile: str, verdicts: Sequence[LimitVerdict]) -> Iterator[str]:
    """All lines of a score."""
    lasted_s = (score.end_utc_ns - score.start_utc_ns) / NS
    of_scene = f"scene {printable(score.scene)}, " if score.scene else ""
    yield (
        f"{printable(score.source)}: {of_scene}{len(score.drones)} drone(s), {score.tracks} "
        f"track(s), {lasted_s:.1f} s from {iso_utc(score.start_utc_ns)}"
    )
    yield (
        f"  distances {score.distances}; beyond {score.settings.cutoff_m:g} m a track is of no "
        f"drone, older than {score.settings.stale_s:g} s it is not there"
    )
    for note in notes_of(score):
        yield f"  note: {printable(note)}"
    title, header, rows, sides = set_table(score)
    yield from table(title, header, rows, sides)
    for title, header, rows, sides in tables_of(score):
        yield from table(title, header, rows[:DRONES_TOLD], sides)
        if len(rows) > DRONES_TOLD:
            yield f"  and {len(rows) - DRONES_TOLD} more; --json has all"
    if verdicts:
        yield from table(*verdict_table(profile, verdicts))
    yield ""
    yield closing(score, verdicts)


Shown = tuple[str, Row, list[Row], str]
"""A table: title, header, rows and sides."""


def notes_of(score: Score) -> Iterator[str]:
    """What of the tracker was left out, and how it failed."""
    yield from score.notes
    for reason, many in score.left_out.items():
        yield f"{many} reports: {reason}"
    if score.failure:
        yield score.failure


def set_table(score: Score) -> Shown:
    """Figures of sets, as stamped and as known."""
    known = SetFigures() if score.as_known is None else score.as_known
    rows: list[Row] = [
        (text, _told(getattr(score.as_stamped, name), form), _told(getattr(known, name), form))
        for name, (text, form) in SETS.items()
    ]
    return "Tracks beside drones, over time", ("", "as stamped", "as known"), rows, "<>>"


def tables_of(score: Score) -> Iterator[Shown]:
    """All other tables."""
    told: list[Row] = [
        (text, _told(getattr(score.reports, n), form)) for n, (text, form) in REPORTS.items()
    ]
    yield f"Reports, {score.reports.reports:.0f}, each at its own time", ("error", ""), told, "<>"
    many = len(score.drones) - score.never_tracked
    beginnings: list[Row] = [
        ("drones that had a track", f"{many} of {len(score.drones)}"),
        ("from cover to the first report, median, s", number(score.initiation_median_s, ".2f")),
        ("distance at the first report, median, m", number(score.alert_median_m, ".0f")),
        ("tracks of no drone ever", f"{score.false_tracks} of {score.tracks}"),
    ]
    yield (
        "Beginnings; drones that never had a track are in the medians",
        ("first report", ""),
        beginnings,
        "<>",
    )
    header: Row = ("drone", "cover s", "tracked %", "tracks", "breaks", "longest s")
    yield (
        "Drones",
        (*header, "first s", "at m", "rms m", "95 % m"),
        [
            (
                printable(each.drone),
                number(each.cover_s, ".1f"),
                percent(each.completeness),
                str(each.tracks),
                str(each.breaks),
                number(each.longest_s, ".1f"),
                number(each.initiation_s, ".2f"),
                number(each.alert_m, ".0f"),
                number(each.position_rms_m, ".2f"),
                number(each.position_p95_m, ".2f"),
            )
            for each in score.drones
        ],
        "<>>>>>>>>>",
    )
    yield (
        "Drones in the cover of each sensor, whoever saw them",
        ("sensor", "drones", "cover s", "tracked %", "rms m", "95 % m", "longest gap s"),
        [
            (
                printable(each.sensor),
                str(each.drones),
                number(each.cover_s, ".1f"),
                percent(each.completeness),
                number(each.position_rms_m, ".2f"),
                number(each.position_p95_m, ".2f"),
                number(each.longest_gap_s, ".1f"),
            )
            for each in score.sensors
        ],
        "<>>>>>>",
    )


def verdict_table(profile: str, verdicts: Sequence[LimitVerdict]) -> Shown:
    """Limits of a profile."""
    rows = [
        (
            each.status,
            printable(each.name),
            number(each.value, ".6g"),
            each.asked,
            str(each.of) if each.of else "",
        )
        for each in verdicts
    ]
    return printable(profile), ("", "", "is", "asked", "of"), list(rows), "<<><>"


def closing(score: Score, verdicts: Sequence[LimitVerdict]) -> str:
    """The last line: the verdict."""
    if score.failure:
        return f"The tracker failed: {printable(score.failure)}."
    if not verdicts:
        return "No profile: nothing is judged. --profile asks for limits."
    counts = {s: sum(v.status == s for v in verdicts) for s in ("failed", "not testable")}
    kept = len(verdicts) - sum(counts.values())
    told = [f"{kept} of {len(verdicts)} limits kept"]
    told += [f"{n} {status}" for status, n in counts.items() if n]
    return ", ".join(told) + "."


def as_values(score: Score, profile: str, verdicts: Sequence[LimitVerdict]) -> dict[str, Any]:
    """The score for JSON; null for what is not known."""
    values: dict[str, Any] = finite(
        {
            "scene": score.scene,
            "source": score.source,
            "start_utc": iso_utc(score.start_utc_ns),
            "end_utc": iso_utc(score.end_utc_ns),
            "dimensions": score.dimensions,
            "settings": asdict(score.settings),
            "figures": score.figures(),
            "drones": [asdict(each) for each in score.drones],
            "sensors": [asdict(each) for each in score.sensors],
            "left_out": dict(score.left_out),
            "failure": score.failure,
            "notes": list(score.notes),
            "profile": profile,
            "limits": [asdict(each) for each in verdicts],
        }
    )
    return values


def _told(value: float, form: str) -> str:
    return percent(value) if form == "%" else number(value, form)
