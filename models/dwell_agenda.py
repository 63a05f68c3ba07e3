"""What an electronically steered radar does next: search, and tracks to look at again.

Search goes through the beams of the cover in turn. A track is looked at again when its prediction
is V times as wrong as a measurement: after 0.4 (s sqrt(tau)/S)^0.4 V^2.4/(1 + V^2/2), by van Keuk
and Blackman (IEEE Trans. AES 29(1), 1993), for an error s across the line of sight and a target
whose acceleration of S is correlated over tau. That is a fit to the filter of such targets: within
6 % up to 0.08 tau and V = 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plotfeed.models.beam import AzimuthCover
from plotfeed.models.detection import cells_across
from plotfeed.models.frames import wrap_180
from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.state import NS, Bools, Columns, Floats, Ints

# Updates after which a track's filter forgets: gains are those of a straight line until then.
LONGEST_MEMORY = 10


@dataclass(frozen=True, kw_only=True)
class Steering:
    """How a beam's time is shared; search beams are `beam_spacing` beamwidths apart.

    Without `revisit_s`, tracks are looked at again by what their targets may do.
    """

    period_s: float
    dwell_s: float
    beam_spacing: float
    max_tracks: int
    search_share: float
    revisit_s: float | None
    manoeuvre_m_s2: float
    manoeuvre_s: float
    error_ratio: float
    drop_misses: int

    @property
    def dwells(self) -> int:
        """Dwells of a period."""
        return int(self.period_s / self.dwell_s + 1e-9)


@nan_without_warnings
def revisit_interval_s(
    sigma_m: Floats, manoeuvre_m_s2: float, manoeuvre_s: float, error_ratio: float
) -> Floats:
    """Seconds after which a track is looked at again; (n,). Errors are standard deviations."""
    scale = (sigma_m * np.sqrt(manoeuvre_s) / manoeuvre_m_s2) ** 0.4
    return np.asarray(0.4 * scale * error_ratio**2.4 / (1 + error_ratio**2 / 2))


@dataclass(frozen=True, kw_only=True)
class BeamTracks(Columns):
    """Tracks of the radar's own: places and velocities (n, 3), east, north and up of it.

    `t_utc_ns` is when the place was updated, `due_ns` when the next look is.
    """

    place_m: Floats
    velocity_m_s: Floats
    t_utc_ns: Ints
    due_ns: Ints
    updates: Ints
    misses: Ints

    @classmethod
    def begun(cls, place_m: Floats, t_utc_ns: Ints, due_ns: Ints) -> BeamTracks:
        """Tracks at places that were just found."""
        n = len(t_utc_ns)
        return cls(
            place_m=place_m,
            velocity_m_s=np.zeros((n, 3)),
            t_utc_ns=t_utc_ns,
            due_ns=due_ns,
            updates=np.ones(n, np.int64),
            misses=np.zeros(n, np.int64),
        )

    def predicted_m(self, t_utc_ns: Ints) -> Floats:
        """Places at those times; (n, 3)."""
        elapsed_s = (t_utc_ns - self.t_utc_ns) / NS
        return self.place_m + self.velocity_m_s * elapsed_s[:, None]

    def updated(self, seen: Bools, place_m: Floats, t_utc_ns: Ints, due_ns: Ints) -> BeamTracks:
        """Tracks after a look at each: those that were seen by places, the others missed."""
        elapsed_s = np.maximum((t_utc_ns - self.t_utc_ns) / NS, 1e-6)
        n = np.minimum(self.updates + 1, LONGEST_MEMORY)
        near, fast = 2 * (2 * n - 1) / (n * (n + 1)), 6 / (n * (n + 1))
        expected_m = self.predicted_m(t_utc_ns)
        off_m = np.where(seen[:, None], place_m - expected_m, 0.0)
        return self.but(
            place_m=np.where(seen[:, None], expected_m + near[:, None] * off_m, self.place_m),
            velocity_m_s=self.velocity_m_s + (fast / elapsed_s)[:, None] * off_m,
            t_utc_ns=np.where(seen, t_utc_ns, self.t_utc_ns),
            due_ns=due_ns,
            updates=self.updates + seen,
            misses=np.where(seen, 0, self.misses + 1),
        )


@dataclass(frozen=True, slots=True)
class Agenda:
    """What a radar keeps in mind from one period to the next."""

    next_beam: int
    tracks: BeamTracks
    searched: int = 0
    """Beams that the last period searched, up to the next one."""
    start_ns: int = 0
    """When that period began."""

    @classmethod
    def empty(cls) -> Agenda:
        """An agenda with no track, and the first beam next."""
        none = np.zeros(0, np.int64)
        return cls(0, BeamTracks.begun(np.zeros((0, 3)), none, none))


@dataclass(frozen=True, slots=True)
class PointedBeams:
    """Azimuths of the beams of a period, degrees: of search, (n,), and of looks at tracks, (m,)."""

    width_deg: float
    search_deg: Floats
    tracks_deg: Floats


def searched_slots(hit: Bools, dwells: int) -> Ints:
    """When each of the beams that are next begins, in dwells, as far as they fit into so many.

    A hit takes one to confirm.
    """
    spent = np.cumsum(1 + hit.astype(np.int64))
    beams = int(np.searchsorted(spent, dwells, side="right"))
    return np.concatenate([np.zeros(1, np.int64), spent])[:beams]


@dataclass(frozen=True, kw_only=True)
class BeamGrid:
    """Beams in rows that fill a cover, `spacing` beamwidths apart or a little less."""

    cover: AzimuthCover
    elevation_min_deg: float
    elevation_max_deg: float
    azimuth_beamwidth_deg: float
    elevation_beamwidth_deg: float
    spacing: float

    @property
    def height_deg(self) -> float:
        """Height of the cover, in elevation."""
        return self.elevation_max_deg - self.elevation_min_deg

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Beams in azimuth and in elevation."""
        across = cells_across(self.cover.span_deg, self.spacing * self.azimuth_beamwidth_deg)
        upwards = cells_across(self.height_deg, self.spacing * self.elevation_beamwidth_deg)
        return int(np.ceil(across - 1e-9)), int(np.ceil(upwards - 1e-9))

    @property
    def beams(self) -> int:
        """Number of all beams."""
        return self.shape[0] * self.shape[1]

    @property
    def side_by_side(self) -> float:
        """How many beamwidths the cover holds, in azimuth times elevation."""
        return cells_across(self.cover.span_deg, self.azimuth_beamwidth_deg) * cells_across(
            self.height_deg, self.elevation_beamwidth_deg
        )

    def beam_of(self, azimuth_deg: Floats, elevation_deg: Floats) -> Ints:
        """The beam in whose part of the cover directions are; (n,)."""
        across, upwards = self.shape
        share = np.mod(azimuth_deg - self.cover.min_deg, 360.0) / self.cover.span_deg
        above = (elevation_deg - self.elevation_min_deg) / self.height_deg
        column = np.clip(np.nan_to_num(share * across), 0, across - 1).astype(np.int64)
        row = np.clip(np.nan_to_num(above * upwards), 0, upwards - 1).astype(np.int64)
        return np.asarray(row * across + column)

    def middle_of(self, beam: Ints) -> tuple[Floats, Floats]:
        """Azimuths and elevations of beams; (n,) each."""
        across, upwards = self.shape
        row, column = np.divmod(beam, across)
        azimuth_deg = self.cover.min_deg + (column + 0.5) * (self.cover.span_deg / across)
        return azimuth_deg, self.elevation_min_deg + (row + 0.5) * (self.height_deg / upwards)

    def gain(self, direction: tuple[Floats, Floats], pointed: tuple[Floats, Floats]) -> Floats:
        """Two-way gain of a Gaussian beam that points elsewhere, by azimuths and elevations; (n,).

        24 dB at a beamwidth off. Of errors of U beamwidths along either axis the mean is
        1/(1 + 16 ln 2 U^2).
        """
        level = np.cos(np.radians(direction[1]))
        across = wrap_180(direction[0] - pointed[0]) * level / self.azimuth_beamwidth_deg
        upwards = (direction[1] - pointed[1]) / self.elevation_beamwidth_deg
        return np.asarray(np.exp2(-8 * (across**2 + upwards**2)))
