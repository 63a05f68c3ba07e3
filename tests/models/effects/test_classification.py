"""Confusion matrices: what is claimed as often as a row says, and how sure a claim is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.significance import assert_law

from plotfeed.models.chance import Chance
from plotfeed.models.effects.classification import ClaimDraws, Confusion

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
