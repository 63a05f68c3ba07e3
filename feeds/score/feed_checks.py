"""Whether a feed is as its sensors claim, as a tracker sees it: each check named and judged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.feeds.console.printed import finite
from plotfeed.feeds.engine.simulation import SimulatedSensor
from plotfeed.feeds.report.asked_sensors import AskedSensor
from plotfeed.feeds.report.text_tables import table
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.score.claimed_feed import (
    BelievedSensor,
    ClaimedLooks,
    SensorFeed,
    left_of_pd,
)
from plotfeed.feeds.score.feed_reading import recorded_feeds
from plotfeed.feeds.score.feed_residuals import feed_checks
from plotfeed.models.chance import Chance
from plotfeed.models.scoring.residuals import ResidualCheck, judged_wrong
from plotfeed.proto.measured_plots import MeasuredPlots

FALSE_RATE = 0.01
"""Share of right feeds, all sensors of a recording together, of which anything is called wrong."""
CARRIED = (
    "channel", "range_m", "bistatic_range_m", "azimuth_deg", "elevation_deg", "sigma_range_m",
    "sigma_bistatic_range_m", "sigma_azimuth_deg", "sigma_elevation_deg",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedCheck:
    """A check of one sensor's feed, and whether it fails."""

    sensor: str
    check: ResidualCheck
    wrong: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class FeedVerdict:
    """What of feeds is not as it is claimed."""

    checks: Sequence[JudgedCheck]
    carriers: Mapping[str, str]
    """From which messages each sensor's plots are."""
    lost: Mapping[str, int]
    """Sectors of each sensor whose plots did not arrive, which are left out."""
    notes: Sequence[str]
    false_rate: float = FALSE_RATE

    @property
    def wrong(self) -> list[JudgedCheck]:
        """The checks that fail."""
        return [each for each in self.checks if each.wrong]


def check_feed(path: Path) -> FeedVerdict:
    """Check the feeds of a recording; raises `PlotfeedError` without a ledger, and `OSError`."""
    found = recorded_feeds(path)
    return FeedVerdict(
        checks=judged(found.sensors),
        carriers=found.carriers,
        lost=found.lost,
        notes=found.notes,
    )


def judged(feeds: Mapping[str, SensorFeed], false_rate: float = FALSE_RATE) -> list[JudgedCheck]:
    """All checks of all sensors, judged together."""
    rows = [(sensor, check) for sensor, feed in feeds.items() for check in feed_checks(feed)]
    wrong = judged_wrong([check for _, check in rows], false_rate)
    return [
        JudgedCheck(sensor=sensor, check=check, wrong=is_wrong)
        for (sensor, check), is_wrong in zip(rows, wrong, strict=True)
    ]


def simulated_feed(scene: Scene, seen: SimulatedSensor, sectors: int = 0) -> SensorFeed:
    """The feed of a simulated sensor, stamped by its own clock; links and formats are left out.

    `sectors` is of how many it is, empty ones too, where the simulation does not tell.
    """
    keys, plots, looks = seen.sensor, seen.plots, seen.looks
    asked = AskedSensor(keys, scene.scene.site, Chance(scene.scene.seed, keys.id), None)
    per_scan = keys.scan.sectors
    numbers = np.unique(
        np.concatenate([each.scan * per_scan + each.sector for each in (plots, looks)])
    )
    order = np.argsort(looks.scan * per_scan + looks.sector, kind="stable")
    looks = looks.rows(order)
    plots = plots.rows(np.argsort(plots.scan * per_scan + plots.sector, kind="stable"))
    measured = MeasuredPlots.of([{}] * len(plots)).but(
        t_utc_ns=(plots.t_utc_ns + keys.clock_ahead_ns).astype(np.object_),
        category=np.zeros(len(plots), np.int64),
        **{name: np.ascontiguousarray(getattr(plots, name)) for name in CARRIED},
    )
    left = left_of_pd(asked)
    pd = np.minimum(looks.pd / left, 1.0) if left > 0 else np.zeros(len(looks))
    return SensorFeed(
        ClaimedLooks(
            sector=np.searchsorted(numbers, looks.scan * per_scan + looks.sector),
            channel=looks.channel,
            target=looks.drone,
            t_utc_ns=looks.t_utc_ns,
            range_m=looks.range_m,
            azimuth_deg=looks.azimuth_deg,
            elevation_deg=looks.elevation_deg,
            pd=pd,
            counts=np.full(len(looks), left > 0),
        ),
        measured,
        np.searchsorted(numbers, plots.scan * per_scan + plots.sector),
        np.zeros(max(len(numbers), 1), np.int64),
        [BelievedSensor.by(asked)],
        (sectors or len(seen.sectors)) / per_scan,
    )


HEADINGS = ("sensor", "check", "claimed", "found", "+-", "", "z", "of", "verdict")
SIDES = "<<>>><>>"


def as_text(verdict: FeedVerdict) -> list[str]:
    """The verdict in lines."""
    rows, before = [], ""
    for each in verdict.checks:
        name = "" if each.sensor == before else each.sensor
        before = each.sensor
        rows.append((name, *_cells(each)))
    lines = list(table("The feed beside its claims, as a tracker sees it", HEADINGS, rows, SIDES))
    if not rows:
        lines.append("  no sensor's plots can be read")
    for sensor, carrier in verdict.carriers.items():
        lost = verdict.lost.get(sensor, 0)
        left_out = f"; {lost} sectors that did not arrive are left out" if lost else ""
        lines.append(f"  {sensor}: by {carrier}{left_out}")
    lines += [f"  {note}" for note in verdict.notes]
    number = sum(not np.isnan(each.check.p) for each in verdict.checks)
    wrong = verdict.wrong
    what = f"{len(wrong)} not as claimed" if wrong else "all as claimed"
    lines.append(
        f"{number} checks: {what}. "
        f"Of right feeds {100 * verdict.false_rate:g} % are called wrong somewhere."
    )
    return lines


def _cells(each: JudgedCheck) -> tuple[str, ...]:
    check = each.check
    if np.isnan(check.p):
        return (check.name, "", "", "", "", "", "", f"not judged: {check.why_not}")
    return (
        check.name,
        f"{check.claimed:.4g}",
        f"{check.found:.4g}",
        f"{check.sigma:.2g}",
        check.unit,
        f"{check.z:+.1f}",
        str(check.of),
        "WRONG" if each.wrong else "ok",
    )


def as_json(verdict: FeedVerdict) -> dict[str, Any]:
    """The verdict for JSON."""
    found: dict[str, Any] = finite(
        {
            "false_rate": verdict.false_rate,
            "wrong": [f"{each.sensor}: {each.check.name}" for each in verdict.wrong],
            "checks": [
                {
                    "sensor": each.sensor,
                    **asdict(each.check),
                    "z": each.check.z,
                    "wrong": each.wrong,
                }
                for each in verdict.checks
            ],
            "carriers": dict(verdict.carriers),
            "lost_sectors": dict(verdict.lost),
            "notes": list(verdict.notes),
        }
    )
    return found
