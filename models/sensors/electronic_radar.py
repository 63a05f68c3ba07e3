"""The active radar whose beam is steered dwell by dwell: search, confirmation and tracks.

A period has so many dwells. Tracks that are due take theirs first, up to a share; search has the
rest, beam by beam, and a beam in which something crosses the threshold is looked at once more at
once, where that was measured. What is seen then is a plot, and begins a track if there is none; so
is what is seen of tracks. Within a period a target's echo does not fluctuate: the confirming dwell
meets the same echo.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from plotfeed.models import detection
from plotfeed.models.beam import Sector
from plotfeed.models.dwell_agenda import (
    Agenda,
    BeamGrid,
    BeamTracks,
    PointedBeams,
    Steering,
    revisit_interval_s,
    searched_slots,
)
from plotfeed.models.fluctuation import STEADY
from plotfeed.models.frames import aer_to_enu, enu_to_aer, wrap_180
from plotfeed.models.sensors.active_radar import ActiveRadar
from plotfeed.models.sensors.polar_radar import Hits
from plotfeed.models.sensors.sensor_model import DwellingSensor, Prediction, Targets
from plotfeed.models.state import NS, Floats, Ints, Looks, Plots

if TYPE_CHECKING:
    from plotfeed.models.effects.surroundings import OnTheWay

SEARCH, CONFIRMATION, REVISIT = 0, 1, 2  # Channels of looks and plots
# Share of the echo below which a dwell that points elsewhere does not look at a target.
UNSEEN = 1e-3
GATE_BEAMS = 1.0
GATE_CELLS = 5.0  # How near a plot is to a track's prediction, in beams across and cells along


@dataclass(frozen=True, slots=True)
class _Period:
    """Targets at the end of a period of so many dwells, and how strong their echoes are in it."""

    targets: Targets
    strength: Floats
    sector: Sector
    dwells: int
    rng: np.random.Generator

    def at(self, rows: Ints, t_utc_ns: Ints) -> Targets:
        """Targets of those rows as they were at those times before the end."""
        targets, velocity = self.targets, self.targets.velocity_enu_m_s
        before_s = (targets.t_utc_ns[rows] - t_utc_ns)[:, None] / NS
        moved_m = np.zeros((len(rows), 3)) if velocity is None else velocity[rows] * before_s
        return replace(
            targets,
            drone=targets.drone[rows],
            t_utc_ns=t_utc_ns,
            position_enu_m=targets.position_enu_m[rows] - targets.along_own_axes(moved_m),
            true_position_enu_m=targets.true_position_enu_m[rows] - moved_m,
            velocity_enu_m_s=None if velocity is None else velocity[rows],
        )

    def ends_ns(self, slots: Ints) -> Ints:
        """When dwells end; the last one with the period."""
        sector = self.sector
        dwell_ns = (sector.end_ns - sector.start_ns) / self.dwells
        ends_ns = sector.start_ns + np.rint((slots + 1) * dwell_ns).astype(np.int64)
        return np.asarray(np.minimum(ends_ns, sector.end_ns))


@dataclass(frozen=True, kw_only=True)
class ElectronicRadar(DwellingSensor):
    """An active radar, whose cover is searched, and how its dwells are shared."""

    radar: ActiveRadar
    steering: Steering

    @property
    def measures_range_rate(self) -> bool:
        """Velocities are needed, for targets are looked at within a period."""
        return True

    @property
    def errs_as_stated(self) -> bool:
        """Errors are those of the radar, by the very echo."""
        return True

    @property
    def claims_held_ns(self) -> int:
        """How long what the radar calls a drone stays."""
        return self.radar.claims_held_ns

    @property
    def false_alarms_per_scan(self) -> float:
        """None is confirmed; they take dwells."""
        return 0.0

    is_radio: ClassVar[bool] = True

    def with_jammers_behind(self, way: OnTheWay) -> Self:
        """The radar with what an obstruction leaves of its jammers."""
        return replace(self, radar=self.radar.with_jammers_behind(way))

    @cached_property
    def among_all(self) -> ActiveRadar:
        """The radar among what surrounds it."""
        met = self.surroundings
        return self.radar if met is None else replace(self.radar, surroundings=met)

    @cached_property
    def grid(self) -> BeamGrid:
        """Beams of search."""
        radar = self.radar
        return BeamGrid(
            cover=radar.azimuth_cover,
            elevation_min_deg=radar.elevation_min_deg,
            elevation_max_deg=radar.elevation_max_deg,
            azimuth_beamwidth_deg=radar.azimuth_beamwidth_deg,
            elevation_beamwidth_deg=radar.elevation_beamwidth_deg,
            spacing=self.steering.beam_spacing,
        )

    def observe_scan(
        self, targets: Targets, sector: Sector, rng: np.random.Generator
    ) -> tuple[Looks, Plots]:
        """A period without anything in mind."""
        looks, plots, _ = self.observe_period(Agenda.empty(), targets, sector, rng)
        return looks, plots

    def observe_period(
        self, agenda: Agenda, targets: Targets, sector: Sector, rng: np.random.Generator
    ) -> tuple[Looks, Plots, Agenda]:
        """Looks and plots of a period, and what there is to do after it."""
        order = self.radar.orders(targets)
        kappa = np.ones(len(targets)) if order is None else order
        steady = kappa == STEADY
        strength = rng.standard_gamma(np.where(steady, 1.0, kappa)) / np.where(steady, 1.0, kappa)
        strength = np.where(steady, 1.0, strength)
        most = int(self.steering.dwells * (1 - self.steering.search_share))
        due = np.flatnonzero(agenda.tracks.due_ns < sector.end_ns)
        due = due[np.argsort(agenda.tracks.due_ns[due], kind="stable")][:most]
        period = _Period(targets, strength, sector, self.steering.dwells, rng)
        looks, plots, tracks = self._revisited(agenda.tracks, due, period)
        searched, confirmed, beams = self._searched(agenda.next_beam, len(due), period)
        tracks = self._with_new(tracks, confirmed, sector)
        every = Looks.joined([looks, searched]), Plots.joined([plots, confirmed])
        next_beam = (agenda.next_beam + beams) % self.grid.beams
        return *every, Agenda(next_beam, tracks, beams, sector.start_ns)

    def pointed(self, agenda: Agenda) -> PointedBeams:
        """Where the beams of the last period pointed, by the agenda after it."""
        beams = (agenda.next_beam - 1 - np.arange(agenda.searched)) % self.grid.beams
        tracks = agenda.tracks
        looked_at = (tracks.t_utc_ns > agenda.start_ns) | (tracks.misses > 0)
        return PointedBeams(
            self.radar.azimuth_beamwidth_deg,
            np.unique(self.grid.middle_of(beams)[0]),
            enu_to_aer(tracks.place_m[looked_at])[0],
        )

    def _looked(
        self,
        there: Targets,
        pointed: tuple[Floats, Floats],
        strength: Floats,
        channel: int,
        rng: np.random.Generator,
    ) -> tuple[Looks, Floats]:
        """Looks by dwells that point somewhere, and their ratios without fluctuation."""
        geometry = azimuth_deg, elevation_deg, _ = enu_to_aer(there.position_enu_m)
        snr = self.among_all.look_snrs(there)[:, 0]
        # At what was read beams are pointed by the axes by which it was: both drift alike.
        at_deg = azimuth_deg
        if channel != SEARCH:
            at_deg = there.read_azimuth_deg(azimuth_deg, there.t_utc_ns)
        snr = snr * self.grid.gain((at_deg, elevation_deg), pointed)
        pd = self.radar.pd((snr * strength)[:, None], np.full(len(snr), STEADY))
        pd = np.nan_to_num(pd) * self.radar.pd_factor
        looks = there.looks(
            slice(None),
            geometry,
            snr=snr,
            pd=pd,
            detected=rng.random(len(pd)) < pd,
            channel=np.full(len(pd), channel, np.int64),
        )
        return looks, snr * strength

    def _measured(
        self, looks: Looks, powers: Floats, there: Targets, rng: np.random.Generator
    ) -> Plots:
        """Plots of the looks that detected, those within cover."""
        which = np.flatnonzero(looks.detected)
        if not len(which):
            return Plots.of(t_utc_ns=np.zeros(0, np.int64))
        echoes = looks.rows(which)
        columns: dict[str, NDArray[Any]] = there.true_geometry(echoes, which)
        steady = np.full(len(which), STEADY)
        hits = Hits(echoes, powers[which][:, None], columns, rng, steady)
        return self.radar.measured(hits, there)

    def _revisited(
        self, tracks: BeamTracks, due: Ints, period: _Period
    ) -> tuple[Looks, Plots, BeamTracks]:
        """Looks at tracks that are due, what is seen, and the tracks after that."""
        t_utc_ns = period.ends_ns(np.arange(len(due)))
        mine = tracks.rows(due)
        aimed_m = mine.predicted_m(t_utc_ns)
        row, track = (a.ravel() for a in np.indices((len(period.targets), len(due))))
        there = period.at(row, t_utc_ns[track])
        aim = enu_to_aer(aimed_m)
        geometry = azimuth_deg, elevation_deg, _ = enu_to_aer(there.position_enu_m)
        read_deg = there.read_azimuth_deg(azimuth_deg, there.t_utc_ns)
        gain = self.grid.gain((read_deg, elevation_deg), (aim[0][track], aim[1][track]))
        near = np.flatnonzero((gain > UNSEEN) & self._reports(geometry))
        track, row = track[near], row[near]
        there = period.at(row, t_utc_ns[track])
        pointed = aim[0][track], aim[1][track]
        looks, powers = self._looked(there, pointed, period.strength[row], REVISIT, period.rng)
        plots = self._measured(looks, powers, there, period.rng)
        found_m = aer_to_enu(plots.azimuth_deg, plots.elevation_deg, plots.range_m)
        apart = self._apart(found_m, aimed_m)  # (plots, tracks)
        dwell = np.searchsorted(t_utc_ns, plots.t_utc_ns)
        apart[dwell[:, None] != np.arange(len(due))] = np.inf
        seen = np.zeros(len(due), np.bool_)
        nearest = np.zeros((len(due), 3))
        if len(plots) and len(due):
            best = apart.argmin(axis=0)
            seen = apart[best, np.arange(len(due))] <= 1.0
            nearest = found_m[best]
        snr = plots.snr[apart.argmin(axis=0)] if len(plots) and len(due) else np.ones(len(due))
        again_ns = period.sector.end_ns - t_utc_ns  # at once, if it was missed
        wait_ns = np.where(seen, self._wait_ns(nearest, snr), again_ns)
        after = mine.updated(seen, nearest, t_utc_ns, t_utc_ns + wait_ns)
        others = np.delete(np.arange(len(tracks)), due)
        every = BeamTracks.joined([tracks.rows(others), after])
        return looks, plots, every.rows(every.misses < self.steering.drop_misses)

    def _searched(self, next_beam: int, first: int, period: _Period) -> tuple[Looks, Plots, int]:
        """Looks of search and confirmation, what was confirmed, and the number of beams."""
        left, rng, strength = period.dwells - first, period.rng, period.strength
        most = min(left, self.grid.beams)
        # Who is at a beam when it points there: first by where all are when the period ends.
        there, rows = period.targets, np.arange(len(period.targets))
        for _ in range(2):
            geometry = enu_to_aer(there.position_enu_m)
            place = (self.grid.beam_of(*geometry[:2]) - next_beam) % self.grid.beams
            met = np.flatnonzero((place < most) & self._reports(geometry))
            met = met[np.argsort(place[met], kind="stable")]
            rows, place = rows[met], place[met]
            there = period.at(rows, period.ends_ns(first + place))
        pointed = self.grid.middle_of((next_beam + place) % self.grid.beams)
        looks, powers = self._looked(there, pointed, strength[rows], SEARCH, rng)
        hit = np.zeros(most, np.bool_)
        hit[place[looks.detected]] = True
        cells = self.radar.resolution_cells / self.grid.side_by_side
        alarms = detection.draw_count(int(np.ceil(cells)) * most, self.radar.pfa, rng)
        hit[rng.integers(0, max(most, 1), alarms)] = True
        begins = searched_slots(hit, left)
        done = np.flatnonzero(place < len(begins))
        looks, powers, place, rows = looks.rows(done), powers[done], place[done], rows[done]
        slots = first + begins[place]
        there = period.at(rows, period.ends_ns(slots))
        looks = looks.but(t_utc_ns=there.t_utc_ns)
        tentative = self._measured(looks, powers, there, rng)
        again = np.flatnonzero(looks.detected)
        inside = np.isin(looks.drone[again], tentative.drone)
        again = again[inside]
        order = np.searchsorted(np.sort(tentative.drone), looks.drone[again])
        by_drone = np.argsort(tentative.drone, kind="stable")[order]
        aim = tentative.azimuth_deg[by_drone], tentative.elevation_deg[by_drone]
        second = period.at(rows[again], period.ends_ns(slots[again] + 1))
        confirming, echoes = self._looked(second, aim, strength[rows[again]], CONFIRMATION, rng)
        confirmed = self._measured(confirming, echoes, second, rng)
        return Looks.joined([looks, confirming]), confirmed, len(begins)

    def _reports(self, geometry: tuple[Floats, Floats, Floats]) -> NDArray[np.bool_]:
        azimuth_deg, elevation_deg, range_m = geometry
        return self.radar.in_cover(range_m, azimuth_deg, elevation_deg)

    def _apart(self, found_m: Floats, aimed_m: Floats) -> Floats:
        """Distances of plots from predictions, 1 at the gate; (plots, tracks)."""
        azimuth_deg, elevation_deg, range_m = enu_to_aer(found_m)
        aim = enu_to_aer(aimed_m)
        across = wrap_180(azimuth_deg[:, None] - aim[0]) / self.radar.azimuth_beamwidth_deg
        upwards = (elevation_deg[:, None] - aim[1]) / self.radar.elevation_beamwidth_deg
        gate_m = GATE_CELLS * max(self.radar.range_resolution_m, 2.0)
        along = (range_m[:, None] - aim[2]) / gate_m
        return np.sqrt((across / GATE_BEAMS) ** 2 + (upwards / GATE_BEAMS) ** 2 + along**2)

    def _wait_ns(self, place_m: Floats, snr: Floats) -> Ints:
        """How long tracks at places are left alone; (n,)."""
        steering = self.steering
        if steering.revisit_s is not None:
            return np.full(len(snr), round(steering.revisit_s * NS), np.int64)
        sigma_deg = np.maximum(*self.radar.sigmas(snr)[1:])
        sigma_m = np.radians(sigma_deg) * np.linalg.norm(place_m, axis=-1)
        wait_s = revisit_interval_s(
            sigma_m, steering.manoeuvre_m_s2, steering.manoeuvre_s, steering.error_ratio
        )
        return np.asarray(np.rint(np.maximum(wait_s, steering.dwell_s) * NS), np.int64)

    def _with_new(self, tracks: BeamTracks, confirmed: Plots, sector: Sector) -> BeamTracks:
        """Tracks with those that confirmed plots begin, as far as there is room and time."""
        if not len(confirmed):
            return tracks
        found_m = aer_to_enu(confirmed.azimuth_deg, confirmed.elevation_deg, confirmed.range_m)
        if len(tracks):
            expected_m = tracks.predicted_m(np.full(len(tracks), sector.end_ns))
            fresh = np.flatnonzero((self._apart(found_m, expected_m) > 2.0).all(axis=1))
            found_m, confirmed = found_m[fresh], confirmed.rows(fresh)
        wait_ns = self._wait_ns(found_m, confirmed.snr)
        waits_ns = np.append(tracks.due_ns - tracks.t_utc_ns, wait_ns)
        interval_s = np.maximum(waits_ns / NS, 1e-6)
        load = np.cumsum(self.steering.dwell_s / np.maximum(interval_s, self.steering.period_s))
        room = (load <= 1 - self.steering.search_share) & (
            np.arange(len(load)) < self.steering.max_tracks
        )
        taken = np.flatnonzero(room[len(tracks) :])
        # It knows no velocity yet: it looks again at the next opportunity.
        t_utc_ns = confirmed.t_utc_ns[taken]
        new = BeamTracks.begun(found_m[taken], t_utc_ns, np.full(len(taken), sector.end_ns))
        return BeamTracks.joined([tracks, new])

    def predict(self, targets: Targets) -> Prediction:
        """A dwell that points at each target, by the radar's closed forms."""
        return self.among_all.predict(targets)

    def stated_sigmas(self, snr: float) -> dict[str, float]:
        """Errors of the radar."""
        return self.radar.stated_sigmas(snr)
