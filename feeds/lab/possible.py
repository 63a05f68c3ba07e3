"""What was possible: a tracker that knows whose each plot is, and what of a loss is whose fault."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from plotfeed.feeds.lab.evidence import Evidence
from plotfeed.feeds.lab.flights import FlightsTally, Truths, scene_of, stands_of
from plotfeed.feeds.lab.scoring import Score, ScoreSettings
from plotfeed.feeds.recording.recorded_plots import plots_in_rows
from plotfeed.feeds.recording.recorded_tracks import (
    LATEST_NS,
    UNKNOWN_NS,
    ReportedTracks,
    TracksRead,
)
from plotfeed.feeds.scene.fields import site_frame
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.accuracy import polar_covariance_m2
from plotfeed.models.frames import LocalFrame, aer_to_enu
from plotfeed.models.plain_tracker import predicted, updated
from plotfeed.models.state import Columns, Floats, Ints, Texts
from plotfeed.models.track_metrics import overtaken
from plotfeed.proto.utc import DAY_NS, NS

LEAST_SIGMA_M, UNMEASURED_SIGMA_M = 0.1, 300.0
SPEED_M_S = 15.0  # Standard deviation of a velocity before anything is known of it
LEAST_DENSITY_M2_S3 = 1e-3


@dataclass(frozen=True, kw_only=True)
class KnownPlots(Columns):
    """Plots of drones, (n,): whose they are, where, how exact, and when they were there to use."""

    drone: Texts
    t_utc_ns: Ints
    arrived_utc_ns: Ints  # `UNKNOWN_NS` of those that never came
    position_ecef_m: Floats
    covariance_ecef_m2: Floats


POSSIBLE = (
    *("gospa_feed_m", "gospa_link_m", "gospa_tracker_m"),
    *("possible_completeness", "possible_rms_m", "bound_rms_m"),
)


def plots_of(
    drones: Texts, plots: Any, frame: LocalFrame, arrived_utc_ns: int
) -> tuple[KnownPlots, int]:
    """Plots of drones, by names that are empty for others', and how many have no place."""
    own = drones != ""
    aer = np.stack([plots.azimuth_deg, np.nan_to_num(plots.elevation_deg), plots.range_m])
    covariance_m2 = polar_covariance_m2(plots) + LEAST_SIGMA_M**2 * np.eye(3)
    up = np.where(np.isnan(plots.elevation_deg), UNMEASURED_SIGMA_M**2, 0.0)
    covariance_m2[:, 2, 2] += up
    placed = np.isfinite(aer).all(axis=0) & np.isfinite(covariance_m2).all(axis=(1, 2))
    which = np.flatnonzero(own & placed)
    turn = frame.rotation_from_ecef
    found = KnownPlots(
        drone=drones[which],
        t_utc_ns=plots.t_utc_ns[which].astype(np.int64),
        arrived_utc_ns=np.full(len(which), arrived_utc_ns),
        position_ecef_m=frame.to_ecef(aer_to_enu(*aer[:, which])),
        covariance_ecef_m2=turn.T @ covariance_m2[which] @ turn,
    )
    return found, int(np.count_nonzero(own)) - len(which)


class RecordedRun(NamedTuple):
    """What a recording tells of a run: where drones were, and their plots."""

    truths: Truths
    plots: Sequence[KnownPlots] = ()
    placeless: int = 0  # Plots of drones that have no place


def read_run(path: Path, scene: Scene | None = None) -> RecordedRun:
    """The flights that a recording's ledger tells of, live or in simulated time, and the plots.

    Sensors stand where the scene says, the one given or the recording's own, or else where their
    descriptions in the recording do. Raises `PlotfeedError` if it is no MCAP, or holds no ledger,
    and `OSError`.
    """
    known: list[KnownPlots] = []
    placeless = 0
    with Evidence.of(path) as evidence:
        scene = scene or scene_of(path)
        frames, longest_s = stands_of(evidence.log, scene)
        tally = FlightsTally(frames, longest_s)
        for part in evidence.parts():
            tally.add(part.told)
            truths, sent = part.told.plots, part.told.messages
            came_ns = np.full(len(part.keys), LATEST_NS)  # When the first message of a sector left
            np.minimum.at(came_ns, sent.entry[sent.delivered], sent.sent_utc_ns[sent.delivered])
            came_ns[came_ns == LATEST_NS] = UNKNOWN_NS
            ends = np.searchsorted(truths.entry, np.arange(len(part.keys) + 1)).tolist()
            for n, (key, found) in enumerate(zip(part.keys, part.plots, strict=True)):
                if found and key.sensor in frames:
                    drones, frame = truths.drone[ends[n] : ends[n + 1]], frames[key.sensor]
                    measured, left_ns = plots_in_rows(found), int(came_ns[n])
                    of_drones, without = plots_of(drones, measured, frame, left_ns)
                    known.append(of_drones)
                    placeless += without
        wrong, damage = evidence.unreadable, len(evidence.log.damage)
        notes = [f"{wrong} entries are no ledger and are left out"] if wrong else []
        if damage:
            notes.append(f"the recording is damaged in {damage} places, which are left out")
        first_ns, last_ns = evidence.log.times_ns or (0, 0)
        of_run = tally.truths(
            (first_ns - DAY_NS, last_ns + DAY_NS),
            site=None if scene is None else site_frame(scene.scene.site),
            scene="" if scene is None else scene.scene.name,
            notes=notes,
        )
    return RecordedRun(of_run, known, placeless)


class Possible:
    """GOSPA, metres, of what was possible, and of the tracker; with its loss by whose fault it is.

    What sensors do not detect, or not exactly, is the feed's; what does not come, or late, the
    link's; the rest is the tracker's. Parts are of GOSPA to its order, and add up to its own.
    """

    def __init__(self, run: RecordedRun, parts: Sequence[KnownPlots], score: Score) -> None:
        truths, joined = run.truths, KnownPlots.joined(parts)
        how, p = score.settings.model_copy(update={"counts_tentative": True}), score.settings.order
        all_of = _followed(truths, joined.but(arrived_utc_ns=joined.t_utc_ns), how)
        came = _followed(truths, joined.rows(joined.arrived_utc_ns != UNKNOWN_NS), how)
        best, linked = (Score(truths, tracks, how) for tracks in (all_of, came))
        axes = slice(how.dimensions)
        spread_m2 = np.trace(linked.errors.covariance_m2[:, axes, axes], axis1=1, axis2=2)
        of_best = best.as_stamped.gospa_m
        of_linked = max((linked.as_known or linked.as_stamped).gospa_m, of_best)
        own = max((score.as_known or score.as_stamped).gospa_m, of_linked)
        self.of_feed_m = of_best
        self.of_link_m: float = (of_linked**p - of_best**p) ** (1 / p)
        self.of_tracker_m: float = (own**p - of_linked**p) ** (1 / p)
        self.completeness = best.as_stamped.completeness  # Of who knows whose each plot is
        self.position_rms_m = linked.reports.position_rms_m
        # The least that this error is in the mean of many such runs, whatever the tracker, by plots
        # that came: posterior Cramer and Rao, of drones that turn at random as hard as these did.
        # In one run it may be smaller by chance, as errors of one flight hang together.
        self.bound_m = float(np.sqrt(spread_m2.mean())) if len(spread_m2) else np.nan
        # Plots of drones that tell no place by themselves, or not how exact it is: not in it.
        self.placeless = run.placeless

    def figures(self) -> dict[str, float]:
        """Figures by name, those of `POSSIBLE`."""
        return dict(zip(POSSIBLE, vars(self).values(), strict=False))

    def __str__(self) -> str:
        parts = {"feed": self.of_feed_m, "link": self.of_link_m, "tracker": self.of_tracker_m}
        worst = max(parts, key=lambda name: parts[name])
        told = ", ".join(f"{name} {value:.1f} m" for name, value in parts.items())
        less = f"; {self.placeless} plots without a place are not in it" if self.placeless else ""
        return (
            f"GOSPA by whose fault: {told}: most is the {worst}'s. Who knows whose each plot is "
            f"has {self.completeness:.1%} of the drones, to {self.position_rms_m:.1f} m; in the "
            f"mean of many such runs no tracker does better than {self.bound_m:.1f} m{less}"
        )


def possible(run: RecordedRun, score: Score) -> Possible | None:
    """What could have been made of the plots; None where none of them has a place."""
    parts = [each for each in run.plots if len(each)]
    return Possible(run, parts, score) if parts else None


def _followed(truths: Truths, plots: KnownPlots, how: ScoreSettings) -> TracksRead:
    """Tracks of each drone by its own plots, as they came.

    Kalman's filter, which knows how hard each drone turns. Between plots there is a report each
    step, as long as its error is less than half the cut-off.
    """
    frame, count, step_ns = truths.middle, len(truths.drones), round(how.step_s * NS)
    number = {name: n for n, name in enumerate(truths.drones)}
    plots = plots.rows(np.array([name in number for name in plots.drone], np.bool_))
    drone = np.array([number[name] for name in plots.drone], np.int64)
    order = np.lexsort((plots.t_utc_ns, plots.arrived_utc_ns, drone))
    plots, drone = plots.rows(order), drone[order]
    late = overtaken(drone, plots.t_utc_ns)
    plots, drone = plots.rows(~late), drone[~late]
    place_m = frame.from_ecef(plots.position_ecef_m)
    turn = frame.rotation_from_ecef
    covariance_m2 = turn @ plots.covariance_ecef_m2 @ turn.T
    first = np.searchsorted(drone, np.arange(count + 1))
    last_ns = np.array([path.t_utc_ns[-1] if len(path.t_utc_ns) else 0 for path in truths.paths])
    until_ns = np.append(plots.arrived_utc_ns[1:], 0)
    until_ns[first[1:][first[1:] > first[:-1]] - 1] = last_ns[first[1:] > first[:-1]]
    density = np.full((count, 1), LEAST_DENSITY_M2_S3)  # White acceleration that turns it as hard
    for own, path in zip(density, truths.paths, strict=True):
        if len(path.t_utc_ns) > 1 and (span_s := float(np.ptp(path.t_utc_ns)) / NS):
            change = np.diff(path.velocity_ecef_m_s, axis=0)
            own[0] = max(float((change**2).sum()) / span_s / 2, LEAST_DENSITY_M2_S3)
    states, spread = np.zeros((count, 6)), np.zeros((count, 6, 6))
    spread[:] = SPEED_M_S**2 * np.eye(6)
    at_ns = np.zeros(count, np.int64)
    found: list[tuple[Ints, Ints, Ints, Floats, Floats]] = []
    for k in range(int(np.diff(first).max(initial=0))):
        own = np.flatnonzero(np.diff(first) > k)
        rows = first[own] + k
        if k:
            since_s = (plots.t_utc_ns[rows] - at_ns[own]) / NS
            before = predicted(states[own], spread[own], since_s, density[own])
            states[own], spread[own] = updated(*before, place_m[rows], covariance_m2[rows])
        else:
            states[own, :3], spread[own, :3, :3] = place_m[rows], covariance_m2[rows]
        at_ns[own], came_ns = plots.t_utc_ns[rows], plots.arrived_utc_ns[rows]
        found.append((at_ns[own], came_ns, own, states[own], spread[own]))
        going, now_ns = own, came_ns + step_ns
        while len(going):
            goes_on = now_ns < until_ns[first[going] + k]
            going, now_ns = going[goes_on], now_ns[goes_on]
            since_s = (now_ns - at_ns[going]) / NS
            later = predicted(states[going], spread[going], since_s, density[going])
            sure = np.trace(later[1][:, :2, :2], axis1=1, axis2=2) < (how.cutoff_m / 2) ** 2
            going, now_ns = going[sure], now_ns[sure]
            found.append((now_ns, now_ns, going, later[0][sure], later[1][sure]))
            now_ns = now_ns + step_ns
    none = (np.zeros(0, np.int64),) * 3 + (np.zeros((0, 6)), np.zeros((0, 6, 6)))
    t_ns, known_ns, track, state, errors_m2 = (
        np.concatenate(column) for column in zip(*(found or [none]), strict=True)
    )
    latitude_deg, longitude_deg, height_m = frame.to_geodetic(state[:, :3])
    reports = ReportedTracks(
        t_utc_ns=t_ns,
        received_utc_ns=known_ns,
        track=track,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        height_m=height_m,
        velocity_enu_m_s=state[:, 3:],
        covariance_m2=errors_m2[:, :3, :3],
        tentative=np.zeros(len(track), np.bool_),
        ended=np.zeros(len(track), np.bool_),
    )
    return TracksRead(reports=reports, names=list(truths.drones), source="possible")
