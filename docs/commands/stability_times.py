"""Where times, scans and random numbers fail: rows of docs/stability.md."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from stability_case import Case

from plotfeed.models.beam import Timetable
from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.truth import fit_velocity
from plotfeed.proto.asterix.cat048 import CAT048
from plotfeed.proto.asterix.codec.encode import Encoder

NS = 1_000_000_000
START_NS = 1_767_225_600 * NS  # 2026-01-01
PERIOD_NS = 600_000_000
DAY_NS = 86_400 * NS


def midnight() -> Case:
    t_ns = START_NS + DAY_NS - 1_000_000
    encoder = Encoder(CAT048, ("I048/140",), lsb={"I048/140": 7_812_500})
    record = encoder.records({"I048/140": t_ns})
    lsb = int.from_bytes(record[-3:], "big")
    return Case(
        where="time of day 1 ms before midnight",
        plain_form="seconds times 128, rounded",
        plain=f"{round((t_ns % DAY_NS) / NS * 128) / 128:g} s, which no day has",
        cure="rounded, then modulo the day",
        ours=f"{lsb / 128:g} s",
        test="proto/asterix/test_asterix_encode.py::test_time_from_nanoseconds_is_exact",
    )


def week() -> Case:
    scans = 7 * 86_400 * 10 // 6
    first = START_NS // PERIOD_NS + 1
    start_ns = first * PERIOD_NS
    clock_s = float(np.cumsum(np.concatenate([[start_ns / NS], np.full(scans, 0.6)]))[-1])
    exact_ns = start_ns + scans * PERIOD_NS
    ours_ns = Timetable(PERIOD_NS, 12).sector(first + scans, 0).start_ns
    return Case(
        where="start of a scan of 0.6 s after a week",
        plain_form="seconds since 1970, 0.6 added at each scan",
        plain=abs(round(clock_s * NS) - exact_ns) / NS,
        cure="scan number times period, in integers",
        ours=abs(ours_ns - exact_ns) / NS,
        unit="s",
        test="models/test_scan.py::test_a_walk_comes_to_the_same_sectors_wherever_it_began",
    )


def scan_number() -> Case:
    scans = START_NS // PERIOD_NS + np.arange(10_000)
    starts_ns = scans * PERIOD_NS
    plain = (starts_ns / NS // 0.6).astype(np.int64)
    ours = [Timetable(PERIOD_NS, 12).sector_at(int(t)).scan for t in starts_ns]
    return Case(
        where="wrong numbers of scans of 0.6 s",
        plain_form="seconds // period",
        plain=float(np.mean(plain != scans)),
        cure="integer division of nanoseconds",
        ours=float(np.mean(np.array(ours) != scans)),
        unit="of the scans",
        test="models/test_scan.py::test_every_time_is_in_the_sector_that_it_is_said_to_be_in",
    )


def last_year() -> Case:
    late_ns = 2**63 - 10 * NS
    steps_ns = np.arange(0, 2 * NS, 1_234_567)
    plain_s = (late_ns + steps_ns) / NS - late_ns / NS
    ours_s = ((late_ns + steps_ns) - late_ns) / NS
    return Case(
        where="time since a sample, in the year 2262",
        plain_form="difference of seconds since 1970",
        plain=float(np.abs(plain_s - steps_ns / NS).max()),
        cure="difference of integer nanoseconds",
        ours=float(np.abs(ours_s - steps_ns / NS).max()),
        unit="s",
        test="models/test_truth.py::test_the_last_year_that_nanoseconds_hold_is_like_any_other",
    )


def slope() -> Case:
    t_ns = START_NS + np.arange(10) * NS // 10
    x_m = 20.0 * np.arange(10) / 10
    t = t_ns / NS
    n = len(t)
    with np.errstate(all="ignore"):
        plain = (n * _sum(t * x_m) - _sum(t) * _sum(x_m)) / (n * _sum(t * t) - _sum(t) ** 2)
    places = list(np.stack([x_m, 0 * x_m, 0 * x_m], axis=-1))
    ours = float(fit_velocity(t_ns.tolist(), places, 0.5)[0])
    return Case(
        where="speed of 20 m/s from a second of positions",
        plain_form="the textbook's sums of t and t², since 1970",
        plain=float(abs(plain - 20.0)),
        cure="times since the latest, less their mean",
        ours=abs(ours - 20.0),
        unit="m/s",
        test="models/test_truth.py::test_the_fitted_velocity_of_straight_noise_free_flight_is_exact",
    )


def _sum(terms: NDArray[np.float64]) -> np.float64:
    """A sum from the first to the last: how pairs are summed is a matter of the machine."""
    return np.float64(np.cumsum(terms)[-1])


def streams() -> Case:
    scan = 2_945_376_000
    plain = [np.random.default_rng(seed + s).random(1000) for seed, s in ((1, scan + 1), (2, scan))]
    ours = [
        Chance(seed, "radar").rng(Purpose.DETECTION, s).random(1000)
        for seed, s in ((1, scan + 1), (2, scan))
    ]
    return Case(
        where="the same draws by seed 1 in scan 2,945,376,001 and by seed 2 in the one before",
        plain_form="a generator seeded with seed + scan",
        plain=float(np.isin(plain[0], plain[1]).mean()),
        cure="seed and sensor are the key, scan and purpose the counter",
        ours=float(np.isin(ours[0], ours[1]).mean()),
        unit="of the draws",
        test="models/test_chance.py::test_no_two_keys_share_draws",
    )


TIMES = (midnight, week, scan_number, last_year, slope, streams)
