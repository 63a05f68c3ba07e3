"""What a sensor reads and claims in place of what it finds, and how badly where it is degraded."""

from __future__ import annotations

import random
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.significance import assert_law, assert_sum

from plotfeed.models.beam import Sector
from plotfeed.models.chance import Chance, Purpose
from plotfeed.models.effects.classification import ClaimDraws, Confusion
from plotfeed.models.effects.readings import Drift, Readings, SkewFrame, own_axes
from plotfeed.models.frames import LocalFrame, aer_to_enu
from plotfeed.models.state import Floats
from plotfeed.testing import scene, staring

# What a sensor reads in place of what it finds.


S = 1_000_000_000
TIMES_NS = np.array([5, 5, 9, 5]) * S


def test_drifts_are_those_of_the_time_and_of_each_quantity_its_own():
    drift = Drift(Chance(1, "radar"), step_ns=S, time_constant_ns=30 * S, n=2)
    readings = Readings(range_scale=1e-3, range_offset_m=5.0, sigma_range_m=2.0,
                        sigma_azimuth_deg=0.5, drift=drift)  # fmt: skip
    off = drift.at(TIMES_NS)
    read_m = readings.range_m(np.full(4, 1000.0), TIMES_NS)
    np.testing.assert_allclose(read_m, 1006.0 + 2.0 * off[:, 0], rtol=1e-15)
    read_deg = readings.azimuth_deg(np.full(4, 10.0), TIMES_NS)
    np.testing.assert_allclose(read_deg, 10.0 + 0.5 * off[:, 1], rtol=1e-15)
    assert read_m[0] == read_m[1] == read_m[3] != read_m[2]
    assert not np.allclose(off[:, 0], off[:, 1])


# Own axes of a sensor that stands askew: one rotation, and where it puts things.


FRAME = LocalFrame(40.45, -3.73, 650.0)
offsets = st.floats(-180.0, 180.0)
tilts = st.floats(0.0, 45.0)
azimuths = st.floats(0.0, 360.0)
elevations = st.floats(-80.0, 80.0)


@given(tilts, azimuths, azimuths, elevations)
def test_a_tilt_raises_what_is_where_it_leans_to(tilt_deg, towards_deg, azimuth_deg, elevation_deg):
    """Spherical trigonometry: sine of the elevation over the leaning horizon."""
    seen = own_axes(0.0, tilt_deg, towards_deg) @ aer_to_enu(azimuth_deg, elevation_deg, 1.0)
    tilt, el = np.radians(tilt_deg), np.radians(elevation_deg)
    away = np.radians(azimuth_deg - towards_deg)
    sine = np.sin(el) * np.cos(tilt) + np.cos(el) * np.sin(tilt) * np.cos(away)
    assert seen[2] == pytest.approx(sine, abs=1e-14)


@given(offsets, tilts, azimuths, st.tuples(azimuths, elevations, st.floats(10.0, 20_000.0)))
def test_a_skew_frame_is_the_rotation_of_the_level_one(offset_deg, tilt_deg, towards_deg, place):
    skew = SkewFrame.at(
        FRAME, azimuth_offset_deg=offset_deg, tilt_deg=tilt_deg, tilt_azimuth_deg=towards_deg
    )
    place_ecef_m = FRAME.to_ecef(aer_to_enu(*place))
    seen = skew.from_ecef(place_ecef_m)
    axes = own_axes(offset_deg, tilt_deg, towards_deg)
    np.testing.assert_allclose(seen, axes @ FRAME.from_ecef(place_ecef_m), atol=1e-8)
    np.testing.assert_allclose(skew.to_ecef(seen), place_ecef_m, atol=5e-9)


# Gauss-Markov drift: its covariance to the last digits, its law, and its memory of nothing.


class Axes:
    """In the place of chance: each draw is an axis of its own, so that values are coefficients."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.axes: dict[int, int] = {}

    def rng(self, _purpose: Purpose, step: int) -> Axes:
        self.step = step
        return self

    def standard_normal(self, n: int) -> Floats:
        axis = self.axes.setdefault(self.step, len(self.axes))
        return np.eye(n)[axis]


@pytest.mark.parametrize("steps_a_constant", [0.01, 0.5, 3.0, 10.0, 600.0, 1e6])
def test_the_covariance_is_that_of_gauss_and_markov_to_the_last_digits(
    steps_a_constant: float,
) -> None:
    spread = np.unique(np.round(np.geomspace(1, 30 * steps_a_constant + 20, 12)).astype(int))
    steps = [*range(8), *(1_700_000_000 + spread).tolist()]
    axes: Any = Axes(400)
    drift = Drift(axes, step_ns=S, time_constant_ns=steps_a_constant * S, n=400)
    value = drift.at(np.array(steps, np.int64) * S)
    lags = np.abs(np.subtract.outer(steps, steps))
    covariance = np.exp(-lags / steps_a_constant)
    np.testing.assert_allclose(value @ value.T, covariance, rtol=0, atol=3e-15)


steps = st.integers(0, 9_000_000_000)


@given(st.lists(steps, min_size=1, max_size=6), st.floats(1.0, 1e4), st.integers(0, 999))
def test_the_same_comes_in_any_order_and_company(
    asked: list[int], steps_a_constant: float, seed: int
) -> None:
    def drift() -> Drift:
        chance = Chance(5, "radar")
        return Drift(chance, step_ns=S, time_constant_ns=steps_a_constant * S, n=2)

    alone = {step: drift().at(np.array([step * S]))[0].tolist() for step in asked}
    shuffled = asked * 2
    random.Random(seed).shuffle(shuffled)  # noqa: S311
    one = drift()
    for step in shuffled:
        assert one.at(np.array([step * S]))[0].tolist() == alone[step]
    together = drift().at(np.array(shuffled, np.int64) * S)
    assert together.tolist() == [alone[step] for step in shuffled]


def test_within_a_step_it_stands_still_and_at_the_end_of_time_there_is_a_value() -> None:
    drift = Drift(Chance(5, "radar"), step_ns=S, time_constant_ns=60 * S, n=2)
    values = drift.at(np.array([7 * S, 7 * S + 1, 8 * S - 1, 8 * S]))
    assert values[0].tolist() == values[1].tolist() == values[2].tolist()
    assert values[3].tolist() != values[2].tolist()
    drift = Drift(Chance(5, "radar"), step_ns=20_000_000, time_constant_ns=1e9 * S, n=2)
    assert np.isfinite(drift.at(np.array([0, 7 * 86_400 * S, (1 << 63) - 1]))).all()


# Confusion matrices: what is claimed as often as a row says, and how sure a claim is.


MATRIX = Confusion(
    claims=("drone", "bird", "aircraft"),
    true_classes=("drone", "bird"),
    rows=((0.8, 0.15, 0.05), (0.3, 0.7, 0.0)),
)


def test_what_the_matrix_does_not_name_is_called_nothing_or_what_otherwise_says() -> None:
    true = np.array(["balloon", None, ""] * 500, np.object_)
    kinds, probability = MATRIX.claimed(true, np.random.default_rng(4))
    assert set(kinds) == {""}
    assert np.isnan(probability).all()
    named = replace(MATRIX, otherwise=(0.0, 1.0, 0.0))
    assert set(named.claimed(true, np.random.default_rng(4))[0]) == {"bird"}


def test_rows_whose_sum_rounds_below_one_never_claim_what_there_is_not() -> None:
    thirds = Confusion(
        claims=("a", "b", "c"), true_classes=("a",), rows=((1 / 3, 1 / 3, 1 / 3 - 1e-9),)
    )

    class Last:
        def random(self, size: tuple[int, ...]) -> np.ndarray:
            return np.full(size, np.nextafter(1.0, 0.0))

    rng: np.random.Generator = Last()  # type: ignore[assignment]
    assert thirds.claimed(np.array(["a"], np.object_), rng)[0].tolist() == ["c"]


HELD_NS = 10_000_000_000


def draws_at(seconds: np.ndarray, drone: np.ndarray) -> np.ndarray:
    draws, t_ns = ClaimDraws([Chance(1, "radar")]), (seconds * 1e9).astype(np.int64)
    return draws.of(np.zeros(len(drone), np.int64), drone.astype(np.int64), t_ns, HELD_NS)


def test_held_numbers_stay_for_their_time_and_change_at_times_of_each_drone() -> None:
    seconds, drone = (a.ravel() for a in np.meshgrid(np.arange(100.0), np.arange(8)))
    found = draws_at(seconds, drone).reshape(8, 100)
    changes = [np.flatnonzero(np.diff(of_drone)) for of_drone in found]
    assert all((np.diff(of_drone) == HELD_NS / 1e9).all() for of_drone in changes)
    assert len({int(of_drone[0]) for of_drone in changes}) > 4


def test_held_numbers_are_uniform_over_drones_and_spells_whatever_else_is_asked() -> None:
    spells, drone = (a.ravel() for a in np.meshgrid(np.arange(60.0) * 10, np.arange(60)))
    found = draws_at(spells, drone)
    assert_law(found, "uniform", "held")
    some = np.arange(0, len(drone), 7)
    np.testing.assert_array_equal(found[some], draws_at(spells[some], drone[some]))


def test_a_claim_by_a_number_that_is_held_is_that_of_its_share_of_the_row() -> None:
    true, drawn = np.full(3, "drone", np.object_), np.array([0.79, 0.81, 0.951])
    kinds, _ = MATRIX.claimed(true, np.random.default_rng(6), drawn)
    assert kinds.tolist() == ["drone", "bird", "aircraft"]


# Factors of a degraded sensor where they leave nothing of a probability.


BEAMS = 18
MICROPHONES: dict[str, Any] = {
    "id": "mic", "type": "acoustic", "scan": staring(), "noise_db": 0.0, "sensitivity_db": 0.0,
    "range_max_m": 1000.0, "azimuth_beamwidth_deg": 20.0, "pfa": 0.01, "report": ["plots"],
}  # fmt: skip


def test_more_alarms_than_there_are_cells_keep_their_mean() -> None:
    """A thousand times the alarms of a Pfa of 0.01: ten a cell, which no Pfa gives."""
    made = scene([MICROPHONES | {"degradation": {"false_alarm_factor": 1000.0}}], seed=1)
    model = made.sensor[0].model(made.scene.site)
    assert model.false_alarms_per_scan == pytest.approx(10 * BEAMS, rel=1e-12)
    sector = Sector(0, 0, 0, 1_000_000_000, 0.0, 360.0, stares=True)
    rng = np.random.default_rng(1)
    n = sum(len(model.draw_false_alarms(sector, rng)) for _ in range(100))
    assert_sum(float(n), 1000.0 * BEAMS, 1000.0 * BEAMS * 0.99, "alarms of 100 scans")
