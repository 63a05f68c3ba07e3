"""What is wrong with tracks as a whole: units, datums, clocks, axes; and the score without it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from plotfeed.feeds.lab.flights import Truths
from plotfeed.feeds.lab.scoring import Score, ScoreSettings, nearest_drones, truth_beside
from plotfeed.feeds.recording.recorded_tracks import UNKNOWN_NS, ReportedTracks, TracksRead
from plotfeed.models.frames import geodetic_to_ecef, geoid_undulation_m
from plotfeed.models.state import Floats, Ints
from plotfeed.models.track_metrics import Level, along_enu
from plotfeed.models.verdicts import FittedEffect, deviation, joint_fit
from plotfeed.proto.units import FOOT_M
from plotfeed.proto.utc import DAY_NS, NS

MOST, MOST_PAIRS = 400, 20_000  # Reports that are looked at, and those times drones
FEWEST = 20
GROSS_M = 60.0  # Half of the reports further off than this: then times may be wrong by seconds
# Errors from which on being wrong counts hardly more: over the ground, of height, of velocity.
SCALES = (10.0, 10.0, 3.0)
FAR_M = 20_000.0
# What a candidate must save: of the mean of the logarithms of squares, and in standard errors.
SAVED, SURE = 0.3, 5.0
GATE_M = 1000.0  # Further from any drone than this, a report says nothing of what is wrong
CLOCK_S = 120  # Of clocks, looked for in whole seconds either way
CLOCK = "clock "
KNOT_M_S = 1852.0 / 3600.0
Change = Callable[[ReportedTracks], ReportedTracks]


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """What is wrong, the first the worst, and the score that there would be without it."""

    findings: tuple[str, ...]
    without: Score


def diagnosed(truths: Truths, tracks: TracksRead, how: ScoreSettings) -> Diagnosis | None:
    """What is wrong with all tracks alike; None where nothing is, or too little is there to say."""
    look = _Look(truths)
    told, findings = tracks.reports, list[str]()
    rows = look.some(told)
    if len(rows) < FEWEST:
        return None
    cost, clock_s = look.costs(rows), 0.0
    while found := look.best(rows, cost):
        text, change, cost = found
        if text.startswith(CLOCK):
            clock_s += float(text.removeprefix(CLOCK))
        else:
            findings.append(text)
        told, rows = change(told), change(rows)
    fitted = look.fitted(rows)
    for each in fitted:
        told = look.without(told, each)
    if clock_s and not any(each.name == "clock" for each in fitted):
        fitted.append(FittedEffect("clock", 0.0, 1.0, ()))
    findings += [_words(e._replace(value=e.value + clock_s * (e.name == "clock"))) for e in fitted]
    if not findings:
        return None
    without = Score(truths, replace(tracks, reports=told), how)
    return Diagnosis(findings=tuple(findings), without=without)


class _Look:
    """Tracks as they would be, beside the drones."""

    def __init__(self, truths: Truths) -> None:
        self._truths = truths
        self._site = truths.sensors_at or truths.site or truths.middle
        self._has_site = truths.sensors_at is not None
        self._level = Level(truths.middle.height_m)

    def some(self, told: ReportedTracks) -> ReportedTracks:
        """Reports to look at, by track and time."""
        usable = np.flatnonzero(
            np.isfinite(told.latitude_deg) & np.isfinite(told.longitude_deg)
            & (told.t_utc_ns != UNKNOWN_NS) & ~told.tentative
        )  # fmt: skip
        most = max(min(MOST, MOST_PAIRS // len(self._truths.paths)), FEWEST)
        rows = told.rows(usable[:: -(-len(usable) // most) or 1])
        return rows.rows(np.lexsort((rows.t_utc_ns, rows.track)))

    def errors(self, rows: ReportedTracks) -> tuple[Ints, Floats, Floats, Floats]:
        """The nearest drone, errors east, north and up, of velocity, and true velocities."""
        with np.errstate(invalid="ignore"):
            point = self._level.points(rows.latitude_deg, rows.longitude_deg, rows.height_m)
        _, drone = nearest_drones(self._truths, rows.t_utc_ns, point, self._level)
        true = truth_beside(self._truths, drone, rows.t_utc_ns, self._level)
        error = along_enu(point - true.point, true.latitude_deg, true.longitude_deg)
        velocity = true.velocity_enu_m_s
        return drone, error, rows.velocity_enu_m_s - velocity, velocity

    def costs(self, rows: ReportedTracks) -> Floats:
        """How wrong each report is, (n,): one that is where no drone is, more than any other."""
        _, error, velocity, _ = self.errors(rows)
        apart = np.hypot(error[:, 0], error[:, 1])
        apart = np.fmin(np.where(np.isnan(apart), FAR_M, apart), FAR_M)
        of_speed = np.hypot(velocity[:, 0], velocity[:, 1])
        parts = zip((apart, np.abs(error[:, 2]), of_speed), SCALES, strict=True)
        found: Floats = np.sum([np.nan_to_num(np.log1p((x / s) ** 2)) for x, s in parts], axis=0)
        # Where no drone is near, its height and velocity are no comfort.
        return np.where(apart >= FAR_M, 3 * math.log1p((FAR_M / SCALES[0]) ** 2), found)

    def best(self, rows: ReportedTracks, cost: Floats) -> tuple[str, Change, Floats] | None:
        """What saves most, if it is more than chance: in words, undone, and what it leaves."""
        found: tuple[str, Change, Floats] | None = None
        best = float(cost.mean()) - SAVED
        for text, change in self._candidates(rows):
            tried = self.costs(change(rows))
            saved = cost - tried
            mean = float(saved.mean())
            if float(tried.mean()) > best:
                continue
            se, _ = deviation(saved - mean, rows.track)
            if mean > SURE * se or mean > 3.0:  # e^3: twenty times as far off
                found, best = (text, change, tried), float(tried.mean()) - SAVED / 10
        return found

    def _candidates(self, rows: ReportedTracks) -> Iterator[tuple[str, Change]]:
        """What is often wrong, the more usual first."""
        has_height = np.isfinite(rows.height_m).any()
        has_velocity = np.isfinite(rows.velocity_enu_m_s[:, :2]).any()
        if has_height:
            by_m = float(
                np.nanmean(geoid_undulation_m(self._site.latitude_deg, self._site.longitude_deg))
            )
            yield f"heights are above mean sea level ({by_m:.1f} m)", _higher(by_m)
            yield "heights are in feet", _higher(0.0, FOOT_M)
            ground_m = self._site.height_m
            yield f"heights are above the ground ({ground_m:.0f} m)", _higher(ground_m)
            yield "heights are in feet above mean sea level", _higher(by_m, FOOT_M)
        if has_velocity:
            yield "velocities have the opposite sign", _faster([-1.0, -1.0, -1.0])
            yield "velocities are in knots", _faster([KNOT_M_S, KNOT_M_S, 1.0])
            yield "velocities are in km/h", _faster([1 / 3.6, 1 / 3.6, 1.0])
            yield (
                "east and north of velocities are exchanged",
                lambda of: of.but(velocity_enu_m_s=of.velocity_enu_m_s[:, [1, 0, 2]]),
            )
        yield (
            "latitude and longitude are exchanged",
            lambda of: of.but(latitude_deg=of.longitude_deg, longitude_deg=of.latitude_deg),
        )
        yield (
            "places are in radians",
            lambda of: of.but(
                latitude_deg=np.degrees(of.latitude_deg), longitude_deg=np.degrees(of.longitude_deg)
            ),
        )
        _, error, _, _ = self.errors(rows)
        apart = np.hypot(error[:, 0], error[:, 1])
        if float(np.median(np.nan_to_num(apart, nan=np.inf))) < GROSS_M:
            return
        midnight_ns = self._truths.start_utc_ns // DAY_NS * DAY_NS
        if rows.t_utc_ns.max() < 2 * DAY_NS:
            yield "times are seconds of the day, without a date", _later(midnight_ns)
        for seconds, whose in ((18, "of GPS, leap seconds not taken off"), (37, "of TAI")):
            yield f"times are {whose} ({seconds} s ahead)", _later(-seconds * NS)
            yield f"leap seconds are taken off times twice ({seconds} s)", _later(seconds * NS)
        for quarters in sorted(range(-48, 57), key=abs)[1:]:
            if quarters % 2 == 0 or abs(quarters) in (23, 35):  # Nepal and Eucla
                zone = f"{quarters // 4 if quarters > 0 else -(-quarters // 4):+d}"
                zone += f":{abs(quarters) % 4 * 15:02d}"
                yield f"times are of a zone, UTC{zone}", _later(-quarters * 900 * NS)
        for seconds in range(-CLOCK_S, CLOCK_S + 1):
            if abs(seconds) > 1:
                yield f"{CLOCK}{seconds}", _later(-seconds * NS)

    def fitted(self, rows: ReportedTracks) -> list[FittedEffect]:
        """Errors of clock, azimuth, range and datum, all at once."""
        drone, error, _, velocity = self.errors(rows)
        near = np.flatnonzero(np.hypot(error[:, 0], error[:, 1]) < GATE_M)
        near = near[np.lexsort((rows.t_utc_ns[near], drone[near]))]
        if len(near) < FEWEST:
            return []
        error, velocity, of = error[near], velocity[near], rows.rows(near)
        nothing = np.zeros_like(error)
        effects = {"clock": -velocity}
        for axis, name in enumerate(("east", "north", "up")):
            effects[name] = nothing.copy()
            effects[name][:, axis] = 1.0
        if self._has_site:
            height_m = np.full(len(of), self._site.height_m)
            where = geodetic_to_ecef(of.latitude_deg, of.longitude_deg, height_m)
            east, north, _ = self._site.from_ecef(where).T
            away = np.maximum(np.hypot(east, north), 1.0)
            turn = np.radians(np.stack([north, -east, 0 * east], axis=1))
            effects["azimuth"] = turn
            effects["range"] = np.stack([east / away, north / away, 0 * east], axis=1)
        return joint_fit(error, effects, drone[near])

    def without(self, told: ReportedTracks, effect: FittedEffect) -> ReportedTracks:
        """Reports without an effect."""
        name, value = effect.name, effect.value
        if name == "clock":
            return _later(-round(value * NS))(told)
        if name == "up":
            return _higher(-value)(told)
        height_m = np.full(len(told), self._site.height_m)
        with np.errstate(invalid="ignore"):
            where = geodetic_to_ecef(told.latitude_deg, told.longitude_deg, height_m)
            east, north, up = self._site.from_ecef(where).T
            if name == "azimuth":
                c, s = math.cos(math.radians(value)), math.sin(math.radians(value))
                east, north = c * east - s * north, s * east + c * north
            elif name == "range":
                nearer = 1 - value / np.maximum(np.hypot(east, north), 1.0)
                east, north = east * nearer, north * nearer
            else:
                east, north = east - value * (name == "east"), north - value * (name == "north")
            place = self._site.to_geodetic(np.stack([east, north, up], axis=1))
        latitude_deg, longitude_deg, _ = place
        return told.but(latitude_deg=latitude_deg, longitude_deg=longitude_deg)


def _later(by_ns: int) -> Change:
    """Times later by so much, those that are known."""

    def change(of: ReportedTracks) -> ReportedTracks:
        known = of.t_utc_ns != UNKNOWN_NS
        return of.but(t_utc_ns=np.where(known, of.t_utc_ns + np.where(known, by_ns, 0), UNKNOWN_NS))

    return change


def _higher(by_m: float, unit_m: float = 1.0) -> Change:
    return lambda of: of.but(height_m=of.height_m * unit_m + by_m)


def _faster(factors: list[float]) -> Change:
    return lambda of: of.but(velocity_enu_m_s=of.velocity_enu_m_s * np.array(factors))


# Of an effect: what is so, by how much, and how it is called where it is another's.
WORDS: dict[str, tuple[str, str, str, str]] = {
    "clock": ("times are", "late, or tracks lag by that,", "early, or tracks lead by that,", "s"),
    "azimuth": ("azimuths from the sensors are", "too large", "too small", "deg"),
    "range": ("ranges from the sensors are", "too long", "too short", "m"),
    "east": ("places are", "too far east", "too far west", "m"),
    "north": ("places are", "too far north", "too far south", "m"),
    "up": ("heights are", "too high", "too low", "m"),
}


def _words(effect: FittedEffect) -> str:
    what, more, less, unit = WORDS[effect.name]
    form = ".2f" if unit != "m" else ".1f"
    size = f"{abs(effect.value):{form}} {unit} {more if effect.value > 0 else less}"
    others = f"; or it is the {' or '.join(effect.others)}" if effect.others else ""
    return f"{what} {size} (+-{1.96 * effect.se:{form}}){others}"
